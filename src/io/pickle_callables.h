/* SPDX-License-Identifier: MIT
 * The callables that a checkpoint names, as descriptions of what they would make. */
#ifndef ERN_IO_PICKLE_CALLABLES_H
#define ERN_IO_PICKLE_CALLABLES_H

#include "io/pickle_value.h"

/* The number of a callable, or ERN_E_UNSUPPORTED with its name. */
ERN_NODISCARD ern_status ern_pickle_find_callable(struct ern_pickle_machine *m, const char *module, const char *name,
                                                  int *number);
/* What calling it would give. */
ERN_NODISCARD ern_status ern_pickle_call(struct ern_pickle_machine *m, int callable,
                                         const struct ern_pickle_value *arguments, struct ern_pickle_value **made);
/* The opcode BUILD: attributes of an ordered dict are left out; a numpy dtype learns its byte order. */
ERN_NODISCARD ern_status ern_pickle_build(struct ern_pickle_machine *m, struct ern_pickle_value *object,
                                          const struct ern_pickle_value *state);
/* ("storage", type, key, place, count), before PyTorch 1.6 with a None behind, as the storage it names. */
ERN_NODISCARD ern_status ern_pickle_storage(struct ern_pickle_machine *m, const struct ern_pickle_value *id,
                                            struct ern_pickle_value **storage);

#endif
