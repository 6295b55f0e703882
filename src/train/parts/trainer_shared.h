/* SPDX-License-Identifier: MIT
 * What all parts of a training read: data only. Each part has a struct of its own beside it, and none knows the trainer
 * that calls them (trainer.h). Internal. */
#ifndef ERN_TRAIN_TRAINER_SHARED_H
#define ERN_TRAIN_TRAINER_SHARED_H

#include "core/backend.h"
#include "core/threads.h"
#include "ernerf/train.h"
#include "model/model.h"
#include "render/march_ops.h"

struct ern_training {
  ern_context *context;
  struct ern_backend *backend;
  struct ern_stream *stream;
  struct ern_pool *pool; /* for work on the host */
  ern_dataset data;
  ern_train_config config;
  ern_communicator communicator;   /* size 1: this process is alone */
  char identity[65], features[65]; /* SHA-256 of clip and speech features; the latter "" without an output */
  char fingerprint[65];            /* of the frames' files, "": not known */
  ern_model *model;                /* configuration and table; its values are those of the last download */
  ern_span parameters;             /* [field.parameters], on the backend */
  struct ern_view *views;          /* [training frames], as the clip has them */
  float (
      *motion)[ERN_MOTION_VALUES]; /* [training frames] of torso_move: of the body; zeros for a torso without motion */
  bool bf16;                       /* products of bf16 (config.precision) */
  uint64_t step;
  double seconds;         /* of training, all runs together */
  double beside;          /* seconds of validations and saves, all runs together */
  double pending_seconds; /* with a communicator: seconds of the last step, not yet in `seconds` */
};

static inline struct ern_march_settings ern_trainer_march(const struct ern_training *t) {
  return (struct ern_march_settings){t->config.bound, t->config.max_steps, t->config.dt_gamma, ERN_NEAR_PLANE};
}

/* Row of the individual codes of a training frame. */
static inline size_t ern_trainer_code(const struct ern_training *t, size_t frame) {
  return t->model->field.config.codes > 0 ? frame : 0;
}

/* With config.seconds, sets config.iters to the steps that fit into the time at the pace so far; where the time is
 * over, to the steps already made; at least `least`. */
void ern_trainer_follow_time(struct ern_training *t, uint64_t least);
/* Seconds of the training so far, all runs together. */
static inline double ern_trainer_spent(const struct ern_training *t) { return t->seconds + t->beside; }

double ern_trainer_clock(void); /* seconds, from any beginning */

#endif
