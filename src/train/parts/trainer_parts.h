/* SPDX-License-Identifier: MIT
 * Parts of a step (docs/scaling.md, "Parts of a step"). Internal. */
#ifndef ERN_TRAIN_TRAINER_PARTS_H
#define ERN_TRAIN_TRAINER_PARTS_H

#include "train/losses_ops.h"
#include "train/parts/trainer_shared.h"

/* Results of a step besides its gradient: means over its rays. A plain array of doubles for the communicator. */
struct ern_step_sum {
  double terms[ERN_LOSS_TERMS]; /* each frame's are means over its own rays */
  double squared_error, samples;
  double dpose[ERN_FRAMES_PER_STEP_MOST][ERN_POSE_PARAMETERS]; /* by frame of the step */
  double seconds, beside;                                      /* before the step, by the clock of rank 0 */
};

/* Sums of parts of a step, on the host: [levels] of a binary tree, each waiting for its sibling. */
struct ern_trainer_parts {
  const struct ern_training *training;
  size_t begin, count; /* the values that this training changes are [begin, begin + count) of all */
  float *values;       /* [levels][count] */
  struct ern_step_sum *sums;
};

ERN_NODISCARD ern_status ern_trainer_parts_check(ern_context *context, const ern_train_config *config);
/* All NULL where a step is one part. Needs ern_trainer_parts_free also after an error. */
ERN_NODISCARD ern_status ern_trainer_parts_make(struct ern_trainer_parts *parts, const struct ern_training *training);
void ern_trainer_parts_free(struct ern_trainer_parts *parts, ern_context *context);
/* Adds gradient and sum of part `number` of this process, 0 the first; each is summed from zero. */
ERN_NODISCARD ern_status ern_trainer_parts_add(struct ern_trainer_parts *parts, size_t number, ern_span gradient,
                                               const struct ern_step_sum *sum);
/* Gradient and sum of the step, from the parts of all processes. frames, batches: of the step, in all processes */
ERN_NODISCARD ern_status ern_trainer_parts_finish(const struct ern_trainer_parts *parts, ern_span gradient,
                                                  size_t frames, size_t batches, struct ern_step_sum *sum);

#endif
