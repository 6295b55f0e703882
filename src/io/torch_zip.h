/* SPDX-License-Identifier: MIT
 * The zip that torch.save writes (PyTorch 1.6 and later): data.pkl says what there is, data/KEY holds the bytes of a
 * storage. Read as if hostile; written so that torch.load(weights_only=True) opens it. What PyTorch wrote before
 * (torch_legacy.h) is read too. */
#ifndef ERN_IO_TORCH_ZIP_H
#define ERN_IO_TORCH_ZIP_H

#include "io/file.h"
#include "io/pickle.h"

/* Entries of a zip, the most that are read or written: a training's state has 300. The library that reads zips looks
 * names up in a hash without a key, so crafted names cost it the square of their number. */
enum { ERN_TORCH_ENTRIES = 1 << 13 };

/* An open file. Tensors of the pickle get their bytes, and those without a name one, in ern_torch_tensors. */
struct ern_torch {
  struct ern_pickle pickle;
  void *private_data;
};

/* Whether the bytes begin as a zip does, or as the tar of PyTorch's first versions, which is not read. */
bool ern_torch_is_zip(const uint8_t *bytes, size_t count);
bool ern_torch_is_tar(const uint8_t *bytes, size_t count);
/* Whether PyTorch wrote them, in any form; ern_torch_open says which it does not read. */
bool ern_torch_is_torch(const uint8_t *bytes, size_t count);
/* ERN_E_FORMAT where a zip's list of entries is not at its end: to be known before all of it is read. */
ERN_NODISCARD ern_status ern_torch_check_end(const struct ern_file_reader *reader);

/* Takes `bytes` (made by ern_allocate) over, also when it fails. `path` is for messages and must outlive the file. */
ERN_NODISCARD ern_status ern_torch_open(ern_context *context, const char *path, uint8_t *bytes, size_t count,
                                        struct ern_torch *torch);
void ern_torch_close(ern_context *context, struct ern_torch *torch);

/* Gives a tensor of the pickle the name PREFIX + NAME, unless it has one. */
ERN_NODISCARD ern_status ern_torch_name(ern_context *context, struct ern_torch *torch, struct ern_pickle_value *tensor,
                                        const char *prefix, const char *name);

/* All tensors, contiguous, those named before first and the others in the order of the pickle; and the tree that they
 * hang in as JSON (owned by the caller, ern_release): {"dict": [[key, value], ...]}, {"ordered": ...}, {"tuple":
 * [...]}, [...] for a list, {"tensor": NAME},
 * {"bytes": HEX}, {"float": "nan"}, and numbers, texts, true, false, null as themselves. A tensor without a name gets
 * `prefix` and its path, such as "stats.results.0". *file takes `torch` over, also when it fails. */
ERN_NODISCARD ern_status ern_torch_tensors(ern_context *context, struct ern_torch *torch, const char *prefix,
                                           struct ern_tensor_file *file, char **tree);

/* Writes such a tree with its tensors, which are looked up in `tensors`. Floats become float64 tensors without sides
 * unless the tree has an "optimizer": PyTorch 1.13 opens no others with weights_only=True. Atomic. */
ERN_NODISCARD ern_status ern_torch_write(ern_context *context, const char *path, const char *tree,
                                         const struct ern_tensor *tensors, size_t tensor_count);

#endif
