/* SPDX-License-Identifier: MIT
 * The output activations for any instruction set (simd/isa.h). A value does not depend on its lane. */
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes_math.h"
#include "mlp/activation_ops.h"

void ERN_ISA(ern_activate_fwd)(float *y, const float *x, ern_activation kind, size_t n) {
  for (size_t i = 0; i < n; i += LANES) {
    const size_t count = n - i < LANES ? n - i : LANES;
    vf value = vf_load_partial(x + i, count);
    switch (kind) {
      case ERN_ACT_DENSITY: value = vf_exp(vf_select(value > 80, vf_all(80), value)); break;
      case ERN_ACT_COLOUR: value = 1.002f * vf_sigmoid(value) - 0.001f; break;
      case ERN_ACT_SIGMOID: value = vf_sigmoid(value); break;
      case ERN_ACT_SOFTPLUS: value = vf_softplus(value); break;
      case ERN_ACT_RELU: value = vf_select(value < 0, (vf){0}, value); break;
    }
    vf_store_partial(y + i, value, count);
  }
}

void ERN_ISA(ern_activate_bwd)(float *dx, const float *dy, const float *x, ern_activation kind, size_t n) {
  for (size_t i = 0; i < n; i += LANES) {
    const size_t count = n - i < LANES ? n - i : LANES;
    const vf by = vf_load_partial(dy + i, count);
    vf value = vf_load_partial(x + i, count);
    switch (kind) {
      case ERN_ACT_DENSITY: value = by * vf_exp(vf_clamp(value, -15, 15)); break;
      case ERN_ACT_COLOUR: value = by * (1.002f * vf_sigmoid_derivative(value)); break;
      case ERN_ACT_SIGMOID: value = by * vf_sigmoid_derivative(value); break;
      case ERN_ACT_SOFTPLUS: value = by * vf_sigmoid(value); break;
      case ERN_ACT_RELU: value = vf_select(value <= 0, (vf){0}, by); break;
    }
    vf_store_partial(dx + i, value, count);
  }
}
