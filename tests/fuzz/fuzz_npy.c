/* SPDX-License-Identifier: MIT
 * Any bytes as a .npy file: as an array, as speech features, as a curve of the lids. */
#include <math.h>

#include "ernerf/data.h"
#include "fuzz.h"
#include "io/npy.h"

static const char path[] = "fuzz.npy";

static size_t item_bytes(ern_npy_type type) { return type == ERN_NPY_U8 ? 1 : type == ERN_NPY_I64 ? 8 : 4; }

static void read_array(ern_context *context) {
  struct ern_npy array;
  if (ern_npy_read(context, path, &array) != ERN_OK) {
    fuzz_refused(context, path);
    return;
  }
  size_t count = 1;
  for (int i = 0; i < array.dims; i++) count *= array.shape[i];
  FUZZ_REQUIRE(count == array.count);
  fuzz_touch(array.data, array.count * item_bytes(array.type));
  ern_npy_free(context, &array);
}

static void read_features(ern_context *context) {
  ern_features features;
  if (ern_features_load(context, path, &features) != ERN_OK) {
    fuzz_refused(context, path);
    return;
  }
  const size_t count = features.windows * (size_t)features.window_length * (size_t)features.width;
  FUZZ_REQUIRE(count > 0);
  for (size_t i = 0; i < count; i++) FUZZ_REQUIRE(fabsf(features.data[i]) <= 1e30f);
  ern_features_free(context, &features);
}

static void read_eyes(ern_context *context) {
  ern_eyes eyes;
  if (ern_eyes_load(context, path, &eyes) != ERN_OK) {
    fuzz_refused(context, path);
    return;
  }
  FUZZ_REQUIRE(eyes.count > 0);
  for (size_t i = 0; i < eyes.count; i++) FUZZ_REQUIRE(eyes.data[i] >= 0 && eyes.data[i] <= 1);
  ern_eyes_free(context, &eyes);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  fuzz_file(path, bytes, count);
  read_array(fuzz_context());
  read_features(fuzz_context());
  read_eyes(fuzz_context());
  return 0;
}
