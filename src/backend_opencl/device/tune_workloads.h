/* SPDX-License-Identifier: MIT
 * Synthetic calls of the slots, for the tuner. */
#ifndef ERN_OPENCL_TUNE_LOADS_H
#define ERN_OPENCL_TUNE_LOADS_H

#include "backend_opencl/device/backend.h"
#include "model/field.h"
#include "model/torso_ops.h"
#include "render/render_ops.h"

struct ern_cl_workloads {
  struct ern_cl_backend *backend;
  struct ern_stream *stream; /* whose scratch holds what the calls read and write */
  struct ern_field field;
  struct ern_render_prepare_args prepare;
  struct ern_grid_bwd_args grid;
  struct ern_mlp_bwd_args mlp;
  struct ern_render_rays_args rays;
  struct ern_render_torso_args torso;
};
ERN_NODISCARD ern_status ern_cl_loads_make(struct ern_cl_backend *backend, struct ern_cl_workloads **loads);
void ern_cl_loads_free(struct ern_cl_workloads *loads); /* accepts NULL */
/* Prepares a stream for ern_cl_workload_run with the backend's present sizes; call it again after they change. */
ERN_NODISCARD ern_status ern_cl_workload_prepare(struct ern_cl_workloads *loads, ern_cl_tunable tunable,
                                                 struct ern_stream *stream);
/* Enqueues a call whose speed depends on the tunable. */
ERN_NODISCARD ern_status ern_cl_workload_run(struct ern_cl_workloads *loads, ern_cl_tunable tunable,
                                             struct ern_stream *stream);

#endif
