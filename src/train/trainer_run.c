/* SPDX-License-Identifier: MIT
 * The training loop: steps; saves and validates when they are due. */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "core/floats.h"
#include "core/memory.h"
#include "core/sized.h"
#include "model/torso_ops.h"
#include "train/divergence.h"
#include "train/parts/trainer_model.h"
#include "train/trainer_step.h"

ern_status ern_trainer_step_sized(ern_trainer *trainer, ern_train_report *report, size_t bytes) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, trainer);
  ERN_NEED(trainer->shared.context, report);
  ern_train_report own = {0};
  const ern_status status = ern_trainer_take_step(trainer, &own);
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
  const double now = ern_trainer_clock(), n = tally->steps > 0 ? (double)tally->steps : 1;
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
  return t->shared.config.seconds > 0 ? ern_trainer_clock() - tally->saved > SAVE_SECONDS
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
  const double began = ern_trainer_clock();
  double validation = 0;
  ern_status status = ERN_OK;
  /* the pictures of an earlier training are replaced after the first save, as all of it is */
  if (validate && t->state.output != NULL && t->state.run.fresh && access(t->state.run.curve, F_OK) == 0)
    ERN_TRY(ern_trainer_state_save(&t->state));
  if (validate) status = validate_now(t, hooks, &validation);
  if (status != ERN_OK) return t->state.output != NULL ? save_after(t, status) : status;
  const bool report_now = last || validation > 0 || ern_trainer_clock() - tally->reported > 0.5;
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
  if (save) tally->saved = ern_trainer_clock();
fail:
  t->shared.beside += ern_trainer_clock() - began;
  if (validate) tally->validated = ern_trainer_spent(&t->shared);
  return status;
}

/* The validation that was stopped at the step of a resume, which is due by steps. */
static ern_status make_up(ern_trainer *t, const ern_train_hooks *hooks) {
  const bool missing = t->state.run.unmeasured && t->shared.communicator.rank == 0;
  const double began = ern_trainer_clock();
  double validation = 0;
  t->state.run.unmeasured = false;
  if (!missing || (t->shared.step < t->shared.config.iters &&
                   (t->shared.config.seconds > 0 || !due(t->shared.step, t->shared.config.validate_every))))
    return ERN_OK;
  ern_status status = validate_now(t, hooks, &validation);
  if (status == ERN_OK && validation > 0)
    status = ern_lines_add(t->shared.context, &t->state.run.curve_lines, "%" PRIu64 ",%.3f,%.4f\n", t->shared.step,
                           t->shared.seconds, validation);
  t->shared.beside += ern_trainer_clock() - began;
  return status;
}

/* The loss of a device, or of a process during a step that had changed the occupancy grid, loses only the steps since
 * the last save: adds that to the error. */
static ern_status stopped(const ern_trainer *t, ern_status status) {
  char cause[1800]; /* room is left for the rest of an error text of 2048 */
  const bool loses = status == ERN_E_DEVICE || (status == ERN_E_IO && t->between);
  if (!loses || t->state.output == NULL) return status;
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
  struct tally tally = {.began = ern_trainer_clock(),
                        .reported = ern_trainer_clock(),
                        .saved = ern_trainer_clock(),
                        .first = t->shared.step};
  tally.validated = ern_trainer_spent(&t->shared);
  struct ern_divergence divergence = {0};
  status = make_up(t, &own);
  if (status != ERN_OK) return stopped(t, status);
  if (t->shared.step >= t->shared.config.iters && t->state.output != NULL) status = ern_trainer_state_save(&t->state);
  if (status != ERN_OK) return status;
  while (t->shared.step < t->shared.config.iters) {
    ern_train_report report;
    status = ern_trainer_take_step(t, &report);
    const bool keep = t->state.output != NULL && t->shared.step > t->state.saved &&
                      status != ERN_E_NO_MEMORY && /* may be mid-update */
                      !t->between;
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
  (*model)->has_motion = t->shared.model->has_motion;
  memcpy((*model)->motion, t->shared.model->motion, sizeof(*model)->motion);
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
