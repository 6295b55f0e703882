/* SPDX-License-Identifier: MIT
 * Products of the fused training pass. A tile is ERN_MLP_TILE samples, a row each, channels contiguous; so no operand
 * of a step needs a transposition:
 *   forward   y  [samples][outs] = x  [samples][ins]  B   B = W^T [ins][outs]
 *   backward  dx [samples][ins]  = dy [samples][outs] W
 *   sums      dW^T [ins][outs]  += x^T dy, over the samples of the tile
 *
 * Where ERN_TILE_PAIRS is defined the factors are pairs of bf16 (gemm_factors.h), each in the room of a float; `count`
 * then counts pairs, and the sums are float. */
#ifndef ERN_GEMM_ROWS_H
#define ERN_GEMM_ROWS_H

#include "backend_cpu/simd/gemm_tile.h"
#if defined(ERN_TILE_PAIRS)
#include "backend_cpu/simd/lanes_bf16.h"
#endif

/* A block of ROWS x ROW_VECTORS sums lives in registers: 6 x 4 of 32, or 6 x 2 of 16; a tile is 8 blocks. */
enum { ROWS = 6, ROW_VECTORS = LANES == 8 ? 2 : 4 };

typedef enum rows_finish {
  ROWS_STORE,
  ROWS_ADD,  /* to the values in `out` */
  ROWS_RELU, /* negative sums become 0; NaN stays NaN */
  ROWS_MASK  /* 0 where the mask is not above 0: the gradient of a ReLU, whose values are the mask */
} rows_finish;

/* out [rows][columns] = finish(A B); columns: a multiple of LANES. A (r, k) is a[r*a_row + k] in rows_forward,
 * a[k*a_row + r] in rows_sums. */
struct rows_product {
  float *out;
  const float *a, *b, *mask;
  size_t out_row, a_row, b_row, mask_row;
  size_t rows, columns, count; /* count: terms of each sum */
  rows_finish finish;
};

LANES_INLINE vf rows_add(vf sum, vf a, vf b) {
#if defined(ERN_TILE_PAIRS)
  return vf_add_pairs(sum, (vu)a, (vu)b);
#else
  return sum + a * b;
#endif
}

LANES_INLINE void rows_block(const struct rows_product *p, size_t row, size_t column, const size_t rows,
                             const size_t vectors, const bool sums) {
  vf sum[ROWS][ROW_VECTORS] = {{{0}}};
  const size_t a_row = sums ? 1 : p->a_row, a_step = sums ? p->a_row : 1;
  const float *a = p->a + row * a_row, *b = p->b + column;
  for (size_t k = 0; k < p->count; k++) {
    vf value[ROW_VECTORS];
#pragma GCC unroll 4
    for (size_t v = 0; v < vectors; v++) value[v] = vf_load(b + v * LANES);
#pragma GCC unroll 6
    for (size_t r = 0; r < rows; r++) {
      const vf weight = vf_all(a[r * a_row]);
#pragma GCC unroll 4
      for (size_t v = 0; v < vectors; v++) sum[r][v] = rows_add(sum[r][v], weight, value[v]);
    }
    a += a_step;
    b += p->b_row;
  }
  float *out = p->out + row * p->out_row + column;
  const float *mask = p->mask + row * p->mask_row + column;
#define ROWS_EACH(statement)                                                    \
  _Pragma("GCC unroll 6") for (size_t r = 0; r < rows; r++) {                   \
    _Pragma("GCC unroll 4") for (size_t v = 0; v < vectors; v++) { statement; } \
  }
  if (p->finish == ROWS_ADD) ROWS_EACH(sum[r][v] += vf_load(out + r * p->out_row + v * LANES))
  if (p->finish == ROWS_RELU) ROWS_EACH(sum[r][v] = vf_select(sum[r][v] < 0, (vf){0}, sum[r][v]))
  if (p->finish == ROWS_MASK)
    ROWS_EACH(sum[r][v] = vf_select(vf_load(mask + r * p->mask_row + v * LANES) <= 0, (vf){0}, sum[r][v]))
  ROWS_EACH(vf_store(out + r * p->out_row + v * LANES, sum[r][v]))
#undef ROWS_EACH
}

LANES_INLINE void rows_column(const struct rows_product *p, size_t column, const size_t vectors, const bool sums) {
  size_t row = 0;
  for (; p->rows - row >= ROWS; row += ROWS) rows_block(p, row, column, ROWS, vectors, sums);
  if (!sums) return; /* a tile is a whole number of blocks */
  if (p->rows - row >= 4) rows_block(p, row, column, 4, vectors, sums), row += 4;
  if (p->rows - row >= 2) rows_block(p, row, column, 2, vectors, sums), row += 2;
  if (p->rows - row >= 1) rows_block(p, row, column, 1, vectors, sums);
}

/* Five registers of columns are split 3 + 2, six 3 + 3: this is faster than 4 + 1 and 4 + 2. */
LANES_INLINE void rows_product(const struct rows_product *p, const bool sums) {
  size_t left = p->columns / LANES, column = 0;
  while (left > 0) {
    size_t take = left < ROW_VECTORS ? left : ROW_VECTORS;
    if (ROW_VECTORS == 4 && (left == 5 || left == 6)) take = 3;
    switch (take) {
#if !defined(__AVX2__) || defined(__AVX512F__)
      case 4: rows_column(p, column, 4, sums); break;
      case 3: rows_column(p, column, 3, sums); break;
#endif
      case 2: rows_column(p, column, 2, sums); break;
      default: rows_column(p, column, 1, sums); break;
    }
    column += take * LANES;
    left -= take;
  }
}

/* `rows` is a tile's. */
static __attribute__((noinline, unused)) void rows_forward(const struct rows_product *p) { rows_product(p, false); }
/* Sums over a tile's samples, or over any number of terms; any number of rows. */
static __attribute__((noinline, unused)) void rows_sums(const struct rows_product *p) { rows_product(p, true); }

/* ---- transposition of rows and lanes ---- */

#define ROWS_LOW(l, d) ((l) & (d) ? LANES + (l) - (d) : (l))
#define ROWS_HIGH(l, d) ((l) & (d) ? LANES + (l) : (l) + (d))
#define ROWS_ROUNDS_4(ROUND) ROUND(1) ROUND(2)
#if defined(__AVX512F__)
#define ROWS_ROUNDS(ROUND) ROWS_ROUNDS_4(ROUND) ROUND(4) ROUND(8)
#elif defined(__AVX2__)
#define ROWS_ROUNDS(ROUND) ROWS_ROUNDS_4(ROUND) ROUND(4)
#else
#define ROWS_ROUNDS(ROUND) ROWS_ROUNDS_4(ROUND)
#endif

/* Transposes: lane l of row r and lane r of row l are exchanged, in log2(LANES) rounds with distance d. */
LANES_INLINE void rows_transpose(vf row[LANES]) {
#define ROWS_TURN(d)                                                             \
  _Pragma("GCC unroll 16") for (int r = 0; r < LANES; r++) {                     \
    if (r & (d)) continue;                                                       \
    const vf low = row[r], high = row[r + (d)];                                  \
    row[r] = __builtin_shufflevector(low, high, LANES_EACH(ROWS_LOW, d));        \
    row[r + (d)] = __builtin_shufflevector(low, high, LANES_EACH(ROWS_HIGH, d)); \
  }
  ROWS_ROUNDS(ROWS_TURN)
#undef ROWS_TURN
}

/* Lane l of the result is the sum of row l. Every row is summed in the same order. */
LANES_INLINE vf rows_total(vf row[LANES]) {
#define ROWS_FOLD(d)                                                       \
  _Pragma("GCC unroll 16") for (int r = 0; r < LANES; r += 2 * (d)) {      \
    const vf low = row[r], high = row[r + (d)];                            \
    row[r] = __builtin_shufflevector(low, high, LANES_EACH(ROWS_LOW, d)) + \
             __builtin_shufflevector(low, high, LANES_EACH(ROWS_HIGH, d)); \
  }
  ROWS_ROUNDS(ROWS_FOLD)
#undef ROWS_FOLD
  return row[0];
}

#endif
