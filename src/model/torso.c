/* SPDX-License-Identifier: MIT */
#include "model/torso.h"

#include "core/status.h"
#include "mlp/activation_ops.h"
#include "mlp/encoding_ops.h"
#include "model/torso_ops.h"

static ern_rows once(ern_rows rows) {
  rows.per = ERN_PER_BATCH;
  return rows;
}

ern_status ern_torso_batch_take(struct ern_stream *stream, const struct ern_field *field, size_t n,
                                struct ern_torso_batch *batch) {
  ern_status status = ERN_OK;
  *batch = (struct ern_torso_batch){.n = n};
  ERN_TRY(ern_scratch_take_rows(stream, 6, 1, &batch->k));
  ERN_TRY(ern_scratch_take_rows(stream, ERN_K_ROWS, 1, &batch->k_encoded));
  batch->k.stride = batch->k_encoded.stride = 1;
  batch->k_encoded = once(batch->k_encoded);
  ERN_TRY(ern_scratch_take_rows(stream, 2, n, &batch->q));
  ERN_TRY(ern_scratch_take_rows(stream, ERN_Q_ROWS, n, &batch->q_encoded));
  ERN_TRY(ern_scratch_take_rows(stream, 2, n, &batch->moved));
  ERN_TRY(ern_scratch_take_rows(stream, 2, n, &batch->moved_by));
  ERN_TRY(ern_scratch_take_rows(stream, 2, n, &batch->x));
  ERN_TRY(ern_scratch_take_rows(stream, field->torso_grid.levels * field->torso_grid.features, n, &batch->grid));
  ERN_TRY(ern_scratch_take_rows(stream, 4, n, &batch->raw));
  ERN_TRY(ern_scratch_take_rows(stream, 4, n, &batch->layer));
fail:
  return status;
}

static struct ern_torso_pose_fwd_args pose_args(const struct ern_torso_inputs *in,
                                                const struct ern_torso_batch *batch) {
  struct ern_torso_pose_fwd_args args = {.k = batch->k.span,
                                         .anchors = ern_span_part(in->parameters, in->field->anchors, 12)};
  if (in->field->config.torso_gamma) args.gamma = ern_span_part(in->parameters, in->field->gamma, 1);
  for (int i = 0; i < 16; i++) args.pose[i] = in->pose[i];
  return args;
}

/* Appends [q_encoded, k_encoded, individual code] to an MLP's input. */
static void add_encoded(const struct ern_torso_inputs *in, const struct ern_torso_batch *batch,
                        struct ern_mlp_fwd_args *args) {
  args->x[args->pieces++] = batch->q_encoded;
  args->x[args->pieces++] = batch->k_encoded;
  if (in->field->config.codes > 0)
    args->x[args->pieces++] =
        (ern_rows){ern_span_part(in->parameters, in->field->torso_codes + in->individual * ERN_TORSO_CODE_WIDTH,
                                 ERN_TORSO_CODE_WIDTH),
                   1, ERN_TORSO_CODE_WIDTH, ERN_PER_BATCH};
}

static struct ern_mlp_fwd_args deform_args(const struct ern_torso_inputs *in, const struct ern_torso_batch *batch) {
  struct ern_mlp_fwd_args args = {
      .y = batch->moved_by, .parameters = in->parameters, .mlp = in->field->torso_deform, .n = batch->n};
  add_encoded(in, batch, &args);
  return args;
}

static struct ern_mlp_fwd_args layer_args(const struct ern_torso_inputs *in, const struct ern_torso_batch *batch) {
  struct ern_mlp_fwd_args args = {.y = batch->raw,
                                  .x = {batch->grid},
                                  .pieces = 1,
                                  .parameters = in->parameters,
                                  .mlp = in->field->torso_net,
                                  .n = batch->n};
  add_encoded(in, batch, &args);
  return args;
}

static struct ern_grid_fwd_args grid_args(const struct ern_torso_inputs *in, const struct ern_torso_batch *batch) {
  const struct ern_grid *grid = &in->field->torso_grid;
  return (struct ern_grid_fwd_args){
      .f = batch->grid,
      .x = {ern_span_of_row(batch->x, 0, batch->n), ern_span_of_row(batch->x, 1, batch->n)},
      .table = ern_span_part(in->parameters, in->field->torso_table, (size_t)grid->entries * (size_t)grid->features),
      .grid = grid,
      .n = batch->n};
}

ern_status ern_torso_q(struct ern_stream *stream, ern_span pixel, int width, int height, float shrink, size_t n,
                       ern_rows q) {
  struct ern_torso_coords_args args = {
      .q = q, .pixel = pixel, .width = width, .height = height, .shrink = shrink, .n = n};
  return stream->backend->torso_coords(stream, &args);
}

ern_status ern_torso_fwd(struct ern_stream *stream, const struct ern_torso_inputs *in, struct ern_torso_batch *batch) {
  const struct ern_backend *backend = stream->backend;
  ern_status status = ERN_OK;
  struct ern_torso_pose_fwd_args pose = pose_args(in, batch);
  ERN_TRY(backend->torso_pose_fwd(stream, &pose));
  struct ern_freq_fwd_args encode_k = {.y = batch->k_encoded, .x = batch->k, .octaves = ERN_K_OCTAVES, .n = 1};
  ERN_TRY(backend->freq_fwd(stream, &encode_k));
  struct ern_freq_fwd_args encode_q = {.y = batch->q_encoded, .x = batch->q, .octaves = ERN_Q_OCTAVES, .n = batch->n};
  ERN_TRY(backend->freq_fwd(stream, &encode_q));
  struct ern_torso_move_args move = {
      .moved = batch->moved, .q = batch->q, .motion = in->motion, .shrink = in->shrink, .n = batch->n};
  ERN_TRY(backend->torso_move(stream, &move));
  struct ern_mlp_fwd_args mlp = deform_args(in, batch);
  ERN_TRY(backend->mlp_fwd(stream, &mlp));
  struct ern_torso_deform_fwd_args deform = {.x = batch->x, .q = batch->moved, .d = batch->moved_by, .n = batch->n};
  ERN_TRY(backend->torso_deform_fwd(stream, &deform));
  struct ern_grid_fwd_args grid = grid_args(in, batch);
  ERN_TRY(backend->grid_fwd(stream, &grid));
  mlp = layer_args(in, batch);
  ERN_TRY(backend->mlp_fwd(stream, &mlp));
  struct ern_activate_fwd_args colour = {batch->layer, batch->raw, ERN_ACT_COLOUR, batch->n};
  ERN_TRY(backend->activate_fwd(stream, &colour));
fail:
  return status;
}

/* The gradient rows of the k encoding and the code, the last inputs of both MLPs. */
static void encoded_gradients(const struct ern_torso_inputs *in, const struct ern_torso_batch *d, ern_span dparameters,
                              struct ern_mlp_bwd_args *args) {
  const int pieces = args->forward.pieces;
  const bool codes = in->field->config.codes > 0;
  args->dx[pieces - (codes ? 2 : 1)] = d->k_encoded;
  if (codes) {
    args->dx[pieces - 1] = args->forward.x[pieces - 1];
    args->dx[pieces - 1].span.buffer = dparameters.buffer;
    args->dx[pieces - 1].span.at = dparameters.at + (args->forward.x[pieces - 1].span.at - in->parameters.at);
  }
}

ern_status ern_torso_bwd(struct ern_stream *stream, const struct ern_torso_inputs *in,
                         const struct ern_torso_batch *batch, struct ern_torso_batch *d, ern_span dparameters) {
  const struct ern_backend *backend = stream->backend;
  const struct ern_field *field = in->field;
  const size_t table = (size_t)field->torso_grid.entries * (size_t)field->torso_grid.features;
  ern_status status = ERN_OK;
  ERN_TRY(backend->zero(stream, d->grid.span));
  ERN_TRY(backend->zero(stream, d->x.span));
  ERN_TRY(backend->zero(stream, d->k_encoded.span));
  ERN_TRY(backend->zero(stream, d->k.span));

  struct ern_activate_bwd_args colour = {d->raw, d->layer, batch->raw, ERN_ACT_COLOUR, batch->n};
  ERN_TRY(backend->activate_bwd(stream, &colour));
  struct ern_mlp_bwd_args layer = {
      .dx = {d->grid}, .dparameters = dparameters, .dy = d->raw, .forward = layer_args(in, batch)};
  encoded_gradients(in, d, dparameters, &layer);
  ERN_TRY(backend->mlp_bwd(stream, &layer));
  struct ern_grid_bwd_args grid = {.dtable = ern_span_part(dparameters, field->torso_table, table),
                                   .dx = {ern_span_of_row(d->x, 0, batch->n), ern_span_of_row(d->x, 1, batch->n)},
                                   .df = d->grid,
                                   .forward = grid_args(in, batch)};
  ERN_TRY(backend->grid_bwd(stream, &grid));
  struct ern_torso_deform_bwd_args deform = {
      .dd = d->moved_by,
      .dx = d->x,
      .forward = {.x = batch->x, .q = batch->moved, .d = batch->moved_by, .n = batch->n}};
  ERN_TRY(backend->torso_deform_bwd(stream, &deform));
  struct ern_mlp_bwd_args moved = {.dparameters = dparameters, .dy = d->moved_by, .forward = deform_args(in, batch)};
  encoded_gradients(in, d, dparameters, &moved);
  ERN_TRY(backend->mlp_bwd(stream, &moved));
  struct ern_freq_bwd_args encode_k = {.dx = d->k, .dy = d->k_encoded, .x = batch->k, .octaves = ERN_K_OCTAVES, .n = 1};
  ERN_TRY(backend->freq_bwd(stream, &encode_k));
  struct ern_torso_pose_bwd_args pose = {
      .danchors = ern_span_part(dparameters, field->anchors, 12), .dk = d->k.span, .forward = pose_args(in, batch)};
  if (field->config.torso_gamma) pose.dgamma = ern_span_part(dparameters, field->gamma, 1);
  ERN_TRY(backend->torso_pose_bwd(stream, &pose));
fail:
  return status;
}

void ern_torso_motion_of_affine(float motion[ERN_MOTION_VALUES], const float a[6]) {
  for (int i = 0; i < ERN_MOTION_VALUES; i++) {
    const int point = i % (ERN_MOTION_VALUES / 2);
    const float *of = a + (i == point ? 0 : 3);
    const float row = 2 * (float)(point / ERN_MOTION_SIDE) / (ERN_MOTION_SIDE - 1) - 1;
    const float column = 2 * (float)(point % ERN_MOTION_SIDE) / (ERN_MOTION_SIDE - 1) - 1;
    motion[i] = of[0] * row + of[1] * column + of[2];
  }
}
