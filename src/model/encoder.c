/* SPDX-License-Identifier: MIT */
#include "model/encoder.h"

#include "core/status.h"
#include "mlp/activation_ops.h"
#include "mlp/encoding_ops.h"

/* ---- grids ------------------------------------------------------------------------------------------------------- */

static size_t table_count(const struct ern_grid *grid) { return (size_t)grid->entries * (size_t)grid->features; }

/* The rows of f that grid `g` fills: all grids of an encoder are alike. */
static ern_rows rows_of(const struct ern_encoder *encoder, int g, ern_rows f) {
  const int rows = encoder->grid[g].levels * encoder->grid[g].features;
  return ern_rows_part(f, g * rows, rows);
}

static struct ern_grid_fwd_args grid_args(const struct ern_head_inputs *in, int g, ern_rows x, ern_rows f, size_t n) {
  const struct ern_encoder *encoder = &in->field->encoder;
  const struct ern_grid *grid = &encoder->grid[g];
  struct ern_grid_fwd_args args = {.f = rows_of(encoder, g, f),
                                   .table = ern_span_part(in->parameters, encoder->table[g], table_count(grid)),
                                   .grid = grid,
                                   .n = n};
  for (int d = 0; d < grid->dims; d++) args.x[d] = ern_span_of_row(x, encoder->axis[g][d], n);
  return args;
}

static ern_status grids_fwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                            struct ern_head_batch *batch) {
  ern_status status = ERN_OK;
  for (int g = 0; g < in->field->encoder.grids && status == ERN_OK; g++) {
    struct ern_grid_fwd_args grid = grid_args(in, g, x, batch->f, batch->n);
    status = stream->backend->grid_fwd(stream, &grid);
  }
  return status;
}

static ern_status grids_bwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                            const struct ern_head_batch *batch, struct ern_head_batch *d, ern_span dparameters) {
  const struct ern_encoder *encoder = &in->field->encoder;
  ern_status status = ERN_OK;
  for (int g = encoder->grids - 1; g >= 0 && status == ERN_OK; g--) {
    struct ern_grid_bwd_args grid = {
        .dtable = ern_span_part(dparameters, encoder->table[g], table_count(&encoder->grid[g])),
        .df = rows_of(encoder, g, d->f),
        .forward = grid_args(in, g, x, batch->f, batch->n)};
    for (int a = 0; d->x.span.buffer != NULL && a < encoder->grid[g].dims; a++)
      grid.dx[a] = ern_span_of_row(d->x, encoder->axis[g][a], batch->n);
    status = stream->backend->grid_bwd(stream, &grid);
  }
  return status;
}

/* ---- network ----------------------------------------------------------------------------------------------------- */

/* hidden = relu(M_0 waves); f = M_1 [waves, hidden]. Only the output of the ReLU is kept: it is above 0 exactly where
 * its input was. */
static struct ern_mlp_fwd_args trunk_args(const struct ern_head_inputs *in, int stack,
                                          const struct ern_head_batch *batch) {
  struct ern_mlp_fwd_args args = {.y = stack == 0 ? batch->hidden : batch->f,
                                  .x = {batch->waves},
                                  .pieces = 1,
                                  .parameters = in->parameters,
                                  .mlp = in->field->encoder.trunk[stack],
                                  .n = batch->n};
  if (stack == 1) args.x[args.pieces++] = batch->hidden;
  return args;
}

static ern_status trunk_fwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                            struct ern_head_batch *batch) {
  const struct ern_backend *backend = stream->backend;
  ern_status status = ERN_OK;
  struct ern_freq_fwd_args waves = {batch->waves, x, ERN_X_OCTAVES, batch->n};
  ERN_TRY(backend->freq_fwd(stream, &waves));
  struct ern_mlp_fwd_args mlp = trunk_args(in, 0, batch);
  ERN_TRY(backend->mlp_fwd(stream, &mlp));
  struct ern_activate_fwd_args relu = {batch->hidden, batch->hidden, ERN_ACT_RELU, batch->n};
  ERN_TRY(backend->activate_fwd(stream, &relu));
  mlp = trunk_args(in, 1, batch);
  ERN_TRY(backend->mlp_fwd(stream, &mlp));
fail:
  return status;
}

static ern_status trunk_bwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                            const struct ern_head_batch *batch, struct ern_head_batch *d, ern_span dparameters) {
  const struct ern_backend *backend = stream->backend;
  const bool moves = d->x.span.buffer != NULL;
  ern_status status = ERN_OK;
  if (moves) ERN_TRY(backend->zero(stream, d->waves.span));
  struct ern_mlp_bwd_args mlp = {.dparameters = dparameters, .dy = d->f, .forward = trunk_args(in, 1, batch)};
  if (moves) mlp.dx[0] = d->waves;
  mlp.dx[1] = d->hidden;
  ERN_TRY(backend->zero(stream, d->hidden.span));
  ERN_TRY(backend->mlp_bwd(stream, &mlp));
  struct ern_activate_bwd_args relu = {d->hidden, d->hidden, batch->hidden, ERN_ACT_RELU, batch->n};
  ERN_TRY(backend->activate_bwd(stream, &relu));
  mlp = (struct ern_mlp_bwd_args){.dparameters = dparameters, .dy = d->hidden, .forward = trunk_args(in, 0, batch)};
  if (moves) mlp.dx[0] = d->waves;
  ERN_TRY(backend->mlp_bwd(stream, &mlp));
  if (moves) {
    struct ern_freq_bwd_args waves = {d->x, d->waves, x, ERN_X_OCTAVES, batch->n};
    ERN_TRY(backend->freq_bwd(stream, &waves));
  }
fail:
  return status;
}

/* ---- by backbone ------------------------------------------------------------------------------------------------- */

ern_status ern_encode_fwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                          struct ern_head_batch *batch) {
  return in->field->encoder.grids > 0 ? grids_fwd(stream, in, x, batch) : trunk_fwd(stream, in, x, batch);
}

ern_status ern_encode_bwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                          const struct ern_head_batch *batch, struct ern_head_batch *d, ern_span dparameters) {
  return in->field->encoder.grids > 0 ? grids_bwd(stream, in, x, batch, d, dparameters)
                                      : trunk_bwd(stream, in, x, batch, d, dparameters);
}
