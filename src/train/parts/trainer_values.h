/* SPDX-License-Identifier: MIT
 * The values that a training changes, on the backend. Internal. */
#ifndef ERN_TRAIN_TRAINER_VALUES_H
#define ERN_TRAIN_TRAINER_VALUES_H

#include "train/parts/trainer_shared.h"

enum { ERN_LEAST_EMA_UPDATES = 10 /* updates before the average is used: until then its initial values dominate it */ };

struct ern_trainer_values {
  const struct ern_training *training;
  struct ern_buffer *reals;
  ern_span gradient, second_moment, average; /* [field.parameters] */
  uint64_t ema_updates;
};

/* Memory for the values, training->parameters included. */
ERN_NODISCARD ern_status ern_trainer_values_make(struct ern_trainer_values *values, struct ern_training *training);
/* A step of AdamW, with the learning rates times `factor`. */
ERN_NODISCARD ern_status ern_trainer_update(const struct ern_trainer_values *values, float factor);
ERN_NODISCARD ern_status ern_trainer_average(struct ern_trainer_values *values);
bool ern_trainer_is_averaged(const struct ern_trainer_values *values); /* whether a save writes the moving average */

#endif
