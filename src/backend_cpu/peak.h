/* SPDX-License-Identifier: MIT
 * Loops that measure a core's peak throughput, with which the kernels are compared. The suffix names the instruction
 * set that a loop needs; `base` is the architecture's baseline, which the reference kernels use. */
#ifndef ERN_CPU_PEAK_H
#define ERN_CPU_PEAK_H

#include <stddef.h>

enum { ERN_PEAK_TABLE = 1 << 14 /* floats of the table that gathers read: 64 KiB, a level of a hash grid */ };

/* Each returns its number of operations: floating-point operations (a multiply-add is two), or reads. It writes *sink,
 * so that the compiler cannot remove the loop. */
typedef double ern_peak_multiply_loop(float *sink, size_t turns);
typedef double ern_peak_gather_loop(float *sink, const float *table, size_t turns);

ern_peak_multiply_loop ern_peak_multiply_base, ern_peak_multiply_avx2, ern_peak_multiply_avx512,
    ern_peak_multiply_avx512bf16, ern_peak_multiply_neon;
ern_peak_gather_loop ern_peak_gather_base, ern_peak_gather_avx2, ern_peak_gather_avx512, ern_peak_gather_neon;
/* `count` floats, a multiple of 64; aligned to 64 bytes. */
typedef void ern_peak_copy_loop(float *restrict to, const float *restrict from, size_t count);
ern_peak_copy_loop ern_peak_copy_base, ern_peak_copy_avx2, ern_peak_copy_avx512, ern_peak_copy_neon;
typedef void ern_peak_update_loop(float *x, size_t count);
ern_peak_update_loop ern_peak_update_base, ern_peak_update_avx2, ern_peak_update_avx512, ern_peak_update_neon;
/* In double, for the double build of the reference; there are no SIMD versions. */
ern_peak_multiply_loop ern_peak_multiply_base64;

#endif
