/* SPDX-License-Identifier: MIT
 * A decoded frame of a video in its own pixel format. */
#ifndef ERN_MEDIA_VIDEO_FRAME_H
#define ERN_MEDIA_VIDEO_FRAME_H

#include <libavutil/frame.h>

#include "core/status.h"
#include "ernerf/media.h"

struct ern_video_frame {
  ern_context *context;
  AVFrame *frame; /* a reference: the pixels may be the decoder's too */
  bool is_plain;  /* yuv420p as ern_video_writer codes it, upright, of even sides */
};

/* *frame: another reference to the pixels. */
ERN_NODISCARD ern_status ern_video_frame_make(ern_context *context, const AVFrame *pixels, bool is_plain,
                                              ern_video_frame **frame);
/* from[4]: where the part (x, y, width, height; the whole frame, or even ones of a plain frame) begins in each plane.
 */
void ern_video_frame_planes(const AVFrame *frame, const int part[4], const uint8_t *from[4]);
/* ERN_E_UNSUPPORTED: the frame is not plain; ERN_E_SHAPE: the part is odd or not in it. */
ERN_NODISCARD ern_status ern_video_frame_check(ern_context *context, const char *path, const ern_video_frame *frame,
                                               const int part[4]);

#endif
