/* SPDX-License-Identifier: MIT
 * Each file simd/NOUN.c is compiled once for each instruction set (cmake/instruction_sets.cmake), with
 * ERN_ISA_NAME as avx2, avx512, avx512bf16 or neon: ERN_ISA(ern_mlp_fwd) is ern_mlp_fwd_avx2. */
#ifndef ERN_SIMD_ISA_H
#define ERN_SIMD_ISA_H

#define ERN_ISA_JOINED(name, isa) name##_##isa
#define ERN_ISA_OF(name, isa) ERN_ISA_JOINED(name, isa)
#define ERN_ISA(name) ERN_ISA_OF(name, ERN_ISA_NAME)

#endif
