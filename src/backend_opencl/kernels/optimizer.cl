/* SPDX-License-Identifier: MIT
 * AdamW, and the moving average of the weights (docs/maths.md, Update). */

/* Each product and sum is rounded, as in the reference. */
#pragma OPENCL FP_CONTRACT OFF

/* p -= rate decay p;  v = beta2 v + (1 - beta2) g^2;  p -= rate g/(sqrt(v/bias_correction) + eps), with keep = 1 - rate
 * decay, fresh = 1 - beta2 and unbias = 1/sqrt(bias_correction), which the host computes in double.
 * sqrt(v/bias_correction) is computed as sqrt(v) unbias, so that the quotient cannot overflow. Where v itself
 * overflows, the step is computed from a scaled gradient and moment (eps is negligible there), and v is stored as the
 * largest float, from which it decays again. All [n]. */
kernel void adamw(SPAN(float, parameters), SPAN(float, second_moment), SPAN(const float, gradient), float rate,
                  float keep, float beta2, float fresh, float unbias, float eps, ulong n) {
  OPEN(float, parameters);
  OPEN(float, second_moment);
  OPEN(const float, gradient);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  const float g = gradient[i], v = beta2 * second_moment[i] + fresh * g * g;
  float step = g / (sqrt(v) * unbias + eps);
  if (v > FLT_MAX) {
    const float less = g * 0x1p-64f, moment = second_moment[i] * 0x1p-64f * 0x1p-64f;
    step = less / (sqrt(beta2 * moment + fresh * less * less) * unbias);
  }
  parameters[i] = keep * parameters[i] - rate * step;
  second_moment[i] = v > FLT_MAX ? FLT_MAX : v;
}

/* average += fresh (parameters - average), fresh = 1 - decay; [n] */
kernel void ema(SPAN(float, average), SPAN(const float, parameters), float fresh, ulong n) {
  OPEN(float, average);
  OPEN(const float, parameters);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  average[i] += fresh * (parameters[i] - average[i]);
}
