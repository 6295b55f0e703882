/* SPDX-License-Identifier: MIT
 * The fused pass of rendering with AVX-512 whose layers multiply pairs of bf16. */
#if !defined(__AVX512F__) || !defined(__AVX512DQ__) || !defined(__AVX512BW__) || !defined(__AVX512VL__) || \
    !defined(__AVX512BF16__) || !defined(__FMA__)
#error "compile this file with -mavx512f -mavx512dq -mavx512bw -mavx512vl -mavx512bf16 -mfma"
#endif

#define ERN_ISA(name) name##_avx512bf16
#define ERN_TILE_PAIRS
#include "backend_cpu/render_body.h"
