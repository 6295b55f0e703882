/* SPDX-License-Identifier: MIT
 * NumPy's .npy files, versions 1 to 3, read as untrusted input. */
#ifndef ERN_IO_NPY_H
#define ERN_IO_NPY_H

#include "core/status.h"

enum { ERN_NPY_MAX_DIMS = 4 };

typedef enum ern_npy_type { ERN_NPY_F16, ERN_NPY_F32, ERN_NPY_F64, ERN_NPY_U8, ERN_NPY_I32, ERN_NPY_I64 } ern_npy_type;

struct ern_npy {
  ern_npy_type type; /* as stored in the file */
  int dims;          /* 0..ERN_NPY_MAX_DIMS */
  size_t shape[ERN_NPY_MAX_DIMS];
  size_t count; /* product of shape */
  void *data;   /* F16 and F64 are converted to float; U8, I32, I64 are not. Owned by the caller. */
};

/* C order, little endian only; anything else is refused with a message, and so is a file shorter or longer than its
 * header says. */
ERN_NODISCARD ern_status ern_npy_read(ern_context *context, const char *path, struct ern_npy *array);
void ern_npy_free(ern_context *context, struct ern_npy *array);

/* Writes float32 in C order, atomically (io/file.h). */
ERN_NODISCARD ern_status ern_npy_write_f32(ern_context *context, const char *path, const float *data, int dims,
                                           const size_t *shape);

#endif
