/* SPDX-License-Identifier: MIT
 * Landmarks that the user supplies (ern_prepare_options.landmarks): a folder of ID.lms, OpenFace's table, or a network.
 */
#ifndef ERN_PREPARE_LANDMARKS_SUPPLIED_H
#define ERN_PREPARE_LANDMARKS_SUPPLIED_H

#include "io/landmarks.h"
#include "prepare/prepare_job.h"

/* The template of landmarks_template.h at a head's pose, pixels of the clip; false where it is not before the camera.
 */
bool ern_landmarks_at_pose(const struct ern_prepare_job *job, const struct ern_head_pose *pose,
                           float points[ERN_LANDMARKS][2]);
/* points[count], pixels of the clip, of the frames frames[count], whose heads are about at poses[count]. `frames` NULL:
 * all of the clip. *held: frames that the source has no points for, and that hold those of another. A network's points
 * are smoothed in time where all frames are asked for, but not the mouth's. */
ERN_NODISCARD ern_status ern_landmarks_supplied(struct ern_prepare_job *job, const size_t *frames,
                                                const struct ern_head_pose *poses, size_t count,
                                                float (*points)[ERN_LANDMARKS][2], size_t *held);
/* Puts the eyes of the faces where the landmarks have them. */
ERN_NODISCARD ern_status ern_landmarks_supplied_eyes(struct ern_prepare_job *job, struct ern_found_face *faces,
                                                     size_t count);
/* Whether the landmarks are the user's own files, which are taken as they are. */
bool ern_landmarks_are_files(const struct ern_prepare_job *job);

#endif
