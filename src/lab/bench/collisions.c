/* SPDX-License-Identifier: MIT */
#include "lab/bench/collisions.h"

#include <math.h>
#include <stdlib.h>

#include "core/memory.h"

enum { AXIS_BITS = 21 }; /* bits of a cell index along one axis; three make a key */

static uint64_t cell_along(float u, uint32_t resolution) {
  const float most = (float)resolution - 1, cell = floorf(u * (float)resolution);
  return cell >= 0 ? (uint64_t)fminf(cell, most) : 0; /* NaN too */
}

static int by_key(const void *a, const void *b) {
  const uint64_t left = *(const uint64_t *)a, right = *(const uint64_t *)b;
  return (left > right) - (left < right);
}

/* Sorts the keys and removes duplicates; returns their number. */
static size_t distinct(uint64_t *key, size_t n) {
  size_t kept = 0;
  qsort(key, n, sizeof *key, by_key);
  for (size_t i = 0; i < n; i++)
    if (i == 0 || key[i] != key[i - 1]) key[kept++] = key[i];
  return kept;
}

/* The corner b of a cell, as a key; its entry. */
static uint64_t vertex(uint64_t cell, int b, const struct ern_collision_level *level, uint32_t *entry) {
  static const uint32_t prime[ERN_GRID_MAX_DIMS] = {1, 2654435761u, 805459861u};
  uint64_t key = 0;
  uint32_t hash = 0;
  for (int d = 0; d < level->dims; d++) {
    const uint64_t c = (cell >> AXIS_BITS * d & ((1u << AXIS_BITS) - 1)) + (uint64_t)(b >> d & 1);
    key |= c << AXIS_BITS * d;
    hash ^= (uint32_t)c * prime[d];
  }
  *entry = hash % level->entries;
  return key;
}

ern_status ern_collisions_count(ern_context *context, const float *const u[ERN_GRID_MAX_DIMS], size_t n,
                                const struct ern_collision_level *level, struct ern_collision_count *count) {
  ern_status status = ERN_OK;
  uint64_t *key = NULL, *owner = NULL; /* owner: 0: free; else the vertex + 1 */
  *count = (struct ern_collision_count){0};
  ERN_TRY(ERN_NEW(context, n, &key));
  ERN_TRY(ERN_NEW(context, level->entries, &owner));
  for (size_t i = 0; i < n; i++)
    for (int d = 0; d < level->dims; d++)
      key[i] |= cell_along(u[level->axis[d]][i], level->resolution) << AXIS_BITS * d;
  count->cells = distinct(key, n);
  count->lookups = count->cells << level->dims;
  for (size_t i = 0; i < count->cells; i++)
    for (int b = 0; b < 1 << level->dims; b++) {
      uint32_t entry = 0;
      const uint64_t one = vertex(key[i], b, level, &entry) + 1;
      if (owner[entry] == 0) owner[entry] = one;
      count->colliding += owner[entry] != one;
    }
fail:
  ern_release(context, key);
  ern_release(context, owner);
  return status;
}
