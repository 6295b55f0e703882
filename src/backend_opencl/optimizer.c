/* SPDX-License-Identifier: MIT
 * Slots of the optimizer and of the average. */
#include <math.h>

#include "backend_opencl/opencl.h"
#include "train/optimizer_ops.h"

/* bias correction 1 - beta2^step, exact for a billion steps too: expm1 of the logarithm. */
ern_status ern_cl_adamw(struct ern_stream *stream, struct ern_adamw_args *a) {
  if (a->n == 0) return ERN_OK;
  const double correction = -expm1((double)a->step * log((double)a->beta2));
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_optimizer, "adamw", "");
  ERN_CL_ARGS(&call, a->parameters, a->second_moment, a->gradient, a->rate,
              (float)(1 - (double)a->rate * (double)a->decay), a->beta2, (float)(1 - (double)a->beta2),
              (float)(1 / sqrt(correction)), a->eps, a->n);
  return ern_cl_each(&call, a->n);
}

ern_status ern_cl_ema(struct ern_stream *stream, struct ern_ema_args *a) {
  if (a->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_optimizer, "ema", "");
  ERN_CL_ARGS(&call, a->average, a->parameters, (float)(1 - (double)a->decay), a->n);
  return ern_cl_each(&call, a->n);
}
