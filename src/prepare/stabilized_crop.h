/* SPDX-License-Identifier: MIT
 * A part of the face as if the head kept still: a grid on the generic face, looked up where the pose puts it. */
#ifndef ERN_PREPARE_STILL_CROP_H
#define ERN_PREPARE_STILL_CROP_H

#include "prepare/prepare_job.h"

struct ern_stabilized_crop {
  double x, y;       /* the middle, metres in the head's frame */
  double step;       /* metres between pixels */
  int columns, rows; /* pixels; row 0 is the highest */
};

/* The picture of a frame in grey, [side][side], 0..255; memory of the caller's. */
ERN_NODISCARD ern_status ern_frame_grey(const struct ern_prepare_job *job, size_t frame, uint8_t *grey);
/* values[rows][columns] of the grey picture [side][side], bilinear. */
void ern_stabilized_crop_take(const struct ern_stabilized_crop *crop, const struct ern_head_pose *pose,
                              const struct ern_prepare_job *job, const uint8_t *grey, float *values);

/* The value at share 0..1 of the sorted values, which are sorted in place; NaN of none. */
float ern_quantile(float *values, size_t count, double share);

#endif
