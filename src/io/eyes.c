/* SPDX-License-Identifier: MIT
 * Reads the eyes' values of all frames from a file: a table of action units, one number per line, or an array. */
#include <math.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "ernerf/data.h"
#include "io/csv.h"
#include "io/file.h"
#include "io/npy.h"
#include "io/number.h"

/* Of AU45_r, in OpenFace's units; from CLOSED on an eye is shut. */
#define MOST_INTENSITY 5.0f
#define CLOSED 2.0f

enum { FILE_LIMIT = 1 << 28, MOST_LINES = 1 << 24, SHOWN = 60 };

static ern_status check_value(ern_context *context, const char *path, const char *where, size_t row, float value,
                              float most) {
  if (value >= 0 && value <= most) return ERN_OK;
  return ern_fail(context, ERN_E_FORMAT, "%s: %s %zu is %g, expected 0 to %g", path, where, row, (double)value,
                  (double)most);
}

/* ---- a table ----------------------------------------------------------------------------------------------------- */

static ern_status read_table(ern_context *context, const char *path, ern_eyes *eyes) {
  ern_status status = ern_csv_read_column(context, path, "AU45_r", &eyes->data, &eyes->count);
  for (size_t i = 0; status == ERN_OK && i < eyes->count; i++) {
    status = check_value(context, path, "column AU45_r, line", i + 2, eyes->data[i], MOST_INTENSITY);
    eyes->data[i] = fminf(eyes->data[i], CLOSED) / CLOSED;
  }
  return status;
}

/* ---- an array ---------------------------------------------------------------------------------------------------- */

static ern_status read_array(ern_context *context, const char *path, ern_eyes *eyes) {
  struct ern_npy array = {0};
  ern_status status = ern_npy_read(context, path, &array);
  if (status != ERN_OK) return status;
  eyes->data = array.data;
  eyes->count = array.count;
  const bool floats = array.type == ERN_NPY_F16 || array.type == ERN_NPY_F32 || array.type == ERN_NPY_F64;
  if (!floats)
    return ern_fail(context, ERN_E_FORMAT, "%s: holds whole numbers, expected float16, float32 or float64", path);
  if (array.dims < 1 || array.dims > 2 || (array.dims == 2 && array.shape[1] != 1))
    return ern_fail(context, ERN_E_SHAPE, "%s: has %d dimensions and %zu values, expected the shape [T] or [T, 1]",
                    path, array.dims, array.count);
  for (size_t i = 0; status == ERN_OK && i < eyes->count; i++)
    status = check_value(context, path, "value", i, eyes->data[i], 1);
  return status;
}

/* ---- a number a line --------------------------------------------------------------------------------------------- */

static bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\r'; }

/* Reads the line that begins at *at and moves *at past it; false where it is not one number. */
static bool take_number(const char **at, const char *end, double *value) {
  const char *newline = memchr(*at, '\n', (size_t)(end - *at)), *stop = newline != NULL ? newline : end;
  const char *from = *at;
  *at = newline != NULL ? newline + 1 : end;
  while (from < stop && is_blank(*from)) from++;
  while (stop > from && is_blank(stop[-1])) stop--;
  return ern_number_read(&from, stop, value) && from == stop;
}

static ern_status read_lines(ern_context *context, const char *path, const char *text, const char *end,
                             ern_eyes *eyes) {
  size_t lines = 1;
  for (const char *at = text; at < end; at++) lines += *at == '\n';
  if (lines > MOST_LINES)
    return ern_fail(context, ERN_E_SHAPE, "%s: has %zu lines, expected at most %d", path, lines, MOST_LINES);
  ern_status status = ERN_NEW(context, lines, &eyes->data);
  for (const char *at = text; status == ERN_OK && at < end; eyes->count++) {
    const char *line = at;
    double value = 0;
    if (!take_number(&at, end, &value)) {
      const int length = (int)strcspn(line, "\r\n");
      return ern_fail(context, ERN_E_FORMAT, "%s: line %zu is \"%.*s\", expected one number from 0 to 1", path,
                      eyes->count + 1, length < SHOWN ? length : SHOWN, line);
    }
    eyes->data[eyes->count] = (float)value;
    status = check_value(context, path, "line", eyes->count + 1, eyes->data[eyes->count], 1);
  }
  return status;
}

/* A file whose first line is a number has no header. */
static ern_status read_text(ern_context *context, const char *path, ern_eyes *eyes) {
  uint8_t *bytes = NULL;
  size_t size = 0;
  double first = 0;
  ern_status status = ern_file_read(context, path, FILE_LIMIT, &bytes, &size);
  if (status != ERN_OK) return status;
  const char *text = (const char *)bytes + ern_text_mark(bytes, size), *at = text, *end = (const char *)bytes + size;
  while (end > text && (is_blank(end[-1]) || end[-1] == '\n')) end--;
  status = text < end && take_number(&at, end, &first) ? read_lines(context, path, text, end, eyes)
                                                       : read_table(context, path, eyes);
  ern_release(context, bytes);
  return status;
}

/* ------------------------------------------------------------------------------------------------------------------ */

ern_status ern_eyes_load(ern_context *context, const char *path, ern_eyes *eyes) {
  ERN_PLAIN_FLOATS;
  if (eyes != NULL) *eyes = (ern_eyes){0};
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, eyes);
  const size_t length = strlen(path);
  ern_status status = length > 4 && strcmp(path + length - 4, ".npy") == 0 ? read_array(context, path, eyes)
                                                                           : read_text(context, path, eyes);
  if (status == ERN_OK && eyes->count == 0)
    status = ern_fail(context, ERN_E_SHAPE, "%s: holds no value, expected one a frame", path);
  if (status != ERN_OK) ern_eyes_free(context, eyes);
  return status;
}

void ern_eyes_free(ern_context *context, ern_eyes *eyes) {
  if (context == NULL || eyes == NULL) return;
  ern_release(context, eyes->data);
  *eyes = (ern_eyes){0};
}
