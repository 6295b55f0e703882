/* SPDX-License-Identifier: MIT
 * Doubles for the lanes of a register of floats, in two registers. For long sums and sums of squares. */
#ifndef ERN_LANES_DOUBLE_H
#define ERN_LANES_DOUBLE_H

#include <math.h>

#include "backend_cpu/simd/lanes.h"
#if defined(__aarch64__)
#include <arm_neon.h>
#endif

typedef double vd __attribute__((vector_size(LANES * 4)));
typedef float vf_half __attribute__((vector_size(LANES * 2)));

/* The lanes of a register of floats: the first LANES/2, and the others. */
struct vd_pair {
  vd half[2];
};

LANES_INLINE struct vd_pair vd_of(vf value) {
#if defined(__AVX512F__)
  const __m512 v = (__m512)value;
  return (struct vd_pair){
      {(vd)_mm512_cvtps_pd(_mm512_castps512_ps256(v)), (vd)_mm512_cvtps_pd(_mm512_extractf32x8_ps(v, 1))}};
#elif defined(__AVX2__)
  const __m256 v = (__m256)value;
  return (struct vd_pair){
      {(vd)_mm256_cvtps_pd(_mm256_castps256_ps128(v)), (vd)_mm256_cvtps_pd(_mm256_extractf128_ps(v, 1))}};
#else
  const union {
    vf whole;
    vf_half half[2];
  } parts = {value};
  return (struct vd_pair){{__builtin_convertvector(parts.half[0], vd), __builtin_convertvector(parts.half[1], vd)}};
#endif
}

/* Rounded to float. */
LANES_INLINE vf vf_of(struct vd_pair value) {
#if defined(__AVX512F__)
  const __m256 low = _mm512_cvtpd_ps((__m512d)value.half[0]), high = _mm512_cvtpd_ps((__m512d)value.half[1]);
  return (vf)_mm512_insertf32x8(_mm512_castps256_ps512(low), high, 1);
#elif defined(__AVX2__)
  const __m128 low = _mm256_cvtpd_ps((__m256d)value.half[0]), high = _mm256_cvtpd_ps((__m256d)value.half[1]);
  return (vf)_mm256_set_m128(high, low);
#else
  union {
    vf whole;
    vf_half half[2];
  } parts;
  for (int h = 0; h < 2; h++) parts.half[h] = __builtin_convertvector(value.half[h], vf_half);
  return parts.whole;
#endif
}

/* sum += value, lane by lane */
LANES_INLINE void vd_add(struct vd_pair *sum, vf value) {
  const struct vd_pair wide = vd_of(value);
  for (int h = 0; h < 2; h++) sum->half[h] += wide.half[h];
}

/* sum += a b; the products of floats are exact. */
LANES_INLINE void vd_add_product(struct vd_pair *sum, vf a, vf b) {
  const struct vd_pair wide_a = vd_of(a), wide_b = vd_of(b);
  for (int h = 0; h < 2; h++) sum->half[h] += wide_a.half[h] * wide_b.half[h];
}

LANES_INLINE vd vd_root(vd x) {
#if defined(__AVX512F__)
  return (vd)_mm512_sqrt_pd((__m512d)x);
#elif defined(__AVX2__)
  return (vd)_mm256_sqrt_pd((__m256d)x);
#elif defined(__aarch64__)
  return (vd)vsqrtq_f64((float64x2_t)x);
#else
  for (int l = 0; l < LANES / 2; l++) x[l] = sqrt(x[l]);
  return x;
#endif
}

/* The sum of all lanes, in the order of the lanes. */
LANES_INLINE double vd_total(struct vd_pair sum) {
  double total = 0;
  for (int h = 0; h < 2; h++) {
    for (int l = 0; l < LANES / 2; l++) total += sum.half[h][l];
  }
  return total;
}

#endif
