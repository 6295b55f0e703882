/* SPDX-License-Identifier: MIT
 * The report that the user reviews before training: CLIP/report.html with sample frames, curves and verdicts, and
 * CLIP/overlay.mp4 with pose and landmarks drawn on every frame. */
#ifndef ERN_PREPARE_REPORT_H
#define ERN_PREPARE_REPORT_H

#include "prepare/prepare_job.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Writes report.html with the steps that have run; it leaves out the others. */
ERN_NODISCARD ern_status ern_report_write(struct ern_prepare_job *job, const ern_prepare_result *result);
/* Writes overlay.mp4; needs poses and landmarks. */
ERN_NODISCARD ern_status ern_report_overlay(struct ern_prepare_job *job);

/* Draws the head's axes (x red, y green, z blue, 60 mm) and the landmarks, [68][2] or NULL, into an RGB picture. */
ERN_NODISCARD ern_status ern_report_draw(const struct ern_prepare_job *job, ern_image *picture,
                                         const struct ern_head_pose *pose, const float (*landmarks)[2]);

#ifdef __cplusplus
}
#endif
#endif
