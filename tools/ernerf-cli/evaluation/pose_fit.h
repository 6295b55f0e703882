/* SPDX-License-Identifier: MIT
 * Finds the head pose at which a model matches a frame best. This shows how much error comes from the pose of an unseen
 * frame. */
#ifndef ERN_CLI_POSE_FIT_H
#define ERN_CLI_POSE_FIT_H

#include "evaluation/evaluate.h"

struct pose_fit {
  float pose[16];    /* of the head, as ern_camera.pose */
  double turn, move; /* rotation and translation from the frame's pose: degrees, mm */
};

/* Fits the head's pose to frame k of the evaluation by Gauss-Newton: least squares of the colours with the Huber
 * weight, the derivatives by central differences of whole pictures. The model does not change. The pixels of the lower
 * face are excluded, because motion of the jaw would be mistaken for a rotation of the head. The fit starts from the
 * pose of evaluate_input and returns it if no better one is found. The renderer must not keep state between frames (no
 * smooth_lips). Returns 0, or EXIT_FAILURE after a message. */
int pose_fit(struct evaluation *evaluation, ern_renderer *renderer, const ern_model *model, size_t k,
             struct pose_fit *fit);

#endif
