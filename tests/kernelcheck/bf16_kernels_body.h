/* SPDX-License-Identifier: MIT
 * The functions of bf16_kernels.h, with the implementation of bf16 pairs that the including file chooses; BF16_NAME
 * gives the suffix. */
#define ERN_TILE_PAIRS
#include "backend_cpu/simd/gemm_factors.h"
#include "backend_cpu/simd/gemm_tile_bf16.h"
#include "kernelcheck/bf16_kernels.h"

void BF16_NAME(bf16_product)(float *out, const float *start, const float *packed, const float *x, size_t rows,
                             size_t count, bool relu) {
  pairs_product(out, start, packed, x, rows, count, relu ? TILE_RELU : TILE_STORE);
}

void BF16_NAME(bf16_rows)(float *made, const float *x, size_t n) { pairs_of_rows(made, x, n); }

static struct rows_product product_of(float *out, struct rows_factors a, struct rows_factors b, size_t rows,
                                      size_t columns, rows_finish finish) {
  return (struct rows_product){.out = out,
                               .a = a.at,
                               .b = b.at,
                               .mask = out,
                               .out_row = columns,
                               .a_row = a.row,
                               .b_row = b.row,
                               .rows = rows,
                               .columns = columns,
                               .count = a.count,
                               .finish = finish};
}

void BF16_NAME(bf16_forward)(float *out, const float *x, size_t x_row, const float *y, size_t ins, size_t outs,
                             float *workspace[2]) {
  const struct rows_factors a = factors_pair_columns(workspace[0], x, x_row, ins),
                            b = factors_pair_rows(workspace[1], y, outs, ins, outs);
  const struct rows_product p = product_of(out, a, b, TILE, outs, ROWS_STORE);
  rows_forward(&p);
}

void BF16_NAME(bf16_sums)(float *out, const float *x, size_t x_row, const float *y, size_t ins, size_t outs,
                          float *workspace[2]) {
  const struct rows_factors a = factors_pair_rows(workspace[0], x, x_row, TILE, x_row),
                            b = factors_pair_rows(workspace[1], y, outs, TILE, outs);
  const struct rows_product p = product_of(out, a, b, ins, outs, ROWS_ADD);
  rows_sums(&p);
}

void BF16_NAME(bf16_add)(float sum[16], const uint32_t a[16], const uint32_t b[16]) {
  vu left, right;
  memcpy(&left, a, sizeof left);
  memcpy(&right, b, sizeof right);
  vf_store(sum, vf_add_pairs(vf_load(sum), left, right));
}
