/* SPDX-License-Identifier: MIT
 * The functions under test for pairs of bf16: product and conversion by the instructions (`real`: only if the machine
 * has AVX512_BF16) and by AVX-512 alone (`emulated`), and the rendering pass with the emulation. */
#ifndef ERN_TESTS_BF16_KERNELS_H
#define ERN_TESTS_BF16_KERNELS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "backend_cpu/fused/render_worker.h"

/* pairs_product of gemm_tile_bf16.h; `relu`: TILE_RELU. */
typedef void bf16_product(float *out, const float *start, const float *packed, const float *x, size_t rows,
                          size_t count, bool relu);
/* pairs_of_rows of gemm_tile_bf16.h */
typedef void bf16_rows(float *made, const float *x, size_t n);
/* Products of training (gemm_rows.h), x [TILE][x_row], rows a whole number of registers; workspace [2]: room for the
 * factors. Forward: out [TILE][outs] = x W, W [ins][outs]. Sums: out [ins][outs] += x^T y, y [TILE][outs]. */
typedef void bf16_rows_product(float *out, const float *x, size_t x_row, const float *y, size_t ins, size_t outs,
                               float *workspace[2]);
/* 16 lanes of vf_add_pairs of lanes_bf16.h: sum[i] += a.b of pairs */
typedef void bf16_add(float sum[16], const uint32_t a[16], const uint32_t b[16]);

bf16_product bf16_product_real, bf16_product_emulated;
bf16_rows bf16_rows_real, bf16_rows_emulated;
bf16_add bf16_add_real, bf16_add_emulated;
bf16_rows_product bf16_forward_real, bf16_forward_emulated, bf16_sums_real, bf16_sums_emulated;
ern_render_worker_kernel ern_render_worker_bf16_emulated;

#endif
