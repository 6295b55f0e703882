/* SPDX-License-Identifier: MIT
 * Which forms of kernels an OpenCL device is checked with. A file of its own: a device's ern_buffer is another struct
 * than the CPU's. */
#include "machines.h"

#if defined(ERN_OPENCL)
#include "backend_opencl/opencl.h"

bool has_form_for_cpus(const ern_backend *backend) {
  return strcmp(backend->name, "opencl") != 0 || ((const struct ern_cl_backend *)backend)->device.host;
}
#else
bool has_form_for_cpus(const ern_backend *backend) { return backend != NULL; }
#endif
