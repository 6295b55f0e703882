/* SPDX-License-Identifier: MIT
 * Ridge regression of the corrections of the training poses on the poses, for frames that were not trained on
 * (docs/poses.md), and likewise of the motion of the body (docs/maths.md, Torso). */
#ifndef ERN_MODEL_POSE_REGRESSION_H
#define ERN_MODEL_POSE_REGRESSION_H

#include <stddef.h>

#include "ernerf/base.h"

/* ERN_POSE_CORRECTION: three angles in degrees and a move in scene units. */
enum { ERN_POSE_NUMBERS = 6, ERN_POSE_CORRECTION = 6, ERN_POSE_MOST_VALUES = ERN_MOTION_VALUES };

/* A fit that predicts `values` numbers, 6..ERN_POSE_MOST_VALUES, is [ERN_POSE_REGRESSION_ROWS][values] floats: a row of
 * constants; a row of slopes by each number of the pose; and two rows with the least and the most of each number of the
 * trained poses, zeros behind. All zeros: it predicts zeros. */
enum { ERN_POSE_REGRESSION_ROWS = 3 + ERN_POSE_NUMBERS };

/* Fits it to n trained frames. pose: [n][16], finite; value: [n][values]. ridge: weight of the squared slopes of a
 * standardised number, relative to the mean squared error. */
void ern_pose_regression_fit(float *fit, size_t values, const float *pose, const float *value, size_t n, double ridge);
/* value: [values]. Clamps the numbers of the pose to the range of the trained poses. */
void ern_pose_regression_predict(const float *fit, size_t values, const float pose[16], double *value);

#endif
