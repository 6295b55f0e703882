/* SPDX-License-Identifier: MIT
 * Slots that convert between pixel rows and the caller's pictures. */
#include "backend_opencl/opencl.h"
#include "render/picture_ops.h"

/* Runs items for n elements, each item a vector of the device. */
static ern_status run_vectors(struct ern_cl_call *call, size_t n) {
  const size_t width = (size_t)call->stream->owner->device.width;
  return ern_cl_each(call, n / width + (n % width != 0));
}

ern_status ern_cl_background(struct ern_stream *stream, struct ern_background_args *a) {
  if (a->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_picture, "background", "");
  ERN_CL_ARGS(&call, a->pixel, a->opacity, a->background, a->torso, a->n);
  return run_vectors(&call, a->n);
}

ern_status ern_cl_picture(struct ern_stream *stream, struct ern_picture_args *a) {
  if (a->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_picture, "picture", "");
  ERN_CL_ARGS(&call, a->rgba, a->rgb, a->alpha, a->pixel, a->head, a->torso, a->n);
  return run_vectors(&call, a->n);
}

static ern_status run_list(struct ern_stream *stream, const char *kernel, ern_rows to, ern_rows from, ern_span pixel,
                           size_t n) {
  if (n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_picture, kernel, "");
  ERN_CL_ARGS(&call, to, from, pixel, from.rows, n);
  return ern_cl_each(&call, n);
}
ern_status ern_cl_gather(struct ern_stream *stream, struct ern_gather_args *a) {
  return run_list(stream, "gather", a->to, a->from, a->pixel, a->n);
}
ern_status ern_cl_scatter(struct ern_stream *stream, struct ern_scatter_args *a) {
  return run_list(stream, "scatter", a->to, a->from, a->pixel, a->n);
}

ern_status ern_cl_blend(struct ern_stream *stream, struct ern_blend_args *a) {
  if (a->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_picture, "blend", "");
  ERN_CL_ARGS(&call, a->to, a->from, a->weight, a->pixel, a->weight.count, a->n);
  return ern_cl_each(&call, a->n);
}

ern_status ern_cl_overlay(struct ern_stream *stream, struct ern_overlay_args *a) {
  if (a->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_picture, "overlay", "");
  ERN_CL_ARGS(&call, a->pixel, a->colour, a->opacity, a->background, a->n);
  return run_vectors(&call, a->n);
}

ern_status ern_cl_finite(struct ern_stream *stream, struct ern_finite_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  ern_status status = ERN_OK;
  ern_span found;
  int32_t host[ERN_CL_SUMS];
  a->finite = true;
  if (a->n == 0) return ERN_OK;
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, ERN_CL_SUMS, &found));
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_picture, "finite", "");
  ERN_CL_ARGS(&call, found, a->values, a->n);
  ERN_TRY(ern_cl_run_sums(&call));
  ERN_TRY(ern_cl_read(stream, host, found, ERN_CL_SUMS));
  for (size_t i = 0; i < ERN_CL_SUMS; i++) a->finite = a->finite && host[i] == 0;
fail:
  ern_arena_release(stream, mark);
  return status;
}
