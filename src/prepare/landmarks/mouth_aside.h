/* SPDX-License-Identifier: MIT
 * Whether the template's landmarks lie beside the mouth. Internal. */
#ifndef ERN_PREPARE_MOUTH_ASIDE_H
#define ERN_PREPARE_MOUTH_ASIDE_H

#include "prepare/prepare_job.h"

/* Looks for the mouth in every frame and makes the step doubtful where it is drawn sideways in too many: the template
 * opens along one line. (x, y): the mouth at rest, metres in the head's frame. Progress begins at `done` of `total`. */
ERN_NODISCARD ern_status ern_landmarks_check_aside(struct ern_prepare_job *job, const struct ern_head_pose *poses,
                                                   double x, double y, size_t done, size_t total);

#endif
