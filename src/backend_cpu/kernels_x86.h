/* SPDX-License-Identifier: MIT
 * The kernels of each instruction set, under their first name. */
#ifndef ERN_KERNELS_X86_H
#define ERN_KERNELS_X86_H

#include "backend_cpu/kernels_isa.h"

#endif
