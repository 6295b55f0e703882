/* SPDX-License-Identifier: MIT
 * The kernels that the CPU's slots call: the reference in the scalar type of this build, and float kernels for each
 * instruction set. The suffix names the instruction set: avx2: AVX2 and FMA; avx512: AVX-512 F, DQ, BW, VL (both built
 * where ERN_X86_KERNELS is defined); neon: any aarch64 (where ERN_ARM_KERNELS is). */
#ifndef ERN_CORE_KERNELS_H
#define ERN_CORE_KERNELS_H

#include "core/operations.h"

#define ERN_KERNEL_OF_REF(name) ern_##name##_kernel ERN_REF(ern_##name);
#define ERN_KERNEL_OF_AVX2(name) ern_##name##_kernel ern_##name##_avx2;
#define ERN_KERNEL_OF_AVX512(name) ern_##name##_kernel ern_##name##_avx512;
#define ERN_KERNEL_OF_NEON(name) ern_##name##_kernel ern_##name##_neon;
ERN_KERNELS(ERN_KERNEL_OF_REF)
ERN_FAST_KERNELS(ERN_KERNEL_OF_AVX2)
ERN_FAST_KERNELS(ERN_KERNEL_OF_AVX512)
ERN_FAST_KERNELS(ERN_KERNEL_OF_NEON)

#endif
