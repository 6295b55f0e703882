/* SPDX-License-Identifier: MIT
 * The head's density at points, stage by stage. */
#include "core/status.h"
#include "model/head.h"
#include "render/render_ops.h"
#include "train/step.h"
#include "train/step_ops.h"

enum { CACHED = 1 << 14 /* points whose activations stay in the cache */ };

static ern_rows rows_from(ern_rows rows, size_t begin) {
  rows.span = ern_span_part(rows.span, begin, rows.span.count - begin);
  return rows;
}

static ern_status chunk(struct ern_stream *stream, const struct ern_head_density_args *a, size_t begin, size_t n) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  const struct ern_head_inputs in = {
      .field = a->field, .parameters = a->parameters, .code = a->code, .eye = a->eye_value};
  struct ern_head_batch batch;
  ern_status status = ERN_OK;
  ERN_TRY(ern_head_batch_take(stream, a->field, n, ERN_BATCH_DENSITY, &batch));
  ERN_TRY(ern_head_density_fwd(stream, &in, rows_from(a->x, begin), &batch));
  ERN_TRY(stream->backend->copy(stream, ern_span_part(a->sigma, begin, n), batch.sigma.span, n));
fail:
  ern_arena_release(stream, mark);
  return status;
}

ern_status ern_head_density_stages(struct ern_stream *stream, struct ern_head_density_args *args) {
  const size_t most = args->at_once > 0 ? args->at_once : CACHED;
  ern_status status = ERN_OK;
  for (size_t begin = 0; begin < args->n && status == ERN_OK; begin += most)
    status = chunk(stream, args, begin, args->n - begin < most ? args->n - begin : most);
  return status;
}
