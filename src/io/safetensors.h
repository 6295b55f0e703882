/* SPDX-License-Identifier: MIT
 * safetensors files: an 8-byte length, a JSON header, the bytes of the tensors. Read as untrusted input. */
#ifndef ERN_IO_SAFETENSORS_H
#define ERN_IO_SAFETENSORS_H

#include "core/status.h"
#include "io/file.h"

enum { ERN_TENSOR_MAX_DIMS = 4 };

typedef enum ern_dtype {
  ERN_F32,
  ERN_F16,
  ERN_BF16,
  ERN_U8,
  ERN_BOOL,
  ERN_I32,
  ERN_I64,
  ERN_F64,
  ERN_I8,
  ERN_I16
} ern_dtype;
const char *ern_dtype_name(ern_dtype dtype); /* "F32", as safetensors writes it */
size_t ern_dtype_bytes(ern_dtype dtype);

struct ern_tensor {
  const char *name;
  ern_dtype dtype;
  int dims;
  size_t shape[ERN_TENSOR_MAX_DIMS];
  size_t count;     /* product of shape, 1 for a scalar */
  size_t at;        /* of a file that was read: first byte after the header */
  const void *data; /* count * ern_dtype_bytes(dtype) bytes, little endian, aligned to its own size */
};

struct ern_metadata {
  const char *key, *value;
};

/* A file in memory. Tensors are sorted by their place in the file. */
struct ern_tensor_file {
  size_t tensor_count, metadata_count;
  struct ern_tensor *tensors;
  struct ern_metadata *metadata;
  void *private_data;
  void (*release)(ern_context *context, void *private_data); /* of private_data; NULL: that of a safetensors file */
};

/* Checks every size, offset, overlap, gap and name before it takes memory for the data. The caller owns the result
 * (ern_tensor_file_free). */
ERN_NODISCARD ern_status ern_safetensors_read(ern_context *context, const char *path, struct ern_tensor_file *file);
/* The same for bytes in memory (made by ern_allocate), of which it takes ownership, also when it fails. `path` is for
 * messages. */
ERN_NODISCARD ern_status ern_safetensors_open(ern_context *context, const char *path, uint8_t *bytes, size_t size,
                                              struct ern_tensor_file *file);
void ern_tensor_file_free(ern_context *context, struct ern_tensor_file *file);

/* NULL where there is none with that name. */
const struct ern_tensor *ern_tensor_file_find(const struct ern_tensor_file *file, const char *name);
const char *ern_tensor_file_metadata(const struct ern_tensor_file *file, const char *key);

/* Converts any float tensor (F32, F16, BF16, F64) to float: out[count]. */
ERN_NODISCARD ern_status ern_tensor_to_float(ern_context *context, const struct ern_tensor *tensor, float *out);

/* Writes tensors in the given order, atomically (io/file.h). The metadata may be empty. */
ERN_NODISCARD ern_status ern_safetensors_write(ern_context *context, const char *path, const struct ern_tensor *tensors,
                                               size_t tensor_count, const struct ern_metadata *metadata,
                                               size_t metadata_count, enum ern_existing existing);

#endif
