/* SPDX-License-Identifier: MIT
 * Whole training steps and densities through the stages; where the device has too little memory for all rays at once,
 * with fewer rays at a time. */
#include "train/step.h"

#include "backend_opencl/opencl.h"
#include "render/render_ops.h"
#include "train/step_ops.h"

static ern_status too_little(struct ern_stream *stream, const char *what, const char *one) {
  ern_context *context = stream->backend->context;
  char cause[1800]; /* room is left for the rest of an error text of 2048 */
  (void)ern_last_error_copy(context, cause, sizeof cause);
  return ern_fail(context, ERN_E_NO_MEMORY, "%s does not fit into the device even with one %s at a time: %s", what, one,
                  cause);
}

/* Keeps a copy of the gradient, as a step may fail and be repeated: 2.5 MB for 14 levels, little beside the 100s of MB
 * of a step. */
ern_status ern_cl_head_step(struct ern_stream *stream, struct ern_head_step_args *a) {
  struct ern_cl_stream *own = ern_cl_stream_of(stream);
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  const struct ern_backend *backend = stream->backend;
  size_t at_once = own->rays_at_once > 0 && own->rays_at_once < a->n ? own->rays_at_once : a->n;
  ern_status status = ERN_OK;
  char last_error[ERN_ERROR_BYTES];
  ern_span before;
  ern_error_keep(backend->context, last_error);
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, a->dparameters.count, &before));
  ERN_TRY(backend->copy(stream, before, a->dparameters, before.count));
  for (;;) {
    status = ern_cl_clean_up(stream, ern_head_step_parts(stream, a, at_once));
    if (status != ERN_E_NO_MEMORY) break;
    if (at_once <= 1) ERN_TRY(too_little(stream, "a training step", "ray"));
    at_once /= 2;
    ERN_TRY(backend->copy(stream, a->dparameters, before, before.count));
  }
  if (status == ERN_OK) ern_error_restore(backend->context, last_error);
  if (status == ERN_OK && at_once < a->n && own->rays_at_once != at_once) {
    own->rays_at_once = at_once;
    ern_log(backend->context, ERN_LOG_INFO,
            "OpenCL: too little memory for a training step of %zu rays at once; going on with %zu at a time, which is "
            "slower",
            a->n, at_once);
  }
fail:
  ern_arena_release(stream, mark);
  return status;
}

ern_status ern_cl_torso_step(struct ern_stream *stream, struct ern_torso_step_args *a) {
  return ern_cl_clean_up(stream, ern_torso_step_stages(stream, a));
}

/* On a GPU more points go through a stage together, as each launch has a cost. */
ern_status ern_cl_head_density(struct ern_stream *stream, struct ern_head_density_args *a) {
  enum { GPU_POINTS = 1 << 18 };
  struct ern_head_density_args part = *a;
  ern_status status = ERN_OK;
  char last_error[ERN_ERROR_BYTES];
  ern_error_keep(stream->backend->context, last_error);
  if (part.at_once == 0 && !ern_cl_backend_of(stream)->device.cpu) part.at_once = GPU_POINTS;
  for (size_t begin = 0; begin < a->n; begin += part.n) {
    part.x.span = ern_span_part(a->x.span, begin, a->x.span.count - begin);
    part.sigma = ern_span_part(a->sigma, begin, a->sigma.count - begin);
    if (part.n > a->n - begin) part.n = a->n - begin;
    while ((status = ern_cl_clean_up(stream, ern_head_density_stages(stream, &part))) == ERN_E_NO_MEMORY && part.n > 1)
      part.n /= 2;
    if (status == ERN_E_NO_MEMORY) return too_little(stream, "the density of points", "point");
    if (status != ERN_OK) return status;
  }
  ern_error_restore(stream->backend->context, last_error);
  return status;
}
