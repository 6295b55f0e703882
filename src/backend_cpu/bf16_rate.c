/* SPDX-License-Identifier: MIT
 * Whether pairs of bf16 are worth their price here: processors that know VDPBF16PS differ fourfold in its rate, and
 * their names do not tell. */
#include "backend_cpu/backend_cpu.h"
#include "backend_cpu/peak.h"
#include "core/profile.h"

#if defined(ERN_X86_KERNELS)
enum { TURNS = 1000, REPEATS = 12 /* a tenth of a millisecond in all; the first wakes the wide units */ };

static double fastest(ern_peak_multiply_loop *loop, double best) {
  float sink = 0;
  const double began = ern_profile_now(), operations = loop(&sink, TURNS), took = ern_profile_now() - began;
  return took > 0 && operations / took > best ? operations / took : best;
}
#endif

/* The rates are 2 or 1/2 of each other on what is known; halfway (of the logarithm), with room for what both share. */
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
