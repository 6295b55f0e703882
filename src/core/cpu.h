/* SPDX-License-Identifier: MIT
 * Name and instruction sets of the processor. */
#ifndef ERN_CORE_CPU_H
#define ERN_CORE_CPU_H

#include <stdbool.h>
#include <stddef.h>

typedef enum ern_isa {
  ERN_ISA_REF,
  ERN_ISA_REF64,
  ERN_ISA_AVX2,
  ERN_ISA_AVX512,
  ERN_ISA_AVX512BF16, /* AVX-512; networks multiply pairs of bf16 when rendering */
  ERN_ISA_NEON,
  ERN_ISAS
} ern_isa;

const char *ern_isa_name(ern_isa isa); /* "ref", "ref64", "avx2", "avx512", "avx512bf16", "neon" */

/* Whether this build has kernels for it and this machine runs them. */
bool ern_isa_available(ern_isa isa);

/* The names of those available, with blanks between. */
void ern_isa_list(char *text, size_t bytes);

/* The processor's own name, or the architecture's. */
void ern_cpu_name(char *text, size_t bytes);

#endif
