/* SPDX-License-Identifier: MIT
 * Multiresolution grids of 1 to 3 dimensions with bilinear or trilinear look-up (paper eq. 3-5; Mueller et al. 2022).
 */
#ifndef ERN_HASHGRID_OPS_H
#define ERN_HASHGRID_OPS_H

#include "core/operations.h"
#include "core/types.h"

struct ern_grid_level {
  float scale;         /* position = u*scale + 0.5, in float in every build: the table is part of the model */
  uint32_t resolution; /* ceil(scale) + 1 */
  uint32_t offset;     /* first entry of the level in the grid's table */
  uint32_t size;       /* entries, a multiple of 8 */
};

/* A grid as plain data. Table: [entries][features], entries of a level contiguous. */
struct ern_grid {
  int dims, levels, features;
  bool hashed; /* false: "tiled", the dense index modulo the size of the level */
  float bound; /* input x in [-bound, bound] */
  uint32_t entries;
  struct ern_grid_level level[ERN_GRID_MAX_LEVELS];
};

struct ern_grid_fwd_args {
  ern_rows f;                    /* out: [levels*features] per sample, row = level*features + feature */
  ern_span x[ERN_GRID_MAX_DIMS]; /* coordinate d of sample i at x[d] + i */
  ern_span table;                /* [entries][features] */
  const struct ern_grid *grid;
  size_t n;
};
#define ERN_COST_grid_fwd(a) ERN_COST_ELSEWHERE

struct ern_grid_bwd_args {
  ern_span dtable;                /* accumulates */
  ern_span dx[ERN_GRID_MAX_DIMS]; /* accumulates; zeroed spans: not wanted */
  ern_rows df;
  struct ern_grid_fwd_args forward; /* f is not used */
};
#define ERN_COST_grid_bwd(a) ERN_COST_ELSEWHERE

/* Kernels: levels [level_begin, level_end) of n samples. Rows f are overwritten; dtable and dx accumulate. A sample
 * with a coordinate outside [-bound, bound] (or NaN) gives zeros and no gradient. dtable NULL: only dx; dx[0] NULL:
 * only the table. `f`, `df`: value (row, i) at row*stride + i. */
typedef void ern_grid_fwd_kernel(ern_real *f, size_t stride, const ern_real *const x[ERN_GRID_MAX_DIMS],
                                 const ern_real *table, const struct ern_grid *grid, int level_begin, int level_end,
                                 size_t n);
typedef void ern_grid_bwd_kernel(ern_real *dtable, ern_real *const dx[ERN_GRID_MAX_DIMS], const ern_real *df,
                                 size_t stride, const ern_real *const x[ERN_GRID_MAX_DIMS], const ern_real *table,
                                 const struct ern_grid *grid, int level_begin, int level_end, size_t n);

ERN_DECLARE_KERNELS(ERN_HASHGRID_OPERATIONS)

#endif
