/* SPDX-License-Identifier: MIT
 * The zip that torch.save writes (PyTorch 1.6 and later): data.pkl describes the contents, data/KEY holds the bytes of
 * a storage. Read as untrusted input; written so that torch.load(weights_only=True) opens it. The older format
 * (torch_legacy.h) is read too. */
#ifndef ERN_IO_TORCH_ZIP_H
#define ERN_IO_TORCH_ZIP_H

#include "io/file.h"
#include "io/pickle.h"

/* Most entries of a zip that is read or written; a training's state has 300. The zip library looks names up in a hash
 * table without a random seed, so crafted names cost time quadratic in their number. */
enum { ERN_TORCH_ENTRIES = 1 << 13 };

/* An open file. ern_torch_tensors gives the tensors of the pickle their bytes, and a name to those without one. */
struct ern_torch {
  struct ern_pickle pickle;
  void *private_data;
};

/* Whether the bytes begin as a zip does, or as the tar of PyTorch's first versions, which is not read. */
bool ern_torch_is_zip(const uint8_t *bytes, size_t count);
bool ern_torch_is_tar(const uint8_t *bytes, size_t count);
/* Whether the bytes are a PyTorch file of any format; ern_torch_open refuses those that it cannot read. */
bool ern_torch_is_torch(const uint8_t *bytes, size_t count);
/* ERN_E_FORMAT where a zip's central directory is not at its end. Checked before the whole file is read. */
ERN_NODISCARD ern_status ern_torch_check_end(const struct ern_file_reader *reader);

/* Takes ownership of `bytes` (made by ern_allocate), also when it fails. `path` is for messages and must outlive the
 * file. */
ERN_NODISCARD ern_status ern_torch_open(ern_context *context, const char *path, uint8_t *bytes, size_t count,
                                        struct ern_torch *torch);
void ern_torch_close(ern_context *context, struct ern_torch *torch);

/* Gives a tensor of the pickle the name PREFIX + NAME, unless it has one. */
ERN_NODISCARD ern_status ern_torch_name(ern_context *context, struct ern_torch *torch, struct ern_pickle_value *tensor,
                                        const char *prefix, const char *name);

/* All tensors, contiguous: first those that ern_torch_name named, then the others in the order of the pickle. And the
 * tree that contains them, as JSON (owned by the caller, ern_release): {"dict": [[key, value], ...]}, {"ordered": ...},
 * {"tuple": [...]}, [...] for a list, {"tensor": NAME},
 * {"bytes": HEX}, {"float": "nan"}, and numbers, texts, true, false, null as themselves. A tensor without a name gets
 * `prefix` and its path, such as "stats.results.0". *file takes ownership of `torch`, also when it fails. */
ERN_NODISCARD ern_status ern_torch_tensors(ern_context *context, struct ern_torch *torch, const char *prefix,
                                           struct ern_tensor_file *file, char **tree);

/* Writes such a tree with its tensors, which are looked up in `tensors`. Floats become zero-dimensional float64 tensors
 * unless the tree has an "optimizer": PyTorch 1.13 refuses plain floats with weights_only=True. Atomic. */
ERN_NODISCARD ern_status ern_torch_write(ern_context *context, const char *path, const char *tree,
                                         const struct ern_tensor *tensors, size_t tensor_count);
struct json_t; /* jansson's */
ERN_NODISCARD ern_status ern_torch_write_tree(ern_context *context, const char *path, const struct json_t *tree,
                                              const struct ern_tensor *tensors, size_t tensor_count);

#endif
