/* SPDX-License-Identifier: MIT
 * Any header as that of a model, read and converted to PyTorch's form; what does not begin as JSON is taken for a whole
 * file. */
#include "ernerf/model.h"
#include "fuzz_header.h"

static void check(const ern_model *model) {
  ern_model_info info;
  ern_model_describe(model, &info);
  FUZZ_REQUIRE(info.levels >= 1 && info.levels <= 24 && info.feature_width >= 1);
  FUZZ_REQUIRE(info.bound > 0 && info.bound <= 16);
  FUZZ_REQUIRE(info.head_steps <= (uint64_t)1 << 53 && info.torso_steps <= (uint64_t)1 << 53);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  static const char path[] = "fuzz.safetensors", converted[] = "fuzz.pth";
  ern_context *context = fuzz_context();
  ern_model *model = NULL;
  if (count > 0 && bytes[0] == '{')
    fuzz_header_file(path, bytes, count);
  else
    fuzz_file(path, bytes, count);
  if (ern_model_load(&model, context, path) == ERN_OK)
    check(model);
  else
    fuzz_refused(context, path);
  ern_model_free(&model);
  unlink(converted);
  if (ern_file_convert(context, path, converted) != ERN_OK) FUZZ_REQUIRE(access(converted, F_OK) != 0);
  return 0;
}
