/* SPDX-License-Identifier: MIT
 * AdamW, the moving average of the weights, and the test for finite values (docs/maths.md, Update). */

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

#define GROUP 64              /* values that a group tests at a time; ERN_CL_SUM_GROUP */
#define ITEMS (GROUP / WIDTH) /* work-items of a group */

/* found: [groups], whether one of a group's values, (n + groups - 1)/groups consecutive ones, is not finite */
kernel __attribute__((reqd_work_group_size(ITEMS, 1, 1))) void finite(SPAN(int, found), SPAN(const float, values),
                                                                      ulong n) {
  OPEN(int, found);
  OPEN(const float, values);
  local uint any[GROUP];
  const ulong part = (n + get_num_groups(0) - 1) / get_num_groups(0);
  const ulong begin = min(get_group_id(0) * part, n), end = min(begin + part, n);
  const uint item = get_local_id(0);
  uintw own = 0; /* the largest exponent */
  for (ulong i = begin + item * WIDTH; i < end; i += GROUP)
    own = max(own, JOINW(as_uint)(loadw_first(values + i, end - i)) & 0x7f800000u);
  STOREW(own, any + item * WIDTH);
  barrier(CLK_LOCAL_MEM_FENCE);
  if (item != 0) return;
  uint most = 0;
  for (uint k = 0; k < GROUP; k++) most = max(most, any[k]);
  found[get_group_id(0)] = most == 0x7f800000u;
}
