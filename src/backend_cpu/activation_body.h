/* SPDX-License-Identifier: MIT
 * The output activations for any instruction set: the including file names it (ERN_ISA) and is compiled for it. A value
 * does not depend on its place in a register. */
#include "backend_cpu/kernels_x86.h"
#include "backend_cpu/lanes.h"
#include "mlp/mlp.h"

/* exp(x) = 2^k exp(r), k = round(x/log 2), |r| <= log(2)/2: eight terms of the series leave r^8/8! < 2^-27. 2^k is
 * taken in two factors, so that the result goes to 0 and to infinity where it should. */
LANES_INLINE vf vf_exp(vf x) {
  const float shift = 0x1.8p23f; /* x + shift - shift rounds to an integer, whose bits are the low ones of x + shift */
  const float log2_high = 0x1.62ep-1f,
              log2_low = 0x1.0bfbe8p-15f; /* log 2, the first part short: its products are exact */
  x = vf_select(x > 89, vf_all(89), vf_select(x < -104, vf_all(-104), x)); /* a NaN stays one */
  const vf shifted = x * 1.44269504f + shift;
  const vf k = shifted - shift;
  const vf r = (x - k * log2_high) - k * log2_low;
  vf sum = vf_all(1.0f / 5040);
  sum = sum * r + 1.0f / 720;
  sum = sum * r + 1.0f / 120;
  sum = sum * r + 1.0f / 24;
  sum = sum * r + 1.0f / 6;
  sum = sum * r + 0.5f;
  sum = sum * r + 1;
  sum = sum * r + 1;
  const vi power = (vi)shifted - (vi)vf_all(shift), half = power >> 1;
  return sum * (vf)((half + 127) << 23) * (vf)((power - half + 127) << 23);
}

LANES_INLINE vf vf_absolute(vf x) { return (vf)((vi)x & INT32_MAX); }

LANES_INLINE vf sigmoid(vf x) { return 1 / (1 + vf_exp(-x)); }

/* e/(1 + e)^2 with e = exp(-|x|) */
LANES_INLINE vf sigmoid_slope(vf x) {
  const vf e = vf_exp(-vf_absolute(x));
  return e / ((1 + e) * (1 + e));
}

LANES_INLINE vf clamp(vf x, float low, float high) {
  return vf_select(x < low, vf_all(low), vf_select(x > high, vf_all(high), x));
}

/* The softplus is the reference's: one a sample, in training only. */
void ERN_ISA(ern_activate_fwd)(float *y, const float *x, ern_activation kind, size_t n) {
  if (kind == ERN_ACT_SOFTPLUS) {
    ern_activate_fwd_ref(y, x, kind, n);
    return;
  }
  for (size_t i = 0; i < n; i += LANES) {
    const size_t count = n - i < LANES ? n - i : LANES;
    vf value = vf_load_some(x + i, count);
    switch (kind) {
      case ERN_ACT_DENSITY: value = vf_exp(vf_select(value > 80, vf_all(80), value)); break;
      case ERN_ACT_COLOUR: value = 1.002f * sigmoid(value) - 0.001f; break;
      default: value = sigmoid(value); break;
    }
    vf_store_some(y + i, value, count);
  }
}

void ERN_ISA(ern_activate_bwd)(float *dx, const float *dy, const float *x, ern_activation kind, size_t n) {
  for (size_t i = 0; i < n; i += LANES) {
    const size_t count = n - i < LANES ? n - i : LANES;
    vf value = vf_load_some(x + i, count);
    switch (kind) {
      case ERN_ACT_DENSITY: value = vf_exp(clamp(value, -15, 15)); break;
      case ERN_ACT_COLOUR: value = 1.002f * sigmoid_slope(value); break;
      case ERN_ACT_SIGMOID: value = sigmoid_slope(value); break;
      case ERN_ACT_SOFTPLUS: value = sigmoid(value); break;
    }
    vf_store_some(dx + i, vf_load_some(dy + i, count) * value, count);
  }
}
