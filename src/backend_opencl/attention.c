/* SPDX-License-Identifier: MIT
 * Slots of the region attention. */
#include "backend_opencl/opencl.h"
#include "model/attention_ops.h"

enum { PARTS = 64 }; /* as in kernels/attention.cl */

ern_status ern_cl_attention_fwd(struct ern_stream *stream, struct ern_attention_fwd_args *a) {
  const struct ern_cl_blocks shape = ern_cl_blocks_of(stream, a->n);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_attention, "attention_fwd", "");
  ern_cl_rows(&call, a->region);
  ern_cl_span(&call, a->norm);
  ern_cl_span(&call, a->region_eye);
  ern_cl_rows(&call, a->v);
  ern_cl_span(&call, a->code);
  ern_cl_span(&call, a->eye_attention);
  ern_cl_float(&call, a->eye);
  ern_cl_int(&call, a->region.rows);
  ern_cl_int(&call, a->v.rows);
  ern_cl_size(&call, a->n);
  return ern_cl_run(&call, shape.count, shape.group);
}

static ern_status bwd_eye(struct ern_stream *stream, const struct ern_attention_bwd_args *a) {
  const struct ern_cl_blocks shape = ern_cl_blocks_of(stream, a->forward.n);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_attention, "attention_eye_bwd", "");
  ern_cl_span(&call, a->deye_attention);
  ern_cl_span(&call, a->dregion_eye);
  ern_cl_float(&call, a->forward.eye);
  ern_cl_size(&call, a->forward.n);
  return ern_cl_run(&call, shape.count, shape.group);
}

/* parts: [channels][PARTS], or zeroed; dv zeroed: only the parts */
static ern_status bwd_v(struct ern_stream *stream, const struct ern_attention_bwd_args *a, ern_rows dv,
                        ern_span parts) {
  const struct ern_attention_fwd_args *forward = &a->forward;
  const size_t channels = (size_t)forward->region.rows;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_attention, "attention_bwd", "");
  ern_cl_rows(&call, dv);
  ern_cl_span(&call, parts);
  ern_cl_rows(&call, a->dregion);
  ern_cl_span(&call, a->dnorm);
  ern_cl_rows(&call, forward->v);
  ern_cl_span(&call, forward->norm);
  ern_cl_span(&call, forward->code);
  ern_cl_int(&call, (int)channels);
  ern_cl_int(&call, forward->v.rows);
  ern_cl_size(&call, forward->n);
  return ern_cl_run(&call, PARTS * channels, ern_cl_blocks_of(stream, 1).group);
}

static ern_status bwd_one(struct ern_stream *stream, const struct ern_attention_bwd_args *a) {
  const struct ern_attention_fwd_args *forward = &a->forward;
  const struct ern_cl_blocks shape = ern_cl_blocks_of(stream, forward->n);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_attention, "attention_one_bwd", "");
  ern_cl_span(&call, a->dv.span);
  ern_cl_rows(&call, a->dregion);
  ern_cl_span(&call, a->dnorm);
  ern_cl_span(&call, forward->v.span);
  ern_cl_span(&call, forward->norm);
  ern_cl_span(&call, forward->code);
  ern_cl_int(&call, forward->region.rows);
  ern_cl_size(&call, forward->n);
  return ern_cl_run(&call, shape.count, shape.group);
}

static ern_status bwd_code(struct ern_stream *stream, const struct ern_attention_bwd_args *a, ern_span parts) {
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_attention, "attention_code_bwd", "");
  ern_cl_span(&call, a->dcode);
  ern_cl_span(&call, parts);
  ern_cl_int(&call, a->forward.region.rows);
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
