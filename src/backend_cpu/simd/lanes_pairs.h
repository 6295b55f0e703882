/* SPDX-License-Identifier: MIT
 * Loads pairs of adjacent floats from scattered addresses, for the kernels. Each pair is a 64-bit load: on processors
 * with a mitigation for their gather instruction (Downfall), gather takes 2 cycles an element and these loads half of
 * that. */
#ifndef ERN_LANES_PAIRS_H
#define ERN_LANES_PAIRS_H

#include "backend_cpu/simd/lanes.h"

/* The lanes stored in memory for scalar loads: compilers would extract each lane from the register with a shuffle. */
struct vu_spilled {
  uint32_t lane[LANES] __attribute__((aligned(sizeof(vu))));
};
LANES_INLINE void vu_spill(struct vu_spilled *spilled, vu value) {
  memcpy(spilled->lane, &value, sizeof value);
  __asm__("" : "+m"(*spilled));
}

/* Registers of pairs, two in each 128-bit part p: `even` registers hold samples 4p and 4p + 1, `odd` ones 4p + 2 and 4p
 * + 3, so that one shuffle within the parts puts all first or all second values in order. */
#if defined(__AVX2__)
/* Two floats as one 64-bit number; `at` need not be aligned. */
LANES_INLINE double pair_at(const float *at) {
  double pair;
  memcpy(&pair, at, sizeof pair);
  return pair;
}
#endif
#if defined(__AVX512F__)
/* A load that fills one 64-bit lane costs no shuffle. */
#define PAIR_INTO(to, lane64, from) \
  (to) = _mm512_mask_broadcastsd_pd(to, (__mmask8)(1 << (lane64)), _mm_set_sd(pair_at(from)))
typedef __m512d pairs;
LANES_INLINE pairs pairs_from(const float *at) { return _mm512_castpd128_pd512(_mm_set_sd(pair_at(at))); }
LANES_INLINE vf pairs_low(pairs a, pairs b) {
  return (vf)_mm512_shuffle_ps(_mm512_castpd_ps(a), _mm512_castpd_ps(b), 0x88);
}
LANES_INLINE vf pairs_high(pairs a, pairs b) {
  return (vf)_mm512_shuffle_ps(_mm512_castpd_ps(a), _mm512_castpd_ps(b), 0xdd);
}
#elif defined(__AVX2__)
#define PAIR_INTO(to, lane64, from) (to) = _mm256_blend_pd(to, _mm256_set1_pd(pair_at(from)), 1 << (lane64))
typedef __m256d pairs;
LANES_INLINE pairs pairs_from(const float *at) { return _mm256_set1_pd(pair_at(at)); }
LANES_INLINE vf pairs_low(pairs a, pairs b) {
  return (vf)_mm256_shuffle_ps(_mm256_castpd_ps(a), _mm256_castpd_ps(b), 0x88);
}
LANES_INLINE vf pairs_high(pairs a, pairs b) {
  return (vf)_mm256_shuffle_ps(_mm256_castpd_ps(a), _mm256_castpd_ps(b), 0xdd);
}
#endif

/* near[0] = at[index], near[1] = at[index + 1]; far: the same of at + row */
LANES_INLINE void vf_load_pairs(const float *at, size_t row, const struct vu_spilled *index, vf near[2], vf far[2]) {
  const float *next = at + row;
#if defined(__AVX2__)
  const uint32_t *i = index->lane;
  pairs near_even = pairs_from(at + i[0]), near_odd = pairs_from(at + i[2]);
  pairs far_even = pairs_from(next + i[0]), far_odd = pairs_from(next + i[2]);
#define PAIRS_AT(lane64, even, odd)        \
  do {                                     \
    const size_t e = i[even], o = i[odd];  \
    PAIR_INTO(near_even, lane64, at + e);  \
    PAIR_INTO(far_even, lane64, next + e); \
    PAIR_INTO(near_odd, lane64, at + o);   \
    PAIR_INTO(far_odd, lane64, next + o);  \
  } while (0)
  PAIRS_AT(1, 1, 3);
  PAIRS_AT(2, 4, 6);
  PAIRS_AT(3, 5, 7);
#if defined(__AVX512F__)
  PAIRS_AT(4, 8, 10);
  PAIRS_AT(5, 9, 11);
  PAIRS_AT(6, 12, 14);
  PAIRS_AT(7, 13, 15);
#endif
#undef PAIRS_AT
  near[0] = pairs_low(near_even, near_odd);
  near[1] = pairs_high(near_even, near_odd);
  far[0] = pairs_low(far_even, far_odd);
  far[1] = pairs_high(far_even, far_odd);
#else
  for (size_t k = 0; k < 2; k++) {
    vf here = {0}, there = {0};
    for (int l = 0; l < LANES; l++) {
      here[l] = at[index->lane[l] + k];
      there[l] = next[index->lane[l] + k];
    }
    near[k] = here;
    far[k] = there;
  }
#endif
}

#endif
