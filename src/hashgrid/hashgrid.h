/* SPDX-License-Identifier: MIT
 * The level tables of the grids (docs/maths.md, Tri-plane hash grids: float32 rounding after each operation). */
#ifndef ERN_HASHGRID_H
#define ERN_HASHGRID_H

#include "hashgrid/hashgrid_ops.h"

struct ern_grid_shape {
  int dims, levels, features;
  int base, finest;     /* resolutions of the first and last level */
  uint32_t table_limit; /* most entries a level, a power of two */
  bool hashed;
  float bound;
};

/* growth g = 2^(log2(finest/base)/(levels-1)) in double, S = (float)log2(g),
 * scale_l = exp2f((float)l*S)*base - 1, entries_l = min(limit, (ceil(base*g^l) + 1)^dims) rounded up to 8. */
ern_status ern_grid_build(struct ern_grid *grid, const struct ern_grid_shape *shape);

#endif
