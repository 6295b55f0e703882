/* SPDX-License-Identifier: MIT
 * Slots of the activations. */
#include "backend_opencl/opencl.h"
#include "mlp/activation_ops.h"

/* In the order of ern_activation. */
static const char *const activate_fwd_kernel[] = {"activate_fwd_density", "activate_fwd_colour", "activate_fwd_sigmoid",
                                                  "activate_fwd_softplus", "activate_fwd_relu"};
static const char *const activate_bwd_kernel[] = {"activate_bwd_density", "activate_bwd_colour", "activate_bwd_sigmoid",
                                                  "activate_bwd_softplus", "activate_bwd_relu"};

ern_status ern_cl_activate_fwd(struct ern_stream *stream, struct ern_activate_fwd_args *a) {
  const struct ern_cl_blocks shape = ern_cl_blocks_of(stream, a->n);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_activation, activate_fwd_kernel[a->kind], "");
  ERN_CL_ARGS(&call, a->y, a->x, (int)shape.count, a->n);
  return ern_cl_run(&call, shape.count * (size_t)a->y.rows, shape.group);
}

ern_status ern_cl_activate_bwd(struct ern_stream *stream, struct ern_activate_bwd_args *a) {
  const struct ern_cl_blocks shape = ern_cl_blocks_of(stream, a->n);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_activation, activate_bwd_kernel[a->kind], "");
  ERN_CL_ARGS(&call, a->dx, a->dy, a->x, (int)shape.count, a->n);
  return ern_cl_run(&call, shape.count * (size_t)a->dx.rows, shape.group);
}
