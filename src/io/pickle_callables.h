/* SPDX-License-Identifier: MIT
 * The Python callables that a checkpoint may name. A call runs no Python; it makes a description of the result. */
#ifndef ERN_IO_PICKLE_CALLABLES_H
#define ERN_IO_PICKLE_CALLABLES_H

#include "io/pickle_value.h"

/* The number of a callable, or ERN_E_UNSUPPORTED with its name. */
ERN_NODISCARD ern_status ern_pickle_find_callable(struct ern_pickle_machine *m, const char *module, const char *name,
                                                  int *number);
/* The value that the call would return. */
ERN_NODISCARD ern_status ern_pickle_call(struct ern_pickle_machine *m, int callable,
                                         const struct ern_pickle_value *arguments, struct ern_pickle_value **made);
/* The opcode BUILD: attributes of an ordered dict are left out; a numpy dtype learns its byte order. */
ERN_NODISCARD ern_status ern_pickle_build(struct ern_pickle_machine *m, struct ern_pickle_value *object,
                                          const struct ern_pickle_value *state);
/* The storage that a persistent id names: ("storage", type, key, location, count), before PyTorch 1.6 with a None at
 * the end. */
ERN_NODISCARD ern_status ern_pickle_storage(struct ern_pickle_machine *m, const struct ern_pickle_value *id,
                                            struct ern_pickle_value **storage);

#endif
