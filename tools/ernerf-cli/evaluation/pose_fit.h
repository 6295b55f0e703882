/* SPDX-License-Identifier: MIT
 * The pose at which a model draws a frame best: what an unseen frame's own pose costs. */
#ifndef ERN_CLI_POSE_FIT_H
#define ERN_CLI_POSE_FIT_H

#include "evaluation/evaluate.h"

struct pose_fit {
  float pose[16];    /* of the head, as ern_camera.pose */
  double turn, move; /* from the pose that the frame had: degrees, mm */
};

/* Fits the head's pose to frame k of the evaluation by Gauss-Newton: least squares of the colours with the Huber
 * weight, the derivatives by central differences of whole pictures. The model stays as it is. All pixels
 * count but those of the lower face, whose jaw would be taken for a turn of the head.
 * The start is the pose that evaluate_input gives; it is the result where nothing is better. The renderer keeps nothing
 * from frame to frame (no smooth_lips). Returns 0, or EXIT_FAILURE after a message. */
int pose_fit(struct evaluation *evaluation, ern_renderer *renderer, const ern_model *model, size_t k,
             struct pose_fit *fit);

#endif
