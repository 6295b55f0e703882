/* SPDX-License-Identifier: MIT
 * The format of torch.save before PyTorch 1.6: five pickles in a row (magic number, version, machine, data, keys of the
 * storages), then for each key the number of elements (int64) and their bytes. */
#ifndef ERN_IO_TORCH_LEGACY_H
#define ERN_IO_TORCH_LEGACY_H

#include "io/pickle.h"

struct ern_legacy_storage {
  const char *key; /* points into the pickle */
  size_t at;       /* offset of its elements in the file */
};

/* Whether the bytes begin with the magic number. */
bool ern_torch_is_legacy(const uint8_t *bytes, size_t count);

/* Reads the data and finds the bytes of its storages by key. Checks that the file has every storage of the pickle,
 * whole and once. On success the caller owns *pickle and *storage (ern_release). */
ERN_NODISCARD ern_status ern_torch_legacy_read(ern_context *context, const char *path, const uint8_t *bytes,
                                               size_t count, struct ern_pickle *pickle,
                                               struct ern_legacy_storage **storage, size_t *storages);
/* NULL where no storage has that key. */
const struct ern_legacy_storage *ern_torch_legacy_find(const struct ern_legacy_storage *storage, size_t storages,
                                                       const char *key);

#endif
