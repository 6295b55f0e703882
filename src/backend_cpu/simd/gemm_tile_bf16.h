/* SPDX-License-Identifier: MIT
 * The product of gemm_tile.h with bf16 factors: out [rows][TILE] = A x, sums in float. x is [count][TILE], each float
 * holding inputs 2k and 2k + 1 of a sample; A is packed likewise (pack_pairs.h). */
#ifndef ERN_GEMM_TILE_BF16_H
#define ERN_GEMM_TILE_BF16_H

#include "backend_cpu/simd/gemm_tile.h"
#include "backend_cpu/simd/lanes_bf16.h"

LANES_INLINE vf tile_relu(vf value) { return vf_select(value < 0, (vf){0}, value); } /* NaN stays NaN */

/* `rows` rows of one group over TILE_VECTORS registers of samples, as tile_block. With TILE_RELU it stores pairs of
 * rows, the inputs of the next product; an odd last row is paired with zeros. */
LANES_INLINE void pairs_block(float *out, const float *start, const float *a, const float *x, size_t count,
                              tile_finish finish, const size_t rows) {
  vf sum[TILE_ROWS][TILE_VECTORS] = {{{0}}};
#define TILE_EACH(step, statement)                                                   \
  _Pragma("GCC unroll 8") for (size_t r = 0; r < rows; r += step) {                  \
    _Pragma("GCC unroll 3") for (size_t v = 0; v < TILE_VECTORS; v++) { statement; } \
  }
  if (start != NULL) TILE_EACH(1, sum[r][v] = vf_load(start + r * TILE + v * LANES))
  for (size_t k = 0; k < count; k++) {
    vu value[TILE_VECTORS];
#pragma GCC unroll 3
    for (size_t v = 0; v < TILE_VECTORS; v++) value[v] = (vu)vf_load(x + v * LANES);
#pragma GCC unroll 8
    for (size_t r = 0; r < rows; r++) {
      uint32_t pair;
      memcpy(&pair, a + r, sizeof pair);
      const vu weight = vu_all(pair);
#pragma GCC unroll 3
      for (size_t v = 0; v < TILE_VECTORS; v++) sum[r][v] = vf_add_pairs(sum[r][v], value[v], weight);
    }
    a += ERN_PACK;
    x += TILE;
  }
  if (finish == TILE_STORE) {
    TILE_EACH(1, vf_store(out + r * TILE + v * LANES, sum[r][v]))
    return;
  }
  TILE_EACH(2, const vf next = r + 1 < rows ? tile_relu(sum[(r + 1) % TILE_ROWS][v]) : (vf){0};
            vf_store(out + r / 2 * TILE + v * LANES, (vf)vf_pairs(tile_relu(sum[r][v]), next)))
#undef TILE_EACH
}

/* out = finish(start + A x); start: [rows][TILE] floats, NULL: zeros. out: [rows][TILE] floats, or, with TILE_RELU,
 * [pairs of rows][TILE]. */
static __attribute__((noinline, unused)) void pairs_product(float *out, const float *start, const float *packed,
                                                            const float *x, size_t rows, size_t count,
                                                            tile_finish finish) {
  const size_t halved = finish == TILE_RELU;
  for (size_t row = 0; row < rows; row += ERN_PACK, packed += ERN_PACK * count) {
    const size_t left = rows - row < ERN_PACK ? rows - row : ERN_PACK;
    for (size_t column = 0; column < TILE; column += TILE_VECTORS * LANES) {
      size_t r = 0;
#define TILE_BLOCK(n)                                                                                                \
  pairs_block(out + ((row + r) >> halved) * TILE + column, start != NULL ? start + (row + r) * TILE + column : NULL, \
              packed + r, x + column, count, finish, n),                                                             \
      r += (n)
      while (left - r >= TILE_ROWS) TILE_BLOCK(TILE_ROWS);
      if (TILE_ROWS > 4 && left - r >= 4) TILE_BLOCK(4);
      if (left - r >= 2) TILE_BLOCK(2);
      if (left - r >= 1) TILE_BLOCK(1);
#undef TILE_BLOCK
    }
  }
}

/* made [pairs of n][TILE] from x [n][TILE]; an odd last row is paired with zeros. */
static __attribute__((unused)) void pairs_of_rows(float *made, const float *x, size_t n) {
  for (size_t row = 0; row < n; row += 2, x += 2 * TILE, made += TILE) {
    for (size_t k = 0; k < TILE; k += LANES)
      vf_store(made + k, (vf)vf_pairs(vf_load(x + k), row + 1 < n ? vf_load(x + TILE + k) : (vf){0}));
  }
}

#endif
