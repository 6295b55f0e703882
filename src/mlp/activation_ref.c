/* SPDX-License-Identifier: MIT
 * Reference of the output activations. None overflows for a finite input; a NaN stays one. */
#include <tgmath.h>

#include "mlp/activation_ops.h"

/* 1/(1 + exp(-x)): exp may become infinite, the quotient is then 0 */
static ern_real sigmoid(ern_real x) { return 1 / (1 + exp(-x)); }

/* s(x) (1 - s(x)) = e/(1 + e)^2 with e = exp(-|x|): without cancellation where s is near 1 */
static ern_real sigmoid_derivative(ern_real x) {
  const ern_real e = exp(-fabs(x));
  return e / ((1 + e) * (1 + e));
}

/* log(1 + exp(x)) = max(x, 0) + log(1 + exp(-|x|)) */
static ern_real softplus(ern_real x) { return (x < 0 ? 0 : x) + log1p(exp(-fabs(x))); }

static ern_real clamp(ern_real x, ern_real low, ern_real high) { return x < low ? low : x > high ? high : x; }

void ERN_REF(ern_activate_fwd)(ern_real *y, const ern_real *x, ern_activation kind, size_t n) {
  for (size_t i = 0; i < n; i++) {
    switch (kind) {
      case ERN_ACT_DENSITY: y[i] = exp(x[i] > 80 ? 80 : x[i]); break;
      case ERN_ACT_COLOUR: y[i] = (ern_real)1.002 * sigmoid(x[i]) - (ern_real)0.001; break;
      case ERN_ACT_SIGMOID: y[i] = sigmoid(x[i]); break;
      case ERN_ACT_SOFTPLUS: y[i] = softplus(x[i]); break;
      case ERN_ACT_RELU: y[i] = x[i] < 0 ? 0 : x[i]; break;
    }
  }
}

void ERN_REF(ern_activate_bwd)(ern_real *dx, const ern_real *dy, const ern_real *x, ern_activation kind, size_t n) {
  for (size_t i = 0; i < n; i++) {
    switch (kind) {
      case ERN_ACT_DENSITY: dx[i] = dy[i] * exp(clamp(x[i], -15, 15)); break;
      case ERN_ACT_COLOUR: dx[i] = dy[i] * ((ern_real)1.002 * sigmoid_derivative(x[i])); break;
      case ERN_ACT_SIGMOID: dx[i] = dy[i] * sigmoid_derivative(x[i]); break;
      case ERN_ACT_SOFTPLUS: dx[i] = dy[i] * sigmoid(x[i]); break;
      case ERN_ACT_RELU: dx[i] = x[i] <= 0 ? 0 : dy[i]; break;
    }
  }
}
