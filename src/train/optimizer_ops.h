/* SPDX-License-Identifier: MIT
 * AdamW, and the moving average of parameters (docs/maths.md, Update). */
#ifndef ERN_OPTIMIZER_OPS_H
#define ERN_OPTIMIZER_OPS_H

#include "core/operations.h"
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
#define ERN_COST_adamw(a) ern_cost("value", (a)->n, 12, 5, 0, 0)
typedef void ern_adamw_kernel(ern_real *parameters, ern_real *second_moment, const ern_real *gradient, float rate,
                              float decay, float beta2, float eps, double bias_correction, size_t n);

/* average += (1 - decay)*(parameters - average) */
struct ern_ema_args {
  ern_span average; /* in and out */
  ern_span parameters;
  float decay;
  size_t n;
};
#define ERN_COST_ema(a) ern_cost("value", (a)->n, 3, 3, 0, 0)
typedef void ern_ema_kernel(ern_real *average, const ern_real *parameters, float decay, size_t n);

ERN_DECLARE_KERNELS(ERN_OPTIMIZER_OPERATIONS)

#endif
