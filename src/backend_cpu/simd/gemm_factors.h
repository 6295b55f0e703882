/* SPDX-License-Identifier: MIT
 * Prepares the factors of the products of gemm_rows.h: floats, or, where ERN_TILE_PAIRS is defined, pairs of bf16, each
 * in the room of a float. An odd last value is paired with 0. */
#ifndef ERN_GEMM_FACTORS_H
#define ERN_GEMM_FACTORS_H

#include "backend_cpu/simd/gemm_rows.h"

struct rows_factors {
  const float *at;
  size_t row, count; /* floats from row to row; terms of a sum over them */
};

#if defined(ERN_TILE_PAIRS)

/* x [TILE][x_row], columns 0 .. count-1, for sums over columns: writes pairs of columns to workspace [TILE][count/2
 * aligned]. */
LANES_INLINE struct rows_factors factors_pair_columns(float *workspace, const float *x, size_t x_row, size_t count) {
  const size_t row = (count + 2 * LANES - 1) / (2 * LANES) * LANES;
  for (size_t c = 0; c < count; c += 2 * LANES) {
    const size_t left = count - c;
    for (size_t s = 0; s < TILE; s++) {
      const float *from = x + s * x_row + c;
      const vf low = left < LANES ? vf_load_first(from, left) : vf_load(from);
      vf high = {0};
      if (left >= 2 * LANES)
        high = vf_load(from + LANES);
      else if (left > LANES)
        high = vf_load_first(from + LANES, left - LANES);
      vf_store(workspace + s * row + c / 2, (vf)vf_pairs_beside(low, high));
    }
  }
  return (struct rows_factors){workspace, row, (count + 1) / 2};
}

/* x [count][x_row], for sums over rows: writes pairs of rows to workspace [count/2][width]. width: a multiple of a
 * register. Source and result may be weights. An odd last row is paired with zeros. */
LANES_INLINE struct rows_factors factors_pair_rows(float *workspace, const float *x, size_t x_row, size_t count,
                                                   size_t width) {
  for (size_t k = 0; k < count; k += 2) {
    for (size_t c = 0; c < width; c += LANES) {
      const vf low = vf_load(x + k * x_row + c), high = k + 1 < count ? vf_load(x + (k + 1) * x_row + c) : (vf){0};
      vf_store(workspace + k / 2 * width + c, (vf)vf_pairs(low, high));
    }
  }
  return (struct rows_factors){workspace, width, (count + 1) / 2};
}

#else

LANES_INLINE struct rows_factors factors_pair_columns(float *workspace, const float *x, size_t x_row, size_t count) {
  (void)workspace;
  return (struct rows_factors){x, x_row, count};
}
LANES_INLINE struct rows_factors factors_pair_rows(float *workspace, const float *x, size_t x_row, size_t count,
                                                   size_t width) {
  (void)workspace, (void)width;
  return (struct rows_factors){x, x_row, count};
}

#endif
#endif
