/* SPDX-License-Identifier: MIT
 * The values that a training changes: update and average (docs/maths.md, Update). */
#include "train/parts/trainer_values.h"

#include <math.h>

#include "core/status.h"
#include "train/optimizer_ops.h"

ern_status ern_trainer_values_make(struct ern_trainer_values *v, struct ern_training *t) {
  const size_t count = t->model->field.parameters, n = (count + 63) / 64 * 64;
  *v = (struct ern_trainer_values){.training = t};
  const ern_status status = t->backend->buffer_make(t->backend, ERN_ELEMENT_REAL, 4 * n, &v->reals);
  if (status != ERN_OK) return status;
  ern_span *const blocks[] = {&t->parameters, &v->gradient, &v->second_moment, &v->average};
  for (size_t i = 0; i < 4; i++) *blocks[i] = (ern_span){v->reals, i * n, count};
  return ERN_OK;
}

bool ern_trainer_is_averaged(const struct ern_trainer_values *v) {
  return v->training->config.ema && v->ema_updates >= ERN_LEAST_EMA_UPDATES;
}

/* Weight decay of AdamW, by learning-rate group; it is 0 for the other networks. */
static const float grid_decay = 1e-2f, audio_attention_decay = 1e-4f;
static const float adamw_beta2 = 0.99f, adamw_eps = 1e-8f; /* beta1 is 0 */

/* AdamW by learning-rate group (docs/maths.md, Update); rates fall as 0.5^s, in the fine stage as 0.05^s. */
static struct ern_adamw_args update_of(const struct ern_training *t, const struct ern_parameter *row, float factor) {
  float rate = t->config.lr_net, decay = 0;
  if (row->group == ERN_GROUP_GRID) rate = t->config.lr, decay = grid_decay;
  if (row->group == ERN_GROUP_AUDIO_ATT) rate = t->config.lr_att, decay = audio_attention_decay;
  return (struct ern_adamw_args){
      .rate = rate * factor, .decay = decay, .beta2 = adamw_beta2, .eps = adamw_eps, .step = t->step + 1};
}

/* Consecutive rows of one group are updated in one call, as most are short; the padding between them is zero and stays
 * zero. */
ern_status ern_trainer_update(const struct ern_trainer_values *v, float factor) {
  const struct ern_training *t = v->training;
  const struct ern_parameter_table *table = &t->model->table;
  for (int r = 0; r < table->rows;) {
    const struct ern_parameter *first = &table->row[r++];
    size_t count = first->count;
    if (first->torso != t->config.torso) continue;
    for (; r < table->rows && table->row[r].torso == first->torso && table->row[r].group == first->group; r++)
      count = table->row[r].at + table->row[r].count - first->at;
    struct ern_adamw_args args = update_of(t, first, factor);
    args.parameters = ern_span_part(t->parameters, first->at, count);
    args.second_moment = ern_span_part(v->second_moment, first->at, count);
    args.gradient = ern_span_part(v->gradient, first->at, count);
    args.n = count;
    const ern_status status = t->backend->adamw(t->stream, &args);
    if (status != ERN_OK) return status;
  }
  return ERN_OK;
}

ern_status ern_trainer_average(struct ern_trainer_values *v) {
  const struct ern_training *t = v->training;
  v->ema_updates++;
  const double n = (double)v->ema_updates;
  struct ern_ema_args args = {.average = v->average,
                              .parameters = t->parameters,
                              .decay = (float)fmin(0.95, (1 + n) / (10 + n)),
                              .n = t->model->field.parameters};
  return t->backend->ema(t->stream, &args);
}
