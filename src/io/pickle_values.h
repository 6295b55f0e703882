/* SPDX-License-Identifier: MIT
 * Between the pickle machine (pickle.c) and the callables it knows (pickle_values.c). */
#ifndef ERN_IO_PICKLE_VALUES_H
#define ERN_IO_PICKLE_VALUES_H

#include "io/pickle.h"

struct ern_pickle_pointers {
  struct ern_pickle_value **item;
  size_t count, room;
};

struct ern_pickle_machine {
  ern_context *context;
  const char *where;
  const uint8_t *bytes;
  size_t count, at;
  size_t begin; /* of the opcode at work */
  uint8_t opcode;
  struct ern_pickle_pointers stack, memo;
  struct ern_pickle_value mark;
  struct arena *arena;
};

/* Room of the machine's arena, within its limit. */
ERN_NODISCARD ern_status ern_pickle_room(struct ern_pickle_machine *m, size_t bytes, void **room);
ERN_NODISCARD ern_status ern_pickle_make(struct ern_pickle_machine *m, ern_pickle_kind kind,
                                         struct ern_pickle_value **value);
ERN_NODISCARD ern_status ern_pickle_append(struct ern_pickle_machine *m, struct ern_pickle_value *list,
                                           struct ern_pickle_value *item);

/* The number of a callable, or ERN_E_UNSUPPORTED with its name. */
ERN_NODISCARD ern_status ern_pickle_find_callable(struct ern_pickle_machine *m, const char *module, const char *name,
                                                  int *number);
/* What calling it would give. */
ERN_NODISCARD ern_status ern_pickle_call(struct ern_pickle_machine *m, int callable,
                                         const struct ern_pickle_value *arguments, struct ern_pickle_value **made);
/* The opcode BUILD: attributes of an ordered dict are left out; a numpy dtype learns its byte order. */
ERN_NODISCARD ern_status ern_pickle_build(struct ern_pickle_machine *m, struct ern_pickle_value *object,
                                          const struct ern_pickle_value *state);
/* ("storage", type, key, place, count) as the storage it names. */
ERN_NODISCARD ern_status ern_pickle_storage(struct ern_pickle_machine *m, const struct ern_pickle_value *id,
                                            struct ern_pickle_value **storage);

#endif
