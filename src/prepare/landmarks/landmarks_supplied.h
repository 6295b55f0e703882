/* SPDX-License-Identifier: MIT
 * Landmarks that the user supplies (ern_prepare_options.landmarks): a folder of ID.lms, OpenFace's table, or a network.
 */
#ifndef ERN_PREPARE_LANDMARKS_SUPPLIED_H
#define ERN_PREPARE_LANDMARKS_SUPPLIED_H

#include "io/landmarks.h"
#include "prepare/prepare_job.h"

/* Projects the template of landmarks_template.h with a head's pose, pixels of the clip; false where it is behind the
 * camera. */
bool ern_landmarks_at_pose(const struct ern_prepare_job *job, const struct ern_head_pose *pose,
                           float points[ERN_LANDMARKS][2]);
/* points[count], pixels of the clip, of the frames frames[count] (NULL: all of the clip). poses[count] are the
 * approximate poses of the heads. *held: the number of frames without points in the source, which hold another frame's.
 * Where all frames are asked for, a network's points are smoothed in time, except the mouth's. */
ERN_NODISCARD ern_status ern_landmarks_supplied(struct ern_prepare_job *job, const size_t *frames,
                                                const struct ern_head_pose *poses, size_t count,
                                                float (*points)[ERN_LANDMARKS][2], size_t *held);
/* Replaces the eyes of the faces by those of the landmarks. */
ERN_NODISCARD ern_status ern_landmarks_supplied_eyes(struct ern_prepare_job *job, struct ern_found_face *faces,
                                                     size_t count);
/* Whether the landmarks are the user's own .lms files, which are used unchanged. */
bool ern_landmarks_are_files(const struct ern_prepare_job *job);

#endif
