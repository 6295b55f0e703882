/* SPDX-License-Identifier: MIT
 * Frames of a clip as `ernerf dub` would make them: the rendered lower face in the recorded picture (ori_imgs/ID.jpg),
 * and how they differ from that picture. */
#ifndef ERN_CLI_DUBBED_H
#define ERN_CLI_DUBBED_H

#include <jansson.h>

#include "dub/dubbed_frame.h"
#include "dub/recorded_picture.h"
#include "ernerf/media.h"
#include "ernerf/render.h"
#include "session/frame_source.h"
#include "session/session.h"

struct dubbed {
  struct session *session;
  ern_clip *clip;
  int width, height;
  struct recorded_picture *recorded;
  struct dubbed_frame frame;
  float *grey[2];      /* [height][width], 0..1: the recorded picture and the dubbed one of the frame before */
  int64_t before_id;   /* of `grey`; -2: none */
  size_t frames, left; /* measured; left as recorded, which are not */
  double lower_face;   /* sum of PSNR in dB of the box round the lower face (ern_dub_box) */
  double squares;      /* sum of squared differences in the jaw band, of values 0..1 */
  size_t values;       /* number of their terms */
  double gradient[2];  /* sums of the gradient's length in the jaw band: recorded, dubbed */
  double change[2];    /* sums of the change of grey from the frame before in the jaw band: recorded, dubbed */
};

/* The caller's clip and its recorded pictures must outlive it. Returns 0, or EXIT_FAILURE after a message, as does the
 * next one. Call dubbed_close in either case. */
int dubbed_open(struct dubbed *dubbed, struct session *session, ern_clip *clip, struct recorded_picture *recorded);
/* Renders the head of `input`, whose camera sees the whole picture, and puts it into the recorded picture: rgba and rgb
 * (NULL: not wanted), [height][width]. */
int dubbed_draw(struct dubbed *dubbed, ern_renderer *renderer, const struct frame_source *frame_source, size_t k,
                const ern_frame_input *input, uint8_t *rgba, float *rgb, ern_frame_times *times);
/* Adds the frame that was drawn last and whose recorded picture was read last. rgb: as drawn. False without memory. */
bool dubbed_add(struct dubbed *dubbed, const struct source_frame *frame, const float *rgb);
void dubbed_print(const struct dubbed *dubbed);
json_t *dubbed_json(const struct dubbed *dubbed);
void dubbed_close(struct dubbed *dubbed);

#endif
