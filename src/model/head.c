/* SPDX-License-Identifier: MIT */
#include "model/head.h"

#include "core/status.h"

static bool has(ern_rows rows) { return rows.span.buffer != NULL; }

ern_status ern_head_batch_take(struct ern_stream *stream, const struct ern_field *field, size_t n, int parts,
                               struct ern_head_batch *batch) {
  ern_status status = ERN_OK;
  *batch = (struct ern_head_batch){.n = n};
  ERN_TRY(ern_take_rows(stream, field->feature_rows, n, &batch->f));
  ERN_TRY(ern_take_rows(stream, ERN_AUDIO_CODE, n, &batch->v));
  ERN_TRY(ern_take_rows(stream, ERN_AUDIO_CODE, n, &batch->region));
  ERN_TRY(ern_take_rows(stream, 1, n, &batch->norm));
  if (field->config.eye) {
    ERN_TRY(ern_take_rows(stream, 1, n, &batch->eye_raw));
    ERN_TRY(ern_take_rows(stream, 1, n, &batch->eye));
    ERN_TRY(ern_take_rows(stream, 1, n, &batch->region_eye));
  }
  if (parts & ERN_BATCH_DENSITY) {
    ERN_TRY(ern_take_rows(stream, parts & ERN_BATCH_COLOUR ? 1 + ERN_GEOMETRY : 1, n, &batch->h));
    ERN_TRY(ern_take_rows(stream, 1, n, &batch->sigma));
  }
  if (parts & ERN_BATCH_COLOUR) {
    ERN_TRY(ern_take_rows(stream, 3, n, &batch->rgb_raw));
    ERN_TRY(ern_take_rows(stream, 3, n, &batch->rgb));
  }
  if (parts & ERN_BATCH_UNCERTAINTY) {
    ERN_TRY(ern_take_rows(stream, 1, n, &batch->unc_raw));
    ERN_TRY(ern_take_rows(stream, 1, n, &batch->unc));
  }
fail:
  return status;
}

static struct ern_grid_args plane_args(const struct ern_head_inputs *in, int plane, ern_rows x, ern_rows f, size_t n) {
  const struct ern_field *field = in->field;
  struct ern_grid_args args = {
      .f = ern_rows_part(f, plane * field->config.levels, field->config.levels),
      .table = ern_span_part(in->parameters, field->plane_table[plane], field->plane[plane].entries),
      .grid = &field->plane[plane],
      .n = n};
  for (int d = 0; d < 2; d++) args.x[d] = ern_span_of_row(x, field->plane_axis[plane][d], n);
  return args;
}

static struct ern_mlp_args mlp_args(const struct ern_head_inputs *in, const struct ern_mlp *mlp, ern_rows y, ern_rows x,
                                    size_t n) {
  return (struct ern_mlp_args){
      .y = y, .x = {x}, .pieces = 1, .ray = in->ray, .parameters = in->parameters, .mlp = *mlp, .n = n};
}

/* The density's input is [f, region, region_eye]. A density-only batch computes the first row of the last layer alone.
 */
static struct ern_mlp_args density_args(const struct ern_head_inputs *in, const struct ern_head_batch *batch) {
  struct ern_mlp_args args = mlp_args(in, &in->field->density, batch->h, batch->f, batch->n);
  args.mlp.width[args.mlp.layers] = batch->h.rows;
  args.x[args.pieces++] = batch->region;
  if (in->field->config.eye) args.x[args.pieces++] = batch->region_eye;
  return args;
}

static struct ern_attention_args attention_args(const struct ern_head_inputs *in, const struct ern_head_batch *batch) {
  struct ern_attention_args args = {.region = batch->region,
                                    .norm = batch->norm.span,
                                    .v = batch->v,
                                    .code = in->code,
                                    .eye = in->eye,
                                    .n = batch->n};
  if (in->field->config.eye) {
    args.region_eye = batch->region_eye.span;
    args.eye_attention = batch->eye.span;
  }
  return args;
}

/* The colour's input is [SH of the ray, geometry, individual code of the frame]. */
static struct ern_mlp_args colour_args(const struct ern_head_inputs *in, const struct ern_head_batch *batch) {
  struct ern_mlp_args args = mlp_args(in, &in->field->colour, batch->rgb_raw, in->sh, batch->n);
  args.x[args.pieces++] = ern_rows_part(batch->h, 1, ERN_GEOMETRY);
  if (in->field->config.codes > 0)
    args.x[args.pieces++] =
        (ern_rows){ern_span_part(in->parameters, in->field->codes + in->individual * ERN_CODE_WIDTH, ERN_CODE_WIDTH), 1,
                   ERN_CODE_WIDTH, ERN_PER_BATCH};
  return args;
}

ern_status ern_head_density_fwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                                struct ern_head_batch *batch) {
  const struct ern_backend *backend = stream->backend;
  const struct ern_field *field = in->field;
  ern_status status = ERN_OK;
  for (int plane = 0; plane < ERN_PLANES; plane++) {
    struct ern_grid_args grid = plane_args(in, plane, x, batch->f, batch->n);
    ERN_TRY(backend->grid_fwd(stream, &grid));
  }
  struct ern_mlp_args mlp = mlp_args(in, &field->attention, batch->v, batch->f, batch->n);
  ERN_TRY(backend->mlp_fwd(stream, &mlp));
  if (field->config.eye) {
    mlp = mlp_args(in, &field->eye, batch->eye_raw, batch->f, batch->n);
    ERN_TRY(backend->mlp_fwd(stream, &mlp));
    struct ern_activate_args sigmoid = {batch->eye, batch->eye_raw, ERN_ACT_SIGMOID, batch->n};
    ERN_TRY(backend->activate_fwd(stream, &sigmoid));
  }
  struct ern_attention_args attention = attention_args(in, batch);
  ERN_TRY(backend->attention_fwd(stream, &attention));
  if (has(batch->h)) {
    mlp = density_args(in, batch);
    ERN_TRY(backend->mlp_fwd(stream, &mlp));
    struct ern_activate_args density = {batch->sigma, ern_rows_part(batch->h, 0, 1), ERN_ACT_DENSITY, batch->n};
    ERN_TRY(backend->activate_fwd(stream, &density));
  }
fail:
  return status;
}

ern_status ern_head_colour_fwd(struct ern_stream *stream, const struct ern_head_inputs *in,
                               struct ern_head_batch *batch) {
  struct ern_mlp_args mlp = colour_args(in, batch);
  const ern_status status = stream->backend->mlp_fwd(stream, &mlp);
  if (status != ERN_OK) return status;
  struct ern_activate_args colour = {batch->rgb, batch->rgb_raw, ERN_ACT_COLOUR, batch->n};
  return stream->backend->activate_fwd(stream, &colour);
}

ern_status ern_head_uncertainty_fwd(struct ern_stream *stream, const struct ern_head_inputs *in,
                                    struct ern_head_batch *batch) {
  struct ern_mlp_args mlp = mlp_args(in, &in->field->uncertainty, batch->unc_raw, batch->f, batch->n);
  const ern_status status = stream->backend->mlp_fwd(stream, &mlp);
  if (status != ERN_OK) return status;
  struct ern_activate_args softplus = {batch->unc, batch->unc_raw, ERN_ACT_SOFTPLUS, batch->n};
  return stream->backend->activate_fwd(stream, &softplus);
}

/* f is detached: the uncertainty does not shape the scene. */
ern_status ern_head_uncertainty_bwd(struct ern_stream *stream, const struct ern_head_inputs *in,
                                    const struct ern_head_batch *batch, struct ern_head_batch *d,
                                    ern_span dparameters) {
  struct ern_activate_bwd_args softplus = {d->unc_raw, d->unc, batch->unc_raw, ERN_ACT_SOFTPLUS, batch->n};
  const ern_status status = stream->backend->activate_bwd(stream, &softplus);
  if (status != ERN_OK) return status;
  struct ern_mlp_bwd_args mlp = {.dparameters = dparameters,
                                 .dy = d->unc_raw,
                                 .forward = mlp_args(in, &in->field->uncertainty, batch->unc_raw, batch->f, batch->n)};
  return stream->backend->mlp_bwd(stream, &mlp);
}

ern_status ern_head_colour_bwd(struct ern_stream *stream, const struct ern_head_inputs *in,
                               const struct ern_head_batch *batch, struct ern_head_batch *d, ern_span dparameters) {
  struct ern_activate_bwd_args colour = {d->rgb_raw, d->rgb, batch->rgb_raw, ERN_ACT_COLOUR, batch->n};
  const ern_status status = stream->backend->activate_bwd(stream, &colour);
  if (status != ERN_OK) return status;
  struct ern_mlp_bwd_args mlp = {.dparameters = dparameters, .dy = d->rgb_raw, .forward = colour_args(in, batch)};
  mlp.dx[1] = ern_rows_part(d->h, 1, ERN_GEOMETRY);
  if (mlp.forward.pieces == 3) {
    mlp.dx[2] = mlp.forward.x[2];
    mlp.dx[2].span.buffer = dparameters.buffer;
    mlp.dx[2].span.at = dparameters.at + (mlp.forward.x[2].span.at - in->parameters.at);
  }
  return stream->backend->mlp_bwd(stream, &mlp);
}

ern_status ern_head_density_bwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                                const struct ern_head_batch *batch, struct ern_head_batch *d, ern_span dparameters,
                                ern_span dcode) {
  const struct ern_backend *backend = stream->backend;
  const struct ern_field *field = in->field;
  ern_status status = ERN_OK;
  struct ern_attention_bwd_args attention = {
      .dv = d->v, .dcode = dcode, .dnorm = d->norm.span, .forward = attention_args(in, batch)};
  if (field->config.eye) attention.deye_attention = d->eye.span;
  if (has(batch->h)) {
    struct ern_activate_bwd_args density = {ern_rows_part(d->h, 0, 1), d->sigma, ern_rows_part(batch->h, 0, 1),
                                            ERN_ACT_DENSITY, batch->n};
    ERN_TRY(backend->activate_bwd(stream, &density));
    struct ern_mlp_bwd_args mlp = {.dparameters = dparameters, .dy = d->h, .forward = density_args(in, batch)};
    mlp.dx[0] = d->f;
    mlp.dx[1] = d->region;
    mlp.dx[2] = d->region_eye;
    ERN_TRY(backend->zero(stream, d->region.span));
    ERN_TRY(backend->zero(stream, d->region_eye.span));
    ERN_TRY(backend->mlp_bwd(stream, &mlp));
    attention.dregion = d->region;
    attention.dregion_eye = d->region_eye.span;
  }
  ERN_TRY(backend->attention_bwd(stream, &attention));
  if (field->config.eye) {
    struct ern_activate_bwd_args sigmoid = {d->eye_raw, d->eye, batch->eye_raw, ERN_ACT_SIGMOID, batch->n};
    ERN_TRY(backend->activate_bwd(stream, &sigmoid));
    struct ern_mlp_bwd_args mlp = {.dx = {d->f},
                                   .dparameters = dparameters,
                                   .dy = d->eye_raw,
                                   .forward = mlp_args(in, &field->eye, batch->eye_raw, batch->f, batch->n)};
    ERN_TRY(backend->mlp_bwd(stream, &mlp));
  }
  struct ern_mlp_bwd_args mlp = {.dx = {d->f},
                                 .dparameters = dparameters,
                                 .dy = d->v,
                                 .forward = mlp_args(in, &field->attention, batch->v, batch->f, batch->n)};
  ERN_TRY(backend->mlp_bwd(stream, &mlp));
  for (int plane = ERN_PLANES - 1; plane >= 0; plane--) {
    struct ern_grid_bwd_args grid = {
        .dtable = ern_span_part(dparameters, field->plane_table[plane], field->plane[plane].entries),
        .df = ern_rows_part(d->f, plane * field->config.levels, field->config.levels),
        .forward = plane_args(in, plane, x, batch->f, batch->n)};
    ERN_TRY(backend->grid_bwd(stream, &grid));
  }
fail:
  return status;
}
