/* SPDX-License-Identifier: MIT
 * The head's occupancy grid with NEON. */
#if !defined(__aarch64__)
#error "compile this file for aarch64"
#endif

#define ERN_ISA(name) name##_neon
#include "backend_cpu/occupancy_body.h"
