/* SPDX-License-Identifier: MIT
 * Refines head poses by the pictures themselves (direct image alignment; Lucas and Kanade, 1981). Tracked points lie on
 * the face; the pixels of hair and temples, far from its middle, tell scale and turn better. */
#ifndef ERN_PREPARE_POSE_ALIGN_H
#define ERN_PREPARE_POSE_ALIGN_H

#include "prepare/prepare_job.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { ERN_POSE_ALIGN_ROUNDS = 2 };

struct ern_pose_align;

/* The points of the head that the frame with this pose shows, without mouth, jaw and neck. centre: half of `side`,
 * pixels. The caller owns *align. */
ERN_NODISCARD ern_status ern_pose_align_make(ern_context *context, int side, double focal, double centre,
                                             const struct ern_head_pose *reference, struct ern_pose_align **align);
/* Adds a frame, grey[side][side], to the mean picture of the points. ern_pose_align_mean makes this picture the one
 * that poses are refined by. It weighs a point by how little it changes where the head is, and by how much the picture
 * changes where the reference has the point: what stays there is background. */
ERN_NODISCARD ern_status ern_pose_align_add(struct ern_pose_align *align, const uint8_t *grey,
                                            const struct ern_head_pose *pose);
void ern_pose_align_mean(struct ern_pose_align *align);
/* Moves the pose to where the frame shows the mean picture, and the face is where the tracks have it. It stays where no
 * better one is found nearby. */
ERN_NODISCARD ern_status ern_pose_align_refine(struct ern_pose_align *align, const uint8_t *grey,
                                               const struct ern_head_pose *tracked, struct ern_head_pose *pose);
/* Smooths in time, by a Gaussian, the corrections: poses[frames] minus tracked[frames], rotation vector and
 * translation. Errors of tracks change slowly; a single picture turns the head by noise, which would be seen as
 * trembling. */
ERN_NODISCARD ern_status ern_pose_align_smooth(ern_context *context, const struct ern_head_pose *tracked, size_t frames,
                                               struct ern_head_pose *poses);
/* All of it: poses[job->frames], by the mean picture of some of the frames, in ERN_POSE_ALIGN_ROUNDS rounds, smoothed.
 * reference: the frame that shows the points. Progress goes from `done` on by a step for each frame of a round, of
 * `total`. */
ERN_NODISCARD ern_status ern_pose_align_frames(struct ern_prepare_job *job, size_t reference,
                                               struct ern_head_pose *poses, size_t done, size_t total);
void ern_pose_align_free(struct ern_pose_align **align); /* accepts NULL */

#ifdef __cplusplus
}
#endif
#endif
