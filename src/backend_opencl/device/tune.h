/* SPDX-License-Identifier: MIT
 * The tuner: which sizes suit a device is measured once for a device and its driver (tune.c), on made-up calls of the
 * slots (tune_loads.c). */
#ifndef ERN_OPENCL_TUNE_H
#define ERN_OPENCL_TUNE_H

#include "backend_opencl/opencl.h"
#include "model/field.h"

/* Device `number` as a backend whose sizes are the standards. */
ERN_NODISCARD ern_status ern_cl_backend_open(ern_context *context, int number, bool deterministic,
                                             struct ern_cl_backend **backend);

/* The standard by the device's limits. */
int ern_cl_standard_size(const struct ern_cl_device *device, ern_cl_knob knob);
/* What is built: the best of those measured where it is clearly faster than the standard. */
int ern_cl_size_kept(const struct ern_cl_measured *measured);

/* Fills size[] and measured[] from the cache folder. On GPUs, what has not been measured for this device is now, where
 * that can be kept; if `asked`, all is on any device. Never fails; time is bounded. */
void ern_cl_tune(struct ern_cl_backend *backend, int number, bool asked);

/* The name of the entry in the cache folder: device, driver, form and the text of the kernels. */
ERN_NODISCARD ern_status ern_cl_tune_key(ern_context *context, const struct ern_cl_device *device,
                                         char key[ERN_CL_KEY_BYTES]);
/* measured: [ERN_CL_KNOB_COUNT], zeros for what is not known: no entry, or one that is not to be trusted. */
void ern_cl_tune_read(ern_context *context, const struct ern_cl_device *device, struct ern_cl_measured *measured);
bool ern_cl_is_tuned(const struct ern_cl_measured *measured); /* all of it is known */
/* False where it cannot be kept. */
bool ern_cl_tune_write(ern_context *context, const struct ern_cl_device *device,
                       const struct ern_cl_measured *measured);

/* Measures the knobs of `wanted` (a bit each) on a backend of its own, until `seconds` are over; a knob of which not
 * all sizes were reached stays as it was. A size that the device refuses is passed over. */
ERN_NODISCARD ern_status ern_cl_measure(struct ern_cl_backend *bench, unsigned wanted, double seconds,
                                        struct ern_cl_measured *measured);

/* ---- made-up calls ---- */

struct ern_cl_loads {
  struct ern_cl_backend *backend;
  struct ern_stream *stream; /* whose scratch holds what the calls read and write */
  struct ern_field field;
  struct ern_render_prepare_args prepare;
  struct ern_grid_bwd_args grid;
  struct ern_mlp_bwd_args mlp;
  struct ern_render_rays_args rays;
  struct ern_render_torso_args torso;
};
ERN_NODISCARD ern_status ern_cl_loads_make(struct ern_cl_backend *backend, struct ern_cl_loads **loads);
void ern_cl_loads_free(struct ern_cl_loads *loads); /* accepts NULL */
/* Readies a stream for run with the backend's sizes as they are, and again after they have changed. */
ERN_NODISCARD ern_status ern_cl_load_prepare(struct ern_cl_loads *loads, ern_cl_knob knob, struct ern_stream *stream);
/* Enqueues a call that the knob matters to. */
ERN_NODISCARD ern_status ern_cl_load_run(struct ern_cl_loads *loads, ern_cl_knob knob, struct ern_stream *stream);

#endif
