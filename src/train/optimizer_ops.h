/* SPDX-License-Identifier: MIT
 * AdamW, the moving average of parameters, and whether they are finite (docs/maths.md, Update). */
#ifndef ERN_OPTIMIZER_OPS_H
#define ERN_OPTIMIZER_OPS_H

#include "core/types.h"

/* AdamW with beta1 = 0, so that the first moment is the gradient and is not kept (Loshchilov and Hutter 2019):
 * p -= rate*decay*p; v = beta2*v + (1-beta2)*g^2; p -= rate*g/(sqrt(v/(1 - beta2^step)) + eps). */
struct ern_adamw_args {
  ern_span parameters, second_moment; /* in and out: real [n] */
  ern_span gradient;
  float rate, decay, beta2, eps;
  uint64_t step; /* of this update, from 1 */
  size_t n;
};
typedef void ern_adamw_kernel(ern_real *parameters, ern_real *second_moment, const ern_real *gradient, float rate,
                              float decay, float beta2, float eps, double bias_correction, size_t n);

/* average += (1 - decay)*(parameters - average) */
struct ern_ema_args {
  ern_span average; /* in and out */
  ern_span parameters;
  float decay;
  size_t n;
};
typedef void ern_ema_kernel(ern_real *average, const ern_real *parameters, float decay, size_t n);

/* Whether all values are finite. */
struct ern_finite_args {
  ern_span values;
  size_t n;
  bool finite; /* out, on the host */
};
typedef bool ern_finite_kernel(const ern_real *values, size_t n);

#define ERN_OPTIMIZER_OPERATIONS(OP, X) \
  OP(X, adamw, SLOT, FAST)              \
  OP(X, ema, SLOT, FAST)                \
  OP(X, finite, SLOT, FAST)

#endif
