/* SPDX-License-Identifier: MIT
 * The losses with NEON. */
#if !defined(__aarch64__)
#error "compile this file for aarch64"
#endif

#define ERN_ISA(name) name##_neon
#include "backend_cpu/losses_body.h"
