/* SPDX-License-Identifier: MIT
 * A model's pictures held against the frames of a clip: what `eval` and `ablate` share. */
#ifndef ERN_CLI_JUDGE_H
#define ERN_CLI_JUDGE_H

#include "backdrop.h"
#include "ernerf/media.h"
#include "ernerf/model.h"
#include "ernerf/render.h"
#include "session.h"
#include "shots.h"

/* Frames of a clip and room for a picture of one. */
struct judge {
  struct session *session;
  ern_clip *clip; /* the caller's */
  ern_clip_info info;
  const ern_features *features;
  float scale; /* of the camera's place */
  ern_audio_pad pad;
  struct shots shots;
  struct backdrop backdrop;
  float *windows, refined[16];
  float *rgb;       /* [height][width][3], as drawn last; so is the next one */
  uint8_t *rgba;    /* [height][width][4] */
  bool bytes_alone; /* judge_draw leaves rgb as it is, for its time to be that of 8-bit pixels alone; false */
};

/* Of one frame. */
struct judged {
  double psnr, ssim, head, mouth; /* head, mouth: PSNR in dB of the regions, where has_head, has_mouth */
  bool has_head, has_mouth;
  double ms; /* drawing to 8-bit pixels: without reading and judging */
  ern_frame_times times;
};

/* Returns 0, or EXIT_FAILURE after a message, as the next three do. judge_close in either case. */
int judge_open(struct judge *judge, struct session *session, ern_clip *clip, enum shot_split split, float scale,
               ern_audio_pad pad);
void judge_close(struct judge *judge);

/* What the renderer is given for shot k. What it points to lasts until the next call. A head is drawn over the frame's
 * torso picture, head and torso over the background. */
int judge_input(struct judge *judge, const ern_model *model, size_t k, ern_frame_input *input);
/* Draws shot k; of `judged` ms and times. */
int judge_draw(struct judge *judge, ern_renderer *renderer, const ern_model *model, size_t k, struct judged *judged);
/* The same, then all figures. */
int judge_frame(struct judge *judge, ern_renderer *renderer, const ern_model *model, size_t k, struct judged *judged);

#endif
