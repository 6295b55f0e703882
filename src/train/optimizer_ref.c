/* SPDX-License-Identifier: MIT
 * AdamW, and the moving average of the weights (docs/maths.md, Update). */
#include <float.h>
#include <tgmath.h>

#include "train/optimizer_ops.h"

#ifdef ERN_DOUBLE
static const ern_real largest = DBL_MAX, shrink = 0x1p-512;
#else
static const ern_real largest = FLT_MAX, shrink = 0x1p-64f;
#endif

/* p -= rate decay p;  v = beta2 v + (1 - beta2) g^2;  p -= rate g/(sqrt(v/bias_correction) + eps).
 * The root is split, so that v/bias_correction cannot overflow. Where v overflows, the quotient is computed from a
 * scaled-down gradient and moment (eps is negligible there), and v is clamped to the largest number, from which it
 * decays again. */
void ERN_REF(ern_adamw)(ern_real *parameters, ern_real *second_moment, const ern_real *gradient, float rate,
                        float decay, float beta2, float eps, double bias_correction, size_t n) {
  const ern_real keep = (ern_real)(1 - (double)rate * (double)decay), fresh = (ern_real)(1 - (double)beta2);
  const ern_real unbias = (ern_real)(1 / sqrt(bias_correction));
  for (size_t i = 0; i < n; i++) {
    const ern_real g = gradient[i], v = beta2 * second_moment[i] + fresh * g * g;
    ern_real step = g / (sqrt(v) * unbias + eps);
    if (v > largest) {
      const ern_real less = g * shrink, moment = second_moment[i] * shrink * shrink;
      step = less / (sqrt(beta2 * moment + fresh * less * less) * unbias);
    }
    parameters[i] = keep * parameters[i] - rate * step;
    second_moment[i] = v > largest ? largest : v;
  }
}

/* average += (1 - decay)(parameters - average) */
void ERN_REF(ern_ema)(ern_real *average, const ern_real *parameters, float decay, size_t n) {
  const ern_real fresh = (ern_real)(1 - (double)decay);
  for (size_t i = 0; i < n; i++) average[i] += fresh * (parameters[i] - average[i]);
}
