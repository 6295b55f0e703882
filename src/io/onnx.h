/* SPDX-License-Identifier: MIT
 * Reads the input and outputs that an ONNX file declares, and checks what a reader of its weights relies on. */
#ifndef ERN_IO_ONNX_H
#define ERN_IO_ONNX_H

#include <stdint.h>

#include "core/status.h"

enum { ERN_ONNX_DIMS = 8, ERN_ONNX_OUTPUTS = 16, ERN_ONNX_NAME = 128 };

struct ern_onnx {
  char input[ERN_ONNX_NAME]; /* of the one input that is no weight: float, of fixed sizes */
  int dims, shape[ERN_ONNX_DIMS];
  size_t outputs;                               /* of the file; may be more than ERN_ONNX_OUTPUTS */
  char output[ERN_ONNX_OUTPUTS][ERN_ONNX_NAME]; /* names of the first ones */
};

/* Parses the bytes of a file. Checks that each weight has as many numbers as its sizes say, and lies in the file.
 * ERN_E_FORMAT: not an ONNX file, truncated, or inconsistent; ERN_E_UNSUPPORTED: sizes that are not fixed, more inputs
 * than one, or weights in other files. */
ERN_NODISCARD ern_status ern_onnx_inspect(ern_context *context, const char *path, const uint8_t *bytes, size_t count,
                                          struct ern_onnx *onnx);

#endif
