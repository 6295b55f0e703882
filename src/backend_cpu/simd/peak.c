/* SPDX-License-Identifier: MIT
 * Peak throughput of a core with one instruction set: multiply-adds in registers, and random reads of a small table. */
#include "backend_cpu/peak.h"
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes.h"

enum {
  MULTIPLY_CHAINS = 12, /* independent chains, to saturate two units of latency 4; 12 + 2 registers of 16 */
  GATHER_CHAINS = 4
};

/* chain = chain*a + b stays near its fixed point b/(1 - a): no denormals, no overflow. */
double ERN_ISA(ern_peak_multiply)(float *sink, size_t turns) {
  vf chain[MULTIPLY_CHAINS];
  const vf a = vf_all(0.999f), b = vf_all(1e-3f);
  for (int k = 0; k < MULTIPLY_CHAINS; k++) chain[k] = b * vf_all((float)k);
  for (size_t turn = 0; turn < turns; turn++) {
#pragma GCC unroll 12
    for (int k = 0; k < MULTIPLY_CHAINS; k++) chain[k] = chain[k] * a + b;
  }
  for (int k = 1; k < MULTIPLY_CHAINS; k++) chain[0] += chain[k];
  *sink = chain[0][0];
  return 2.0 * MULTIPLY_CHAINS * LANES * (double)turns;
}

/* Plain loads and stores through the caches: where the copy stays in a cache this is faster than memcpy, which bypasses
 * them. */
void ERN_ISA(ern_peak_copy)(float *restrict to, const float *restrict from, size_t count) {
  for (size_t i = 0; i < count; i += 4 * LANES) {
    const vf a = vf_load(from + i), b = vf_load(from + i + LANES), c = vf_load(from + i + 2 * LANES),
             d = vf_load(from + i + 3 * LANES);
    vf_store(to + i, a);
    vf_store(to + i + LANES, b);
    vf_store(to + i + 2 * LANES, c);
    vf_store(to + i + 3 * LANES, d);
  }
}

/* Negates every value in place. No cache line is fetched only to be overwritten, so its useful bandwidth is higher than
 * a copy's. */
void ERN_ISA(ern_peak_update)(float *x, size_t count) {
  for (size_t i = 0; i < count; i += 4 * LANES)
    for (size_t k = 0; k < 4; k++) vf_store(x + i + k * LANES, -vf_load(x + i + k * LANES));
}

/* Indices are the high bits of a linear congruential generator (constants of Numerical Recipes); ERN_PEAK_TABLE is
 * 2^14. */
double ERN_ISA(ern_peak_gather)(float *sink, const float *table, size_t turns) {
  vf sum[GATHER_CHAINS];
  vu state[GATHER_CHAINS];
  for (int k = 0; k < GATHER_CHAINS; k++) {
    sum[k] = vf_all(0);
    for (int l = 0; l < LANES; l++) state[k][l] = 2654435761u * (uint32_t)(k * LANES + l + 1);
  }
  for (size_t turn = 0; turn < turns; turn++) {
#pragma GCC unroll 4
    for (int k = 0; k < GATHER_CHAINS; k++) {
      state[k] = state[k] * 1664525u + 1013904223u;
      sum[k] += vf_gather(table, state[k] >> 18);
    }
  }
  for (int k = 1; k < GATHER_CHAINS; k++) sum[0] += sum[k];
  *sink = sum[0][0];
  return 1.0 * GATHER_CHAINS * LANES * (double)turns;
}
