/* SPDX-License-Identifier: MIT */
#include "backend_opencl/devices.h"

#include "core/status.h"

#if defined(ERN_OPENCL)
#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>

enum { MAX_PLATFORMS = 16, MAX_DEVICES = 64, TEXT_BYTES = 256 };

static void say_device(cl_device_id device, int number, void (*say)(void *, const ern_device_info *), void *user) {
  char name[TEXT_BYTES] = "", version[TEXT_BYTES] = "";
  cl_uint units = 0;
  cl_ulong memory = 0;
  if (clGetDeviceInfo(device, CL_DEVICE_NAME, sizeof name, name, NULL) != CL_SUCCESS) name[0] = 0;
  if (clGetDeviceInfo(device, CL_DEVICE_VERSION, sizeof version, version, NULL) != CL_SUCCESS) version[0] = 0;
  if (clGetDeviceInfo(device, CL_DEVICE_MAX_COMPUTE_UNITS, sizeof units, &units, NULL) != CL_SUCCESS) units = 0;
  if (clGetDeviceInfo(device, CL_DEVICE_GLOBAL_MEM_SIZE, sizeof memory, &memory, NULL) != CL_SUCCESS) memory = 0;
  const ern_device_info info = {.kind = "opencl",
                                .number = number,
                                .name = name,
                                .version = version,
                                .instruction_sets = "",
                                .compute_units = units,
                                .memory_bytes = memory};
  say(user, &info);
}

ern_status ern_opencl_devices_list(ern_context *context, void (*say)(void *, const ern_device_info *), void *user) {
  cl_platform_id platform[MAX_PLATFORMS];
  cl_uint platforms = 0;
  int number = 0;
  /* The loader answers with an error where no driver is installed: that is a machine without OpenCL. */
  if (clGetPlatformIDs(MAX_PLATFORMS, platform, &platforms) != CL_SUCCESS) platforms = 0;
  if (platforms == 0) ern_log(context, ERN_LOG_INFO, "OpenCL: no driver is installed");
  for (cl_uint p = 0; p < platforms && p < MAX_PLATFORMS; p++) {
    cl_device_id device[MAX_DEVICES];
    cl_uint devices = 0;
    if (clGetDeviceIDs(platform[p], CL_DEVICE_TYPE_ALL, MAX_DEVICES, device, &devices) != CL_SUCCESS) continue;
    for (cl_uint d = 0; d < devices && d < MAX_DEVICES; d++) say_device(device[d], number++, say, user);
  }
  return ERN_OK;
}
#else
ern_status ern_opencl_devices_list(ern_context *context, void (*say)(void *, const ern_device_info *), void *user) {
  (void)say, (void)user;
  ern_log(context, ERN_LOG_INFO, "OpenCL: this build is without it");
  return ERN_OK;
}
#endif
