/* SPDX-License-Identifier: MIT
 * The occupancy grid of the head (docs/maths.md, Occupancy). */
#ifndef ERN_OCCUPANCY_OPS_H
#define ERN_OCCUPANCY_OPS_H

#include "core/operations.h"
#include "core/types.h"

struct ern_view;

/* grid = -1 in cells that none of the views sees, 0 elsewhere: a cell is seen where z_cam > 0, |x_cam| < cx/f*z_cam +
 * 2/128*bound and the same for y, for its centre (2c/127 - 1)*bound*(127/128). */
struct ern_occupancy_mark_args {
  ern_span grid;                /* out: real [ERN_OCCUPANCY_CELLS], Morton order */
  const struct ern_view *views; /* on the host */
  size_t view_count;
  float bound;
};
/* A centre into a camera 15, its place in the picture 4. */
#define ERN_COST_occupancy_mark(a) ern_cost("cell", (a)->grid.count, 19 * (double)(a)->view_count, 1, 0, 0)
typedef void ern_occupancy_mark_kernel(ern_real *grid, const struct ern_view *views, size_t view_count, float bound,
                                       uint32_t cell_begin, uint32_t cell_end);

enum { ERN_OCCUPANCY_BLOCK = 64 /* cells, 4 an axis, that follow each other in Morton order */ };

/* The blocks that a refresh updates: those with an occupied cell, and of the others those with number & mask == turn.
 * mask 0 and turn 0: all. */
struct ern_occupancy_turn {
  uint32_t turn, mask; /* mask: 2^k - 1 */
};
/* bits: byte [ERN_OCCUPANCY_BYTES] */
static inline bool ern_occupancy_block_near(const uint8_t *bits, uint32_t block) {
  uint8_t any = 0;
  for (uint32_t k = 0; k < ERN_OCCUPANCY_BLOCK / 8; k++) any |= bits[ERN_OCCUPANCY_BLOCK / 8 * block + k];
  return any != 0;
}
static inline bool ern_occupancy_block_due(const uint8_t *bits, uint32_t block, struct ern_occupancy_turn turn) {
  return (block & turn.mask) == turn.turn || ern_occupancy_block_near(bits, block);
}

/* Cells whose density a refresh needs: those not marked, and their 6 neighbours, in the blocks that are due. */
struct ern_occupancy_list_args {
  ern_span cells; /* out: int32 [ERN_OCCUPANCY_CELLS], ascending Morton numbers, the first `count` of them */
  ern_span grid, bits;
  struct ern_occupancy_turn turn;
  size_t count; /* out, on the host */
};
#define ERN_COST_occupancy_list(a) ern_cost("cell", (a)->grid.count, 0, 1, 1, 0)
typedef size_t ern_occupancy_list_kernel(int32_t *cells, const ern_real *grid, const uint8_t *bits,
                                         struct ern_occupancy_turn turn);

/* Sample points: (2c/127 - 1)*bound*(127/128) + uniform(-1, 1)*bound/128 an axis; the numbers are Philox's for (seed,
 * step, cell, ERN_RNG_REFRESH_CELL), words 0, 1, 2 for x, y, z. */
struct ern_occupancy_points_args {
  ern_rows x;     /* out: [3] per cell */
  ern_span cells; /* int32 [n] */
  float bound;
  uint64_t seed, step;
  size_t n;
};
#define ERN_COST_occupancy_points(a) ern_cost("cell", (a)->n, 0, 0, 0, 0) /* Philox */
typedef void ern_occupancy_points_kernel(ern_real *x, size_t stride, const int32_t *cells, float bound, uint64_t seed,
                                         uint64_t step, size_t n);

/* fresh[cells[i]] = sigma[i] */
struct ern_occupancy_scatter_args {
  ern_span fresh; /* out: real [ERN_OCCUPANCY_CELLS] */
  ern_span cells, sigma;
  size_t n;
};
#define ERN_COST_occupancy_scatter(a) ern_cost("cell", (a)->n, 0, 2, 1, 0) /* of ascending cells */

/* Factor of a cell's old density at a refresh: `near` in blocks with an occupied cell, `far` in others that are due, 1
 * in the rest. */
struct ern_occupancy_decay {
  float near, far;
  struct ern_occupancy_turn turn;
};
static inline float ern_occupancy_decay_of(const uint8_t *bits, uint32_t block, const struct ern_occupancy_decay *d) {
  if (ern_occupancy_block_near(bits, block)) return d->near;
  return (block & d->turn.mask) == d->turn.turn ? d->far : 1;
}

/* new = maximum of fresh and its 6 neighbours (inside the cube); grid = max(decay*grid, new) where grid >= 0; then the
 * mean over all cells with marked ones counted as 0, and the bits: grid > min(mean, limit). */
struct ern_occupancy_update_args {
  ern_span grid;  /* in and out */
  ern_span bits;  /* in: the old bits, on which the decay depends; out: byte [ERN_OCCUPANCY_BYTES] */
  ern_span fresh; /* 0 in cells that are in no list */
  struct ern_occupancy_decay decay;
  float limit; /* 10 */
  double mean; /* out, on the host */
};
#define ERN_COST_occupancy_update(a) ern_cost("cell", (a)->grid.count, 2, 3, 0, 0)
/* Cells [cell_begin, cell_end); *sum gets the sum of max(grid, 0) over them, in double. */
typedef void ern_occupancy_update_kernel(ern_real *grid, double *sum, const ern_real *fresh, const uint8_t *bits,
                                         const struct ern_occupancy_decay *decay, uint32_t cell_begin,
                                         uint32_t cell_end);
/* Bytes [byte_begin, byte_end). */
typedef void ern_occupancy_pack_kernel(uint8_t *bits, const ern_real *grid, float threshold, uint32_t byte_begin,
                                       uint32_t byte_end);

ERN_DECLARE_KERNELS(ERN_OCCUPANCY_OPERATIONS)

#endif
