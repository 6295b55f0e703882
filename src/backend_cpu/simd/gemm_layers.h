/* SPDX-License-Identifier: MIT
 * The layers of an MLP for a tile: in float, or, where ERN_TILE_PAIRS is defined, with weights and inputs in pairs of
 * bf16 and the rest in float. */
#ifndef ERN_GEMM_LAYERS_H
#define ERN_GEMM_LAYERS_H

#if defined(ERN_TILE_PAIRS)
#include "backend_cpu/fused/pack_pairs.h"
#include "backend_cpu/simd/gemm_tile_bf16.h"

/* Number of rows of TILE floats that n inputs of a layer take. */
LANES_INLINE size_t tile_rows_padded(size_t n) { return ern_pairs(n); }

/* Converts x [n][TILE] to the inputs of a layer: returns x itself, or `workspace` with the pairs. */
LANES_INLINE float *tile_inputs(float *workspace, float *x, size_t n) {
  pairs_of_rows(workspace, x, n);
  return workspace;
}

/* Writes the last input of a layer; the inputs' memory ends after it. */
LANES_INLINE void tile_last_input(float *at, vf value) { vf_store(at, (vf)vf_pairs(value, (vf){0})); }

/* Scales a register of samples of n inputs. */
LANES_INLINE void tile_scale(float *x, vf factor, size_t n) {
  for (size_t row = 0; row < ern_pairs(n); row++) {
    const vu pair = (vu)vf_load(x + row * TILE);
    vf_store(x + row * TILE, (vf)vf_pairs(factor * (vf)(pair << 16), factor * (vf)(pair & 0xFFFF0000u)));
  }
}

/* next = relu(start + A x), as inputs of the next layer; x takes `rows_padded` rows. */
LANES_INLINE void tile_layer(float *next, const float *start, const float *packed, const float *x, size_t rows,
                             size_t rows_padded) {
  pairs_product(next, start, packed, x, rows, rows_padded, TILE_RELU);
}

/* out = A x, in float. */
LANES_INLINE void tile_outputs(float *out, const float *packed, const float *x, size_t rows, size_t rows_padded) {
  pairs_product(out, NULL, packed, x, rows, rows_padded, TILE_STORE);
}

#else
#include "backend_cpu/simd/gemm_tile.h"

LANES_INLINE size_t tile_rows_padded(size_t n) { return n; }

LANES_INLINE float *tile_inputs(float *workspace, float *x, size_t n) {
  (void)workspace, (void)n;
  return x;
}

LANES_INLINE void tile_last_input(float *at, vf value) { vf_store(at, value); }

LANES_INLINE void tile_scale(float *x, vf factor, size_t n) {
  for (size_t row = 0; row < n; row++) vf_store(x + row * TILE, factor * vf_load(x + row * TILE));
}

LANES_INLINE void tile_layer(float *next, const float *start, const float *packed, const float *x, size_t rows,
                             size_t rows_padded) {
  tile_product(next, start, packed, x, rows, rows_padded, TILE_RELU);
}

LANES_INLINE void tile_outputs(float *out, const float *packed, const float *x, size_t rows, size_t rows_padded) {
  tile_product(out, NULL, packed, x, rows, rows_padded, TILE_STORE);
}

#endif
#endif
