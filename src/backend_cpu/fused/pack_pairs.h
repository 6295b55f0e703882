/* SPDX-License-Identifier: MIT
 * Packs weights for the product of bf16 pairs (gemm_tile_bf16.h): the layout of pack.h with two columns, rounded to
 * bf16, in each float: the even column in the lower half. An odd last column is paired with a zero. */
#ifndef ERN_PACK_PAIRS_H
#define ERN_PACK_PAIRS_H

#include <stdint.h>
#include <string.h>

#include "backend_cpu/fused/pack.h"

/* The nearest bf16, ties to even; denormal numbers become zeros and NaNs quiet ones, as processors convert. */
static inline uint32_t ern_bf16(float value) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  const uint32_t size = bits & 0x7fffffffu;
  if (size > 0x7f800000u) return bits >> 16 | 0x40u;
  if (size < 0x00800000u) return bits >> 16 & 0x8000u;
  return (bits + 0x7fffu + (bits >> 16 & 1)) >> 16;
}

/* Number of pairs of n values. */
static inline size_t ern_pairs(size_t n) { return (n + 1) / 2; }

/* packed[pairs of columns of it `at` ..] = A [rows][columns], A (r, c) at a[r*row_step + c]; `packed` is `width` pairs
 * wide. */
static inline void ern_pack_pairs(float *packed, size_t width, size_t at, const float *a, size_t row_step, size_t rows,
                                  size_t columns) {
  const size_t padded = ern_pack_count(rows, 1);
  for (size_t r = 0; r < padded; r++) {
    float *to = packed + r / ERN_PACK * ERN_PACK * width + at * ERN_PACK + r % ERN_PACK;
    const float *row = a + r * row_step;
    for (size_t c = 0; c < columns; c += 2, to += ERN_PACK) {
      const uint32_t low = r < rows ? ern_bf16(row[c]) : 0;
      const uint32_t high = r < rows && c + 1 < columns ? ern_bf16(row[c + 1]) : 0;
      const uint32_t pair = low | high << 16;
      memcpy(to, &pair, sizeof pair);
    }
  }
}

#endif
