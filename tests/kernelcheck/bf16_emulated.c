/* SPDX-License-Identifier: MIT
 * By AVX-512 alone: the same bodies over another header, and the whole rendering pass. */
#include "kernelcheck/bf16_emulated.h"
#define BF16_NAME(name) name##_emulated
#include "kernelcheck/bf16_kernels_body.h"

#define ERN_ISA_NAME bf16_emulated
#include "backend_cpu/simd/render.c"
