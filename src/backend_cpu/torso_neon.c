/* SPDX-License-Identifier: MIT
 * The torso over a picture with NEON. */
#if !defined(__aarch64__)
#error "compile this file for aarch64"
#endif

#define ERN_ISA(name) name##_neon
#include "backend_cpu/torso_body.h"
