/* SPDX-License-Identifier: MIT
 * What a person looks at before a training: CLIP/report.html with pictures of frames across the video, curves and
 * verdicts, and CLIP/overlay.mp4 with pose and landmarks drawn on every frame. */
#ifndef ERN_PREPARE_REPORT_H
#define ERN_PREPARE_REPORT_H

#include "prepare/prepare_job.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Writes the page of what there is; steps that were not reached are left out. */
ERN_NODISCARD ern_status ern_report_write(struct ern_prepare_job *job, const ern_prepare_result *result);
/* overlay.mp4; needs poses and landmarks. */
ERN_NODISCARD ern_status ern_report_overlay(struct ern_prepare_job *job);

/* Draws the head's axes (x red, y green, z blue, 60 mm) and the landmarks, [68][2] or NULL, into an RGB picture. */
ERN_NODISCARD ern_status ern_report_draw(const struct ern_prepare_job *job, ern_image *picture,
                                         const struct ern_head_pose *pose, const float (*landmarks)[2]);

#ifdef __cplusplus
}
#endif
#endif
