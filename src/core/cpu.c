/* SPDX-License-Identifier: MIT */
#include "core/cpu.h"

#include <stdio.h>
#include <string.h>

#if defined(__x86_64__)
#include <cpuid.h>
#endif

const char *ern_isa_name(ern_isa isa) {
  static const char *const name[ERN_ISAS] = {"ref", "ref64", "avx2", "avx512", "avx512bf16", "neon"};
  return isa < ERN_ISAS ? name[isa] : "unknown";
}

bool ern_isa_available(ern_isa isa) {
  switch (isa) {
    case ERN_ISA_REF:
    case ERN_ISA_REF64: return true;
#if defined(ERN_X86_KERNELS)
    case ERN_ISA_AVX2: return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    case ERN_ISA_AVX512:
      return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
             __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("fma");
    case ERN_ISA_AVX512BF16: return ern_isa_available(ERN_ISA_AVX512) && __builtin_cpu_supports("avx512bf16");
#else
    case ERN_ISA_AVX2:
    case ERN_ISA_AVX512:
    case ERN_ISA_AVX512BF16: return false;
#endif
#if defined(ERN_ARM_KERNELS)
    case ERN_ISA_NEON: return true; /* every aarch64 has it */
#else
    case ERN_ISA_NEON: return false;
#endif
    case ERN_ISAS: break;
  }
  return false;
}

void ern_isa_list(char *text, size_t bytes) {
  size_t used = 0;
  if (bytes > 0) text[0] = 0;
  for (ern_isa isa = ERN_ISA_REF; isa < ERN_ISAS; isa++) {
    if (!ern_isa_available(isa) || used >= bytes) continue;
    const int written = snprintf(text + used, bytes - used, "%s%s", used > 0 ? " " : "", ern_isa_name(isa));
    if (written > 0) used += (size_t)written;
  }
}

void ern_cpu_name(char *text, size_t bytes) {
#if defined(__x86_64__)
  unsigned word[12] = {0};
  if ((unsigned)__get_cpuid_max(0x80000000u, NULL) >= 0x80000004u) {
    for (unsigned leaf = 0; leaf < 3; leaf++)
      __get_cpuid(0x80000002u + leaf, &word[4 * leaf], &word[4 * leaf + 1], &word[4 * leaf + 2], &word[4 * leaf + 3]);
    char brand[sizeof word + 1] = {0};
    memcpy(brand, word, sizeof word);
    const char *start = brand;
    while (*start == ' ') start++;
    snprintf(text, bytes, "%s", start);
    return;
  }
  snprintf(text, bytes, "x86-64");
#elif defined(__aarch64__)
  snprintf(text, bytes, "aarch64");
#else
  snprintf(text, bytes, "unknown processor");
#endif
}
