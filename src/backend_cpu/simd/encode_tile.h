/* SPDX-License-Identifier: MIT
 * The tri-plane encoding of a tile of samples from unhashed levels (frame_net.h), for any instruction set. */
#ifndef ERN_ENCODE_TILE_H
#define ERN_ENCODE_TILE_H

#include "backend_cpu/fused/frame_net.h"
#include "backend_cpu/simd/gemm_tile.h"
#include "backend_cpu/simd/lanes_pairs.h"

/* f = bilinear in (s, t) of the four values around a cell. All cells are computed first, so that no look-up waits for
 * its address. */
LANES_INLINE void encode_level(float *f, const vf *u, const vf *v, const struct ern_dense_level *level) {
  enum { VECTORS = TILE / LANES };
  const vf scale = vf_all(level->scale);
  struct vu_spilled cell[VECTORS];
  vf s[VECTORS], t[VECTORS];
#pragma GCC unroll 12
  for (size_t k = 0; k < VECTORS; k++) {
    const vf p = vf_multiply_rounded(u[k], scale) + 0.5f, q = vf_multiply_rounded(v[k], scale) + 0.5f;
    const vi column = __builtin_convertvector(p, vi), row = __builtin_convertvector(q, vi); /* >= 0: floor */
    s[k] = p - __builtin_convertvector(column, vf);
    t[k] = q - __builtin_convertvector(row, vf);
    vu_spill(&cell[k], (vu)column + (vu)row * level->row);
  }
#pragma GCC unroll 12
  for (size_t k = 0; k < VECTORS; k++) {
    vf near[2], far[2];
    vf_load_pairs(level->value, level->row, &cell[k], near, far);
    const vf nearer = near[0] + s[k] * (near[1] - near[0]), farther = far[0] + s[k] * (far[1] - far[0]);
    vf_store(f + k * LANES, nearer + t[k] * (farther - nearer));
  }
}

/* Coordinates on [0, 1] of the samples of a tile. */
struct tile_places {
  vf u[3][TILE / LANES];
};
LANES_INLINE void tile_place(struct tile_places *places, const float *x, float bound) {
  for (size_t axis = 0; axis < 3; axis++) {
    for (size_t k = 0; k < TILE / LANES; k++)
      places->u[axis][k] = (vf_load(x + axis * TILE + k * LANES) + bound) / (2 * bound);
  }
}

/* Features of some tiles, f[i] [3*levels][TILE], level by level; all samples inside [-bound, bound]. */
static __attribute__((unused)) void encode_tiles(float *const *f, const struct tile_places *places, size_t tiles,
                                                 const struct ern_frame_net *net) {
  size_t row = 0;
  for (size_t plane = 0; plane < ERN_PLANES; plane++) {
    const int *axis = net->axis[plane];
    for (int l = 0; l < net->levels; l++, row += TILE) {
      for (size_t i = 0; i < tiles; i++)
        encode_level(f[i] + row, places[i].u[axis[0]], places[i].u[axis[1]], &net->level[plane][l]);
    }
  }
}

#endif
