/* SPDX-License-Identifier: MIT
 * AdamW, the moving average and the test for finite values with NEON. */
#if !defined(__aarch64__)
#error "compile this file for aarch64"
#endif

#define ERN_ISA(name) name##_neon
#include "backend_cpu/optimizer_body.h"
