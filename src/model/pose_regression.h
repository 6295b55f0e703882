/* SPDX-License-Identifier: MIT
 * Ridge regression of the corrections of the training poses on the poses, for frames that were not trained on
 * (docs/poses.md), and likewise of the motion of the body (docs/maths.md, Torso). */
#ifndef ERN_MODEL_POSE_REGRESSION_H
#define ERN_MODEL_POSE_REGRESSION_H

#include <stddef.h>

enum { ERN_POSE_NUMBERS = 6 };

/* All zeros: it predicts no correction. A correction is three angles in degrees and a move in scene units. */
struct ern_pose_regression {
  float constant[ERN_POSE_NUMBERS];
  float slope[ERN_POSE_NUMBERS][ERN_POSE_NUMBERS];       /* by number of the pose, then by number of the correction */
  float least[ERN_POSE_NUMBERS], most[ERN_POSE_NUMBERS]; /* of the numbers of the trained poses */
};
enum { ERN_POSE_REGRESSION_ROWS = 9 }; /* the struct as [rows][ERN_POSE_NUMBERS] floats */

/* Fits it to n trained frames. pose: [n][16], finite; correction: [n][ERN_POSE_NUMBERS]. ridge: weight of the squared
 * slopes of a standardised number, relative to the mean squared error. */
void ern_pose_regression_fit(struct ern_pose_regression *fit, const float *pose, const float *correction, size_t n,
                             double ridge);
/* Clamps the numbers of the pose to the range of the trained poses. */
void ern_pose_regression_predict(const struct ern_pose_regression *fit, const float pose[16],
                                 double correction[ERN_POSE_NUMBERS]);

#endif
