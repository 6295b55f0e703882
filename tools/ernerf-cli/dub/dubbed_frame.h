/* SPDX-License-Identifier: MIT
 * A recorded frame with the rendered lower face in it: what `dub`, `live --video` and `eval --compose dub` draw. */
#ifndef ERN_CLI_DUBBED_FRAME_H
#define ERN_CLI_DUBBED_FRAME_H

#include "ernerf/media.h"
#include "ernerf/render.h"
#include "session/frame_source.h"
#include "session/session.h"

struct dubbed_frame {
  ern_context *context;
  ern_clip *clip;
  int clip_size[2], size[2]; /* width, height of the clip, and of its whole square as it would be rendered, pixels */
  float scale[2];            /* rendered pixels a pixel of the recorded frame, across and down */
  uint8_t *head, *wanted;    /* [size[1]][size[0]][4]; [size[1]][size[0]] */
  float *opacity;            /* [size[1]][size[0]] */
  int box[4]; /* x, y, width, height of what the last frame drew on, pixels of its `recorded`; no width: nothing */
};

/* folder: of the clip, which needs landmarks and must outlive the frame. square: x, y, width, height of the clip's
 * square in the recorded frames. The head is rendered in its pixels, but in no more than it was trained on: more cost
 * time and show nothing new. Returns 0, or EXIT_FAILURE after a message. */
int dubbed_frame_open(struct dubbed_frame *dubbed, struct session *session, ern_clip *clip, const char *folder,
                      const int square[4]);
/* box: x, y, width, height of what may be drawn on in frame k, pixels of a recorded frame of width x height, in which
 * the clip's square is at `square`; no width: nothing. */
ern_status dubbed_frame_box(const struct dubbed_frame *dubbed, const struct frame_source *frame_source, size_t k,
                            int width, int height, const int square[4], int box[4]);
/* rgba, [height][width][4] of `recorded`: that picture with the head of frame k. square: where
 * the clip's square is in it. whole: the frame, whose camera sees the whole square in `size` pixels; background and
 * torso are not drawn. */
ern_status dubbed_frame_draw(struct dubbed_frame *dubbed, ern_renderer *renderer,
                             const struct frame_source *frame_source, size_t k, const ern_frame_input *whole,
                             const ern_image *recorded, const int square[4], uint8_t *rgba, ern_frame_times *times);
/* rgba, as drawn over the part `region` (x, y, width, height) of a frame, becomes its part in the box, grown to even
 * numbers. part: where that is in the frame; no width: nowhere. */
void dubbed_frame_cut(const struct dubbed_frame *dubbed, const int region[4], uint8_t *rgba, int part[4]);
void dubbed_frame_close(struct dubbed_frame *dubbed);

#endif
