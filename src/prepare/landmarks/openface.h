/* SPDX-License-Identifier: MIT
 * Reads the table that OpenFace (Baltrusaitis et al., "OpenFace 2.0", FG 2018) wrote for the clip's video: a row for
 * each frame of the video. */
#ifndef ERN_PREPARE_OPENFACE_H
#define ERN_PREPARE_OPENFACE_H

#include "io/landmarks.h"
#include "prepare/prepare_job.h"

/* points[job->frames], pixels of the clip: from columns x_0..x_67 and y_0..y_67, pixels of the displayed video, of the
 * row nearest in time (column timestamp). A frame whose row has success 0 holds the last points with success 1; *held
 * counts such frames. ERN_E_FORMAT where a point lies further than ERN_PREPARE_REACH from the clip. */
ERN_NODISCARD ern_status ern_openface_landmarks(struct ern_prepare_job *job, const char *path,
                                                float (*points)[ERN_LANDMARKS][2], size_t *held);
/* values[job->frames]: column AU45_r, by the column timestamp, seconds of the video. A table without that column has a
 * row for each frame of the clip, in order. Where there is a column success, frames without success hold the last
 * value, as above. ERN_E_FORMAT where a value is not in 0..5. */
ERN_NODISCARD ern_status ern_openface_blinks(struct ern_prepare_job *job, const char *path, float *values,
                                             size_t *held);
/* Adds a reason to the verdict where many frames are held. */
void ern_openface_check(struct ern_prepare_job *job, const char *path, size_t held);

#endif
