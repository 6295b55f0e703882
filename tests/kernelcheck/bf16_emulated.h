/* SPDX-License-Identifier: MIT
 * Emulates pairs of bf16 without AVX512_BF16, in place of backend_cpu/lanes_bf16.h: bit-exact to Intel's manual for
 * VCVTNE2PS2BF16 and VDPBF16PS (volume 2, "Operation" and "Description"), by AVX-512 F and DQ. NaNs stay NaNs, but
 * their payload bits are not modelled.
 *
 * VDPBF16PS: two fused multiply-adds one after the other, of the high halves first; each is rounded to nearest, ties to
 * even. Denormal operands, the sum before included, are zeros with their sign; a result that is below the normal
 * numbers after rounding to 24 bits, whatever its exponent, is a zero with its sign. MXCSR plays no part. */
#ifndef ERN_LANES_BF16_H
#define ERN_LANES_BF16_H

#include <float.h>

#include "backend_cpu/simd/lanes.h"

LANES_INLINE vf bf16_magnitude(vf value) { return (vf)((vi)value & INT32_MAX); }
LANES_INLINE vf bf16_flushed(vf value, vi tiny) { return vf_select(tiny, (vf)((vi)value & INT32_MIN), value); }

/* The result is in the lower half of each lane. */
LANES_INLINE vu bf16_of(vf value) {
  const vu bits = (vu)value, size = bits & 0x7fffffffu;
  const vu rounded = (bits + 0x7fffu + (bits >> 16 & 1)) >> 16;
  const vu quiet = bits >> 16 | 0x40u, zero = bits >> 16 & 0x8000u;
  const vf tiny_or = vf_select((vi)(size < 0x00800000u), (vf)zero, (vf)rounded);
  return (vu)vf_select((vi)(size > 0x7f800000u), (vf)quiet, tiny_or);
}

LANES_INLINE vu vf_pairs(vf low, vf high) { return bf16_of(low) | bf16_of(high) << 16; }

LANES_INLINE vu vf_pairs_beside(vf first, vf second) {
  union {
    uint16_t half[2 * LANES];
    vu pairs;
  } made;
  const vu low = bf16_of(first), high = bf16_of(second);
  for (int l = 0; l < LANES; l++) made.half[l] = (uint16_t)low[l], made.half[LANES + l] = (uint16_t)high[l];
  return made.pairs;
}

/* sum + a b, as each of the two sums is formed; a and b are floats with 8 significant bits.
 * A float result of exactly FLT_MIN may have been rounded up to it from below on the coarser grid of denormals, where
 * rounding to 24 bits stays below. At 2^64 times the size there are no denormals, and the grid is the fine one: the
 * larger factor cannot be 1 or more where the sum is so small, so that it can take the 2^64. */
LANES_INLINE vf bf16_multiply_add(vf sum, vf a, vf b) {
  a = bf16_flushed(a, bf16_magnitude(a) < FLT_MIN);
  b = bf16_flushed(b, bf16_magnitude(b) < FLT_MIN);
  sum = bf16_flushed(sum, bf16_magnitude(sum) < FLT_MIN);
  const vf result = (vf)_mm512_fmadd_ps((__m512)a, (__m512)b, (__m512)sum);
  vi tiny = bf16_magnitude(result) < FLT_MIN;
  const vi edge = bf16_magnitude(result) == FLT_MIN;
  if (vi_any(edge)) {
    const vi a_scales = bf16_magnitude(a) < 1;
    const vf scaled_a = vf_select(a_scales, a * 0x1p64f, a), scaled_b = vf_select(a_scales, b, b * 0x1p64f);
    const vf scaled = (vf)_mm512_fmadd_ps((__m512)scaled_a, (__m512)scaled_b, (__m512)(sum * 0x1p64f));
    tiny |= edge & (bf16_magnitude(scaled) < FLT_MIN * 0x1p64f);
  }
  return bf16_flushed(result, tiny);
}

/* Inlined into each product it would take 8 s to compile. */
static __attribute__((noinline)) vf vf_add_pairs(vf sum, vu a, vu b) {
  sum = bf16_multiply_add(sum, (vf)(a & 0xffff0000u), (vf)(b & 0xffff0000u));
  return bf16_multiply_add(sum, (vf)(a << 16), (vf)(b << 16));
}

#endif
