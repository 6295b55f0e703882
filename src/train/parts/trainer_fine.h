/* SPDX-License-Identifier: MIT
 * The fine stage of a head's training (docs/maths.md, "The fine stage"), and what a step of either stage consists of.
 * Internal. */
#ifndef ERN_TRAIN_TRAINER_FINE_H
#define ERN_TRAIN_TRAINER_FINE_H

#include "train/parts/trainer_shared.h"

struct ern_trainer_fine {
  const struct ern_training *training;
  uint64_t from;             /* the first step of the fine stage; UINT64_MAX: none */
  struct ern_buffer *filter; /* of patches_ops.h; NULL without a fine stage */
  ern_fine_loss loss;        /* a copy of *config.fine_loss */
  char name[32];             /* and its name */
  double value;              /* of the loss for a made-up patch; NAN: not known */
};

/* Checks training->config.fine_loss, which then points to a copy. */
ERN_NODISCARD ern_status ern_trainer_fine_take(struct ern_trainer_fine *fine, struct ern_training *training);
static inline const char *ern_trainer_fine_name(const struct ern_training *t) {
  return t->config.fine_loss != NULL ? t->config.fine_loss->name : "ssim";
}
/* Whether the next step belongs to the fine stage. */
static inline bool ern_trainer_is_fine(const struct ern_trainer_fine *f) { return f->training->step >= f->from; }
/* Decides when the fine stage begins. fine->from, fine->value: those of a resumed state. */
ERN_NODISCARD ern_status ern_trainer_fine_begin(struct ern_trainer_fine *fine);
/* Steps before the fine stage, all steps where there is none; with config.seconds an estimate from the pace so far. */
uint64_t ern_trainer_coarse_steps(const struct ern_trainer_fine *fine);
/* Before a step, with config.seconds: begins the fine stage once its share of the time has come. */
void ern_trainer_fine_due(struct ern_trainer_fine *fine);
size_t ern_trainer_most_rays(const struct ern_trainer_fine *fine); /* of any step */
/* Frames, rays and patches of the next step. */
size_t ern_trainer_step_frames(const struct ern_trainer_fine *fine);
size_t ern_trainer_step_rays(const struct ern_trainer_fine *fine);
size_t ern_trainer_step_patches(const struct ern_trainer_fine *fine); /* 0: its rays are no patches */
enum { ERN_STEP_BATCHES_MOST = 64 };
/* Batches of the next step in all processes: one for each frame, or several for a frame where a step has more parts
 * than frames. */
size_t ern_trainer_step_batches(const struct ern_trainer_fine *fine);
/* The batches of this process are a contiguous range: its first one, and their number. */
size_t ern_trainer_first_batch(const struct ern_trainer_fine *fine);
static inline size_t ern_trainer_own_batches(const struct ern_trainer_fine *f) {
  return ern_trainer_step_batches(f) / (size_t)f->training->communicator.size;
}
/* Pixels of patches [first, first + count) of the step, one patch after the other. about: the frame */
void ern_trainer_place_patches(const struct ern_trainer_fine *fine, const ern_dataset_frame *about, size_t first,
                               size_t count, int32_t *pixel);

#endif
