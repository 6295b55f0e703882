/* SPDX-License-Identifier: MIT
 * The peak of AVX2 and FMA. */
#if !defined(__AVX2__) || !defined(__FMA__)
#error "compile this file with -mavx2 -mfma"
#endif

#define ERN_ISA(name) name##_avx2
#include "backend_cpu/peak_body.h"
