/* SPDX-License-Identifier: MIT
 * The counter-based random numbers of core/rng.h, one counter a lane: the same bits. */
#ifndef ERN_LANES_RANDOM_H
#define ERN_LANES_RANDOM_H

#include "backend_cpu/simd/lanes.h"
#include "core/rng.h"

/* Returns the low halves of the 64-bit products; *high = the high halves. */
LANES_INLINE vu vu_multiply_wide(vu a, uint32_t b, vu *high) {
#if defined(__AVX512F__)
  const __m512i x = (__m512i)a, y = _mm512_set1_epi32((int)b);
  const __m512i even = _mm512_mul_epu32(x, y), odd = _mm512_mul_epu32(_mm512_srli_epi64(x, 32), y);
  *high = (vu)_mm512_mask_blend_epi32(0xaaaa, _mm512_srli_epi64(even, 32), odd);
  return (vu)_mm512_mask_blend_epi32(0xaaaa, even, _mm512_slli_epi64(odd, 32));
#elif defined(__AVX2__)
  const __m256i x = (__m256i)a, y = _mm256_set1_epi32((int)b);
  const __m256i even = _mm256_mul_epu32(x, y), odd = _mm256_mul_epu32(_mm256_srli_epi64(x, 32), y);
  *high = (vu)_mm256_blend_epi32(_mm256_srli_epi64(even, 32), odd, 0xaa);
  return (vu)_mm256_blend_epi32(even, _mm256_slli_epi64(odd, 32), 0xaa);
#else
  vu low;
  for (int l = 0; l < LANES; l++) {
    const uint64_t product = (uint64_t)a[l] * b;
    low[l] = (uint32_t)product;
    (*high)[l] = (uint32_t)(product >> 32);
  }
  return low;
#endif
}

struct vu_random {
  vu word[4];
};

/* ern_random_at of each lane's index */
LANES_INLINE struct vu_random vu_random_at(uint64_t seed, uint64_t step, vu index, ern_purpose purpose) {
  vu c0 = vu_all((uint32_t)step), c1 = vu_all((uint32_t)(step >> 32)), c2 = index, c3 = vu_all((uint32_t)purpose);
  uint32_t k0 = (uint32_t)seed, k1 = (uint32_t)(seed >> 32);
  for (int round = 0; round < 10; round++) {
    vu high0 = c0, high1 = c2;
    const vu low0 = vu_multiply_wide(c0, 0xD2511F53u, &high0), low1 = vu_multiply_wide(c2, 0xCD9E8D57u, &high1);
    c0 = high1 ^ c1 ^ k0;
    c2 = high0 ^ c3 ^ k1;
    c1 = low1;
    c3 = low0;
    k0 += 0x9E3779B9u;
    k1 += 0xBB67AE85u;
  }
  return (struct vu_random){{c0, c1, c2, c3}};
}

/* ern_uniform: [0, 1) */
LANES_INLINE vf vu_uniform(vu word) { return __builtin_convertvector((vi)(word >> 8), vf) * 0x1p-24f; }

#define LANES_NUMBER(i, d) i
/* first, first + 1, .. */
LANES_INLINE vu vu_from(uint32_t first) { return first + (vu){LANES_EACH(LANES_NUMBER, )}; }

#endif
