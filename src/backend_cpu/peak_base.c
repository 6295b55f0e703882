/* SPDX-License-Identifier: MIT
 * Peak throughput of the architecture's baseline instruction set, for which the reference is compiled: products and
 * sums are rounded separately (no fused multiply-add), registers have four floats. */
#define ERN_ISA_NAME base
#include "backend_cpu/simd/peak.c"

typedef double vd __attribute__((vector_size(LANES * 4)));

double ern_peak_multiply_base64(float *sink, size_t turns) {
  const vd zero = {0};
  const vd a = zero + 0.999, b = zero + 1e-3;
  vd chain[MULTIPLY_CHAINS];
  for (int k = 0; k < MULTIPLY_CHAINS; k++) chain[k] = b * (double)k;
  for (size_t turn = 0; turn < turns; turn++) {
#pragma GCC unroll 12
    for (int k = 0; k < MULTIPLY_CHAINS; k++) chain[k] = chain[k] * a + b;
  }
  for (int k = 1; k < MULTIPLY_CHAINS; k++) chain[0] += chain[k];
  *sink = (float)chain[0][0];
  return 2.0 * MULTIPLY_CHAINS * (LANES / 2) * (double)turns;
}
