/* SPDX-License-Identifier: MIT
 * Speech features from a .npy file. */
#include <math.h>

#include "core/floats.h"
#include "core/memory.h"
#include "ernerf/data.h"
#include "io/feature_range.h"
#include "io/npy.h"

enum { MAX_WINDOW = ERN_FEATURE_WINDOW_MOST, MAX_WIDTH = ERN_FEATURE_WIDTH_MOST };

ern_status ern_features_check(ern_context *context, const char *where, const ern_features *features) {
  size_t values = 0, bytes = 0;
  if (features->data == NULL || features->windows < 1 || features->window_length < 1 ||
      features->window_length > MAX_WINDOW || features->width < 1 || features->width > MAX_WIDTH)
    return ern_fail(context, ERN_E_ARGUMENT,
                    "%s: the features are [%zu, %d, %d]%s, expected [1 or more, 1..%d, 1..%d] and data", where,
                    features->windows, features->window_length, features->width,
                    features->data == NULL ? " with data NULL" : "", MAX_WINDOW, MAX_WIDTH);
  if (!ern_size_multiply(features->windows, (size_t)features->window_length * (size_t)features->width, &values) ||
      !ern_size_multiply(values, sizeof(float), &bytes) || bytes > PTRDIFF_MAX)
    return ern_fail(context, ERN_E_ARGUMENT, "%s: the features have %zu windows, which no memory holds", where,
                    features->windows);
  return ERN_OK;
}

ern_status ern_features_check_values(ern_context *context, const char *where, const ern_features *features) {
  const size_t width = (size_t)features->width, window = (size_t)features->window_length * width;
  for (size_t i = 0; i < features->windows * window; i++) {
    const float value = features->data[i];
    if (ern_feature_fits(value)) continue;
    return ern_fail(context, isfinite(value) ? ERN_E_FORMAT : ERN_E_NONFINITE,
                    "%s: value [%zu, %zu, %zu] is %g, expected a finite number, -1e30 to 1e30", where, i / window,
                    i % window / width, i % width, (double)value);
  }
  return ERN_OK;
}

static ern_status check_shape(ern_context *context, const char *path, const struct ern_npy *array) {
  if (array->type != ERN_NPY_F16 && array->type != ERN_NPY_F32 && array->type != ERN_NPY_F64) {
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: holds whole numbers, expected float16, float32 or float64", path);
  }
  if (array->dims != 3) {
    return ern_fail(context, ERN_E_SHAPE, "%s: shape has %d sizes, expected 3: [T, window, D]", path, array->dims);
  }
  const size_t *shape = array->shape;
  if (shape[0] < 1 || shape[1] < 1 || shape[1] > MAX_WINDOW || shape[2] < 1 || shape[2] > MAX_WIDTH) {
    return ern_fail(context, ERN_E_SHAPE, "%s: shape is [%zu, %zu, %zu], expected [T, 1..%d, 1..%d]", path, shape[0],
                    shape[1], shape[2], MAX_WINDOW, MAX_WIDTH);
  }
  return ERN_OK;
}

ern_status ern_features_load(ern_context *context, const char *path, ern_features *features) {
  ERN_PLAIN_FLOATS;
  if (features != NULL) *features = (ern_features){0};
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, features);
  ern_status status = ERN_OK;
  struct ern_npy array = {0};
  ERN_TRY(ern_npy_read(context, path, &array));
  ERN_TRY(check_shape(context, path, &array));
  const ern_features read = {.data = array.data,
                             .windows = array.shape[0],
                             .window_length = (int)array.shape[1],
                             .width = (int)array.shape[2]};
  ERN_TRY(ern_features_check_values(context, path, &read));
  *features = read;
  return ERN_OK;
fail:
  ern_npy_free(context, &array);
  return status;
}

ern_status ern_features_save(ern_context *context, const char *path, const ern_features *features) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, features);
  ern_status status = ern_features_check(context, path, features);
  if (status == ERN_OK) status = ern_features_check_values(context, path, features);
  if (status != ERN_OK) return status;
  return ern_npy_write_f32(context, path, features->data, 3,
                           (size_t[]){features->windows, (size_t)features->window_length, (size_t)features->width});
}

void ern_features_free(ern_context *context, ern_features *features) {
  if (context == NULL || features == NULL) return;
  ern_release(context, features->data);
  *features = (ern_features){0};
}
