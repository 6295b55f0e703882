/* SPDX-License-Identifier: MIT
 * The tuner: measures, once for a device and its driver, which work sizes are fastest. */
#ifndef ERN_OPENCL_TUNE_H
#define ERN_OPENCL_TUNE_H

#include "backend_opencl/device/backend.h"
#include "backend_opencl/device/cache.h"

/* The standard size, by the device's form. */
int ern_cl_standard_size(const struct ern_cl_device *device, ern_cl_tunable tunable);
/* The size to build with: the best measured one where it is clearly faster than the standard. */
int ern_cl_size_selected(const struct ern_cl_measured *measured);

/* Fills size[]: the best measured size where there is one and the backend may deviate from the standard. */
void ern_cl_sizes_set(struct ern_cl_backend *backend);
const char *ern_cl_tunable_name(ern_cl_tunable tunable);

/* The name of the entry in the cache folder: device, driver, form and the text of the kernels. */
ERN_NODISCARD ern_status ern_cl_tune_key(ern_context *context, const struct ern_cl_device *device,
                                         char key[ERN_CL_KEY_BYTES]);
/* measured: [ERN_CL_TUNABLE_COUNT], zeros where unknown: no entry, or an invalid one. */
void ern_cl_tune_read(ern_context *context, const struct ern_cl_device *device, struct ern_cl_measured *measured);
bool ern_cl_is_tuned(const struct ern_cl_measured *measured);             /* all of it is known */
unsigned ern_cl_unknown_tunables(const struct ern_cl_measured *measured); /* a bit each */
/* False where it cannot be written. */
bool ern_cl_tune_write(ern_context *context, const struct ern_cl_device *device,
                       const struct ern_cl_measured *measured);

/* Measures the tunables of `wanted` (a bit each) on the backend `bench`, for at most `seconds`; a tunable keeps its old
 * values unless all its sizes were measured. Skips a size that the device refuses. */
ERN_NODISCARD ern_status ern_cl_measure(struct ern_cl_backend *bench, unsigned wanted, double seconds,
                                        struct ern_cl_measured *measured);

#endif
