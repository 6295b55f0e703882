/* SPDX-License-Identifier: MIT
 * A step of a training: batch, gradient, update; refresh and average when they are due. */
#include "train/trainer_step.h"

#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "model/torso_ops.h"
#include "render/picture_ops.h"
#include "train/step.h"
#include "train/step_ops.h"

/* Progress: s of docs/maths.md, Update. In the coarse stage over its own steps, in the fine stage over all steps. */
static double progress(const ern_trainer *t) {
  const uint64_t steps = ern_trainer_is_fine(&t->fine) ? t->shared.config.iters : ern_trainer_coarse_steps(&t->fine);
  return steps > t->shared.step ? (double)t->shared.step / (double)steps : 1;
}

static const char *const term_name[ERN_LOSS_TERMS] = {"photometric", "uncertainty",   "static_uncertainty",
                                                      "entropy",     "audio_ambient", "eye_ambient",
                                                      "smoothness",  "key_points",    "patches"};

static void add_part(const ern_trainer *t, struct ern_step_sum *sum, const double *terms, double squared_error,
                     size_t samples, size_t rays) {
  const double all = (double)ern_trainer_step_rays(&t->fine), share = (double)rays / all;
  for (int i = 0; i < ERN_LOSS_TERMS; i++) sum->terms[i] += share * terms[i];
  sum->squared_error += share * squared_error;
  sum->samples += (double)samples / all;
}

static struct ern_step_patches patches_of(const ern_trainer *t, const struct ern_batch *batch) {
  if (batch->patches == 0) return (struct ern_step_patches){.count = 0};
  const int side = t->shared.config.patch_size;
  const float weight = t->shared.step % 2 == 1 ? t->shared.config.fine_lips_weight : t->shared.config.fine_weight;
  return (struct ern_step_patches){.loss = t->shared.config.fine_loss,
                                   .filter = {t->fine.filter, 0, ern_patch_filter_count((size_t)side)},
                                   .weight = weight,
                                   .side = side,
                                   .count = batch->patches};
}

static ern_status head_step(ern_trainer *t, struct ern_batch *batch, struct ern_step_sum *sum) {
  const struct ern_march_settings march = ern_trainer_march(&t->shared);
  const struct ern_view view =
      t->poses != NULL ? ern_trainer_poses_view(t->poses, batch->frame) : t->shared.views[batch->frame];
  struct ern_head_step_args args = {.dparameters = t->values.gradient,
                                    .parameters = t->shared.parameters,
                                    .field = &t->shared.model->field,
                                    .view = &view,
                                    .settings = &march,
                                    .bits = t->occupancy.bits,
                                    .pixel_number = batch->pixel_number,
                                    .jitter = batch->jitter,
                                    .truth = batch->truth,
                                    .background = batch->background,
                                    .face = batch->face,
                                    .windows = batch->windows,
                                    .eye_value = batch->eye,
                                    .individual = ern_trainer_code(&t->shared, batch->frame),
                                    .weights = {.s = (float)progress(t),
                                                .uncertainty = 1,
                                                .static_uncertainty = 1e-3f,
                                                .entropy = 1e-4f,
                                                .audio_ambient = 1e-4f,
                                                .eye_ambient = 1e-4f,
                                                .smoothness = 1e-5f,
                                                .adaptive = true},
                                    .transmittance_stop = 1e-4f,
                                    .smooth = t->shared.step % ERN_SMOOTH_EVERY == 0,
                                    .bf16 = t->shared.bf16,
                                    .seed = t->shared.config.seed,
                                    .step = t->shared.step,
                                    .dpose = ern_trainer_poses_due(t->poses) ? batch->dpose : NULL,
                                    .dpose_weight = batch->rigid,
                                    .patches = patches_of(t, batch),
                                    .meanwhile = ern_trainer_draw_ahead,
                                    .user = &t->batches,
                                    .n = batch->rays};
  const ern_status status = t->shared.backend->head_step(t->shared.stream, &args);
  add_part(t, sum, args.terms, args.squared_error, args.samples, batch->rays);
  for (size_t i = 0; i < ERN_POSE_PARAMETERS; i++) sum->dpose[batch->of_step][i] += batch->dpose[i];
  return status;
}

static ern_status torso_step(ern_trainer *t, const struct ern_batch *batch, struct ern_step_sum *sum) {
  struct ern_torso_step_args args = {.dparameters = t->values.gradient,
                                     .parameters = t->shared.parameters,
                                     .field = &t->shared.model->field,
                                     .view = &t->shared.views[batch->frame],
                                     .grid = t->occupancy.torso_grid,
                                     .threshold = (float)fmin(t->occupancy.torso_mean, 0.01),
                                     .shrink = t->shared.config.torso_shrink,
                                     .pixel_number = batch->pixel_number,
                                     .truth = batch->truth,
                                     .background = batch->background,
                                     .individual = ern_trainer_code(&t->shared, batch->frame),
                                     .motion = t->shared.motion[batch->frame],
                                     .meanwhile = ern_trainer_draw_ahead,
                                     .user = &t->batches,
                                     .n = batch->rays};
  const ern_status status = t->shared.backend->torso_step(t->shared.stream, &args);
  add_part(t, sum, args.terms, args.terms[ERN_LOSS_PHOTOMETRIC], args.samples, batch->rays);
  return status;
}

static ern_status batch_step(ern_trainer *t, struct ern_batch *batch, struct ern_step_sum *sum) {
  return t->shared.config.torso ? torso_step(t, batch, sum) : head_step(t, batch, sum);
}

/* Checks every loss term and gradient; the error names the first that is not finite. */
static ern_status check_finite(ern_trainer *t, const struct ern_step_sum *sum) {
  const size_t frames = ern_trainer_step_frames(&t->fine);
  const double *terms = sum->terms;
  for (int i = 0; i < ERN_LOSS_TERMS; i++)
    if (!isfinite(terms[i]))
      return ern_fail(t->shared.context, ERN_E_NONFINITE,
                      "step %" PRIu64 ": the loss term %s is %g; the parameters are as before", t->shared.step,
                      term_name[i], terms[i]);
  for (size_t i = 0; i < frames * ERN_POSE_PARAMETERS; i++)
    if (!isfinite(sum->dpose[i / ERN_POSE_PARAMETERS][i % ERN_POSE_PARAMETERS]))
      return ern_fail(t->shared.context, ERN_E_NONFINITE,
                      "step %" PRIu64
                      ": the gradient of the pose of training frame %zu is not finite; the parameters are "
                      "as before",
                      t->shared.step, ern_trainer_step_frame(&t->batches, i / ERN_POSE_PARAMETERS));
  struct ern_finite_args all = {.values = t->values.gradient, .n = t->shared.model->field.parameters};
  ern_status status = t->shared.backend->finite(t->shared.stream, &all);
  if (status != ERN_OK || all.finite) return status;
  for (int r = 0; r < t->shared.model->table.rows; r++) {
    const struct ern_parameter *row = &t->shared.model->table.row[r];
    struct ern_finite_args one = {.values = ern_span_part(t->values.gradient, row->at, row->count), .n = row->count};
    status = t->shared.backend->finite(t->shared.stream, &one);
    if (status != ERN_OK) return status;
    if (!one.finite)
      return ern_fail(t->shared.context, ERN_E_NONFINITE,
                      "step %" PRIu64 ": the gradient of %s is not finite; the parameters are as before",
                      t->shared.step, row->name);
  }
  return ERN_OK;
}

/* Refreshes or prunes the grid where that is due. */
static ern_status occupancy(ern_trainer *t) {
  struct ern_trainer_occupancy *o = &t->occupancy;
  const bool prune = ern_trainer_prune_due(&t->fine);
  if (o->pruned || (!prune && t->shared.step % ern_trainer_refresh_every(&t->shared) != 0)) return ERN_OK;
  t->between = true;
  return prune ? ern_trainer_prune(o, t->poses) : ern_trainer_refresh(o);
}

/* Gradient and results of some batches. */
static ern_status part_step(ern_trainer *t, struct ern_batch *batches, size_t count, struct ern_step_sum *sum) {
  *sum = (struct ern_step_sum){.samples = 0};
  ern_status status = t->shared.backend->zero(t->shared.stream, t->values.gradient);
  for (size_t k = 0; status == ERN_OK && k < count; k++) status = batch_step(t, &batches[k], sum);
  return status;
}

/* Those of a step: of this process's batches and of those of the others. */
static ern_status sum_step(ern_trainer *t, struct ern_batch *batches, struct ern_step_sum *sum) {
  const size_t own = ern_trainer_own_batches(&t->fine),
               parts = (size_t)(t->shared.config.step_parts / t->shared.communicator.size), each = own / parts;
  const ern_span gradient = t->values.gradient;
  ern_status status = ERN_OK;
  if (t->shared.config.step_parts == 1) return part_step(t, batches, own, sum);
  for (size_t p = 0; p < parts; p++) {
    ERN_TRY(part_step(t, batches + p * each, each, sum));
    ERN_TRY(ern_trainer_parts_add(&t->parts, p, gradient, sum));
  }
  status = ern_trainer_parts_finish(&t->parts, gradient, ern_trainer_step_frames(&t->fine),
                                    ern_trainer_step_batches(&t->fine), sum);
fail:
  return status;
}

/* Processes that train together use the time of rank 0 as it was before the step: the step's own seconds are counted
 * with the next step. */
static void count_seconds(ern_trainer *t, const struct ern_step_sum *sum, double spent_now) {
  if (t->shared.communicator.size == 1) {
    t->shared.seconds += spent_now;
  } else {
    t->shared.seconds = sum->seconds;
    t->shared.beside = sum->beside;
    t->shared.pending_seconds = spent_now;
  }
}

ern_status ern_trainer_take_step(ern_trainer *t, ern_train_report *report) {
  const struct ern_arena_mark mark = ern_arena_mark(t->shared.stream);
  const double began = ern_trainer_clock();
  struct ern_step_sum sum;
  struct ern_batch batches[ERN_STEP_BATCHES_MOST];
  ern_status status = ERN_OK;
  /* processes that train together agree on the time only at the end of a step */
  if (t->shared.step < t->shared.config.iters && t->shared.communicator.size == 1)
    ern_trainer_follow_time(&t->shared, t->shared.step + 1);
  ern_trainer_fine_due(&t->fine);
  const size_t frames = ern_trainer_step_frames(&t->fine), own = ern_trainer_own_batches(&t->fine);
  *report = (ern_train_report){.iters = t->shared.config.iters};
  if (t->shared.step >= t->shared.config.iters)
    ERN_TRY(ern_fail(t->shared.context, ERN_E_STATE, "train: all %" PRIu64 " steps are done", t->shared.config.iters));
  /* first, so that the state is that after the last step where a picture cannot be read */
  for (size_t k = 0; k < own; k++)
    ERN_TRY(ern_trainer_batch(&t->batches, ern_trainer_first_batch(&t->fine) + k, &batches[k]));
  ERN_TRY(occupancy(t));
  ERN_TRY(sum_step(t, batches, &sum));
  report->psnr = -10 * log10(fmax(sum.squared_error, 1e-10));
  report->samples_per_ray = sum.samples;
  ERN_TRY(check_finite(t, &sum));
  ERN_TRY(ern_trainer_update(&t->values, (float)pow(ern_trainer_is_fine(&t->fine) ? 0.05 : 0.5, progress(t))));
  for (size_t k = 0; ern_trainer_poses_due(t->poses) && k < frames; k++)
    ern_trainer_poses_step(t->poses, ern_trainer_step_frame(&t->batches, k), sum.dpose[k]);
  t->shared.step++;
  t->between = false;
  if (t->shared.step % t->shared.config.ema_every == 0) ERN_TRY(ern_trainer_average(&t->values));
  for (int i = 0; i < ERN_LOSS_TERMS; i++) report->loss += sum.terms[i];
  count_seconds(t, &sum, ern_trainer_clock() - began);
  ern_trainer_follow_time(&t->shared, t->shared.step);
  report->iters = t->shared.config.iters;
fail:
  report->step = t->shared.step;
  report->seconds = t->shared.seconds;
  ern_arena_release(t->shared.stream, mark);
  return status;
}
