/* SPDX-License-Identifier: MIT */
#include "prepare/pose/pose_align.h"

#include <math.h>
#include <string.h>

#include "prepare/pose/bundle.h"
#include "prepare/stabilized_crop.h"

enum { MEAN_OF = 60 }; /* frames of the mean picture */

ern_status ern_pose_align_smooth(ern_context *context, const struct ern_head_pose *tracked, size_t frames,
                                 struct ern_head_pose *poses) {
  enum { REACH = 6 };           /* frames */
  const double deviation = 2.0; /* frames */
  double(*moved)[6] = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(context, frames, &moved));
  for (size_t i = 0; i < frames; i++) {
    struct ern_bundle_pose before, after;
    ern_bundle_pose_from(&tracked[i], &before);
    ern_bundle_pose_from(&poses[i], &after);
    for (int c = 0; c < 6; c++) moved[i][c] = after.values[c] - before.values[c];
  }
  for (size_t i = 0; i < frames; i++) {
    struct ern_bundle_pose pose;
    double sum[6] = {0}, weights = 0;
    for (size_t k = i < REACH ? 0 : i - REACH; k < frames && k <= i + REACH; k++) {
      const double away = ((double)k - (double)i) / deviation, weight = exp(-0.5 * away * away);
      for (int c = 0; c < 6; c++) sum[c] += weight * moved[k][c];
      weights += weight;
    }
    ern_bundle_pose_from(&tracked[i], &pose);
    for (int c = 0; c < 6; c++) pose.values[c] += sum[c] / weights;
    ern_bundle_pose_to(&pose, &poses[i]);
  }
fail:
  ern_release(context, moved);
  return status;
}

ern_status ern_pose_align_frames(struct ern_prepare_job *job, size_t reference, struct ern_head_pose *poses,
                                 size_t done, size_t total) {
  const size_t frames = job->frames, count = frames < MEAN_OF ? frames : MEAN_OF;
  struct ern_pose_align *align = NULL;
  struct ern_head_pose *tracked = NULL;
  uint8_t *grey = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(job->context, (size_t)job->side * (size_t)job->side, &grey));
  ERN_TRY(ERN_NEW(job->context, frames, &tracked));
  memcpy(tracked, poses, frames * sizeof *tracked);
  ERN_TRY(ern_pose_align_make(job->context, job->side, job->focal, 0.5 * job->side, &poses[reference], &align));
  for (size_t round = 0; round < ERN_POSE_ALIGN_ROUNDS; round++) {
    for (size_t i = 0; i < count; i++) {
      const size_t frame = count > 1 ? i * (frames - 1) / (count - 1) : 0;
      ERN_TRY(ern_frame_grey(job, frame, grey));
      ERN_TRY(ern_pose_align_add(align, grey, &poses[frame]));
    }
    ern_pose_align_mean(align);
    for (size_t i = 0; i < frames; i++) {
      ERN_TRY(ern_frame_grey(job, i, grey));
      ERN_TRY(ern_pose_align_refine(align, grey, &tracked[i], &poses[i]));
      ERN_TRY(ern_prepare_progress(job, done + round * frames + i + 1, total));
    }
  }
  ERN_TRY(ern_pose_align_smooth(job->context, tracked, frames, poses));
fail:
  ern_pose_align_free(&align);
  ern_release(job->context, tracked);
  ern_release(job->context, grey);
  return status;
}
