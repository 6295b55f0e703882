/* SPDX-License-Identifier: MIT
 * Any bytes as an ONNX file: what is taken has an input and an output whose names and sizes are within bounds. */
#include "fuzz.h"
#include "io/onnx.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  ern_context *context = fuzz_context();
  struct ern_onnx onnx;
  if (ern_onnx_inspect(context, "fuzz.onnx", bytes, count, &onnx) != ERN_OK) {
    fuzz_refused(context, "fuzz.onnx");
    return 0;
  }
  FUZZ_REQUIRE(onnx.dims >= 1 && onnx.dims <= ERN_ONNX_DIMS && onnx.outputs >= 1);
  for (int d = 0; d < onnx.dims; d++) FUZZ_REQUIRE(onnx.shape[d] >= 1);
  FUZZ_REQUIRE(strlen(onnx.input) < ERN_ONNX_NAME);
  for (size_t i = 0; i < onnx.outputs && i < ERN_ONNX_OUTPUTS; i++)
    FUZZ_REQUIRE(strlen(onnx.output[i]) < ERN_ONNX_NAME);
  return 0;
}
