/* SPDX-License-Identifier: MIT
 * The torso over a picture with AVX2. */
#if !defined(__AVX2__) || !defined(__FMA__) || defined(__AVX512F__)
#error "compile this file with -mavx2 -mfma and without AVX-512"
#endif

#define ERN_ISA(name) name##_avx2
#include "backend_cpu/torso_body.h"
