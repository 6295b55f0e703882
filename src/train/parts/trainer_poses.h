/* SPDX-License-Identifier: MIT
 * Refinement of poses during training (docs/poses.md). Internal. */
#ifndef ERN_TRAIN_TRAINER_POSES_H
#define ERN_TRAIN_TRAINER_POSES_H

#include "train/losses_ops.h"
#include "train/parts/trainer_fine.h"

/* One row per frame: three angles (radians) and a translation (scene units) of the model's camera refinement, both
 * about the scene's origin. Their mean over the trained frames is 0. */
struct ern_trainer_poses {
  const struct ern_training *training;
  const struct ern_trainer_fine *fine;
  float *row;     /* [frames][ERN_POSE_PARAMETERS] */
  float *bend;    /* [frames][ERN_POSE_PARAMETERS]: second differences of the clip's own camera path, 0 at its gaps */
  size_t *beside; /* [frames][2]: the frames before and after in time, the frame itself where there is none */
  int64_t *speech_row;  /* [frames]: their rows of the speech */
  float mean_square[2]; /* of the gradients by angles and by moves, all frames together; 0: no step yet */
};

/* Leaves *poses NULL where config.refine_poses is not set. Needs ern_trainer_poses_free also after an error. */
ERN_NODISCARD ern_status ern_trainer_poses_make(struct ern_trainer_poses **poses, const struct ern_trainer_fine *fine);
void ern_trainer_poses_free(struct ern_trainer_poses **poses);

/* Whether the next step asks for the camera's gradient. poses NULL: no. */
bool ern_trainer_poses_due(const struct ern_trainer_poses *poses);
/* The camera of a training frame as it is refined now. */
struct ern_view ern_trainer_poses_view(const struct ern_trainer_poses *poses, size_t frame);
/* Updates the pose row of the frame that a step trained on. dpose: [ERN_POSE_PARAMETERS], finite */
void ern_trainer_poses_step(struct ern_trainer_poses *poses, size_t frame, const double *dpose);

/* Writes the rows, in the model's form, and their regression to training->model. poses NULL: does nothing. */
ERN_NODISCARD ern_status ern_trainer_poses_download(const struct ern_trainer_poses *poses);
/* The reverse: reads the rows that `model` has. */
ERN_NODISCARD ern_status ern_trainer_poses_take(struct ern_trainer_poses *poses, const ern_model *model);

#endif
