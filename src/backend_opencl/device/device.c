/* SPDX-License-Identifier: MIT
 * Finds the OpenCL devices and queries their properties. */
#include "backend_opencl/device/device.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "backend_opencl/device/limits.h"

enum {
  MAX_PLATFORMS = 16,
  MAX_DEVICES = ERN_CL_MAX_DEVICES,
  EXTENSION_BYTES = 1 << 14,
  CPU_WIDTH = 16,
  COMPUTE_CAPABILITY_MAJOR = 0x4000 /* of cl_nv_device_attribute_query */
};

/* The ICD loader returns an error where no driver is installed. */
int ern_cl_devices_find(struct ern_cl_found found[MAX_DEVICES], int *platforms_found) {
  cl_platform_id platform[MAX_PLATFORMS];
  cl_uint platforms = 0;
  int count = 0;
  if (clGetPlatformIDs(MAX_PLATFORMS, platform, &platforms) != CL_SUCCESS) platforms = 0;
  if (platforms > MAX_PLATFORMS) platforms = MAX_PLATFORMS;
  for (cl_uint p = 0; p < platforms; p++) {
    cl_device_id device[MAX_DEVICES];
    cl_uint devices = 0;
    if (clGetDeviceIDs(platform[p], CL_DEVICE_TYPE_ALL, MAX_DEVICES, device, &devices) != CL_SUCCESS) continue;
    for (cl_uint d = 0; d < devices && d < MAX_DEVICES && count < MAX_DEVICES; d++)
      found[count++] = (struct ern_cl_found){platform[p], device[d]};
  }
  *platforms_found = (int)platforms;
  return count;
}

/* The text of a device; "" where it has none or a longer one. */
static void text_of(cl_device_id device, cl_device_info what, char *text, size_t bytes) {
  text[0] = 0;
  if (clGetDeviceInfo(device, what, bytes, text, NULL) != CL_SUCCESS) text[0] = 0;
  text[bytes - 1] = 0;
}

static uint64_t number_of(cl_device_id device, cl_device_info what, size_t bytes) {
  uint64_t value = 0; /* little-endian hosts: a cl_uint fills its low half */
  if (clGetDeviceInfo(device, what, bytes, &value, NULL) != CL_SUCCESS) value = 0;
  return value;
}

static bool has_extension(const char *extensions, const char *name) {
  const size_t length = strlen(name);
  for (const char *at = strstr(extensions, name); at != NULL; at = strstr(at + length, name))
    if ((at == extensions || at[-1] == ' ') && (at[length] == ' ' || at[length] == 0)) return true;
  return false;
}

void ern_cl_device_query(struct ern_cl_device *device) {
  char extensions[EXTENSION_BYTES];
  const cl_device_id id = device->id;
  text_of(id, CL_DEVICE_NAME, device->name, sizeof device->name);
  text_of(id, CL_DEVICE_VERSION, device->version, sizeof device->version);
  text_of(id, CL_DRIVER_VERSION, device->driver, sizeof device->driver);
  text_of(id, CL_DEVICE_EXTENSIONS, extensions, sizeof extensions);
  if (clGetPlatformInfo(device->platform, CL_PLATFORM_VERSION, sizeof device->platform_version,
                        device->platform_version, NULL) != CL_SUCCESS)
    device->platform_version[0] = 0;
  const char *driver = device->platform_version;
  device->keeps_kernels = strstr(driver, "pocl") != NULL || strstr(driver, "PoCL") != NULL;
  device->host = (number_of(id, CL_DEVICE_TYPE, sizeof(cl_device_type)) & CL_DEVICE_TYPE_CPU) != 0;
  device->cpu = device->host;
  device->exact_divide = (number_of(id, CL_DEVICE_SINGLE_FP_CONFIG, sizeof(cl_device_fp_config)) &
                          CL_FP_CORRECTLY_ROUNDED_DIVIDE_SQRT) != 0;
  device->nvidia = has_extension(extensions, "cl_nv_device_attribute_query");
  device->half = has_extension(extensions, "cl_khr_fp16");
  device->subgroups = has_extension(extensions, "cl_khr_subgroups") || has_extension(extensions, "cl_intel_subgroups");
  device->float_add =
      ern_cl_float_add_find(device->platform, id, device->nvidia, has_extension(extensions, "cl_ext_float_atomics"),
                            has_extension(extensions, "cl_amd_device_attribute_query"));
  const int native = (int)number_of(id, CL_DEVICE_NATIVE_VECTOR_WIDTH_FLOAT, sizeof(cl_uint));
  device->width = 1;
  /* overrides the form, to compare both on one device */
  const char *form = getenv("ERNERF_OPENCL_FORM");
  if (form != NULL && strcmp(form, "cpu") == 0) device->cpu = true;
  if (form != NULL && (strcmp(form, "gpu") == 0 || strcmp(form, "tensor") == 0)) device->cpu = false;
  const bool ampere = device->nvidia && number_of(id, COMPUTE_CAPABILITY_MAJOR, sizeof(cl_uint)) >= 8;
  device->tensor = !device->cpu && (form != NULL ? strcmp(form, "tensor") == 0 : ampere);
  for (int width = 4; device->cpu && width <= native && width <= CPU_WIDTH; width *= 2) device->width = width;
  device->group_most = (size_t)number_of(id, CL_DEVICE_MAX_WORK_GROUP_SIZE, sizeof(size_t));
  device->local_bytes = (size_t)number_of(id, CL_DEVICE_LOCAL_MEM_SIZE, sizeof(cl_ulong));
  device->memory_bytes = number_of(id, CL_DEVICE_GLOBAL_MEM_SIZE, sizeof(cl_ulong));
  device->buffer_bytes = number_of(id, CL_DEVICE_MAX_MEM_ALLOC_SIZE, sizeof(cl_ulong));
  device->units = (cl_uint)number_of(id, CL_DEVICE_MAX_COMPUTE_UNITS, sizeof(cl_uint));
}

ern_status ern_cl_device_open(ern_context *context, int number, struct ern_cl_device *device) {
  struct ern_cl_found found[MAX_DEVICES];
  int platforms = 0;
  const int count = ern_cl_devices_find(found, &platforms);
  if (platforms == 0)
    return ern_fail(context, ERN_E_UNSUPPORTED,
                    "OpenCL: no driver is installed (no ICD); install one for your device (Debian: pocl-opencl-icd "
                    "runs on the CPU), or use --backend cpu");
  if (count == 0)
    return ern_fail(context, ERN_E_UNSUPPORTED, "OpenCL: %d driver%s installed, but none of them has a device",
                    platforms, platforms == 1 ? " is" : "s are");
  if (number < 0 || number >= count)
    return ern_fail(context, ERN_E_UNSUPPORTED,
                    "OpenCL: found no device %d, expected 0 to %d (`ernerf info devices` lists them)", number,
                    count - 1);
  *device = (struct ern_cl_device){.platform = found[number].platform, .id = found[number].device};
  ern_cl_device_query(device);
  if (number_of(device->id, CL_DEVICE_AVAILABLE, sizeof(cl_bool)) == 0)
    return ern_fail(context, ERN_E_DEVICE, "OpenCL: device %d (%s) says it is not available", number, device->name);
  if (number_of(device->id, CL_DEVICE_COMPILER_AVAILABLE, sizeof(cl_bool)) == 0)
    return ern_fail(context, ERN_E_UNSUPPORTED, "OpenCL: device %d (%s) has no compiler for kernels", number,
                    device->name);
  if (device->group_most < ERN_CL_LIMIT_group_items)
    return ern_fail(context, ERN_E_UNSUPPORTED,
                    "OpenCL: device %d (%s) has work-groups of %zu items at most, expected %d or more", number,
                    device->name, device->group_most, ERN_CL_LIMIT_group_items);
  return ERN_OK;
}
