/* SPDX-License-Identifier: MIT
 * An OpenCL device: what it can do, and how it is found. */
#ifndef ERN_OPENCL_DEVICE_H
#define ERN_OPENCL_DEVICE_H

#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>
#include <stdbool.h>
#include <stdint.h>

#include "backend_opencl/device/float_add.h"
#include "core/status.h"

/* Properties of a device, queried once. */
struct ern_cl_device {
  cl_platform_id platform;
  cl_device_id id;
  char name[128], version[128], driver[128], platform_version[128];
  bool host; /* a CPU, whatever the form */
  bool cpu;  /* form of the kernels: a work-item processes a vector of samples, as suits a CPU; false: one sample, as
                suits a GPU. Follows the type of the device unless ERNERF_OPENCL_FORM=cpu|gpu|tensor is set */
  bool keeps_kernels; /* the driver has its own cache, and ours would only slow it: PoCL compiles each kernel once for
                         its launch and, to return a binary, once more for any size of work-group */
  bool exact_divide;  /* division and square root can be correctly rounded */
  bool half;          /* cl_khr_fp16 */
  bool nvidia;        /* the compiler takes PTX */
  bool tensor;        /* layers are computed by tensor cores, NVIDIA's of TF32: wide ones of the fused pass, those of a
                         training step. ERNERF_OPENCL_FORM=gpu: not; =tensor: also where there are none, in plain arithmetic */
  bool subgroups;     /* cl_khr_subgroups or cl_intel_subgroups */
  ern_cl_float_add float_add;
  int width;             /* samples a work-item processes: the native vector of a CPU, 1 elsewhere */
  size_t group_most;     /* work-items a group at most */
  size_t local_bytes;    /* local memory a group */
  uint64_t memory_bytes; /* global memory */
  uint64_t buffer_bytes; /* one buffer at most */
  cl_uint units;
};

enum { ERN_CL_MAX_DEVICES = 64 };
struct ern_cl_found {
  cl_platform_id platform;
  cl_device_id device;
};
/* The devices of all platforms, in their order; returns how many. No platform: a machine without OpenCL. */
int ern_cl_devices_find(struct ern_cl_found found[ERN_CL_MAX_DEVICES], int *platforms);
/* Fills all but platform and id. */
void ern_cl_device_query(struct ern_cl_device *device);
/* Opens device `number`, as ern_opencl_devices_list counts. ERN_E_UNSUPPORTED names what there is instead. */
ERN_NODISCARD ern_status ern_cl_device_open(ern_context *context, int number, struct ern_cl_device *device);

#endif
