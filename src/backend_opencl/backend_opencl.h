/* SPDX-License-Identifier: MIT
 * The OpenCL devices of the machine, and each as a backend. */
#ifndef ERN_BACKEND_OPENCL_H
#define ERN_BACKEND_OPENCL_H

#include "ernerf/backend.h"

/* Calls `say` for each device of each platform, numbered consecutively from 0. Having none is no error. */
ERN_NODISCARD ern_status ern_opencl_devices_list(ern_context *context,
                                                 void (*say)(void *user, const ern_device_info *device), void *user);

/* The backend of device `number`; see ern_backend_config for `deterministic` and `tune`. ERN_E_UNSUPPORTED where there
 * is no driver or no such device, or where this build is without OpenCL. */
ERN_NODISCARD ern_status ern_opencl_backend_make(ern_context *context, int number, bool deterministic, bool tune,
                                                 ern_backend **backend);

/* The same with the standard work sizes, for the tuner. */
struct ern_cl_backend;
ERN_NODISCARD ern_status ern_cl_backend_open(ern_context *context, int number, bool deterministic,
                                             struct ern_cl_backend **backend);

/* ern_backend_tuning for an OpenCL backend. */
void ern_opencl_tuning(const ern_backend *backend, void (*say)(void *user, const ern_tuning *tuning), void *user);

#endif
