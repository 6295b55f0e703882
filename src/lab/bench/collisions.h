/* SPDX-License-Identifier: MIT
 * Hash collisions of one look-up step (paper, supplement, "The Number of Hash Collisions"). */
#ifndef ERN_LAB_COLLISIONS_H
#define ERN_LAB_COLLISIONS_H

#include "core/types.h"
#include "hashgrid/hashgrid_ops.h"

/* One level that is hashed whatever its resolution. */
struct ern_collision_level {
  int dims, axis[ERN_GRID_MAX_DIMS]; /* 2 or 3 of the coordinates, in the order of the hash's primes */
  uint32_t resolution, entries;
};

struct ern_collision_count {
  size_t cells;     /* distinct cells that the points lie in */
  size_t lookups;   /* of the cells' corners, 2^dims for each cell: points in one cell share them */
  size_t colliding; /* look-ups whose entry was already taken by another vertex */
};

/* u: coordinates [n] each, in [0, 1]; others are clamped. ERN_E_NO_MEMORY. */
ERN_NODISCARD ern_status ern_collisions_count(ern_context *context, const float *const u[ERN_GRID_MAX_DIMS], size_t n,
                                              const struct ern_collision_level *level,
                                              struct ern_collision_count *count);

#endif
