/* SPDX-License-Identifier: MIT
 * Peak throughput of AVX512_BF16: products of pairs. */
#if !defined(__AVX512BF16__)
#error "compile this file with -mavx512f -mavx512dq -mavx512bw -mavx512vl -mavx512bf16 -mfma"
#endif

#include "backend_cpu/peak.h"
#include "backend_cpu/simd/lanes_bf16.h"

enum { PAIR_CHAINS = 16 /* enough for two units of latency 7 */ };

/* Each turn adds 2^-24 to a chain: no overflow and no denormals. */
double ern_peak_multiply_avx512bf16(float *sink, size_t turns) {
  vf chain[PAIR_CHAINS];
  const vu a = vf_pairs(vf_all(0x1p-12f), vf_all(0x1p-12f)), b = vf_pairs(vf_all(0x1p-13f), vf_all(0x1p-13f));
  for (int k = 0; k < PAIR_CHAINS; k++) chain[k] = vf_all((float)(k + 1));
  for (size_t turn = 0; turn < turns; turn++) {
#pragma GCC unroll 16
    for (int k = 0; k < PAIR_CHAINS; k++) chain[k] = vf_add_pairs(chain[k], a, b);
  }
  for (int k = 1; k < PAIR_CHAINS; k++) chain[0] += chain[k];
  *sink = chain[0][0];
  return 4.0 * PAIR_CHAINS * LANES * (double)turns;
}
