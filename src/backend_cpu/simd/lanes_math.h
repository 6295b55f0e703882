/* SPDX-License-Identifier: MIT
 * Elementary functions of a register, for the kernel bodies. Errors are given in units of the last place (ulp) of the
 * exact value, the largest of millions of arguments against double, fused multiply-adds or not; below the normal
 * numbers, in units of the smallest denormal one. NaN in, NaN out; a value does not depend on its lane. */
#ifndef ERN_LANES_MATH_H
#define ERN_LANES_MATH_H

#include <float.h>
#include <math.h>

#include "backend_cpu/simd/lanes.h"

LANES_INLINE vf vf_absolute(vf x) { return (vf)((vi)x & INT32_MAX); }

LANES_INLINE vf vf_clamp(vf x, float low, float high) {
  return vf_select(x < low, vf_all(low), vf_select(x > high, vf_all(high), x));
}

/* g of attention_fade (model/attention_ops.h) */
LANES_INLINE vf vf_fade(vf x, const float fade[2]) {
  const vf t = vf_clamp((x - fade[0]) / (fade[1] - fade[0]), 0, 1);
  return 1 - t * t * (3 - 2 * t);
}

/* ---- exponentials ---- */

/* log 2 in two parts, the first short: its products with whole numbers below 2^11 are exact */
#define VF_LOG2_HIGH 0x1.62ep-1f
#define VF_LOG2_LOW 0x1.0bfbe8p-15f

/* x = k log 2 + r, |r| <= log(2)/2, for x in [-104, 89], to which it is clamped: beyond, exp is 0 or infinite. */
LANES_INLINE vf vf_exp_reduce(vf x, vi *k) {
  const float shift = 0x1.8p23f; /* x + shift - shift rounds to an integer, whose bits are the low ones of x + shift */
  x = vf_clamp(x, -104, 89);
  const vf shifted = x * 1.44269504f + shift;
  const vf whole = shifted - shift;
  *k = (vi)shifted - (vi)vf_all(shift);
  return (x - whole * VF_LOG2_HIGH) - whole * VF_LOG2_LOW;
}

/* value 2^k for k in [-151, 128]: multiplied as two factors, so that only the result underflows or overflows, not the
 * power. */
LANES_INLINE vf vf_times_power(vf value, vi k) {
  const vi half = k >> 1;
  return value * (vf)((vu)(half + 127) << 23) * (vf)((vu)(k - half + 127) << 23);
}

/* (exp(r) - 1 - r)/r^2 for |r| <= log(2)/2, to 2^-26 of exp(r) - 1 */
LANES_INLINE vf vf_exp_series(vf r) {
  vf sum = vf_all(1.0f / 40320);
  sum = sum * r + 1.0f / 5040;
  sum = sum * r + 1.0f / 720;
  sum = sum * r + 1.0f / 120;
  sum = sum * r + 1.0f / 24;
  sum = sum * r + 1.0f / 6;
  return sum * r + 0.5f;
}

/* exp(x) = 2^k exp(r): eight terms of the series leave r^8/8! < 2^-27. At most 1.25 ulp off. */
LANES_INLINE vf vf_exp(vf x) {
  vi k;
  const vf r = vf_exp_reduce(x, &k);
  vf sum = vf_all(1.0f / 5040);
  sum = sum * r + 1.0f / 720;
  sum = sum * r + 1.0f / 120;
  sum = sum * r + 1.0f / 24;
  sum = sum * r + 1.0f / 6;
  sum = sum * r + 0.5f;
  sum = sum * r + 1;
  sum = sum * r + 1;
  return vf_times_power(sum, k);
}

/* exp(x), and exp(x) - 1 without cancellation: 2^k (exp(r) - 1) + (2^k - 1), at half its size, so that 2^k does not
 * overflow before the result does. Below 2^-100 the power does not change a float that is -1. Each at most 1.5 ulp off.
 */
LANES_INLINE vf vf_exp_expm1(vf x, vf *expm1) {
  vi k;
  const vf r = vf_exp_reduce(x, &k);
  const vf less_one = (vf_exp_series(r) * r) * r + r;
  const vi least = (vi){0} - 100, bounded = (vi)vf_select(k < least, (vf)least, (vf)k);
  const vf half_power = (vf)((vu)(bounded + 126) << 23);
  *expm1 = 2 * (half_power * less_one + (half_power - 0.5f));
  return vf_times_power(1 + less_one, k);
}

/* exp(x) - 1, at most 1.5 ulp off */
LANES_INLINE vf vf_expm1(vf x) {
  vf value;
  (void)vf_exp_expm1(x, &value);
  return value;
}

/* 1/(1 + exp(-x)), at most 2.5 ulp off; below -88.7 the exponential is infinite and the quotient 0. */
LANES_INLINE vf vf_sigmoid(vf x) { return 1 / (1 + vf_exp(-x)); }

/* The sigmoid's derivative e/(1 + e)^2 with e = exp(-|x|), at most 4 ulp off: no cancellation where the sigmoid is near
 * 1. */
LANES_INLINE vf vf_sigmoid_derivative(vf x) {
  const vf e = vf_exp(-vf_absolute(x));
  return e / ((1 + e) * (1 + e));
}

/* ---- norms ---- */

/* A sum of squares may overflow or underflow although its root is an ordinary float. It is then computed again from
 * values times each of these factors. Scaled so, the squares of 128 values of FLT_MAX do not overflow, and squares that
 * matter beside the largest do not underflow. */
#define VF_OF_HUGE 0x1p-70f
#define VF_OF_TINY 0x1p100f

LANES_INLINE int vf_squares_leave_float(vf sum) { return vi_any((sum < 0x1p-100f) | (sum > FLT_MAX)); }

/* The root, from three sums of squares: of the values, of the values times VF_OF_HUGE, and of the values times
 * VF_OF_TINY. */
LANES_INLINE vf vf_root_of_any(vf sum, vf of_huge, vf of_tiny) {
  const vf large = vf_sqrt(of_huge) * (1 / VF_OF_HUGE), small = vf_sqrt(of_tiny) * (1 / VF_OF_TINY);
  return vf_select(sum > FLT_MAX, large, vf_select(sum < 0x1p-100f, small, vf_sqrt(sum)));
}

/* ---- logarithms ---- */

/* log(x) = k log 2 + log(1 + f), 1 + f in [sqrt(1/2), sqrt(2)): log(1 + f) = 2 artanh(s) = f - s (f - q) with
 * s = f/(2 + f), q = 2 s^2 (1/3 + s^2/5 + s^4/7 + s^6/9); the next term is below 2^-28. At most 1.5 ulp off, denormal
 * x too; log(0) = -infinity, NaN below. */
LANES_INLINE vf vf_log(vf x) {
  const vi small = x < FLT_MIN;
  const vu bits = (vu)vf_select(small, x * 0x1p25f, x); /* unsigned: below 0 they may wrap, and are not used */
  const vi k = (vi)(bits - 0x3f3504f3u) >> 23;          /* the bits of sqrt(1/2) */
  const vf f = (vf)(bits - ((vu)k << 23)) - 1;
  const vf whole = __builtin_convertvector(k, vf) - vf_select(small, vf_all(25), (vf){0});
  const vf s = f / (2 + f), z = s * s;
  const vf q = z * (2.0f / 3 + z * (2.0f / 5 + z * (2.0f / 7 + z * (2.0f / 9))));
  const vf value = whole * VF_LOG2_HIGH + (whole * VF_LOG2_LOW + (f - s * (f - q)));
  const vf edge = vf_select(x == 0, vf_all(-INFINITY), vf_select(x > FLT_MAX, x, vf_all(NAN)));
  return vf_select((x > 0) & (x <= FLT_MAX), value, edge);
}

/* At most 3 ulp off. */
LANES_INLINE vf vf_log2(vf x) { return vf_log(x) * 1.44269504f; }

/* log(1 + x) without cancellation: log(u) + (x - (u - 1))/u, u = 1 + x rounded. At most 2.5 ulp off. */
LANES_INLINE vf vf_log1p(vf x) {
  const vf u = 1 + x;
  const vf value = vf_log(u) + (x - (u - 1)) / u;
  return vf_select((u > 0) & (u <= FLT_MAX), value, vf_log(u));
}

/* log(1 + exp(x)) = max(x, 0) + log(1 + exp(-|x|)), at most 3 ulp off */
LANES_INLINE vf vf_softplus(vf x) { return vf_select(x < 0, (vf){0}, x) + vf_log1p(vf_exp(-vf_absolute(x))); }

/* ---- sine and cosine ---- */

/* x = k pi/2 + r. pi/2 in three parts: the first two have 12 and 7 bits, so that their products with |k| < 2^12 are
 * exact, and so are the first two differences; the third leaves 2^-39. */
enum { VF_SINE_LIMIT = 4096 };
LANES_INLINE vf vf_sine_reduce(vf x, vi *k) {
  const float shift = 0x1.8p23f;
  const vf shifted = x * 0.636619772f + shift, whole = shifted - shift;
  *k = (vi)shifted - (vi)vf_all(shift);
  return ((x - whole * 0x1.922p+0f) - whole * -0x1.2cp-18f) - whole * 0x1.110b46p-26f;
}

/* libm's result lane by lane, for arguments outside the reduction's range. */
LANES_INLINE vf vf_sine_far(vf x, vf *cosine) {
  vf sine = x;
  for (int l = 0; l < LANES; l++) {
    const float at = x[l];
    sine[l] = sinf(at);
    (*cosine)[l] = cosf(at);
  }
  return sine;
}

/* sin(x), and cos(x): at most 2^-23 off for |x| <= VF_SINE_LIMIT, by the series to r^9 and r^10 on |r| <= pi/4. Where
 * any lane's |x| is larger, libm computes the whole register. */
LANES_INLINE vf vf_sine_cosine(vf x, vf *cosine) {
  if (vi_any(vf_absolute(x) > VF_SINE_LIMIT)) return vf_sine_far(x, cosine);
  vi k;
  const vf r = vf_sine_reduce(x, &k), z = r * r;
  const vf s = r + r * z * (-1.0f / 6 + z * (1.0f / 120 + z * (-1.0f / 5040 + z * (1.0f / 362880))));
  const vf c = 1 + z * (-0.5f + z * (1.0f / 24 + z * (-1.0f / 720 + z * (1.0f / 40320 + z * (-1.0f / 3628800)))));
  const vi odd = (k & 1) != 0;
  const vi sine_sign = (vi)((vu)(k & 2) << 30), cosine_sign = (vi)((vu)((k + 1) & 2) << 30);
  *cosine = (vf)((vi)vf_select(odd, s, c) ^ cosine_sign);
  return (vf)((vi)vf_select(odd, c, s) ^ sine_sign);
}

LANES_INLINE vf vf_sine(vf x) {
  vf cosine = x;
  return vf_sine_cosine(x, &cosine);
}

#endif
