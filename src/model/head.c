/* SPDX-License-Identifier: MIT */
#include "model/head.h"

#include "core/status.h"
#include "mlp/activation_ops.h"
#include "model/attention_ops.h"
#include "model/encoder.h"

static bool has(ern_rows rows) { return rows.span.buffer != NULL; }

static ern_status take_encoder(struct ern_stream *stream, const struct ern_field *field, struct ern_head_batch *batch) {
  ern_status status = ERN_OK;
  ERN_TRY(ern_scratch_take_rows(stream, field->feature_rows, batch->n, &batch->f));
  if (field->config.backbone == ERN_BACKBONE_MLP) {
    ERN_TRY(ern_scratch_take_rows(stream, ERN_X_ROWS, batch->n, &batch->waves));
    ERN_TRY(ern_scratch_take_rows(stream, ERN_TRUNK_WIDTH, batch->n, &batch->hidden));
  }
fail:
  return status;
}

static ern_status take_regions(struct ern_stream *stream, const struct ern_field *field, struct ern_head_batch *batch) {
  ern_status status = ERN_OK;
  if (ern_field_attends(field)) {
    ERN_TRY(ern_scratch_take_rows(stream, field->attention.width[2], batch->n, &batch->v));
    ERN_TRY(ern_scratch_take_rows(stream, ERN_AUDIO_CODE, batch->n, &batch->region));
    ERN_TRY(ern_scratch_take_rows(stream, 1, batch->n, &batch->norm));
  }
  if (ern_field_attends_eye(field)) {
    ERN_TRY(ern_scratch_take_rows(stream, 1, batch->n, &batch->eye_raw));
    ERN_TRY(ern_scratch_take_rows(stream, 1, batch->n, &batch->eye));
    ERN_TRY(ern_scratch_take_rows(stream, 1, batch->n, &batch->region_eye));
  } else if (field->config.eye) {
    ERN_TRY(ern_scratch_take_rows(stream, 1, 1, &batch->region_eye));
    batch->region_eye.per = ERN_PER_BATCH;
  }
fail:
  return status;
}

ern_status ern_head_batch_take(struct ern_stream *stream, const struct ern_field *field, size_t n, int parts,
                               struct ern_head_batch *batch) {
  ern_status status = ERN_OK;
  *batch = (struct ern_head_batch){.n = n};
  ERN_TRY(take_encoder(stream, field, batch));
  ERN_TRY(take_regions(stream, field, batch));
  if (parts & ERN_BATCH_DENSITY) {
    ERN_TRY(ern_scratch_take_rows(stream, parts & ERN_BATCH_COLOUR ? 1 + ERN_GEOMETRY : 1, n, &batch->h));
    ERN_TRY(ern_scratch_take_rows(stream, 1, n, &batch->sigma));
  }
  if (parts & ERN_BATCH_COLOUR) {
    ERN_TRY(ern_scratch_take_rows(stream, 3, n, &batch->rgb_raw));
    ERN_TRY(ern_scratch_take_rows(stream, 3, n, &batch->rgb));
  }
  if (parts & ERN_BATCH_UNCERTAINTY) {
    ERN_TRY(ern_scratch_take_rows(stream, 1, n, &batch->unc_raw));
    ERN_TRY(ern_scratch_take_rows(stream, 1, n, &batch->unc));
  }
fail:
  return status;
}

static struct ern_mlp_fwd_args mlp_args(const struct ern_head_inputs *in, const struct ern_mlp *mlp, ern_rows y,
                                        ern_rows x, size_t n) {
  return (struct ern_mlp_fwd_args){
      .y = y, .x = {x}, .pieces = 1, .ray = in->ray, .parameters = in->parameters, .mlp = *mlp, .n = n};
}

/* The speech input of the density network: the code weighted per sample by the attention, or the code of the batch
 * unchanged. */
static ern_rows region_rows(const struct ern_head_inputs *in, const struct ern_head_batch *batch) {
  if (ern_field_attends(in->field)) return batch->region;
  return (ern_rows){in->code, 1, ERN_AUDIO_CODE, ERN_PER_BATCH};
}

/* The density's input is [f, region, region_eye]. A density-only batch computes only the first row of the last
 * layer. */
static struct ern_mlp_fwd_args density_args(const struct ern_head_inputs *in, const struct ern_head_batch *batch) {
  struct ern_mlp_fwd_args args = mlp_args(in, &in->field->density, batch->h, batch->f, batch->n);
  args.mlp.width[args.mlp.layers] = batch->h.rows;
  args.x[args.pieces++] = region_rows(in, batch);
  if (in->field->config.eye) args.x[args.pieces++] = batch->region_eye;
  return args;
}

static struct ern_attention_fwd_args attention_args(const struct ern_head_inputs *in,
                                                    const struct ern_head_batch *batch) {
  struct ern_attention_fwd_args args = {.region = batch->region,
                                        .norm = batch->norm.span,
                                        .v = batch->v,
                                        .code = in->code,
                                        .eye = in->eye,
                                        .n = batch->n};
  if (has(batch->eye)) {
    args.region_eye = batch->region_eye.span;
    args.eye_attention = batch->eye.span;
  }
  return args;
}

/* The colour's input is [SH of the ray, geometry, individual code of the frame], of which the first and the last may be
 * absent. */
static struct ern_mlp_fwd_args colour_args(const struct ern_head_inputs *in, const struct ern_head_batch *batch) {
  struct ern_mlp_fwd_args args = mlp_args(in, &in->field->colour, batch->rgb_raw, in->sh, batch->n);
  if (in->field->config.no_view) args.pieces = 0;
  args.x[args.pieces++] = ern_rows_part(batch->h, 1, ERN_GEOMETRY);
  if (in->field->config.codes > 0)
    args.x[args.pieces++] =
        (ern_rows){ern_span_part(in->parameters, in->field->codes + in->individual * ERN_CODE_WIDTH, ERN_CODE_WIDTH), 1,
                   ERN_CODE_WIDTH, ERN_PER_BATCH};
  return args;
}

/* v, or its gradient, times what is left of the voice at the samples' heights. No gradient by the height: it would move
 * a refined pose by where the voice ends. */
static ern_status fade(struct ern_stream *stream, const struct ern_field *field, ern_rows v, ern_rows x, size_t n) {
  if (!ern_field_fades(field)) return ERN_OK;
  const float *ends = field->config.voice_fade;
  struct ern_attention_fade_args args = {v, ern_span_of_row(x, 0, n), {ends[0], ends[1]}, n};
  return stream->backend->attention_fade(stream, &args);
}

/* Speech and eye inputs of the density network. */
static ern_status regions_fwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                              struct ern_head_batch *batch) {
  const struct ern_backend *backend = stream->backend;
  const struct ern_field *field = in->field;
  ern_status status = ERN_OK;
  if (has(batch->v)) {
    struct ern_mlp_fwd_args mlp = mlp_args(in, &field->attention, batch->v, batch->f, batch->n);
    ERN_TRY(backend->mlp_fwd(stream, &mlp));
    ERN_TRY(fade(stream, field, batch->v, x, batch->n));
  }
  if (has(batch->eye)) {
    struct ern_mlp_fwd_args mlp = mlp_args(in, &field->eye, batch->eye_raw, batch->f, batch->n);
    ERN_TRY(backend->mlp_fwd(stream, &mlp));
    struct ern_activate_fwd_args sigmoid = {batch->eye, batch->eye_raw, ERN_ACT_SIGMOID, batch->n};
    ERN_TRY(backend->activate_fwd(stream, &sigmoid));
  } else if (has(batch->region_eye)) {
    ERN_TRY(backend->upload_reals(stream, batch->region_eye.span, &in->eye, 1));
  }
  if (has(batch->v) || has(batch->eye)) {
    struct ern_attention_fwd_args attention = attention_args(in, batch);
    ERN_TRY(backend->attention_fwd(stream, &attention));
  }
fail:
  return status;
}

ern_status ern_head_density_fwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                                struct ern_head_batch *batch) {
  const struct ern_backend *backend = stream->backend;
  ern_status status = ERN_OK;
  ERN_TRY(ern_encode_fwd(stream, in, x, batch));
  ERN_TRY(regions_fwd(stream, in, x, batch));
  if (has(batch->h)) {
    struct ern_mlp_fwd_args mlp = density_args(in, batch);
    ERN_TRY(backend->mlp_fwd(stream, &mlp));
    struct ern_activate_fwd_args density = {batch->sigma, ern_rows_part(batch->h, 0, 1), ERN_ACT_DENSITY, batch->n};
    ERN_TRY(backend->activate_fwd(stream, &density));
  }
fail:
  return status;
}

ern_status ern_head_colour_fwd(struct ern_stream *stream, const struct ern_head_inputs *in,
                               struct ern_head_batch *batch) {
  struct ern_mlp_fwd_args mlp = colour_args(in, batch);
  const ern_status status = stream->backend->mlp_fwd(stream, &mlp);
  if (status != ERN_OK) return status;
  struct ern_activate_fwd_args colour = {batch->rgb, batch->rgb_raw, ERN_ACT_COLOUR, batch->n};
  return stream->backend->activate_fwd(stream, &colour);
}

ern_status ern_head_uncertainty_fwd(struct ern_stream *stream, const struct ern_head_inputs *in,
                                    struct ern_head_batch *batch) {
  struct ern_mlp_fwd_args mlp = mlp_args(in, &in->field->uncertainty, batch->unc_raw, batch->f, batch->n);
  const ern_status status = stream->backend->mlp_fwd(stream, &mlp);
  if (status != ERN_OK) return status;
  struct ern_activate_fwd_args softplus = {batch->unc, batch->unc_raw, ERN_ACT_SOFTPLUS, batch->n};
  return stream->backend->activate_fwd(stream, &softplus);
}

/* f is detached: the uncertainty has no gradient to the scene. */
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
  const int geometry = in->field->config.no_view ? 0 : 1, code = geometry + 1;
  if (geometry > 0) mlp.dx[0] = d->sh;
  mlp.dx[geometry] = ern_rows_part(d->h, 1, ERN_GEOMETRY);
  if (mlp.forward.pieces > code) {
    mlp.dx[code] = mlp.forward.x[code];
    mlp.dx[code].span.buffer = dparameters.buffer;
    mlp.dx[code].span.at = dparameters.at + (mlp.forward.x[code].span.at - in->parameters.at);
  }
  return stream->backend->mlp_bwd(stream, &mlp);
}

/* Writes d->f, and d->region and d->region_eye where they are per sample; adds to dcode where the code is used
 * unchanged. */
static ern_status density_bwd(struct ern_stream *stream, const struct ern_head_inputs *in,
                              const struct ern_head_batch *batch, struct ern_head_batch *d, ern_span dparameters,
                              ern_span dcode) {
  const struct ern_backend *backend = stream->backend;
  struct ern_activate_bwd_args density = {ern_rows_part(d->h, 0, 1), d->sigma, ern_rows_part(batch->h, 0, 1),
                                          ERN_ACT_DENSITY, batch->n};
  struct ern_mlp_bwd_args mlp = {.dparameters = dparameters, .dy = d->h, .forward = density_args(in, batch)};
  ern_status status = ERN_OK;
  ERN_TRY(backend->activate_bwd(stream, &density));
  mlp.dx[0] = d->f;
  if (has(d->region)) {
    ERN_TRY(backend->zero(stream, d->region.span));
    mlp.dx[1] = d->region;
  } else {
    mlp.dx[1] = (ern_rows){dcode, 1, ERN_AUDIO_CODE, ERN_PER_BATCH};
  }
  if (has(d->eye)) {
    ERN_TRY(backend->zero(stream, d->region_eye.span));
    mlp.dx[2] = d->region_eye;
  }
  ERN_TRY(backend->mlp_bwd(stream, &mlp));
fail:
  return status;
}

/* From d->region and d->region_eye (not in a batch without a density), d->norm and d->eye to d->f. */
static ern_status regions_bwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                              const struct ern_head_batch *batch, struct ern_head_batch *d, ern_span dparameters,
                              ern_span dcode) {
  const struct ern_backend *backend = stream->backend;
  const struct ern_field *field = in->field;
  struct ern_attention_bwd_args attention = {.dv = d->v,
                                             .dcode = has(d->v) ? dcode : (ern_span){0},
                                             .dnorm = d->norm.span,
                                             .deye_attention = d->eye.span,
                                             .forward = attention_args(in, batch)};
  ern_status status = ERN_OK;
  if (has(batch->h)) {
    attention.dregion = d->region;
    if (has(d->eye)) attention.dregion_eye = d->region_eye.span;
  }
  ERN_TRY(backend->attention_bwd(stream, &attention));
  if (has(d->eye)) {
    struct ern_activate_bwd_args sigmoid = {d->eye_raw, d->eye, batch->eye_raw, ERN_ACT_SIGMOID, batch->n};
    ERN_TRY(backend->activate_bwd(stream, &sigmoid));
    struct ern_mlp_bwd_args mlp = {.dx = {d->f},
                                   .dparameters = dparameters,
                                   .dy = d->eye_raw,
                                   .forward = mlp_args(in, &field->eye, batch->eye_raw, batch->f, batch->n)};
    ERN_TRY(backend->mlp_bwd(stream, &mlp));
  }
  if (has(d->v)) {
    ERN_TRY(fade(stream, field, d->v, x, batch->n));
    struct ern_mlp_bwd_args mlp = {.dx = {d->f},
                                   .dparameters = dparameters,
                                   .dy = d->v,
                                   .forward = mlp_args(in, &field->attention, batch->v, batch->f, batch->n)};
    ERN_TRY(backend->mlp_bwd(stream, &mlp));
  }
fail:
  return status;
}

ern_status ern_head_density_bwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                                const struct ern_head_batch *batch, struct ern_head_batch *d, ern_span dparameters,
                                ern_span dcode) {
  ern_status status = ERN_OK;
  if (has(batch->h)) ERN_TRY(density_bwd(stream, in, batch, d, dparameters, dcode));
  if (has(d->v) || has(d->eye)) ERN_TRY(regions_bwd(stream, in, x, batch, d, dparameters, dcode));
  ERN_TRY(ern_encode_bwd(stream, in, x, batch, d, dparameters));
fail:
  return status;
}
