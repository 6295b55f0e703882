/* SPDX-License-Identifier: MIT
 * Output activations. */
#ifndef ERN_ACTIVATION_OPS_H
#define ERN_ACTIVATION_OPS_H

#include "core/operations.h"
#include "core/types.h"

typedef enum ern_activation {
  ERN_ACT_DENSITY,  /* exp(min(x, 80)); dx = dy * exp(clamp(x, -15, 15)): the gradient is clamped on purpose */
  ERN_ACT_COLOUR,   /* 1.002/(1 + exp(-x)) - 0.001 */
  ERN_ACT_SIGMOID,  /* 1/(1 + exp(-x)) */
  ERN_ACT_SOFTPLUS, /* log(1 + exp(x)), without overflow */
  ERN_ACT_RELU      /* max(x, 0); no gradient at 0, so that y serves the backward pass as well as x */
} ern_activation;

struct ern_activate_fwd_args {
  ern_rows y; /* out; may be the same rows as x */
  ern_rows x;
  ern_activation kind;
  size_t n;
};
#define ERN_COST_activate_fwd(a) ERN_COST_ELSEWHERE
struct ern_activate_bwd_args {
  ern_rows dx; /* overwritten; may be the same rows as dy */
  ern_rows dy;
  ern_rows x; /* the input of the forward pass */
  ern_activation kind;
  size_t n;
};
#define ERN_COST_activate_bwd(a) ERN_COST_ELSEWHERE
typedef void ern_activate_fwd_kernel(ern_real *y, const ern_real *x, ern_activation kind, size_t n);
typedef void ern_activate_bwd_kernel(ern_real *dx, const ern_real *dy, const ern_real *x, ern_activation kind,
                                     size_t n);

ERN_DECLARE_KERNELS(ERN_ACTIVATION_OPERATIONS)

#endif
