/* SPDX-License-Identifier: MIT
 * Values of a pickle, and the pickle machine, which allocates them in its own arena. */
#ifndef ERN_IO_PICKLE_VALUE_H
#define ERN_IO_PICKLE_VALUE_H

#include <stdbool.h>

#include "io/safetensors.h"

typedef enum ern_pickle_kind {
  ERN_PICKLE_NONE,
  ERN_PICKLE_BOOL,
  ERN_PICKLE_INT,
  ERN_PICKLE_FLOAT,
  ERN_PICKLE_TEXT,
  ERN_PICKLE_BYTES,
  ERN_PICKLE_TUPLE,
  ERN_PICKLE_LIST,
  ERN_PICKLE_DICT,
  ERN_PICKLE_ORDERED, /* collections.OrderedDict */
  ERN_PICKLE_STORAGE,
  ERN_PICKLE_TENSOR,
  ERN_PICKLE_NUMPY_DTYPE,
  ERN_PICKLE_CALLABLE,
  ERN_PICKLE_MARK
} ern_pickle_kind;

/* Several values may refer to the same one, and a hostile pickle may contain cycles: a traversal must limit its
 * steps. */
struct ern_pickle_value {
  ern_pickle_kind kind;
  union {
    int64_t integer; /* BOOL, INT; of a CALLABLE its number */
    double real;
    struct {
      const char *text; /* followed by a 0 */
      size_t length;
    } words; /* TEXT, BYTES */
    struct {
      struct ern_pickle_value **item; /* of a dict: key, value, key, value ... */
      size_t count, capacity;
    } list;
    struct {
      const char *key; /* name of the entry that holds the bytes */
      ern_dtype dtype;
      size_t count;
    } storage;
    struct {
      const struct ern_pickle_value *storage;
      size_t offset; /* elements */
      int dims;
      size_t shape[ERN_TENSOR_MAX_DIMS], stride[ERN_TENSOR_MAX_DIMS];
      const char *name; /* NULL until it gets one */
    } tensor;
    struct {
      char type;  /* b i u f */
      char order; /* < > | */
      int bytes;
    } numpy;
  } as;
};

/* The value of a text key of a dict, the last one where there are several; NULL where there is none or no dict. */
struct ern_pickle_value *ern_pickle_get(const struct ern_pickle_value *dict, const char *key);
static inline bool ern_pickle_is_dict(const struct ern_pickle_value *value) {
  return value != NULL && (value->kind == ERN_PICKLE_DICT || value->kind == ERN_PICKLE_ORDERED);
}

struct ern_pickle_pointers {
  struct ern_pickle_value **item;
  size_t count, capacity;
};

struct ern_pickle_machine {
  ern_context *context;
  const char *where;
  const uint8_t *bytes;
  size_t count, at;
  size_t begin; /* offset of the current opcode */
  uint8_t opcode;
  struct ern_pickle_pointers stack, memo, storages;
  bool first; /* bytes may follow the pickle */
  struct ern_pickle_value mark;
  struct ern_pickle_arena *arena;
};

/* Memory of the machine's arena, within its limit; NULL where *status is not ERN_OK. */
ERN_NODISCARD void *ern_pickle_allocate(struct ern_pickle_machine *m, size_t bytes, ern_status *status);
ERN_NODISCARD ern_status ern_pickle_make(struct ern_pickle_machine *m, ern_pickle_kind kind,
                                         struct ern_pickle_value **value);
ERN_NODISCARD ern_status ern_pickle_append(struct ern_pickle_machine *m, struct ern_pickle_value *list,
                                           struct ern_pickle_value *item);

struct ern_pickle_arena;
ERN_NODISCARD ern_status ern_pickle_arena_make(ern_context *context, struct ern_pickle_arena **arena);
void ern_pickle_arena_free(ern_context *context, struct ern_pickle_arena *arena); /* accepts NULL */

#endif
