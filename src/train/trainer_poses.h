/* SPDX-License-Identifier: MIT
 * The poses of the training frames as parameters (docs/maths.md, "Poses"). */
#ifndef ERN_TRAIN_TRAINER_POSES_H
#define ERN_TRAIN_TRAINER_POSES_H

#include "train/losses_ops.h"
#include "train/trainer.h"

enum {
  ERN_POSE_GAUGE = 1 + ERN_POSE_SLOPES,
  ERN_POSE_HALF = 3 /* frames on either side that a pose is averaged over for the gauge */
};

/* A row a frame: three angles of the model's camera refinement, as radians, and a move, scene units, both about the
 * scene's origin. An affine function of the clip's pose has no part in them: the gauge. */
struct ern_trainer_poses {
  float *row;           /* [frames][ERN_POSE_SLOPES] */
  float *bend;          /* [frames][ERN_POSE_SLOPES]: second differences of the clip's own path, 0 at its gaps */
  double *gauge;        /* [ERN_POSE_GAUGE][frames]: orthonormal, of 1 and of the clip's poses, 0 where none is left */
  size_t *beside;       /* [frames][2]: the frames before and after in time, the frame itself where there is none */
  int64_t *moment;      /* [frames]: their rows of the speech */
  float mean_square[2]; /* of the gradients by angles and by moves, all frames together; 0: no step yet */
};

/* Nothing where config.refine_poses is not set. */
ERN_NODISCARD ern_status ern_trainer_poses_make(ern_trainer *t);
void ern_trainer_poses_free(ern_trainer *t);

/* Whether this step asks for the camera's gradient. */
bool ern_trainer_poses_due(const ern_trainer *t);
/* The camera of a training frame as it is refined now. */
struct ern_view ern_trainer_poses_view(ern_trainer *t, size_t frame);
/* A step of the frame that was visited. dpose: [ERN_POSE_SLOPES], finite */
void ern_trainer_poses_step(ern_trainer *t, size_t frame, const double *dpose);

/* The rows as the model keeps them, into t->model->camera. */
void ern_trainer_poses_download(ern_trainer *t);
/* The reverse, of the rows that `model` has. */
void ern_trainer_poses_take(ern_trainer *t, const ern_model *model);

#endif
