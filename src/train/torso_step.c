/* SPDX-License-Identifier: MIT
 * A training step of the torso with the head frozen: compares its layer over the background with the frame's torso
 * image. */
#include <string.h>

#include "core/status.h"
#include "model/torso.h"
#include "model/torso_ops.h"
#include "render/march_ops.h"
#include "train/losses_ops.h"
#include "train/step.h"
#include "train/step_ops.h"

ern_status ern_torso_step_stages(struct ern_stream *stream, struct ern_torso_step_args *args) {
  const struct ern_backend *backend = stream->backend;
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  struct ern_torso_inputs in = {args->field,      args->parameters, args->view->pose,
                                args->individual, args->motion,     args->shrink};
  struct ern_torso_batch batch, d;
  ern_rows pixel, dpixel;
  ern_status status = ERN_OK;
  memset(args->terms, 0, sizeof args->terms);

  struct ern_torso_select_args select = {.pixel = args->pixel_number,
                                         .grid = args->grid,
                                         .threshold = args->threshold,
                                         .width = args->view->width,
                                         .height = args->view->height,
                                         .n = args->n};
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, args->n, &select.index));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, args->n, &select.selected));
  ERN_TRY(backend->torso_select(stream, &select));
  args->samples = select.count;
  ERN_TRY(ern_torso_batch_take(stream, args->field, select.count, &batch));
  ERN_TRY(ern_scratch_take_rows(stream, 3, args->n, &pixel));
  ERN_TRY(ern_scratch_take_rows(stream, 3, args->n, &dpixel));
  ERN_TRY(
      ern_torso_q(stream, select.selected, args->view->width, args->view->height, args->shrink, select.count, batch.q));
  ERN_TRY(ern_torso_fwd(stream, &in, &batch));
  struct ern_torso_composite_fwd_args composite = {.pixel = pixel,
                                                   .layer = batch.layer,
                                                   .index = select.index,
                                                   .background = args->background,
                                                   .rays = args->n,
                                                   .n = select.count};
  ERN_TRY(backend->torso_composite_fwd(stream, &composite));
  struct ern_mse_args mse = {.dpixel = dpixel, .pixel = pixel, .truth = args->truth, .n = args->n};
  ERN_TRY(backend->mse(stream, &mse));
  struct ern_key_points_loss_args key_points = {.danchors = ern_span_part(args->dparameters, args->field->anchors, 12),
                                                .anchors = ern_span_part(args->parameters, args->field->anchors, 12)};
  ERN_TRY(backend->key_points_loss(stream, &key_points));

  ERN_TRY(ern_torso_batch_take(stream, args->field, select.count, &d));
  struct ern_torso_composite_bwd_args backward = {.dlayer = d.layer, .dpixel = dpixel, .forward = composite};
  ERN_TRY(backend->torso_composite_bwd(stream, &backward));
  ERN_TRY(ern_torso_bwd(stream, &in, &batch, &d, args->dparameters));
  if (args->meanwhile != NULL) args->meanwhile(args->user);
  ERN_TRY(backend->synchronize(stream));
  args->terms[ERN_LOSS_PHOTOMETRIC] = mse.term;
  args->terms[ERN_LOSS_KEY_POINTS] = key_points.term;
fail:
  ern_arena_release(stream, mark);
  return status;
}
