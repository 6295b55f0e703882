/* SPDX-License-Identifier: MIT
 * A crop of the face that the pose stabilises: a grid on the generic face, sampled where the pose projects it. */
#ifndef ERN_PREPARE_STABILIZED_CROP_H
#define ERN_PREPARE_STABILIZED_CROP_H

#include "prepare/prepare_job.h"

struct ern_stabilized_crop {
  double x, y;       /* the middle, metres in the head's frame */
  double step;       /* metres between pixels */
  int columns, rows; /* pixels; row 0 is the highest */
};

/* Reads a frame into grey[side][side], 0..255; memory of the caller. */
ERN_NODISCARD ern_status ern_frame_grey(const struct ern_prepare_job *job, size_t frame, uint8_t *grey);
/* values[rows][columns] of the grey picture [side][side], bilinear. */
void ern_stabilized_crop_take(const struct ern_stabilized_crop *crop, const struct ern_head_pose *pose,
                              const struct ern_prepare_job *job, const uint8_t *grey, float *values);

/* The quantile at `share`, 0..1. Sorts the values in place. NaN where count is 0. */
float ern_quantile(float *values, size_t count, double share);

#endif
