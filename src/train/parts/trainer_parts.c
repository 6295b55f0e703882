/* SPDX-License-Identifier: MIT
 * Parts of a step: the gradient of each is summed from zero, and parts are added as a binary tree. So the sum has the
 * same bits whether one process computes all of them or several a range each (docs/scaling.md, "Parts of a step"). */
#include "train/parts/trainer_parts.h"

#include "core/memory.h"
#include "train/parts/trainer_processes.h"

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
static void find_values(struct ern_trainer_parts *parts) {
  const struct ern_training *t = parts->training;
  const struct ern_parameter_table *table = &t->model->table;
  size_t begin = SIZE_MAX, end = 0;
  for (int r = 0; r < table->rows; r++) {
    const struct ern_parameter *row = &table->row[r];
    if (row->torso != t->config.torso) continue;
    if (row->at < begin) begin = row->at;
    if (row->at + row->count > end) end = row->at + row->count;
  }
  parts->begin = begin < end ? begin : 0;
  parts->count = begin < end ? end - begin : 0;
}

ern_status ern_trainer_parts_make(struct ern_trainer_parts *parts, const struct ern_training *t) {
  size_t levels = 2; /* one more than the height of the tree over this process's parts */
  ern_status status = ERN_OK;
  *parts = (struct ern_trainer_parts){.training = t};
  if (t->config.step_parts == 1) return ERN_OK;
  for (int own = t->config.step_parts / t->communicator.size; own > 1; own /= 2) levels++;
  find_values(parts);
  ERN_TRY(ERN_NEW(t->context, levels * parts->count, &parts->values));
  ERN_TRY(ERN_NEW(t->context, levels, &parts->sums));
fail:
  return status;
}

void ern_trainer_parts_free(struct ern_trainer_parts *parts, ern_context *context) {
  ern_release(context, parts->values);
  ern_release(context, parts->sums);
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

ern_status ern_trainer_parts_add(struct ern_trainer_parts *parts, size_t number, ern_span gradient,
                                 const struct ern_step_sum *sum) {
  const struct ern_training *t = parts->training;
  size_t height = (size_t)__builtin_popcountll(number); /* parts before it, merged, wait below */
  const ern_status status =
      t->backend->download_reals(t->stream, parts->values + height * parts->count,
                                 ern_span_part(gradient, parts->begin, parts->count), parts->count);
  if (status != ERN_OK) return status;
  parts->sums[height++] = *sum;
  for (size_t above = number + 1; above % 2 == 0; above /= 2) merge(parts, height--);
  return ERN_OK;
}

ern_status ern_trainer_parts_finish(const struct ern_trainer_parts *parts, ern_span gradient, size_t frames,
                                    size_t batches, struct ern_step_sum *sum) {
  const struct ern_training *t = parts->training;
  struct ern_step_sum *all = &parts->sums[0];
  ern_status status = ERN_OK;
  if (t->communicator.rank == 0) {
    all->seconds = t->seconds + t->pending_seconds;
    all->beside = t->beside;
  }
  ERN_TRY(ern_trainer_sum(t, parts->values, parts->count, (double *)all, sizeof *all / sizeof(double)));
  *sum = *all;
  /* a batch's gradient is that of the mean over its own rays; a power of 2, so exact */
  const float share = (float)frames / (float)batches;
  for (size_t i = 0; i < parts->count && share != 1; i++) parts->values[i] *= share;
  for (size_t i = 0; i < frames * ERN_POSE_PARAMETERS; i++)
    sum->dpose[i / ERN_POSE_PARAMETERS][i % ERN_POSE_PARAMETERS] *= (double)share;
  status = t->backend->upload_reals(t->stream, ern_span_part(gradient, parts->begin, parts->count), parts->values,
                                    parts->count);
fail:
  return status;
}
