/* SPDX-License-Identifier: MIT
 * How a device adds to a float in its memory. */
#ifndef ERN_OPENCL_FLOAT_ADD_H
#define ERN_OPENCL_FLOAT_ADD_H

#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>
#include <stdbool.h>

/* The values of FLOAT_ADD in kernels/float_add.cl. */
typedef enum ern_cl_float_add {
  ERN_CL_FLOAT_ADD_LOOP,      /* compare and swap, on any device */
  ERN_CL_FLOAT_ADD_PTX,       /* red.global.add.f32: NVIDIA */
  ERN_CL_FLOAT_ADD_EXTENSION, /* cl_ext_float_atomics: needs OpenCL C 3.0 */
  ERN_CL_FLOAT_ADD_AMD /* global_atomic_add_f32: AMD, where the compiler has the builtin for the GPU: clang 14 for
                          gfx90a, clang 15 for gfx940 too, not for gfx906, gfx908 and gfx1030 */
} ern_cl_float_add;

/* The one instruction that the device has, by what it announces: NVIDIA's PTX, `extension` cl_ext_float_atomics, an
 * `amd` compiler. The latter two are taken if a program with them builds, else the loop is. */
ern_cl_float_add ern_cl_float_add_find(cl_platform_id platform, cl_device_id device, bool nvidia, bool extension,
                                       bool amd);
/* The version of OpenCL C that it needs: "CL1.2". */
const char *ern_cl_float_add_standard(ern_cl_float_add way);

#endif
