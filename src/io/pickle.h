/* SPDX-License-Identifier: MIT
 * Python pickles as torch.save writes them, read as if hostile: a machine over a list of opcodes and callables that
 * builds plain values and runs nothing. Whatever is not on the lists is refused with its opcode and offset. */
#ifndef ERN_IO_PICKLE_H
#define ERN_IO_PICKLE_H

#include "io/pickle_value.h"

struct ern_pickle {
  struct ern_pickle_value *root;
  struct ern_pickle_arena *arena; /* memory of all values */
  struct ern_pickle_value **storage;
  size_t storages; /* that its tensors lie in, once for each time that the pickle names one */
};

/* `where` is for messages, such as "head.pth: data.pkl". On success the caller owns *pickle; text points into its own
 * copies, so `bytes` may go. ERN_E_UNSUPPORTED: an opcode or callable that is not on the lists; ERN_E_FORMAT: damaged;
 * ERN_E_SHAPE: more than the limits. */
ERN_NODISCARD ern_status ern_pickle_read(ern_context *context, const char *where, const uint8_t *bytes, size_t count,
                                         struct ern_pickle *pickle);
/* The same of the first of several pickles that follow each other; *used: its bytes. */
ERN_NODISCARD ern_status ern_pickle_read_first(ern_context *context, const char *where, const uint8_t *bytes,
                                               size_t count, struct ern_pickle *pickle, size_t *used);
void ern_pickle_free(ern_context *context, struct ern_pickle *pickle);

#endif
