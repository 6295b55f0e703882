/* SPDX-License-Identifier: MIT
 * The matrix product of the fused passes: out [rows][TILE] = A [rows][count] x [count][TILE]. A tile is ERN_MLP_TILE
 * samples, channel-major.
 *
 * A is packed in groups of ERN_PACK rows, each group column by column, so that the values that a block of sums
 * broadcasts are contiguous; rows past the last are zeros. The layout is the same for every instruction set. */
#ifndef ERN_GEMM_TILE_H
#define ERN_GEMM_TILE_H

#include "backend_cpu/fused/pack.h"
#include "backend_cpu/simd/lanes.h"

/* A block of TILE_ROWS x TILE_VECTORS sums lives in registers: 8 x 3 of 32, or 4 x 3 of 16, with three for x and one
 * for A. */
enum { TILE = ERN_MLP_TILE, TILE_VECTORS = 3, TILE_ROWS = LANES == 8 ? 4 : 8 };

typedef enum tile_finish { TILE_STORE, TILE_RELU } tile_finish;

/* `rows` rows of one group over TILE_VECTORS registers of samples. `rows` is a constant where this is inlined. */
LANES_INLINE void tile_block(float *out, const float *start, const float *a, const float *x, size_t count,
                             tile_finish finish, const size_t rows) {
  vf sum[TILE_ROWS][TILE_VECTORS] = {{{0}}};
#define TILE_EACH(statement)                                                         \
  _Pragma("GCC unroll 8") for (size_t r = 0; r < rows; r++) {                        \
    _Pragma("GCC unroll 3") for (size_t v = 0; v < TILE_VECTORS; v++) { statement; } \
  }
  if (start != NULL) TILE_EACH(sum[r][v] = vf_load(start + r * TILE + v * LANES))
  for (size_t k = 0; k < count; k++) {
    vf value[TILE_VECTORS];
#pragma GCC unroll 3
    for (size_t v = 0; v < TILE_VECTORS; v++) value[v] = vf_load(x + v * LANES);
#pragma GCC unroll 8
    for (size_t r = 0; r < rows; r++) {
      const vf weight = vf_all(a[r]);
#pragma GCC unroll 3
      for (size_t v = 0; v < TILE_VECTORS; v++) sum[r][v] += weight * value[v];
    }
    a += ERN_PACK;
    x += TILE;
  }
  if (finish == TILE_RELU) TILE_EACH(sum[r][v] = vf_select(sum[r][v] < 0, (vf){0}, sum[r][v])) /* NaN stays NaN */
  TILE_EACH(vf_store(out + r * TILE + v * LANES, sum[r][v]))
#undef TILE_EACH
}

/* out = finish(start + A x); start: [rows][TILE], NULL: zeros; it may be `out`. */
static __attribute__((noinline, unused)) void tile_product(float *out, const float *start, const float *packed,
                                                           const float *x, size_t rows, size_t count,
                                                           tile_finish finish) {
  for (size_t row = 0; row < rows; row += ERN_PACK, packed += ERN_PACK * count) {
    const size_t left = rows - row < ERN_PACK ? rows - row : ERN_PACK;
    for (size_t column = 0; column < TILE; column += TILE_VECTORS * LANES) {
      size_t r = 0;
#define TILE_BLOCK(n)                                                                                               \
  tile_block(out + (row + r) * TILE + column, start != NULL ? start + (row + r) * TILE + column : NULL, packed + r, \
             x + column, count, finish, n),                                                                         \
      r += (n)
      while (left - r >= TILE_ROWS) TILE_BLOCK(TILE_ROWS);
      if (TILE_ROWS > 4 && left - r >= 4) TILE_BLOCK(4);
      if (left - r >= 2) TILE_BLOCK(2);
      if (left - r >= 1) TILE_BLOCK(1);
#undef TILE_BLOCK
    }
  }
}

#endif
