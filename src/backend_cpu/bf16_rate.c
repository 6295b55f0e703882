/* SPDX-License-Identifier: MIT
 * Measures whether products of bf16 pairs are faster than float here: the rate of VDPBF16PS differs fourfold between
 * processors and cannot be inferred from their names. */
#include "backend_cpu/backend_cpu.h"
#include "backend_cpu/peak.h"
#include "core/profile.h"

#if defined(ERN_X86_KERNELS)
enum { TURNS = 1000, REPEATS = 12 /* 0.1 ms in all; the first powers up the wide units */ };

static double fastest(ern_peak_multiply_loop *loop, double best) {
  float sink = 0;
  const double began = ern_profile_now(), operations = loop(&sink, TURNS), took = ern_profile_now() - began;
  return took > 0 && operations / took > best ? operations / took : best;
}
#endif

/* On known processors the ratio of the rates is 2 or 1/2. The threshold is near the geometric mean, with a margin for
 * the overhead of both loops. */
bool ern_cpu_bf16_is_faster(void) {
#if defined(ERN_X86_KERNELS)
  double floats = 0, pairs = 0;
  if (!ern_isa_available(ERN_ISA_AVX512BF16)) return false;
  for (int k = 0; k < REPEATS; k++) {
    floats = fastest(ern_peak_multiply_avx512, floats);
    pairs = fastest(ern_peak_multiply_avx512bf16, pairs);
  }
  return pairs > 1.25 * floats;
#else
  return false;
#endif
}
