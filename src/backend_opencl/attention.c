/* SPDX-License-Identifier: MIT
 * Slots of the region attention. */
#include "backend_opencl/opencl.h"
#include "model/attention_ops.h"

enum { PARTS = 64 }; /* as in kernels/attention.cl */

ern_status ern_cl_attention_fwd(struct ern_stream *stream, struct ern_attention_fwd_args *a) {
  const struct ern_cl_blocks shape = ern_cl_blocks_of(stream, a->n);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_attention, "attention_fwd", "");
  ERN_CL_ARGS(&call, a->region, a->norm, a->region_eye, a->v, a->code, a->eye_attention, a->eye, a->region.rows,
              a->v.rows, a->n);
  return ern_cl_run(&call, shape.count, shape.group);
}

ern_status ern_cl_attention_fade(struct ern_stream *stream, struct ern_attention_fade_args *a) {
  const struct ern_cl_blocks shape = ern_cl_blocks_of(stream, a->n);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_attention, "attention_fade", "");
  ERN_CL_ARGS(&call, a->v, a->height, a->fade[0], a->fade[1], a->v.rows, a->n);
  return ern_cl_run(&call, shape.count, shape.group);
}

static ern_status bwd_eye(struct ern_stream *stream, const struct ern_attention_bwd_args *a) {
  const struct ern_cl_blocks shape = ern_cl_blocks_of(stream, a->forward.n);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_attention, "attention_eye_bwd", "");
  ERN_CL_ARGS(&call, a->deye_attention, a->dregion_eye, a->forward.eye, a->forward.n);
  return ern_cl_run(&call, shape.count, shape.group);
}

/* parts: [channels][PARTS], or zeroed; dv zeroed: only the parts */
static ern_status bwd_v(struct ern_stream *stream, const struct ern_attention_bwd_args *a, ern_rows dv,
                        ern_span parts) {
  const struct ern_attention_fwd_args *forward = &a->forward;
  const size_t channels = (size_t)forward->region.rows;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_attention, "attention_bwd", "");
  ERN_CL_ARGS(&call, dv, parts, a->dregion, a->dnorm, forward->v, forward->norm, forward->code, (int)channels,
              forward->v.rows, forward->n);
  return ern_cl_run(&call, PARTS * channels, ern_cl_blocks_of(stream, 1).group);
}

static ern_status bwd_one(struct ern_stream *stream, const struct ern_attention_bwd_args *a) {
  const struct ern_attention_fwd_args *forward = &a->forward;
  const struct ern_cl_blocks shape = ern_cl_blocks_of(stream, forward->n);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_attention, "attention_one_bwd", "");
  ERN_CL_ARGS(&call, a->dv.span, a->dregion, a->dnorm, forward->v.span, forward->norm, forward->code,
              forward->region.rows, forward->n);
  return ern_cl_run(&call, shape.count, shape.group);
}

static ern_status bwd_code(struct ern_stream *stream, const struct ern_attention_bwd_args *a, ern_span parts) {
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_attention, "attention_code_bwd", "");
  ERN_CL_ARGS(&call, a->dcode, parts, a->forward.region.rows);
  return ern_cl_each(&call, (size_t)a->forward.region.rows);
}

ern_status ern_cl_attention_bwd(struct ern_stream *stream, struct ern_attention_bwd_args *a) {
  ern_status status = ERN_OK;
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  const size_t channels = (size_t)a->forward.region.rows;
  const bool one = a->forward.v.rows == 1 && channels > 1;
  const bool by_code = a->dcode.buffer != NULL && a->dregion.span.buffer != NULL;
  ern_span parts = {0};
  if (a->forward.n == 0) return ERN_OK;
  if (by_code) ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, PARTS * channels, &parts));
  if (one) ERN_TRY(bwd_one(stream, a));
  if (channels > 0 && (!one || by_code)) ERN_TRY(bwd_v(stream, a, one ? (ern_rows){.stride = 0} : a->dv, parts));
  if (by_code) ERN_TRY(bwd_code(stream, a, parts));
  if (a->deye_attention.buffer != NULL && a->dregion_eye.buffer != NULL) ERN_TRY(bwd_eye(stream, a));
fail:
  ern_arena_release(stream, mark);
  return status;
}
