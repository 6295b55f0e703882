/* SPDX-License-Identifier: MIT
 * AdamW and the moving average for any instruction set (simd/isa.h). Products are rounded
 * separately, so that the results are bit-identical to the reference's; memory bandwidth is the limit anyway. */
#include <float.h>
#include <math.h>

#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes_double.h"
#include "train/optimizer_ops.h"

struct adamw_scales {
  vf keep, fresh, unbias, rate, beta2, eps;
};

/* The second moment of an entry without gradients halves every 69 steps (beta2 = 0.99), becomes denormal and stays so.
 * Some processors take 100 ns for a product or root of denormals, but convert and add them at full speed. So where a
 * denormal may occur, products and root are computed in double: exact, and rounded to float once. */

/* Whether v or a product may be denormal. */
LANES_INLINE bool near_denormal(vf v, vf g) {
  const vi v_bits = (vi)v & INT32_MAX, g_bits = (vi)g & INT32_MAX;
  const vi low_v = (v_bits > 0) & (v_bits < 0x01000000);              /* 2^-125 */
  return vi_any(low_v | ((g_bits > 0) & (g_bits < 0x21800000))) != 0; /* 2^-60 */
}

/* The product rounded to float. */
LANES_INLINE vf product_by_doubles(vf a, vf b) {
  struct vd_pair product = vd_of(a);
  const struct vd_pair wide_b = vd_of(b);
  for (int h = 0; h < 2; h++) product.half[h] *= wide_b.half[h];
  return vf_of(product);
}

/* beta2 v + (fresh g) g, and its root */
LANES_INLINE vf next_moment(vf v, vf g, const struct adamw_scales *s, vf *root) {
  if (!near_denormal(v, g)) {
    const vf next = vf_multiply_rounded(s->beta2, v) + vf_multiply_rounded(vf_multiply_rounded(s->fresh, g), g);
    *root = vf_sqrt(next);
    return next;
  }
  const vf next = product_by_doubles(s->beta2, v) + product_by_doubles(product_by_doubles(s->fresh, g), g);
  struct vd_pair wide = vd_of(next);
  for (int h = 0; h < 2; h++) wide.half[h] = vd_root(wide.half[h]); /* as good as one rounding: 53 >= 2*24 + 2 bits */
  *root = vf_of(wide);
  return next;
}

/* For a gradient whose square overflows: as in the reference, both are scaled by 2^-64. */
LANES_INLINE vf far_quotient(vf v, vf g, const struct adamw_scales *s) {
  const vf less = g * 0x1p-64f, moment = v * 0x1p-64f * 0x1p-64f;
  const vf next =
      vf_multiply_rounded(s->beta2, moment) + vf_multiply_rounded(vf_multiply_rounded(s->fresh, less), less);
  return less / vf_multiply_rounded(vf_sqrt(next), s->unbias);
}

LANES_INLINE void adamw_some(float *parameters, float *second_moment, const float *gradient,
                             const struct adamw_scales *s, size_t count) {
  const vf g = vf_load_partial(gradient, count), before = vf_load_partial(second_moment, count);
  vf root;
  const vf v = next_moment(before, g, s, &root);
  vf quotient = g / (vf_multiply_rounded(root, s->unbias) + s->eps);
  const vi far = v > FLT_MAX;
  if (vi_any(far)) quotient = vf_select(far, far_quotient(before, g, s), quotient);
  const vf step = vf_multiply_rounded(s->rate, quotient);
  vf_store_partial(parameters, vf_multiply_rounded(s->keep, vf_load_partial(parameters, count)) - step, count);
  vf_store_partial(second_moment, vf_select(far, vf_all(FLT_MAX), v), count);
}

void ERN_ISA(ern_adamw)(float *parameters, float *second_moment, const float *gradient, float rate, float decay,
                        float beta2, float eps, double bias_correction, size_t n) {
  const struct adamw_scales scales = {.keep = vf_all((float)(1 - (double)rate * (double)decay)),
                                      .fresh = vf_all((float)(1 - (double)beta2)),
                                      .unbias = vf_all((float)(1 / sqrt(bias_correction))),
                                      .rate = vf_all(rate),
                                      .beta2 = vf_all(beta2),
                                      .eps = vf_all(eps)};
  size_t i = 0;
  for (; i + LANES <= n; i += LANES) adamw_some(parameters + i, second_moment + i, gradient + i, &scales, LANES);
  if (i < n) adamw_some(parameters + i, second_moment + i, gradient + i, &scales, n - i);
}

LANES_INLINE void ema_some(float *average, const float *parameters, vf fresh, size_t count) {
  const vf own = vf_load_partial(average, count);
  vf_store_partial(average, own + vf_multiply_rounded(fresh, vf_load_partial(parameters, count) - own), count);
}

void ERN_ISA(ern_ema)(float *average, const float *parameters, float decay, size_t n) {
  const vf fresh = vf_all((float)(1 - (double)decay));
  size_t i = 0;
  for (; i + LANES <= n; i += LANES) ema_some(average + i, parameters + i, fresh, LANES);
  if (i < n) ema_some(average + i, parameters + i, fresh, n - i);
}
