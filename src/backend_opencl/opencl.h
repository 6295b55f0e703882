/* SPDX-License-Identifier: MIT
 * Common declarations of the OpenCL slots. Kernels are in kernels/, one .cl file for each noun, compiled after
 * kernels/common.cl; NOUN.c launches them.
 *
 * A kernel takes a span as two arguments (base, offset) and rows as three (base, offset, stride): see common.cl. */
#ifndef ERN_OPENCL_H
#define ERN_OPENCL_H

#include "backend_opencl/device/buffer.h"
#include "backend_opencl/device/launch.h"
#include "core/status.h"

#define ERN_CL_SLOT(name) ern_status ern_cl_##name(struct ern_stream *, struct ern_##name##_args *);
ERN_SLOTS(ERN_CL_SLOT)
#undef ERN_CL_SLOT

#endif
