/* SPDX-License-Identifier: MIT
 * A register as LANES/4 quads of four floats, each loaded from its own address; and a register as a small look-up
 * table. */
#ifndef ERN_LANES_QUADS_H
#define ERN_LANES_QUADS_H

#include "backend_cpu/simd/lanes.h"

enum { QUADS = LANES / 4 };

/* Loads quad q from at[q]. */
LANES_INLINE vf vf_load_quads(const float *const at[QUADS]) {
#if defined(__AVX512F__)
  __m512 value = _mm512_castps128_ps512(_mm_loadu_ps(at[0]));
  value = _mm512_insertf32x4(value, _mm_loadu_ps(at[1]), 1);
  value = _mm512_insertf32x4(value, _mm_loadu_ps(at[2]), 2);
  return (vf)_mm512_insertf32x4(value, _mm_loadu_ps(at[3]), 3);
#elif defined(__AVX2__)
  return (vf)_mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(at[0])), _mm_loadu_ps(at[1]), 1);
#else
  return vf_load(at[0]);
#endif
}

/* Stores quad q to at[q]. */
LANES_INLINE void vf_store_quads(float *const at[QUADS], vf value) {
#if defined(__AVX512F__)
  _mm_storeu_ps(at[0], _mm512_castps512_ps128((__m512)value));
  _mm_storeu_ps(at[1], _mm512_extractf32x4_ps((__m512)value, 1));
  _mm_storeu_ps(at[2], _mm512_extractf32x4_ps((__m512)value, 2));
  _mm_storeu_ps(at[3], _mm512_extractf32x4_ps((__m512)value, 3));
#elif defined(__AVX2__)
  _mm_storeu_ps(at[0], _mm256_castps256_ps128((__m256)value));
  _mm_storeu_ps(at[1], _mm256_extractf128_ps((__m256)value, 1));
#else
  vf_store(at[0], value);
#endif
}

/* Broadcasts the quad at `at` to every quad. */
LANES_INLINE vf vf_all_quad(const void *at) {
#if defined(__AVX512F__)
  return (vf)_mm512_broadcast_f32x4(_mm_loadu_ps(at));
#elif defined(__AVX2__)
  return (vf)_mm256_broadcast_ps(at);
#else
  return vf_load(at);
#endif
}

/* Broadcasts element `which` (a constant 0..3) of each quad within that quad. */
#define QUAD_ELEMENT(l, which) ((l) & ~3) + (which)
#define vf_quad_element(value, which) __builtin_shufflevector(value, value, LANES_EACH(QUAD_ELEMENT, which))

/* Transposes 4 x 4 in each quad: element c of register r and element r of register c are exchanged. */
#define QUAD_EVEN(l, d) ((l)&1 ? LANES : 0) + ((l) & ~3) + ((l) >> 1 & 1) + (d)
#define QUAD_HALF(l, d) ((l)&2 ? LANES : 0) + ((l) & ~3) + ((l)&1) + (d)
LANES_INLINE void vf_transpose_quads(vf value[4]) {
  const vf low01 = __builtin_shufflevector(value[0], value[1], LANES_EACH(QUAD_EVEN, 0));
  const vf low23 = __builtin_shufflevector(value[2], value[3], LANES_EACH(QUAD_EVEN, 0));
  const vf high01 = __builtin_shufflevector(value[0], value[1], LANES_EACH(QUAD_EVEN, 2));
  const vf high23 = __builtin_shufflevector(value[2], value[3], LANES_EACH(QUAD_EVEN, 2));
  value[0] = __builtin_shufflevector(low01, low23, LANES_EACH(QUAD_HALF, 0));
  value[1] = __builtin_shufflevector(low01, low23, LANES_EACH(QUAD_HALF, 2));
  value[2] = __builtin_shufflevector(high01, high23, LANES_EACH(QUAD_HALF, 0));
  value[3] = __builtin_shufflevector(high01, high23, LANES_EACH(QUAD_HALF, 2));
}

/* A table of 4 columns of 4 pairs of floats, in which each lane looks up a value: pair (row, column) at 8*column +
 * 2*row. WINDOW_IS_FAST: a look-up is one instruction. */
#if defined(__AVX512F__)
enum { WINDOW_IS_FAST = 1 };
struct window {
  __m512 low, high;
};
LANES_INLINE struct window window_load(const float *at, size_t step) {
  const __m256d column[4] = {_mm256_loadu_pd((const double *)(const void *)at),
                             _mm256_loadu_pd((const double *)(const void *)(at + step)),
                             _mm256_loadu_pd((const double *)(const void *)(at + 2 * step)),
                             _mm256_loadu_pd((const double *)(const void *)(at + 3 * step))};
  return (struct window){
      _mm512_castpd_ps(_mm512_insertf64x4(_mm512_castpd256_pd512(column[0]), column[1], 1)),
      _mm512_castpd_ps(_mm512_insertf64x4(_mm512_castpd256_pd512(column[2]), column[3], 1)),
  };
}
LANES_INLINE vf window_at(const struct window *window, vi index) {
  return (vf)_mm512_permutex2var_ps(window->low, (__m512i)index, window->high);
}
#else
enum { WINDOW_IS_FAST = 0 };
struct window {
  float value[32];
};
LANES_INLINE struct window window_load(const float *at, size_t step) {
  struct window window;
  for (size_t c = 0; c < 4; c++) memcpy(window.value + 8 * c, at + c * step, 8 * sizeof *at);
  return window;
}
LANES_INLINE vf window_at(const struct window *window, vi index) {
  vf value;
  for (int l = 0; l < LANES; l++) value[l] = window->value[index[l]];
  return value;
}
#endif

/* The least and the greatest lane; undefined result where a lane is NaN. */
LANES_INLINE float vf_least(vf value) {
#if defined(__AVX512F__)
  return _mm512_reduce_min_ps((__m512)value);
#else
  float least = value[0];
  for (int l = 1; l < LANES; l++) least = value[l] < least ? value[l] : least;
  return least;
#endif
}
LANES_INLINE float vf_greatest(vf value) {
#if defined(__AVX512F__)
  return _mm512_reduce_max_ps((__m512)value);
#else
  float greatest = value[0];
  for (int l = 1; l < LANES; l++) greatest = value[l] > greatest ? value[l] : greatest;
  return greatest;
#endif
}

#endif
