/* SPDX-License-Identifier: MIT
 * Any bytes as a safetensors file. */
#include "fuzz.h"
#include "io/safetensors.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  ern_context *context = fuzz_context();
  struct ern_tensor_file file;
  if (ern_safetensors_open(context, "fuzz", fuzz_copy(context, bytes, count), count, &file) == ERN_OK) {
    for (size_t i = 0; i < file.tensor_count; i++)
      fuzz_touch(file.tensors[i].data, file.tensors[i].count * ern_dtype_bytes(file.tensors[i].dtype));
  }
  ern_tensor_file_free(context, &file);
  return 0;
}
