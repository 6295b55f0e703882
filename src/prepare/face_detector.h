/* SPDX-License-Identifier: MIT
 * Detects frontal faces and their eyes by OpenCV's cascades (Viola and Jones, "Rapid Object Detection using a Boosted
 * Cascade of Simple Features", CVPR 2001), or by a network that the user supplies. */
#ifndef ERN_PREPARE_FACE_DETECTOR_H
#define ERN_PREPARE_FACE_DETECTOR_H

#include "prepare/prepare_job.h"

#ifdef __cplusplus
extern "C" {
#endif

struct ern_face_detector;

/* `network`: an ONNX file (face_network_opencv.h). NULL: the cascades of Debian's opencv-data, or of the folder that
 * ERNERF_CASCADES names. */
ERN_NODISCARD ern_status ern_face_detector_make(ern_context *context, const char *network,
                                                struct ern_face_detector **detector);
/* faces[*count] of a picture of 3 channels, the largest first, at most `capacity`, in pixels; `frame` is not set.
 * aspect: pixel aspect ratio, width over height. */
ERN_NODISCARD ern_status ern_face_detector_find(struct ern_face_detector *detector, const ern_image *picture,
                                                double aspect, struct ern_found_face *faces, size_t capacity,
                                                size_t *count);
/* face->sharpness = variance of what means over 4 x 4 pixels lose of a face, over that of what means over 8 x 8 lose;
 * the face is 200 pixels wide at most. Sharp faces have 0.18 to 0.42; 0: the face is too small to tell. */
ERN_NODISCARD ern_status ern_face_sharpness(ern_context *context, const ern_image *picture,
                                            struct ern_found_face *face);
/* Scales region = x, y, width, height (pixels, may be fractions) of a picture to a square of `side` pixels by area
 * averaging. */
ERN_NODISCARD ern_status ern_picture_crop(ern_context *context, const ern_image *picture, const double region[4],
                                          int side, ern_image *crop);
void ern_face_detector_free(struct ern_face_detector **detector); /* accepts NULL */

#ifdef __cplusplus
}
#endif
#endif
