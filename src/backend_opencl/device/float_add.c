/* SPDX-License-Identifier: MIT
 * Finds out how a device adds to a float in its memory. A compiler that announces a way may still lack it: AMD's has
 * the builtin for some GPUs alone, and clang 14's __has_builtin is true for all of them. So a program is built. */
#include "backend_opencl/device/float_add.h"

#include <stdio.h>

#include "backend_opencl/device/kernel_sources.h"

enum { SINGLE_FP_ATOMIC_CAPABILITIES = 0x4231, GLOBAL_FP_ATOMIC_ADD = 1 << 1 }; /* of cl_ext_float_atomics */

const char *ern_cl_float_add_standard(ern_cl_float_add way) {
  return way == ERN_CL_FLOAT_ADD_EXTENSION ? "CL3.0" : "CL1.2";
}

static bool builds(cl_platform_id platform, cl_device_id device, ern_cl_float_add way) {
  static const char kernel[] = "\nkernel void add(global float *at) { add_atomically(at, 1); }\n";
  const char *text[2] = {(const char *)ern_cl_text_float_add, kernel};
  const size_t bytes[2] = {ern_cl_bytes_float_add, sizeof kernel - 1};
  const cl_context_properties properties[] = {CL_CONTEXT_PLATFORM, (cl_context_properties)platform, 0};
  char options[64];
  cl_int code = CL_SUCCESS;
  snprintf(options, sizeof options, "-cl-std=%s -D FLOAT_ADD=%d", ern_cl_float_add_standard(way), (int)way);
  cl_context context = clCreateContext(properties, 1, &device, NULL, NULL, &code);
  if (code != CL_SUCCESS) return false;
  cl_program program = clCreateProgramWithSource(context, 2, text, bytes, &code);
  if (code == CL_SUCCESS) {
    code = clBuildProgram(program, 1, &device, options, NULL, NULL);
    clReleaseProgram(program);
  }
  clReleaseContext(context);
  return code == CL_SUCCESS;
}

ern_cl_float_add ern_cl_float_add_find(cl_platform_id platform, cl_device_id device, bool nvidia, bool extension,
                                       bool amd) {
  cl_bitfield able = 0;
  if (nvidia) return ERN_CL_FLOAT_ADD_PTX;
  if (extension && clGetDeviceInfo(device, SINGLE_FP_ATOMIC_CAPABILITIES, sizeof able, &able, NULL) == CL_SUCCESS &&
      (able & GLOBAL_FP_ATOMIC_ADD) != 0 && builds(platform, device, ERN_CL_FLOAT_ADD_EXTENSION))
    return ERN_CL_FLOAT_ADD_EXTENSION;
  return amd && builds(platform, device, ERN_CL_FLOAT_ADD_AMD) ? ERN_CL_FLOAT_ADD_AMD : ERN_CL_FLOAT_ADD_LOOP;
}
