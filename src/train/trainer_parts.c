/* SPDX-License-Identifier: MIT
 * Parts of a step: the gradient of each is summed from zero, and parts are added as a binary tree. So the sum has the
 * same bits whether one process computes all of them or several a range each (docs/scaling.md, "Parts of a step"). */
#include <string.h>

#include "core/memory.h"
#include "train/trainer.h"

static bool is_power_of_2(int value) { return value > 0 && (value & (value - 1)) == 0; }

ern_status ern_trainer_parts_check(ern_context *context, const ern_train_config *c) {
  const int parts = c->step_parts;
  const ern_communicator *communicator = c->communicator;
  if (!is_power_of_2(parts) || parts > ERN_STEP_PARTS_MOST)
    return ern_fail(context, ERN_E_ARGUMENT, "train: step_parts is %d, expected a power of 2 from 1 to %d", parts,
                    ERN_STEP_PARTS_MOST);
  if (c->rays % parts != 0)
    return ern_fail(context, ERN_E_ARGUMENT, "train: step_parts is %d, expected a number that divides the %d rays",
                    parts, c->rays);
  if (c->frames_per_step % parts != 0 && parts % c->frames_per_step != 0)
    return ern_fail(context, ERN_E_ARGUMENT,
                    "train: step_parts is %d and frames_per_step %d, expected that one divides the other", parts,
                    c->frames_per_step);
  if (communicator == NULL) return ERN_OK;
  if (communicator->sum == NULL || communicator->gather == NULL || communicator->broadcast == NULL ||
      communicator->rank < 0 || communicator->rank >= communicator->size)
    return ern_fail(context, ERN_E_ARGUMENT, "train: the communicator lacks a function, or is of rank %d of %d",
                    communicator->rank, communicator->size);
  if (parts % communicator->size != 0)
    return ern_fail(context, ERN_E_ARGUMENT,
                    "train: %d processes share the %d parts of a step (step_parts), expected a number that divides it",
                    communicator->size, parts);
  return ERN_OK;
}

/* The range from the first to the last trained row; rows in between that are not trained have no gradient. */
static void find_values(ern_trainer *t) {
  const struct ern_parameter_table *table = &t->shared.model->table;
  size_t begin = SIZE_MAX, end = 0;
  for (int r = 0; r < table->rows; r++) {
    const struct ern_parameter *row = &table->row[r];
    if (row->torso != t->shared.config.torso) continue;
    if (row->at < begin) begin = row->at;
    if (row->at + row->count > end) end = row->at + row->count;
  }
  t->parts.begin = begin < end ? begin : 0;
  t->parts.count = begin < end ? end - begin : 0;
}

ern_status ern_trainer_parts_make(ern_trainer *t) {
  struct ern_trainer_parts *parts = &t->parts;
  size_t levels = 2; /* one more than the height of the tree over this process's parts */
  ern_status status = ERN_OK;
  if (t->shared.config.step_parts == 1) return ERN_OK;
  for (int own = t->shared.config.step_parts / t->shared.communicator.size; own > 1; own /= 2) levels++;
  find_values(t);
  ERN_TRY(ERN_NEW(t->shared.context, levels * parts->count, &parts->values));
  ERN_TRY(ERN_NEW(t->shared.context, levels, &parts->sums));
fail:
  return status;
}

void ern_trainer_parts_free(ern_trainer *t) {
  ern_release(t->shared.context, t->parts.values);
  ern_release(t->shared.context, t->parts.sums);
  t->parts = (struct ern_trainer_parts){0};
}

static void add_sum(struct ern_step_sum *to, const struct ern_step_sum *from) {
  double *sum = (double *)to;
  const double *other = (const double *)from;
  for (size_t i = 0; i < sizeof *to / sizeof *sum; i++) sum[i] += other[i];
}

/* Adds the topmost level to the one below it. */
static void merge(struct ern_trainer_parts *parts, size_t height) {
  float *to = parts->values + (height - 2) * parts->count;
  const float *from = to + parts->count;
  for (size_t i = 0; i < parts->count; i++) to[i] += from[i];
  add_sum(&parts->sums[height - 2], &parts->sums[height - 1]);
}

/* Computes a part, summed from zero, into level `height`. */
static ern_status part_step(ern_trainer *t, struct ern_batch *batches, size_t count, size_t height) {
  struct ern_trainer_parts *parts = &t->parts;
  ern_status status = ERN_OK;
  parts->sums[height] = (struct ern_step_sum){.samples = 0};
  ERN_TRY(t->shared.backend->zero(t->shared.stream, t->values.gradient));
  for (size_t k = 0; k < count; k++) ERN_TRY(ern_trainer_batch_step(t, &batches[k], &parts->sums[height]));
  ERN_TRY(t->shared.backend->download_reals(t->shared.stream, parts->values + height * parts->count,
                                            ern_span_part(t->values.gradient, parts->begin, parts->count),
                                            parts->count));
fail:
  return status;
}

ern_status ern_trainer_parts_step(ern_trainer *t, struct ern_batch *batches, struct ern_step_sum *sum) {
  struct ern_trainer_parts *parts = &t->parts;
  const size_t own = (size_t)(t->shared.config.step_parts / t->shared.communicator.size),
               each = ern_trainer_own_batches(&t->fine) / own;
  const size_t frames = ern_trainer_step_frames(&t->fine), all = ern_trainer_step_batches(&t->fine);
  size_t height = 0;
  ern_status status = ERN_OK;
  for (size_t p = 0; p < own; p++) {
    ERN_TRY(part_step(t, batches + p * each, each, height++));
    for (size_t above = p + 1; above % 2 == 0; above /= 2) merge(parts, height--);
  }
  if (t->shared.communicator.rank == 0) {
    parts->sums[0].seconds = t->shared.seconds + t->shared.pending_seconds;
    parts->sums[0].beside = t->shared.beside;
  }
  ERN_TRY(ern_trainer_sum(&t->shared, parts->values, parts->count, (double *)&parts->sums[0],
                          sizeof parts->sums[0] / sizeof(double)));
  *sum = parts->sums[0];
  /* a batch's gradient is that of the mean over its own rays; a power of 2, so exact */
  const float share = (float)frames / (float)all;
  for (size_t i = 0; i < parts->count && share != 1; i++) parts->values[i] *= share;
  for (size_t i = 0; i < frames * ERN_POSE_PARAMETERS; i++)
    sum->dpose[i / ERN_POSE_PARAMETERS][i % ERN_POSE_PARAMETERS] *= (double)share;
  ERN_TRY(t->shared.backend->upload_reals(
      t->shared.stream, ern_span_part(t->values.gradient, parts->begin, parts->count), parts->values, parts->count));
fail:
  return status;
}
