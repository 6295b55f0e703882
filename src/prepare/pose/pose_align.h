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
/* Adds a frame, grey[side][side], to the mean picture of the points, which ern_pose_align_mean makes the one that poses
 * are refined by. It weighs points by how little they change. */
ERN_NODISCARD ern_status ern_pose_align_add(struct ern_pose_align *align, const uint8_t *grey,
                                            const struct ern_head_pose *pose);
ERN_NODISCARD ern_status ern_pose_align_mean(struct ern_pose_align *align);
/* Moves the pose to where the frame shows the mean picture. It stays where no better one is found nearby. */
ERN_NODISCARD ern_status ern_pose_align_refine(struct ern_pose_align *align, const uint8_t *grey,
                                               struct ern_head_pose *pose);
void ern_pose_align_free(struct ern_pose_align **align); /* accepts NULL */

#ifdef __cplusplus
}
#endif
#endif
