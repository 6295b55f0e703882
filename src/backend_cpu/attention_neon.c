/* SPDX-License-Identifier: MIT
 * Region attention with NEON. */
#if !defined(__aarch64__)
#error "compile this file for aarch64"
#endif

#define ERN_ISA(name) name##_neon
#include "backend_cpu/attention_body.h"
