/* SPDX-License-Identifier: MIT
 * OpenCL programs: built at their first use, cached as binaries. */
#ifndef ERN_OPENCL_PROGRAM_H
#define ERN_OPENCL_PROGRAM_H

#include "backend_opencl/device/backend.h"
#include "backend_opencl/device/cache.h"

/* The program of a source and options ("" or "-D A=1 -D B=2"), built or read from the cache at its first use. It lives
 * as long as the backend. */
ERN_NODISCARD ern_status ern_cl_program_get(struct ern_cl_backend *backend, ern_cl_source source, const char *options,
                                            cl_program *program);
void ern_cl_programs_free(struct ern_cl_backend *backend);
/* Whether the cache has binaries of an earlier frame or training on the device. */
bool ern_cl_programs_kept(ern_context *context, const struct ern_cl_device *device);
/* The cache key of a program's binary: a hash of everything that it depends on. */
ERN_NODISCARD ern_status ern_cl_program_key(ern_context *context, const struct ern_cl_device *device,
                                            ern_cl_source source, const char *options, char key[ERN_CL_KEY_BYTES]);

/* Build options of a source for the device: "-cl-std=CL1.2 -D WIDTH=16 ...". */
void ern_cl_base_options(const struct ern_cl_device *device, ern_cl_source source, char *text, size_t bytes);

#endif
