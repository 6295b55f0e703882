/* SPDX-License-Identifier: MIT */
#include "io/landmarks.h"

#include <math.h>
#include <string.h>

#include "core/memory.h"
#include "io/file.h"
#include "io/number.h"

enum { FILE_LIMIT = 1 << 20 };
static const double most_pixels = 1e6; /* from the corner: a point farther away is an error */

static const char *skip_blanks(const char *at, const char *end) {
  while (at < end && (*at == ' ' || *at == '\t' || *at == '\r')) at++;
  return at;
}

/* "x y" and nothing else, both in pixels. */
static bool read_point(const char *at, const char *end, float point[2]) {
  for (int axis = 0; axis < 2; axis++) {
    double value = 0;
    const char *start = skip_blanks(at, end);
    if (axis > 0 && start == at) return false;
    at = start;
    if (!ern_number_read(&at, end, &value) || !(fabs(value) <= most_pixels)) return false;
    point[axis] = (float)value;
  }
  return skip_blanks(at, end) == end;
}

ern_status ern_landmarks_read(ern_context *context, const char *path, float points[ERN_LANDMARKS][2]) {
  ern_status status = ERN_OK;
  uint8_t *bytes = NULL;
  size_t size = 0, lines = 0;
  ERN_TRY(ern_file_read(context, path, FILE_LIMIT, &bytes, &size));
  const char *at = (const char *)bytes + ern_text_mark(bytes, size), *end = (const char *)bytes + size;
  while (end > at && strchr(" \t\r\n", end[-1]) != NULL && end[-1] != 0) end--;
  for (; at < end; lines++) {
    const char *newline = memchr(at, '\n', (size_t)(end - at));
    const char *stop = newline != NULL ? newline : end;
    float point[2] = {0, 0};
    if (!read_point(at, stop, point)) {
      ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: line %zu is \"%.*s\", expected two numbers \"x y\" within 1e6", path,
                       lines + 1, (int)(stop - at < 60 ? stop - at : 60), at));
    }
    if (lines < ERN_LANDMARKS) memcpy(points[lines], point, sizeof point);
    at = newline != NULL ? newline + 1 : end;
  }
  if (lines != ERN_LANDMARKS) {
    ERN_TRY(ern_fail(context, ERN_E_SHAPE, "%s: has %zu landmarks, expected %d", path, lines, ERN_LANDMARKS));
  }
fail:
  ern_release(context, bytes);
  return status;
}
