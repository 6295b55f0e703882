/* SPDX-License-Identifier: MIT
 * The beginning of a distributed training: all processes have the same settings, data and state. */
#include <stdio.h>
#include <string.h>

#include "core/memory.h"
#include "train/trainer.h"

/* Compares a text with rank 0's. */
static ern_status check_same(ern_trainer *t, const char *what, const char *own) {
  char first[512] = "";
  snprintf(first, sizeof first, "%s", own);
  const ern_status status = ern_trainer_broadcast(&t->shared, first, sizeof first);
  if (status != ERN_OK || strcmp(own, first) == 0) return status;
  return ern_fail(t->shared.context, ERN_E_MISMATCH, "train: rank %d has %s%s; rank 0 has %s, expected the same",
                  t->shared.communicator.rank, what, own, first);
}

/* Checks what must be the same in all processes, except the numbers that rank 0 sends to all (share_numbers): the
 * instruction set too, as each rounds differently. */
static ern_status check_same_training(ern_trainer *t) {
  char own[512], words[64];
  const ern_setting *s;
  snprintf(own, sizeof own, "backend %s (%s), clip %.12s, speech %.12s, %s of %zu parameters%s, loss of patches %s",
           t->shared.backend->name, t->shared.backend->isa, t->shared.identity, t->shared.features,
           t->shared.config.torso ? "torso" : "head", t->shared.model->field.parameters,
           t->shared.data.head != NULL ? " with ern_dataset.head" : "", ern_trainer_fine_name(&t->shared));
  ern_status status = check_same(t, "", own);
  for (size_t i = 0; (s = ern_train_setting(i)) != NULL && status == ERN_OK; i++) {
    if (!s->same_everywhere) continue;
    snprintf(words, sizeof words, "%s ", s->name);
    ern_setting_write(s, &t->shared.config, own);
    status = check_same(t, words, own);
  }
  return status;
}

/* Copies values on the backend from rank 0 to all. */
static ern_status share_reals(ern_trainer *t, ern_span values) {
  float *host = NULL;
  ern_status status = ERN_NEW(t->shared.context, values.count, &host);
  if (status != ERN_OK) return status;
  ERN_TRY(t->shared.backend->download_reals(t->shared.stream, host, values, values.count));
  ERN_TRY(ern_trainer_broadcast(&t->shared, host, values.count * sizeof *host));
  ERN_TRY(t->shared.backend->upload_reals(t->shared.stream, values, host, values.count));
  ERN_TRY(t->shared.backend->synchronize(t->shared.stream));
fail:
  ern_release(t->shared.context, host);
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
  struct {
    uint64_t step, ema_updates, fine_from, iters, fine_steps;
    double seconds, beside, torso_mean;
    uint64_t bf16, pruned;
  } now = {t->shared.step,         t->values.ema_updates,       t->fine.from,
           t->shared.config.iters, t->shared.config.fine_steps, t->shared.seconds,
           t->shared.beside,       t->occupancy.torso_mean,     t->shared.bf16,
           t->occupancy.pruned};
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
  return ERN_OK;
}

ern_status ern_trainer_share_state(ern_trainer *t) {
  const ern_span values[] = {t->shared.parameters, t->values.second_moment, t->values.average};
  ern_status status = ERN_OK;
  if (t->shared.communicator.size == 1) return ERN_OK;
  ERN_TRY(check_same_training(t));
  ERN_TRY(share_numbers(t));
  for (size_t i = 0; i < sizeof values / sizeof *values; i++) ERN_TRY(share_reals(t, values[i]));
  ERN_TRY(share_bits(t));
  ERN_TRY(share_poses(t));
  if (t->shared.config.torso) {
    ERN_TRY(share_reals(t, t->occupancy.torso_grid));
  } else {
    ERN_TRY(share_reals(t, t->occupancy.grid));
    ERN_TRY(ern_trainer_list(&t->occupancy));
  }
fail:
  return status;
}
