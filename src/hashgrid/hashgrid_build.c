/* SPDX-License-Identifier: MIT
 * Level tables of the grids: scales, resolutions, sizes and offsets. They are part of the model, so they have the same
 * bits in every build. */
#include <math.h>

#include "hashgrid/hashgrid.h"

enum {
  FINEST_LIMIT = 1 << 20, /* cell numbers stay exact in float */
  TABLE_LIMIT = 1 << 30,
  FEATURES_LIMIT = 64
};

static bool shape_is_valid(const struct ern_grid_shape *shape) {
  const bool counts = shape->dims >= 1 && shape->dims <= ERN_GRID_MAX_DIMS && shape->levels >= 1 &&
                      shape->levels <= ERN_GRID_MAX_LEVELS && shape->features >= 1 && shape->features <= FEATURES_LIMIT;
  const bool resolutions = shape->base >= 1 && shape->finest >= shape->base && shape->finest <= FINEST_LIMIT;
  const uint32_t limit = shape->table_limit;
  const bool table = limit >= 8 && limit <= TABLE_LIMIT && (limit & (limit - 1)) == 0;
  return counts && resolutions && table && isfinite(shape->bound) && shape->bound > 0;
}

/* min(limit, (ceil(base*g^l) + 1)^dims), rounded up to a multiple of 8 */
static uint32_t level_entries(const struct ern_grid_shape *shape, double growth, int level) {
  const double side = ceil(shape->base * pow(growth, level)) + 1;
  double cells = 1;
  for (int d = 0; d < shape->dims; d++) cells *= side;
  const uint32_t entries = cells < shape->table_limit ? (uint32_t)cells : shape->table_limit;
  return (entries + 7) / 8 * 8;
}

ern_status ern_grid_build(struct ern_grid *grid, const struct ern_grid_shape *shape) {
  if (!shape_is_valid(shape)) return ERN_E_ARGUMENT;
  *grid = (struct ern_grid){.dims = shape->dims,
                            .levels = shape->levels,
                            .features = shape->features,
                            .hashed = shape->hashed,
                            .bound = shape->bound};
  const double octaves = shape->levels > 1 ? log2((double)shape->finest / shape->base) / (shape->levels - 1) : 0;
  const double growth = exp2(octaves);
  const float step = (float)log2(growth); /* S */
  uint64_t offset = 0;
  for (int l = 0; l < shape->levels; l++) {
    /* Volatile steps: each is rounded to float once, and none can be contracted into a fused multiply-add. */
    const volatile float exponent = (float)l * step;
    const volatile float resolution = exp2f(exponent) * (float)shape->base;
    struct ern_grid_level *level = &grid->level[l];
    level->scale = resolution - 1.0f;
    level->resolution = (uint32_t)ceilf(level->scale) + 1;
    level->size = level_entries(shape, growth, l);
    level->offset = (uint32_t)offset;
    offset += level->size;
    if (offset > UINT32_MAX) return ERN_E_ARGUMENT;
  }
  grid->entries = (uint32_t)offset;
  return ERN_OK;
}
