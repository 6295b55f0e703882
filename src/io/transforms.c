/* SPDX-License-Identifier: MIT
 * Head poses from a transforms_*.json file. */
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "ernerf/data.h"
#include "io/file.h"
#include "io/json.h"

/* JSON_LIMIT, bytes of memory, holds some 300,000 frames: three hours */
enum { FILE_LIMIT = 1 << 26, JSON_LIMIT = 1 << 30, MAX_SIDE = 8192, MAX_ID = 999999999 };

/* Limits of a matrix: entries of a rotation are at most 1, and a camera is some units from the head. Numbers far beyond
 * are errors of the program that wrote the file. */
static const double MAX_ROTATION = 1e3, MAX_PLACE = 1e6;

/* The position of a value in the file, for messages. */
struct place {
  ern_context *context;
  const char *path;
  long long frame; /* -1: not in a frame */
};

/* "FILE: frame 3: field FIELD is FOUND, expected EXPECTED" */
static ern_status wrong(const struct place *place, ern_status code, const char *field, const json_t *found,
                        const char *expected) {
  char frame[48] = "";
  if (place->frame >= 0) snprintf(frame, sizeof frame, "frame %lld: ", place->frame);
  char value[64] = "missing";
  if (found != NULL && json_dumpb(found, NULL, 0, JSON_ENCODE_ANY) < sizeof value) {
    value[json_dumpb(found, value, sizeof value, JSON_ENCODE_ANY)] = 0;
  } else if (found != NULL) {
    snprintf(value, sizeof value, "%s", json_is_object(found) ? "an object" : json_is_array(found) ? "a list" : "long");
  }
  return ern_fail(place->context, code, "%s: %sfield %s is %s, expected %s", place->path, frame, field, value,
                  expected);
}

/* JSON has neither NaN nor infinity; a number past the range of double is an error of its parser. */
static ern_status read_positive(const struct place *place, const json_t *object, const char *field, double *value) {
  const json_t *found = json_object_get(object, field);
  *value = json_number_value(found);
  if (found == NULL) return wrong(place, ERN_E_FORMAT, field, found, "a positive number");
  if (!json_is_number(found)) return wrong(place, ERN_E_FORMAT, field, found, "a positive number");
  if (!(*value > 0) || !(*value <= (double)FLT_MAX)) {
    return wrong(place, ERN_E_FORMAT, field, found, "a positive number within float32");
  }
  return ERN_OK;
}

static ern_status read_id(const struct place *place, const json_t *frame, const char *field, int64_t *id) {
  static const char expected[] = "a whole number of at least 0 and at most 999999999";
  const json_t *found = json_object_get(frame, field);
  if (found == NULL) return wrong(place, ERN_E_FORMAT, field, found, expected);
  if (!json_is_integer(found) || json_integer_value(found) < 0 || json_integer_value(found) > MAX_ID) {
    return wrong(place, ERN_E_FORMAT, field, found, expected);
  }
  *id = json_integer_value(found);
  return ERN_OK;
}

/* R^T R = 1 and det R = 1, up to the rounding of files with a few decimals: a camera that scales, shears or mirrors
 * renders a distorted head. */
static ern_status check_rotation(const struct place *place, const json_t *rows, const float m[16]) {
  static const double tolerance = 1e-2;
  double worst = 0;
  for (int i = 0; i < 3; i++)
    for (int j = 0; j <= i; j++) {
      double product = i == j ? -1 : 0;
      for (int k = 0; k < 3; k++) product += (double)m[4 * k + i] * (double)m[4 * k + j];
      worst = fmax(worst, fabs(product));
    }
  const double minor[3] = {(double)m[5] * (double)m[10] - (double)m[6] * (double)m[9],
                           (double)m[4] * (double)m[10] - (double)m[6] * (double)m[8],
                           (double)m[4] * (double)m[9] - (double)m[5] * (double)m[8]};
  const double determinant = (double)m[0] * minor[0] - (double)m[1] * minor[1] + (double)m[2] * minor[2];
  if (worst <= tolerance && determinant > 0) return ERN_OK;
  return wrong(place, ERN_E_FORMAT, "transform_matrix", rows,
               "a rotation in its first 3 rows and columns: columns of length 1 at right angles, determinant 1");
}

static ern_status read_matrix(const struct place *place, const json_t *frame, float matrix[16]) {
  const json_t *rows = json_object_get(frame, "transform_matrix");
  if (rows == NULL) return wrong(place, ERN_E_FORMAT, "transform_matrix", rows, "4 rows of 4 numbers");
  if (json_array_size(rows) != 4) return wrong(place, ERN_E_SHAPE, "transform_matrix", rows, "4 rows of 4 numbers");
  for (size_t i = 0; i < 16; i++) {
    const json_t *row = json_array_get(rows, i / 4), *cell = json_array_get(row, i % 4);
    char field[40];
    snprintf(field, sizeof field, "transform_matrix[%zu]", i / 4);
    if (json_array_size(row) != 4) return wrong(place, ERN_E_SHAPE, field, row, "4 numbers");
    snprintf(field, sizeof field, "transform_matrix[%zu][%zu]", i / 4, i % 4);
    if (!json_is_number(cell)) return wrong(place, ERN_E_FORMAT, field, cell, "a number");
    const double value = json_number_value(cell);
    const bool turns = i % 4 < 3;
    if (!(fabs(value) <= (turns ? MAX_ROTATION : MAX_PLACE)))
      return wrong(place, ERN_E_FORMAT, field, cell, turns ? "a number of at most 1e3" : "a number of at most 1e6");
    matrix[i] = (float)value;
    if (i < 12) continue;
    const float last = i == 15 ? 1.0f : 0.0f; /* the last row is 0 0 0 1; float arithmetic may leave rounding errors */
    if (fabs(value - (double)last) > 1e-6) return wrong(place, ERN_E_FORMAT, field, cell, i == 15 ? "1" : "0");
    matrix[i] = last;
  }
  return check_rotation(place, rows, matrix);
}

/* One side of the picture in pixels: field `field`, else twice the principal point. */
static ern_status read_side(const struct place *place, const json_t *root, const char *field, double centre,
                            int *side) {
  const json_t *found = json_object_get(root, field);
  if (found == NULL) {
    const double twice = 2 * centre;
    if (!(twice <= MAX_SIDE) || lround(twice) < 1) {
      return ern_fail(place->context, ERN_E_FORMAT, "%s: field c%s is %g, expected 0.5 to %d where w and h are absent",
                      place->path, field[0] == 'w' ? "x" : "y", centre, MAX_SIDE / 2);
    }
    *side = (int)lround(twice);
    return ERN_OK;
  }
  const double value = json_is_number(found) ? json_number_value(found) : 0;
  if (!(value >= 1) || !(value <= MAX_SIDE) || value != floor(value)) {
    return wrong(place, ERN_E_FORMAT, field, found, "a whole number of pixels, 1 to 8192");
  }
  *side = (int)value;
  return ERN_OK;
}

static ern_status read_camera(const struct place *place, const json_t *root, ern_pose_list *list) {
  ern_status status = ERN_OK;
  ERN_TRY(read_positive(place, root, "focal_len", &list->focal));
  ERN_TRY(read_positive(place, root, "cx", &list->cx));
  ERN_TRY(read_positive(place, root, "cy", &list->cy));
  const bool has_width = json_object_get(root, "w") != NULL, has_height = json_object_get(root, "h") != NULL;
  if (has_width != has_height) {
    ERN_TRY(wrong(place, ERN_E_FORMAT, has_width ? "h" : "w", NULL, "both w and h, or neither"));
  }
  ERN_TRY(read_side(place, root, "w", list->cx, &list->width));
  ERN_TRY(read_side(place, root, "h", list->cy, &list->height));
fail:
  return status;
}

static ern_status read_frames(struct place *place, const json_t *root, ern_pose_list *list) {
  ern_status status = ERN_OK;
  const json_t *frames = json_object_get(root, "frames");
  if (frames == NULL) return wrong(place, ERN_E_FORMAT, "frames", frames, "a list of frames");
  if (json_array_size(frames) == 0) return wrong(place, ERN_E_FORMAT, "frames", frames, "a list of at least one frame");
  ERN_TRY(ERN_NEW(place->context, json_array_size(frames), &list->poses));
  list->count = json_array_size(frames);
  for (size_t i = 0; i < list->count; i++) {
    const json_t *frame = json_array_get(frames, i);
    place->frame = (long long)i;
    if (!json_is_object(frame)) ERN_TRY(wrong(place, ERN_E_FORMAT, "frames[]", frame, "an object"));
    ERN_TRY(read_id(place, frame, "img_id", &list->poses[i].img_id));
    ERN_TRY(read_id(place, frame, "aud_id", &list->poses[i].aud_id));
    ERN_TRY(read_matrix(place, frame, list->poses[i].matrix));
  }
fail:
  return status;
}

ern_status ern_pose_list_load(ern_context *context, const char *path, ern_pose_list *list) {
  ERN_PLAIN_FLOATS;
  if (list != NULL) *list = (ern_pose_list){0};
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, list);
  ern_status status = ERN_OK;
  struct place place = {.context = context, .path = path, .frame = -1};
  uint8_t *bytes = NULL;
  size_t size = 0;
  json_t *root = NULL;
  ERN_TRY(ern_file_read(context, path, FILE_LIMIT, &bytes, &size));
  ERN_TRY(ern_json_parse(context, path, "", (const char *)bytes, size, JSON_LIMIT, &root));
  ERN_TRY(read_camera(&place, root, list));
  ERN_TRY(read_frames(&place, root, list));
  goto done;
fail:
  ern_pose_list_free(context, list);
done:
  json_decref(root);
  ern_release(context, bytes);
  return status;
}

void ern_pose_list_free(ern_context *context, ern_pose_list *list) {
  if (context == NULL || list == NULL) return;
  ern_release(context, list->poses);
  *list = (ern_pose_list){0};
}
