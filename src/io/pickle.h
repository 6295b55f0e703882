/* SPDX-License-Identifier: MIT
 * Python pickles as torch.save writes them, read as untrusted input: a machine with fixed lists of opcodes and
 * callables, which builds plain values and runs no Python. Anything that is not on the lists is refused with its opcode
 * and offset. */
#ifndef ERN_IO_PICKLE_H
#define ERN_IO_PICKLE_H

#include "io/pickle_value.h"

struct ern_pickle {
  struct ern_pickle_value *root;
  struct ern_pickle_arena *arena; /* memory of all values */
  struct ern_pickle_value **storage;
  size_t storages; /* of its tensors; listed once for each time that the pickle names it */
};

/* `where` is for messages, such as "head.pth: data.pkl". On success the caller owns *pickle, which has its own copies
 * of texts: `bytes` may be released. ERN_E_UNSUPPORTED: an opcode or callable that is not on the lists; ERN_E_FORMAT:
 * damaged; ERN_E_SHAPE: more than the limits. */
ERN_NODISCARD ern_status ern_pickle_read(ern_context *context, const char *where, const uint8_t *bytes, size_t count,
                                         struct ern_pickle *pickle);
/* The same for the first of several pickles in a row; *used: its length in bytes. */
ERN_NODISCARD ern_status ern_pickle_read_first(ern_context *context, const char *where, const uint8_t *bytes,
                                               size_t count, struct ern_pickle *pickle, size_t *used);
void ern_pickle_free(ern_context *context, struct ern_pickle *pickle);

#endif
