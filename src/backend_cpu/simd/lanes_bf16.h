/* SPDX-License-Identifier: MIT
 * Pairs of bf16 (the upper halves of floats) in a register, a pair a lane, for the kernel bodies: AVX512_BF16.
 * VDPBF16PS rounds each of its two sums to the nearest float, ties to even, whatever the rounding mode is; it treats
 * denormal operands and results as zeros. */
#ifndef ERN_LANES_BF16_H
#define ERN_LANES_BF16_H

#include "backend_cpu/simd/lanes.h"

#if !defined(__AVX512BF16__) || !defined(__AVX512BW__)
#error "pairs of bf16 need AVX512_BF16 and AVX512BW"
#endif

/* low and high, each rounded to the nearest bf16, ties to even; denormal numbers become zeros. */
LANES_INLINE vu vf_pairs(vf low, vf high) {
#define PAIR_OF(l, d) (uint32_t)((l) | ((l) + LANES) << 16) /* of 32 halves, number l and number LANES + l */
  static const vu halves = {LANES_EACH(PAIR_OF, 0)};
#undef PAIR_OF
  return (vu)_mm512_permutexvar_epi16((__m512i)halves, (__m512i)_mm512_cvtne2ps_pbh((__m512)high, (__m512)low));
}

/* The same for pairs of adjacent values: pair l is values (2l, 2l + 1) of `first` followed by `second`. */
LANES_INLINE vu vf_pairs_beside(vf first, vf second) { return (vu)_mm512_cvtne2ps_pbh((__m512)second, (__m512)first); }

/* (sum + a.high b.high) + a.low b.low */
LANES_INLINE vf vf_add_pairs(vf sum, vu a, vu b) { return (vf)_mm512_dpbf16_ps((__m512)sum, (__m512bh)a, (__m512bh)b); }

#endif
