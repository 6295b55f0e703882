/* SPDX-License-Identifier: MIT
 * The training loop: batch, step, update; refresh, average, save and validate when they are due. */
#include "train/trainer.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "core/floats.h"
#include "core/memory.h"
#include "core/sized.h"
#include "model/torso_ops.h"
#include "render/picture_ops.h"
#include "train/divergence.h"
#include "train/parts/trainer_model.h"
#include "train/step.h"
#include "train/step_ops.h"

static double seconds_now(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + (double)now.tv_nsec * 1e-9;
}

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
  if (o->pruned) return ERN_OK;
  if (ern_trainer_prune_due(&t->fine)) return ern_trainer_prune(o, t->poses);
  return t->shared.step % ern_trainer_refresh_every(&t->shared) == 0 ? ern_trainer_refresh(o) : ERN_OK;
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

static ern_status take_step(ern_trainer *t, ern_train_report *report) {
  const struct ern_arena_mark mark = ern_arena_mark(t->shared.stream);
  const double began = seconds_now();
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
  if (t->shared.step % t->shared.config.ema_every == 0) ERN_TRY(ern_trainer_average(&t->values));
  for (int i = 0; i < ERN_LOSS_TERMS; i++) report->loss += sum.terms[i];
  count_seconds(t, &sum, seconds_now() - began);
  ern_trainer_follow_time(&t->shared, t->shared.step);
  report->iters = t->shared.config.iters;
fail:
  report->step = t->shared.step;
  report->seconds = t->shared.seconds;
  ern_arena_release(t->shared.stream, mark);
  return status;
}

ern_status ern_trainer_step_sized(ern_trainer *trainer, ern_train_report *report, size_t bytes) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, trainer);
  ERN_NEED(trainer->shared.context, report);
  ern_train_report own = {0};
  const ern_status status = take_step(trainer, &own);
  ern_struct_copy_out(report, bytes, &own, sizeof own);
  return status;
}

/* ---- the loop ---------------------------------------------------------------------------------------------------- */

enum { SAVE_SECONDS = 60 };

/* Means since the last report, and the rate of this run. */
struct tally {
  double began, reported, saved, loss, psnr, samples;
  uint64_t first, steps;
  double validated; /* seconds of the training at the last validation */
};

static ern_train_report make_report(const ern_trainer *t, struct tally *tally) {
  const double now = seconds_now(), n = tally->steps > 0 ? (double)tally->steps : 1;
  ern_train_report report = {.step = t->shared.step,
                             .iters = t->shared.config.iters,
                             .loss = tally->loss / n,
                             .psnr = tally->psnr / n,
                             .samples_per_ray = tally->samples / n,
                             .seconds = t->shared.seconds};
  report.steps_per_second = now > tally->began ? (double)(t->shared.step - tally->first) / (now - tally->began) : 0;
  if (t->shared.config.seconds > 0)
    report.seconds_left = fmax(t->shared.config.seconds - ern_trainer_spent(&t->shared), 0);
  else if (report.steps_per_second > 0)
    report.seconds_left = (double)(t->shared.config.iters - t->shared.step) / report.steps_per_second;
  tally->loss = tally->psnr = tally->samples = 0;
  tally->steps = 0;
  tally->reported = now;
  return report;
}

static ern_status note(ern_trainer *t, const ern_train_report *r, double validation) {
  if (t->state.output == NULL) return ERN_OK;
  ern_status status = ern_lines_add(t->shared.context, &t->state.run.log_lines,
                                    "{\"step\": %" PRIu64
                                    ", \"seconds\": %.3f, \"loss\": %.8g, \"psnr\": %.4f, "
                                    "\"samples_per_ray\": %.3f, \"steps_per_second\": %.4f}\n",
                                    r->step, r->seconds, r->loss, r->psnr, r->samples_per_ray, r->steps_per_second);
  if (status != ERN_OK || !(validation > 0)) return status;
  return ern_lines_add(t->shared.context, &t->state.run.curve_lines, "%" PRIu64 ",%.3f,%.4f\n", r->step, r->seconds,
                       validation);
}

static bool due(uint64_t step, uint64_t every) { return every > 0 && step % every == 0; }

/* With config.seconds: a save each minute; a validation after each tenth of the time, but not more often. */
static bool save_due(const ern_trainer *t, const struct tally *tally) {
  return t->shared.config.seconds > 0 ? seconds_now() - tally->saved > SAVE_SECONDS
                                      : due(t->shared.step, t->shared.config.save_every);
}
static bool validation_due(const ern_trainer *t, const struct tally *tally) {
  return t->shared.config.seconds > 0
             ? ern_trainer_spent(&t->shared) - tally->validated > fmax(t->shared.config.seconds / 10, SAVE_SECONDS)
             : due(t->shared.step, t->shared.config.validate_every);
}

/* Saves the training after the error `failed`, such as an unreadable picture or a failed validation. After
 * ERN_E_NONFINITE the values may be invalid, and after ERN_E_DEVICE they cannot be read: then nothing is saved. */
static ern_status save_after(ern_trainer *t, ern_status failed) {
  char cause[1800]; /* room is left for the rest of an error text of 2048 */
  if (failed == ERN_E_NONFINITE || failed == ERN_E_DEVICE) return failed;
  (void)ern_last_error_copy(t->shared.context, cause, sizeof cause);
  const ern_status saved = ern_trainer_state_save(&t->state);
  if (saved != ERN_OK) return saved;
  return ern_fail(t->shared.context, failed, "%s; step %" PRIu64 " is saved", cause, t->shared.step);
}

/* With the values that a save would write. */
static ern_status validate_now(ern_trainer *t, const ern_train_hooks *hooks, double *psnr) {
  const bool averaged = ern_trainer_is_averaged(&t->values);
  const ern_status status = ern_trainer_download(&t->state, averaged ? t->values.average : t->shared.parameters);
  if (status != ERN_OK) return status;
  ern_arena_trim(t->shared.stream); /* a renderer needs memory too; the download has waited for all that ran */
  return ern_trainer_validate(&t->speech, t->poses, hooks, psnr);
}

static ern_status finish_step(ern_trainer *t, const ern_train_hooks *hooks, struct tally *tally) {
  if (t->shared.communicator.rank > 0) return ERN_OK;
  const bool last = t->shared.step == t->shared.config.iters;
  const bool validate = last || validation_due(t, tally);
  const bool save = t->state.output != NULL && (last || save_due(t, tally));
  const double began = seconds_now();
  double validation = 0;
  ern_status status = ERN_OK;
  /* the pictures of an earlier training are replaced after the first save, as all of it is */
  if (validate && t->state.output != NULL && t->state.run.fresh && access(t->state.run.curve, F_OK) == 0)
    ERN_TRY(ern_trainer_state_save(&t->state));
  if (validate) status = validate_now(t, hooks, &validation);
  if (status != ERN_OK) return t->state.output != NULL ? save_after(t, status) : status;
  const bool report_now = last || validation > 0 || seconds_now() - tally->reported > 0.5;
  if (report_now) {
    const ern_train_report report = make_report(t, tally);
    ERN_TRY(note(t, &report, validation));
    if (hooks->progress != NULL && hooks->progress(hooks->user, &report) != 0 && !last) {
      if (t->state.output != NULL) ERN_TRY(ern_trainer_state_save(&t->state));
      ERN_TRY(ern_fail(t->shared.context, ERN_E_CANCELLED, "train: stopped at step %" PRIu64 " of %" PRIu64 "%s",
                       t->shared.step, t->shared.config.iters, t->state.output != NULL ? "; the state is saved" : ""));
    }
  }
  if (save) ERN_TRY(ern_trainer_state_save(&t->state));
  if (save) tally->saved = seconds_now();
fail:
  t->shared.beside += seconds_now() - began;
  if (validate) tally->validated = ern_trainer_spent(&t->shared);
  return status;
}

/* The validation that was stopped at the step of a resume, which is due by steps. */
static ern_status make_up(ern_trainer *t, const ern_train_hooks *hooks) {
  const bool missing = t->state.run.unmeasured && t->shared.communicator.rank == 0;
  const double began = seconds_now();
  double validation = 0;
  t->state.run.unmeasured = false;
  if (!missing || (t->shared.step < t->shared.config.iters &&
                   (t->shared.config.seconds > 0 || !due(t->shared.step, t->shared.config.validate_every))))
    return ERN_OK;
  ern_status status = validate_now(t, hooks, &validation);
  if (status == ERN_OK && validation > 0)
    status = ern_lines_add(t->shared.context, &t->state.run.curve_lines, "%" PRIu64 ",%.3f,%.4f\n", t->shared.step,
                           t->shared.seconds, validation);
  t->shared.beside += seconds_now() - began;
  return status;
}

/* The loss of a device loses only the steps since the last save: adds that to the error. */
static ern_status stopped(const ern_trainer *t, ern_status status) {
  char cause[1800]; /* room is left for the rest of an error text of 2048 */
  if (status != ERN_E_DEVICE || t->state.output == NULL) return status;
  (void)ern_last_error_copy(t->shared.context, cause, sizeof cause);
  if (t->state.saved == 0)
    return ern_fail(t->shared.context, status,
                    "%s; after step %" PRIu64 ", and nothing of this training was saved before", cause, t->shared.step);
  return ern_fail(t->shared.context, status,
                  "%s; after step %" PRIu64 "; the state of step %" PRIu64
                  " is whole in %s, and a resume goes on from it, on any backend",
                  cause, t->shared.step, t->state.saved, t->state.run.folder);
}

static void warn_of_divergence(ern_trainer *t, const struct ern_divergence *divergence) {
  char kept[1200] = ""; /* room is left for the rest of a line of 2048 */
  t->state.diverged = t->state.output != NULL && t->state.saved > 0;
  if (t->state.diverged)
    snprintf(kept, sizeof kept,
             "; the next save keeps the state of before as %s, which --from goes on from, to another output",
             t->state.run.good);
  ern_log(t->shared.context, ERN_LOG_WARNING,
          "train: PSNR has fallen from %.1f to %.1f dB by step %" PRIu64
          ", though every value is finite: as a rule the networks are dead then and stay so; begin again with lower "
          "rates (grids %g, networks %g)%s",
          divergence->best, divergence->mean, t->shared.step, (double)t->shared.config.lr,
          (double)t->shared.config.lr_net, kept);
}

ern_status ern_trainer_run_sized(ern_trainer *t, const ern_train_hooks *hooks, size_t bytes) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, t);
  ern_train_hooks own = {0};
  ern_status status = hooks != NULL ? ERN_COPY_IN(t->shared.context, ern_train_hooks, &own, hooks, bytes) : ERN_OK;
  if (status != ERN_OK) return status;
  struct tally tally = {
      .began = seconds_now(), .reported = seconds_now(), .saved = seconds_now(), .first = t->shared.step};
  tally.validated = ern_trainer_spent(&t->shared);
  struct ern_divergence divergence = {0};
  status = make_up(t, &own);
  if (status != ERN_OK) return stopped(t, status);
  if (t->shared.step >= t->shared.config.iters && t->state.output != NULL) status = ern_trainer_state_save(&t->state);
  if (status != ERN_OK) return status;
  while (t->shared.step < t->shared.config.iters) {
    ern_train_report report;
    status = take_step(t, &report);
    const bool keep =
        t->state.output != NULL && t->shared.step > t->state.saved && status != ERN_E_NO_MEMORY; /* may be mid-update */
    if (status != ERN_OK) return stopped(t, keep ? save_after(t, status) : status);
    /* not in the fine stage: patches differ too much from step to step */
    if (t->shared.config.rays >= 64 && !ern_trainer_is_fine(&t->fine) && ern_divergence_step(&divergence, report.psnr))
      warn_of_divergence(t, &divergence);
    tally.loss += report.loss;
    tally.psnr += report.psnr;
    tally.samples += report.samples_per_ray;
    tally.steps++;
    status = finish_step(t, &own, &tally);
    if (status != ERN_OK) return stopped(t, status);
  }
  /* needed where a callback made the last steps */
  if (t->state.output != NULL && t->state.saved != t->shared.step) status = ern_trainer_state_save(&t->state);
  return status == ERN_OK ? ern_trainer_wait_for_first(&t->shared) : status;
}

ern_status ern_trainer_model(ern_trainer *t, ern_model **model) {
  ERN_PLAIN_FLOATS;
  if (model != NULL) *model = NULL;
  ERN_NEED(NULL, t);
  ERN_NEED(t->shared.context, model);
  ern_status status = ern_trainer_download(&t->state, t->shared.parameters);
  if (status == ERN_OK) status = ern_model_make(model, t->shared.context, &t->shared.model->field.config);
  if (status != ERN_OK) return status;
  memcpy((*model)->block, t->shared.model->block, t->shared.model->field.parameters * sizeof(float));
  memcpy((*model)->bits, t->shared.model->bits, ERN_OCCUPANCY_BYTES);
  if ((*model)->torso_grid != NULL)
    memcpy((*model)->torso_grid, t->shared.model->torso_grid, ERN_TORSO_CELLS * sizeof(float));
  status = ern_trainer_copy_camera(*model, t->shared.model);
  if (status != ERN_OK) {
    ern_model_free(model);
    return status;
  }
  (*model)->head_steps = t->shared.model->head_steps;
  (*model)->torso_steps = t->shared.model->torso_steps;
  (*model)->view = t->shared.model->view;
  memcpy((*model)->clip, t->shared.model->clip, sizeof(*model)->clip);
  memcpy((*model)->speech, t->shared.model->speech, sizeof(*model)->speech);
  memcpy((*model)->speech_network, t->shared.model->speech_network, sizeof(*model)->speech_network);
  memcpy((*model)->consent, t->shared.model->consent, sizeof(*model)->consent);
  (*model)->dub = t->shared.model->dub;
  return ERN_OK;
}

void ern_trainer_describe_sized(const ern_trainer *trainer, ern_train_report *report, size_t bytes) {
  ern_train_report own = {0};
  if (trainer != NULL)
    own = (ern_train_report){
        .step = trainer->shared.step, .iters = trainer->shared.config.iters, .seconds = trainer->shared.seconds};
  ern_struct_copy_out(report, bytes, &own, sizeof own);
}

ern_status ern_trainer_save(ern_trainer *trainer) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, trainer);
  return ern_trainer_state_save(&trainer->state);
}

const char *ern_trainer_folder(const ern_trainer *trainer) {
  return trainer != NULL ? trainer->state.run.folder : NULL;
}
