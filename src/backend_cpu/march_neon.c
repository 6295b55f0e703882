/* SPDX-License-Identifier: MIT
 * Rays, marching and samples with NEON. */
#if !defined(__aarch64__)
#error "compile this file for aarch64"
#endif

#define ERN_ISA(name) name##_neon
#include "backend_cpu/march_body.h"
