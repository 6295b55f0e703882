/* SPDX-License-Identifier: MIT */
#include "io/pickle_value.h"

#include <string.h>

#include "core/memory.h"

enum { BLOCK_BYTES = 1 << 16 };
static const size_t arena_limit = (size_t)1 << 28;

struct block {
  struct block *before;
};

struct ern_pickle_arena {
  struct block *last;
  uint8_t *free;
  size_t left, taken;
};

void *ern_pickle_allocate(struct ern_pickle_machine *m, size_t bytes, ern_status *status) {
  struct ern_pickle_arena *arena = m->arena;
  *status = ERN_OK;
  if (bytes > arena_limit - arena->taken)
    *status = ern_fail(m->context, ERN_E_SHAPE, "%s: the values take more than %zu bytes", m->where, arena_limit);
  if (*status != ERN_OK) return NULL;
  const size_t need = (bytes + 15) / 16 * 16;
  if (need > arena->left) {
    const size_t size = need > BLOCK_BYTES ? need : BLOCK_BYTES;
    struct block *fresh = ern_allocate(m->context, size + 16, 1);
    *status = ern_allocation_status(m->context, fresh);
    if (fresh == NULL) return NULL;
    fresh->before = arena->last;
    arena->last = fresh;
    arena->free = (uint8_t *)fresh + 16;
    arena->left = size;
  }
  void *memory = arena->free;
  arena->free += need;
  arena->left -= need;
  arena->taken += bytes;
  return memory;
}

ern_status ern_pickle_make(struct ern_pickle_machine *m, ern_pickle_kind kind, struct ern_pickle_value **value) {
  ern_status status;
  *value = ern_pickle_allocate(m, sizeof **value, &status);
  if (status == ERN_OK) (*value)->kind = kind;
  return status;
}

ern_status ern_pickle_append(struct ern_pickle_machine *m, struct ern_pickle_value *list,
                             struct ern_pickle_value *item) {
  if (list->as.list.count == list->as.list.capacity) {
    const size_t capacity = list->as.list.capacity > 0 ? 2 * list->as.list.capacity : 4;
    ern_status status;
    struct ern_pickle_value **fresh = ern_pickle_allocate(m, capacity * sizeof *fresh, &status);
    if (status != ERN_OK) return status;
    if (list->as.list.count > 0) memcpy(fresh, list->as.list.item, list->as.list.count * sizeof list->as.list.item[0]);
    list->as.list.item = fresh;
    list->as.list.capacity = capacity;
  }
  list->as.list.item[list->as.list.count++] = item;
  return ERN_OK;
}

void ern_pickle_arena_free(ern_context *context, struct ern_pickle_arena *arena) {
  struct block *block = arena != NULL ? arena->last : NULL;
  while (block != NULL) {
    struct block *before = block->before;
    ern_release(context, block);
    block = before;
  }
  ern_release(context, arena);
}

ern_status ern_pickle_arena_make(ern_context *context, struct ern_pickle_arena **arena) {
  return ERN_NEW(context, 1, arena);
}

struct ern_pickle_value *ern_pickle_get(const struct ern_pickle_value *dict, const char *key) {
  if (!ern_pickle_is_dict(dict)) return NULL;
  const size_t length = strlen(key);
  for (size_t i = dict->as.list.count; i >= 2; i -= 2) {
    const struct ern_pickle_value *found = dict->as.list.item[i - 2];
    if (found->kind == ERN_PICKLE_TEXT && found->as.words.length == length &&
        memcmp(found->as.words.text, key, length) == 0)
      return dict->as.list.item[i - 1];
  }
  return NULL;
}
