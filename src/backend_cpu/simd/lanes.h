/* SPDX-License-Identifier: MIT
 * A SIMD register of floats, for kernels that are compiled once for each instruction set. Arithmetic uses GCC's vector
 * types; only these headers (lanes*.h) have intrinsics, for what vector types lack (gather). */
#ifndef ERN_LANES_H
#define ERN_LANES_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(__AVX512F__)
#include <immintrin.h>
enum { LANES = 16 };
#define LANES_EACH(F, d)                                                                                        \
  F(0, d), F(1, d), F(2, d), F(3, d), F(4, d), F(5, d), F(6, d), F(7, d), F(8, d), F(9, d), F(10, d), F(11, d), \
      F(12, d), F(13, d), F(14, d), F(15, d)
#elif defined(__AVX2__)
#include <immintrin.h>
enum { LANES = 8 };
#define LANES_EACH(F, d) F(0, d), F(1, d), F(2, d), F(3, d), F(4, d), F(5, d), F(6, d), F(7, d)
#else
enum { LANES = 4 };
#define LANES_EACH(F, d) F(0, d), F(1, d), F(2, d), F(3, d)
#endif

typedef float vf __attribute__((vector_size(LANES * 4)));
typedef int32_t vi __attribute__((vector_size(LANES * 4))); /* also masks: all bits of a lane, or none */
typedef uint32_t vu __attribute__((vector_size(LANES * 4)));
typedef float vf_anywhere __attribute__((vector_size(LANES * 4), aligned(4), may_alias));

#define LANES_INLINE static inline __attribute__((always_inline))

LANES_INLINE vf vf_load(const float *at) { return *(const vf_anywhere *)at; }
LANES_INLINE void vf_store(float *at, vf value) { *(vf_anywhere *)at = value; }
LANES_INLINE vf vf_all(float value) { return value - (vf){0}; }
LANES_INLINE vu vu_all(uint32_t value) { return value - (vu){0}; }

/* Loads or stores the first `count` lanes. The other lanes load as 0; their memory is not touched. count <= LANES */
LANES_INLINE vf vf_load_partial(const float *at, size_t count) {
  if (count == LANES) return vf_load(at);
  vf value = {0};
  memcpy(&value, at, count * sizeof *at);
  return value;
}
LANES_INLINE void vf_store_partial(float *at, vf value, size_t count) {
  if (count == LANES) {
    vf_store(at, value);
  } else {
    memcpy(at, &value, count * sizeof *at);
  }
}

/* mask ? a : b */
LANES_INLINE vf vf_select(vi mask, vf a, vf b) { return (vf)((mask & (vi)a) | (~mask & (vi)b)); }

/* The product rounded by itself, never contracted into a fused multiply-add: as the reference rounds it. */
LANES_INLINE vf vf_multiply_rounded(vf a, vf b) {
  vf product = a * b;
#if defined(__x86_64__)
  __asm__("" : "+v"(product));
#elif defined(__aarch64__)
  __asm__("" : "+w"(product));
#else
  __asm__("" : "+m"(product));
#endif
  return product;
}

/* at[index] */
LANES_INLINE vf vf_gather(const float *at, vu index) {
#if defined(__AVX512F__)
  return (vf)_mm512_i32gather_ps((__m512i)index, at, 4);
#elif defined(__AVX2__)
  return (vf)_mm256_i32gather_ps(at, (__m256i)index, 4);
#else
  vf value;
  for (int l = 0; l < LANES; l++) value[l] = at[index[l]];
  return value;
#endif
}

/* Whether a lane of the mask is set. */
LANES_INLINE int vi_any(vi mask) {
#if defined(__AVX512F__)
  return _mm512_test_epi32_mask((__m512i)mask, (__m512i)mask) != 0;
#elif defined(__AVX2__)
  return !_mm256_testz_si256((__m256i)mask, (__m256i)mask);
#else
  int32_t any = 0;
  for (int l = 0; l < LANES; l++) any |= mask[l];
  return any != 0;
#endif
}

/* a > b ? a : b and a < b ? a : b: b where either is NaN or both are zeros */
LANES_INLINE vf vf_max(vf a, vf b) {
#if defined(__AVX512F__)
  return (vf)_mm512_max_ps((__m512)a, (__m512)b);
#elif defined(__AVX2__)
  return (vf)_mm256_max_ps((__m256)a, (__m256)b);
#else
  return vf_select(a > b, a, b);
#endif
}
LANES_INLINE vf vf_min(vf a, vf b) {
#if defined(__AVX512F__)
  return (vf)_mm512_min_ps((__m512)a, (__m512)b);
#elif defined(__AVX2__)
  return (vf)_mm256_min_ps((__m256)a, (__m256)b);
#else
  return vf_select(a < b, a, b);
#endif
}

/* 32-bit words, least byte first, that need not be aligned: word number `index` from `at` on. */
LANES_INLINE vu vu_gather_words(const uint8_t *at, vu index) {
#if defined(__AVX512F__)
  return (vu)_mm512_i32gather_epi32((__m512i)index, at, 4);
#elif defined(__AVX2__)
  return (vu)_mm256_i32gather_epi32((const int *)(const void *)at, (__m256i)index, 4);
#else
  vu value;
  for (int l = 0; l < LANES; l++) {
    uint32_t word;
    memcpy(&word, at + 4 * (size_t)index[l], sizeof word);
    value[l] = word;
  }
  return value;
#endif
}

/* Rounded correctly, as sqrtf is. */
LANES_INLINE vf vf_sqrt(vf value) {
#if defined(__AVX512F__)
  return (vf)_mm512_sqrt_ps((__m512)value);
#elif defined(__AVX2__)
  return (vf)_mm256_sqrt_ps((__m256)value);
#else
  for (int l = 0; l < LANES; l++) value[l] = __builtin_sqrtf(value[l]);
  return value;
#endif
}

/* A mask as an integer, a bit a lane. Where vi is not a mask, the bits are its signs. */
LANES_INLINE uint32_t vi_bits(vi mask) {
#if defined(__AVX512DQ__)
  return _mm512_movepi32_mask((__m512i)mask);
#elif defined(__AVX2__)
  return (uint32_t)_mm256_movemask_ps((__m256)mask);
#else
  uint32_t bits = 0;
  for (int l = 0; l < LANES; l++) bits |= ((uint32_t)mask[l] >> 31) << l;
  return bits;
#endif
}
LANES_INLINE vi vi_of_bits(uint32_t bits) {
#if defined(__AVX512DQ__)
  return (vi)_mm512_movm_epi32((__mmask16)bits);
#else
#define LANES_BIT(l, d) 1 << l
  static const vi lane = {LANES_EACH(LANES_BIT, 0)};
#undef LANES_BIT
  return ((vi)vu_all(bits) & lane) != 0;
#endif
}
/* Bits of the lanes where a < b. */
LANES_INLINE uint32_t vf_less_bits(vf a, vf b) {
#if defined(__AVX512F__)
  return _mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_LT_OQ);
#else
  return vi_bits(a < b);
#endif
}

/* As vf_load_partial and vf_store_partial, faster with variable counts; a count above LANES means all lanes. */
LANES_INLINE vf vf_load_first(const float *at, size_t count) {
  if (count >= LANES) return vf_load(at);
#if defined(__AVX512F__)
  return (vf)_mm512_maskz_loadu_ps((__mmask16)((1u << count) - 1), at);
#elif defined(__AVX2__)
  return (vf)_mm256_maskload_ps(at, (__m256i)vi_of_bits((1u << count) - 1));
#else
  return vf_load_partial(at, count);
#endif
}
LANES_INLINE void vf_store_first(float *at, vf value, size_t count) {
  if (count >= LANES) {
    vf_store(at, value);
    return;
  }
#if defined(__AVX512F__)
  _mm512_mask_storeu_ps(at, (__mmask16)((1u << count) - 1), (__m512)value);
#elif defined(__AVX2__)
  _mm256_maskstore_ps(at, (__m256i)vi_of_bits((1u << count) - 1), (__m256)value);
#else
  vf_store_partial(at, value, count);
#endif
}

#endif
