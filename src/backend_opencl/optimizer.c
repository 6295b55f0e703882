/* SPDX-License-Identifier: MIT
 * Slots of the optimizer and of the average. */
#include <math.h>

#include "backend_opencl/opencl.h"

/* bias correction 1 - beta2^step, exact for a billion steps too: expm1 of the logarithm. */
ern_status ern_cl_adamw(struct ern_stream *stream, struct ern_adamw_args *a) {
  if (a->n == 0) return ERN_OK;
  const double correction = -expm1((double)a->step * log((double)a->beta2));
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_optimizer, "adamw", "");
  ern_cl_span(&call, a->parameters);
  ern_cl_span(&call, a->second_moment);
  ern_cl_span(&call, a->gradient);
  ern_cl_float(&call, a->rate);
  ern_cl_float(&call, (float)(1 - (double)a->rate * (double)a->decay));
  ern_cl_float(&call, a->beta2);
  ern_cl_float(&call, (float)(1 - (double)a->beta2));
  ern_cl_float(&call, (float)(1 / sqrt(correction)));
  ern_cl_float(&call, a->eps);
  ern_cl_size(&call, a->n);
  return ern_cl_each(&call, a->n);
}

ern_status ern_cl_ema(struct ern_stream *stream, struct ern_ema_args *a) {
  if (a->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_optimizer, "ema", "");
  ern_cl_span(&call, a->average);
  ern_cl_span(&call, a->parameters);
  ern_cl_float(&call, (float)(1 - (double)a->decay));
  ern_cl_size(&call, a->n);
  return ern_cl_each(&call, a->n);
}

ern_status ern_cl_finite(struct ern_stream *stream, struct ern_finite_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  ern_status status = ERN_OK;
  ern_span found;
  int32_t host[ERN_CL_SUMS];
  a->finite = true;
  if (a->n == 0) return ERN_OK;
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, ERN_CL_SUMS, &found));
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_optimizer, "finite", "");
  ern_cl_span(&call, found);
  ern_cl_span(&call, a->values);
  ern_cl_size(&call, a->n);
  ERN_TRY(ern_cl_run_sums(&call));
  ERN_TRY(ern_cl_read(stream, host, found, ERN_CL_SUMS));
  for (size_t i = 0; i < ERN_CL_SUMS; i++) a->finite = a->finite && host[i] == 0;
fail:
  ern_arena_release(stream, mark);
  return status;
}
