/* SPDX-License-Identifier: MIT
 * Packs weights for the register-tiled product of gemm_tile.h: [group][column][ERN_PACK]. Group g has the ERN_PACK rows
 * from g*ERN_PACK on; rows past the last are zeros. */
#ifndef ERN_PACK_H
#define ERN_PACK_H

#include "mlp/mlp_tile.h"

enum { ERN_PACK = 8 };

/* Reals of a packed matrix. */
static inline size_t ern_pack_count(size_t rows, size_t columns) {
  return (rows + ERN_PACK - 1) / ERN_PACK * ERN_PACK * columns;
}

/* packed[columns of it `at` ..] = A [rows][columns], A (r, c) at a[r*row_step + c*column_step]; `packed` is `width`
 * columns wide. */
static inline void ern_pack_columns(float *packed, size_t width, size_t at, const float *a, size_t row_step,
                                    size_t column_step, size_t rows, size_t columns) {
  const size_t padded = ern_pack_count(rows, 1);
  for (size_t r = 0; r < padded; r++) {
    float *to = packed + r / ERN_PACK * ERN_PACK * width + at * ERN_PACK + r % ERN_PACK;
    for (size_t c = 0; c < columns; c++) to[c * ERN_PACK] = r < rows ? a[r * row_step + c * column_step] : 0;
  }
}

/* The whole of W [rows][columns], row-major. */
static inline void ern_pack(float *packed, const float *w, size_t rows, size_t columns) {
  ern_pack_columns(packed, columns, 0, w, columns, 1, rows, columns);
}

#endif
