/* SPDX-License-Identifier: MIT
 * The functions of bf16_kernels.h, by the pairs of bf16 that the including file has chosen; BF16_NAME gives the suffix.
 */
#include "backend_cpu/simd/tile_pairs.h"
#include "kernelcheck/bf16_kernels.h"

void BF16_NAME(bf16_product)(float *out, const float *start, const float *packed, const float *x, size_t rows,
                             size_t count, bool relu) {
  pairs_product(out, start, packed, x, rows, count, relu ? TILE_RELU : TILE_STORE);
}

void BF16_NAME(bf16_rows)(float *made, const float *x, size_t n) { pairs_of_rows(made, x, n); }

void BF16_NAME(bf16_add)(float sum[16], const uint32_t a[16], const uint32_t b[16]) {
  vu left, right;
  memcpy(&left, a, sizeof left);
  memcpy(&right, b, sizeof right);
  vf_store(sum, vf_add_pairs(vf_load(sum), left, right));
}
