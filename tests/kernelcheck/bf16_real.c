/* SPDX-License-Identifier: MIT
 * By the instructions. */
#define BF16_NAME(name) name##_real
#include "kernelcheck/bf16_kernels_body.h"
