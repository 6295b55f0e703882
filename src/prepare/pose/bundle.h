/* SPDX-License-Identifier: MIT
 * Bundle adjustment of a rigid head (Triggs et al., "Bundle Adjustment - A Modern Synthesis", 2000): it finds the poses
 * and points that minimise the reprojection error. */
#ifndef ERN_PREPARE_BUNDLE_H
#define ERN_PREPARE_BUNDLE_H

#include "prepare/prepare_job.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A head pose as parameters of the bundle adjustment: rotation vector (radians; its norm is the angle) and translation,
 * metres, of X_camera = R X_head + t (prepare_job.h). */
struct ern_bundle_pose {
  double values[6];
};
void ern_bundle_pose_from(const struct ern_head_pose *pose, struct ern_bundle_pose *bundle);
void ern_bundle_pose_to(const struct ern_bundle_pose *bundle, struct ern_head_pose *pose);

struct ern_observation {
  uint32_t point;
  float share; /* 0..1: multiplies the point's weight */
  float at[2]; /* pixels */
};
/* The points that a frame shows. */
struct ern_observations {
  struct ern_observation *list; /* [count], by rising `point` */
  size_t count;
};

struct ern_bundle {
  ern_context *context;
  double focal, centre; /* pixels */
  size_t frames, points;
  const struct ern_observations *seen; /* [frames] */
  const float *weights;                /* [points], 0..1: how rigid a point is */
  const double (*prior)[3];            /* [points]: their positions on the generic head, metres */
  double (*shape)[3];                  /* [points], metres */
  struct ern_bundle_pose *poses;       /* [frames] */
};

/* Reprojection error: the distance in pixels between the observed point and its projection. */
double ern_bundle_residual(const struct ern_bundle *bundle, size_t frame, const struct ern_observation *seen);

/* Optimises the shape and the poses of frames chosen[count] (rising); the pose of frame `fixed` stays. */
ERN_NODISCARD ern_status ern_bundle_adjust(struct ern_bundle *bundle, const size_t *chosen, size_t count, size_t fixed);
/* Optimises one pose alone, from its present value. *seen: the number of points that constrain it. */
ERN_NODISCARD ern_status ern_bundle_one(struct ern_bundle *bundle, size_t frame, size_t *seen);
/* Optimises the poses of frames begin to end - 1 together, with a penalty on acceleration. The poses before `begin`
 * stay. */
ERN_NODISCARD ern_status ern_bundle_path(struct ern_bundle *bundle, size_t begin, size_t end);

#ifdef __cplusplus
}
#endif
#endif
