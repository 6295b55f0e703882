/* SPDX-License-Identifier: MIT
 * The torso over a picture with AVX-512. */
#if !defined(__AVX512F__) || !defined(__AVX512DQ__) || !defined(__AVX512BW__) || !defined(__AVX512VL__) || \
    !defined(__FMA__)
#error "compile this file with -mavx512f -mavx512dq -mavx512bw -mavx512vl -mfma"
#endif

#define ERN_ISA(name) name##_avx512
#include "backend_cpu/torso_body.h"
