/* SPDX-License-Identifier: MIT
 * A register of floats, for the kernel bodies that are compiled once for each instruction set. Arithmetic is that of
 * vector types; what they lack (gather) is here, and nowhere else. */
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

/* The first `count` lanes; the others are 0, and are not touched. count <= LANES */
LANES_INLINE vf vf_load_some(const float *at, size_t count) {
  if (count == LANES) return vf_load(at);
  vf value = {0};
  memcpy(&value, at, count * sizeof *at);
  return value;
}
LANES_INLINE void vf_store_some(float *at, vf value, size_t count) {
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

#endif
