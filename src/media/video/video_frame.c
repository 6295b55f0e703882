/* SPDX-License-Identifier: MIT */
#include "media/video/video_frame.h"

#include "core/memory.h"

bool ern_video_frame_is_plain(const ern_video_frame *frame) { return frame != NULL && frame->is_plain; }

void ern_video_frame_planes(const AVFrame *frame, const int part[4], const uint8_t *from[4]) {
  const ptrdiff_t x = part[0], y = part[1];
  for (int i = 0; i < 4; i++) from[i] = frame->data[i];
  if (x == 0 && y == 0) return;
  from[0] += y * frame->linesize[0] + x;
  for (int i = 1; i < 3; i++) from[i] += y / 2 * frame->linesize[i] + x / 2;
}

ern_status ern_video_frame_check(ern_context *context, const char *path, const ern_video_frame *frame,
                                 const int part[4]) {
  const int width = frame->frame->width, height = frame->frame->height;
  if (!frame->is_plain)
    return ern_fail(context, ERN_E_UNSUPPORTED,
                    "%s: a part of a frame that is not plain (ern_video_frame_is_plain): its pixels are not yuv420p of "
                    "BT.709, or turned, or of an odd number",
                    path);
  bool fits = part[0] >= 0 && part[1] >= 0 && part[2] > 0 && part[3] > 0;
  fits = fits && part[0] <= width - part[2] && part[1] <= height - part[3];
  if (fits && (part[0] | part[1] | part[2] | part[3]) % 2 == 0) return ERN_OK;
  return ern_fail(context, ERN_E_SHAPE,
                  "%s: the part is at %d, %d with %d x %d pixels, expected even ones in the frame of %d x %d", path,
                  part[0], part[1], part[2], part[3], width, height);
}

ern_status ern_video_frame_clone(ern_context *context, const ern_video_frame *frame, ern_video_frame **clone) {
  if (clone != NULL) *clone = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, frame);
  ERN_NEED(context, clone);
  return ern_video_frame_make(context, frame->frame, frame->is_plain, clone);
}

ern_status ern_video_frame_make(ern_context *context, const AVFrame *pixels, bool is_plain, ern_video_frame **frame) {
  ern_video_frame *made = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(context, 1, &made));
  *made = (ern_video_frame){.context = context, .frame = av_frame_clone(pixels), .is_plain = is_plain};
  if (made->frame == NULL) ERN_TRY(ern_fail(context, ERN_E_NO_MEMORY, "no memory for a frame of a video"));
  *frame = made;
  return ERN_OK;
fail:
  ern_video_frame_free(&made);
  return status;
}

void ern_video_frame_free(ern_video_frame **frame) {
  if (frame == NULL || *frame == NULL) return;
  ern_video_frame *dying = *frame;
  *frame = NULL;
  av_frame_free(&dying->frame);
  ern_release(dying->context, dying);
}
