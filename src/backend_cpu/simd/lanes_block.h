/* SPDX-License-Identifier: MIT
 * A vector of eight floats on every instruction set: 2x2x2 cells that are contiguous in Morton order. */
#ifndef ERN_LANES_BLOCK_H
#define ERN_LANES_BLOCK_H

#include "backend_cpu/simd/lanes.h"

enum { BLOCK = 8 };
typedef float vb __attribute__((vector_size(BLOCK * 4)));
typedef int32_t vbi __attribute__((vector_size(BLOCK * 4))); /* also masks */
typedef float vb_anywhere __attribute__((vector_size(BLOCK * 4), aligned(4), may_alias));

/* mask ? a : b */
LANES_INLINE vb vb_select(vbi mask, vb a, vb b) {
#if defined(__AVX2__)
  return (vb)_mm256_blendv_ps((__m256)b, (__m256)a, (__m256)mask);
#else
  return (vb)((mask & (vbi)a) | (~mask & (vbi)b));
#endif
}

/* found > most ? found : most: a NaN in `found` is ignored. */
LANES_INLINE vb vb_larger(vb found, vb most) {
#if defined(__AVX2__)
  return (vb)_mm256_max_ps((__m256)found, (__m256)most);
#else
  return vb_select(found > most, found, most);
#endif
}

#endif
