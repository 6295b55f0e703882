/* SPDX-License-Identifier: MIT
 * Reference of the multiresolution grids (paper eq. 3-5; Mueller et al. 2022).
 *
 *   u = (x + bound) / (2 bound)      p = u*scale_l + 0.5      cell = floor(p)      t = p - cell
 *   f_l(x) = sum over the 2^dims corners b of prod_d (b_d ? t_d : 1 - t_d) * table[index(cell + b)] */
#include <tgmath.h>

#include "hashgrid/hashgrid_ops.h"

/* The cell of a sample in a level, and its position in the cell. */
struct place {
  uint32_t cell[ERN_GRID_MAX_DIMS];
  ern_real t[ERN_GRID_MAX_DIMS]; /* in [0, 1) */
};

/* False where a coordinate is outside [-bound, bound] or NaN. */
static bool locate(struct place *place, const ern_real *const x[ERN_GRID_MAX_DIMS], size_t i,
                   const struct ern_grid *grid, const struct ern_grid_level *level) {
  const ern_real bound = (ern_real)grid->bound;
  for (int d = 0; d < grid->dims; d++) {
    if (!(x[d][i] >= -bound && x[d][i] <= bound)) return false;
    const ern_real u = (x[d][i] + bound) / (2 * bound);
    const ern_real p = u * (ern_real)level->scale + (ern_real)0.5;
    const ern_real cell = floor(p);
    place->cell[d] = (uint32_t)cell;
    place->t[d] = p - cell;
  }
  return true;
}

/* Dense, sum_d c_d (resolution+1)^d, while that fits the level; else the hash XOR_d c_d*prime_d in 32-bit arithmetic,
 * or, without hashing, the dense index of as many dimensions as fit. Either one modulo the entries of the level. */
static uint32_t entry_index(const uint32_t cell[ERN_GRID_MAX_DIMS], const struct ern_grid *grid,
                            const struct ern_grid_level *level) {
  static const uint32_t prime[ERN_GRID_MAX_DIMS] = {1, 2654435761u, 805459861u};
  uint64_t stride = 1;
  uint32_t index = 0;
  for (int d = 0; d < grid->dims && stride <= level->size; d++) {
    index += cell[d] * (uint32_t)stride;
    stride *= level->resolution + 1;
  }
  if (grid->hashed && stride > level->size) {
    index = 0;
    for (int d = 0; d < grid->dims; d++) index ^= cell[d] * prime[d];
  }
  return level->offset + index % level->size;
}

/* The entry of corner b and its weight prod_d (b_d ? t_d : 1 - t_d); without the factor of dimension `skip`. */
static ern_real corner(uint32_t *entry, const struct place *place, int b, int skip, const struct ern_grid *grid,
                       const struct ern_grid_level *level) {
  uint32_t cell[ERN_GRID_MAX_DIMS] = {0};
  ern_real weight = 1;
  for (int d = 0; d < grid->dims; d++) {
    const bool upper = (b >> d & 1) != 0;
    cell[d] = place->cell[d] + upper;
    if (d != skip) weight *= upper ? place->t[d] : 1 - place->t[d];
  }
  *entry = entry_index(cell, grid, level);
  return weight;
}

void ERN_REF(ern_grid_fwd)(ern_real *f, size_t stride, const ern_real *const x[ERN_GRID_MAX_DIMS],
                           const ern_real *table, const struct ern_grid *grid, int level_begin, int level_end,
                           size_t n) {
  const size_t features = (size_t)grid->features;
  for (int l = level_begin; l < level_end; l++) {
    const struct ern_grid_level *level = &grid->level[l];
    ern_real *rows = f + (size_t)l * features * stride;
    for (size_t i = 0; i < n; i++) {
      for (size_t c = 0; c < features; c++) rows[c * stride + i] = 0;
      struct place place;
      if (!locate(&place, x, i, grid, level)) continue;
      for (int b = 0; b < 1 << grid->dims; b++) {
        uint32_t entry = 0;
        const ern_real weight = corner(&entry, &place, b, -1, grid, level);
        for (size_t c = 0; c < features; c++) rows[c * stride + i] += weight * table[entry * features + c];
      }
    }
  }
}

/* dtable[entry][c] += weight * df_c */
static void add_to_table(ern_real *dtable, const struct place *place, const ern_real *df, size_t stride,
                         const struct ern_grid *grid, const struct ern_grid_level *level) {
  const size_t features = (size_t)grid->features;
  for (int b = 0; b < 1 << grid->dims; b++) {
    uint32_t entry = 0;
    const ern_real weight = corner(&entry, place, b, -1, grid, level);
    for (size_t c = 0; c < features; c++) dtable[entry * features + c] += weight * df[c * stride];
  }
}

/* df_l/dx_d = scale_l/(2 bound) * sum over corners b of (b_d ? 1 : -1) * prod_{e != d} (b_e ? t_e : 1 - t_e) *
 * table[...] */
static ern_real gradient(int d, const struct place *place, const ern_real *df, size_t stride, const ern_real *table,
                         const struct ern_grid *grid, const struct ern_grid_level *level) {
  const size_t features = (size_t)grid->features;
  ern_real sum = 0;
  for (int b = 0; b < 1 << grid->dims; b++) {
    uint32_t entry = 0;
    const ern_real weight = corner(&entry, place, b, d, grid, level);
    ern_real value = 0;
    for (size_t c = 0; c < features; c++) value += df[c * stride] * table[entry * features + c];
    sum += (b >> d & 1) != 0 ? weight * value : -weight * value;
  }
  return sum * ((ern_real)level->scale / (2 * (ern_real)grid->bound));
}

void ERN_REF(ern_grid_bwd)(ern_real *dtable, ern_real *const dx[ERN_GRID_MAX_DIMS], const ern_real *df, size_t stride,
                           const ern_real *const x[ERN_GRID_MAX_DIMS], const ern_real *table,
                           const struct ern_grid *grid, int level_begin, int level_end, size_t n) {
  for (int l = level_begin; l < level_end; l++) {
    const struct ern_grid_level *level = &grid->level[l];
    const ern_real *rows = df + (size_t)l * (size_t)grid->features * stride;
    for (size_t i = 0; i < n; i++) {
      struct place place;
      if (!locate(&place, x, i, grid, level)) continue;
      if (dtable != NULL) add_to_table(dtable, &place, rows + i, stride, grid, level);
      if (dx[0] == NULL) continue;
      for (int d = 0; d < grid->dims; d++) dx[d][i] += gradient(d, &place, rows + i, stride, table, grid, level);
    }
  }
}
