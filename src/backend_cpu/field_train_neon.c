/* SPDX-License-Identifier: MIT
 * The kernels of the fused training step with NEON. */
#if !defined(__aarch64__)
#error "compile this file for aarch64"
#endif

#define ERN_ISA(name) name##_neon
#include "backend_cpu/field_train_body.h"
