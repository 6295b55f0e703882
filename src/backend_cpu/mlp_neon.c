/* SPDX-License-Identifier: MIT
 * The fully connected stacks with NEON. */
#if !defined(__aarch64__)
#error "compile this file for aarch64"
#endif

#define ERN_ISA(name) name##_neon
#include "backend_cpu/mlp_body.h"
