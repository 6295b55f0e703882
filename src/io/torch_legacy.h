/* SPDX-License-Identifier: MIT
 * What torch.save wrote before PyTorch 1.6: five pickles one after the other (a mark, the version, the machine, the
 * data, the keys of its storages), then of each key the number of its elements (int64) and their bytes. */
#ifndef ERN_IO_TORCH_LEGACY_H
#define ERN_IO_TORCH_LEGACY_H

#include "io/pickle.h"

struct ern_legacy_storage {
  const char *key; /* lies in the pickle */
  size_t at;       /* offset of its elements in the file */
};

/* Whether the bytes begin so. */
bool ern_torch_is_legacy(const uint8_t *bytes, size_t count);

/* The data, and where the bytes of its storages are, by key. Every storage of the pickle is there, whole and once. On
 * success the caller owns *pickle and *storage (ern_release). */
ERN_NODISCARD ern_status ern_torch_legacy_read(ern_context *context, const char *path, const uint8_t *bytes,
                                               size_t count, struct ern_pickle *pickle,
                                               struct ern_legacy_storage **storage, size_t *storages);
/* NULL where there is none of that key. */
const struct ern_legacy_storage *ern_torch_legacy_find(const struct ern_legacy_storage *storage, size_t storages,
                                                       const char *key);

#endif
