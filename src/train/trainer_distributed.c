/* SPDX-License-Identifier: MIT
 * The beginning of a distributed training: all processes have the same settings, data and state. */
#include <stdio.h>
#include <string.h>

#include "core/format.h"
#include "core/memory.h"
#include "train/parts/trainer_motion.h"
#include "train/trainer.h"

/* Compares a text with rank 0's. */
static ern_status check_same(const struct ern_training *t, const char *what, const char *own) {
  char first[512] = "";
  snprintf(first, sizeof first, "%s", own);
  const ern_status status = ern_trainer_broadcast(t, first, sizeof first);
  if (status != ERN_OK || strcmp(own, first) == 0) return status;
  return ern_fail(t->context, ERN_E_MISMATCH, "train: rank %d has %s%s; rank 0 has %s, expected the same",
                  t->communicator.rank, what, own, first);
}

/* Checks what must be the same in all processes, except the numbers that rank 0 sends to all (share_numbers): the
 * instruction set too, as each rounds differently. */
static ern_status check_same_training(const struct ern_training *t) {
  char own[512], words[64];
  const ern_setting *s;
  ern_format(own, sizeof own,
             "libernerf %s, backend %s (%s), clip %.12s, files of its frames %s, scale %.9g, speech %.12s, %s of %zu "
             "parameters%s%s, loss of patches %s",
             ern_version(), t->backend->name, t->backend->isa, t->identity,
             t->fingerprint[0] != 0 ? t->fingerprint : "not known", (double)t->data.scale, t->features,
             t->config.torso ? "torso" : "head", t->model->field.parameters,
             t->data.has_torso ? " with torso pictures" : "", t->data.head != NULL ? " with ern_dataset.head" : "",
             ern_trainer_fine_name(t));
  ern_status status = check_same(t, "", own);
  for (size_t i = 0; (s = ern_train_setting(i)) != NULL && status == ERN_OK; i++) {
    if (!s->same_everywhere) continue;
    snprintf(words, sizeof words, "%s ", s->name);
    ern_setting_write(s, &t->config, own);
    status = check_same(t, words, own);
  }
  return status;
}

/* Copies values on the backend from rank 0 to all. */
static ern_status share_reals(const struct ern_training *t, ern_span values) {
  float *host = NULL;
  ern_status status = ERN_NEW(t->context, values.count, &host);
  if (status != ERN_OK) return status;
  ERN_TRY(t->backend->download_reals(t->stream, host, values, values.count));
  ERN_TRY(ern_trainer_broadcast(t, host, values.count * sizeof *host));
  ERN_TRY(t->backend->upload_reals(t->stream, values, host, values.count));
  ERN_TRY(t->backend->synchronize(t->stream));
fail:
  ern_release(t->context, host);
  return status;
}

static ern_status share_bits(ern_trainer *t) {
  uint8_t *bits = t->shared.model->bits;
  ern_status status = ERN_OK;
  ERN_TRY(t->shared.backend->download_bytes(t->shared.stream, bits, t->occupancy.bits, ERN_OCCUPANCY_BYTES));
  ERN_TRY(ern_trainer_broadcast(&t->shared, bits, ERN_OCCUPANCY_BYTES));
  ERN_TRY(t->shared.backend->upload_bytes(t->shared.stream, t->occupancy.bits, bits, ERN_OCCUPANCY_BYTES));
fail:
  return status;
}

static ern_status share_poses(ern_trainer *t) {
  struct ern_trainer_poses *poses = t->poses;
  if (poses == NULL) return ERN_OK;
  const ern_status status = ern_trainer_broadcast(&t->shared, poses->row,
                                                  ERN_POSE_PARAMETERS * t->shared.data.frames[0] * sizeof *poses->row);
  return status == ERN_OK ? ern_trainer_broadcast(&t->shared, poses->mean_square, sizeof poses->mean_square) : status;
}

/* Sends the progress of the training from rank 0 to all. */
static ern_status share_numbers(ern_trainer *t) {
  float *fade = t->shared.model->field.config.voice_fade;
  struct {
    uint64_t step, ema_updates, fine_from, iters, fine_steps;
    double seconds, beside, torso_mean;
    uint64_t bf16, pruned, motion;
    float fade[2];
  } now = {t->shared.step,         t->values.ema_updates,       t->fine.from,
           t->shared.config.iters, t->shared.config.fine_steps, t->shared.seconds,
           t->shared.beside,       t->occupancy.torso_mean,     t->shared.bf16,
           t->occupancy.pruned,    t->shared.model->has_motion, {fade[0], fade[1]}};
  const ern_status status = ern_trainer_broadcast(&t->shared, &now, sizeof now);
  if (status != ERN_OK) return status;
  t->shared.step = now.step;
  t->values.ema_updates = now.ema_updates;
  t->fine.from = now.fine_from;
  t->shared.config.iters = now.iters;
  t->shared.config.fine_steps = now.fine_steps;
  t->shared.seconds = now.seconds;
  t->shared.beside = now.beside;
  t->occupancy.torso_mean = now.torso_mean;
  t->shared.bf16 = now.bf16 != 0;
  t->occupancy.pruned = now.pruned != 0;
  memcpy(fade, now.fade, sizeof now.fade);
  return t->shared.model->has_motion == (now.motion != 0) ? ERN_OK
                                                          : ern_trainer_motion_set(&t->shared, now.motion != 0);
}

ern_status ern_trainer_share_state(ern_trainer *t) {
  const ern_span values[] = {t->shared.parameters, t->values.second_moment, t->values.average};
  ern_status status = ERN_OK;
  if (t->shared.communicator.size == 1) return ERN_OK;
  ERN_TRY(check_same_training(&t->shared));
  ERN_TRY(share_numbers(t));
  for (size_t i = 0; i < sizeof values / sizeof *values; i++) ERN_TRY(share_reals(&t->shared, values[i]));
  ERN_TRY(share_bits(t));
  ERN_TRY(share_poses(t));
  if (t->shared.config.torso) {
    ERN_TRY(share_reals(&t->shared, t->occupancy.torso_grid));
  } else {
    ERN_TRY(share_reals(&t->shared, t->occupancy.grid));
    ERN_TRY(ern_trainer_list(&t->occupancy));
  }
fail:
  return status;
}
