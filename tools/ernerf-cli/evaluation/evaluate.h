/* SPDX-License-Identifier: MIT
 * Pictures, most often a model's, held against the frames of a clip: what `eval`, `compare` and `ablate` share. */
#ifndef ERN_CLI_EVALUATE_H
#define ERN_CLI_EVALUATE_H

#include "ernerf/media.h"
#include "ernerf/model.h"
#include "ernerf/render.h"
#include "evaluation/measures.h"
#include "session/background.h"
#include "session/frame_source.h"
#include "session/portrait.h"
#include "session/session.h"

/* Frames of a clip and room for a picture of one. */
struct evaluation {
  struct session *session;
  ern_clip *clip; /* the caller's */
  ern_clip_info info;
  const ern_features *features;
  float scale; /* of the camera's place */
  ern_audio_pad pad;
  struct frame_source frame_source;
  struct background background;
  float *windows, refined[16];
  const float *head_pose;    /* [16] for evaluate_input in the place of the frame's own; NULL, the default: that */
  float *rgb;                /* [height][width][3], as drawn last; so is the next one */
  uint8_t *rgba;             /* [height][width][4] */
  struct measures *measures; /* evaluate_picture adds its frame; NULL: not wanted */
  bool bytes_alone; /* evaluate_draw leaves rgb as it is, for its time to be that of 8-bit pixels alone; false */
};

/* Of one frame. */
struct evaluated {
  double psnr, ssim, head, mouth; /* head, mouth: PSNR in dB of the regions, where has_head, has_mouth */
  bool has_head, has_mouth;
  double ms; /* drawing to 8-bit pixels: without reading and evaluation */
  ern_frame_times times;
};

/* Returns 0, or EXIT_FAILURE after a message, as those below do. evaluate_close in either case. */
int evaluate_open(struct evaluation *evaluation, struct session *session, ern_clip *clip, enum frame_source_split split,
                  float scale, ern_audio_pad pad);
/* The same for a portrait, which it opens: the frames of its --split that --frames asks for. portrait_close in either
 * case. measures: takes the frames that are evaluated. Returns an exit status after a message. */
int evaluate_open_portrait(struct evaluation *evaluation, struct portrait *portrait, struct session *session,
                           const struct args *args, struct measures *measures);
void evaluate_close(struct evaluation *evaluation);

/* What the renderer is given for frame k. What it points to lasts until the next call. A head is drawn over the frame's
 * torso picture, head and torso over the background. */
int evaluate_input(struct evaluation *evaluation, const ern_model *model, size_t k, ern_frame_input *input);
/* Draws frame k; of `evaluated` ms and times. */
int evaluate_draw(struct evaluation *evaluation, ern_renderer *renderer, const ern_model *model, size_t k,
                  struct evaluated *evaluated);
/* The figures of frame k, whose picture is in `rgb`, wherever it comes from; ms and times stay. */
int evaluate_picture(struct evaluation *evaluation, size_t k, struct evaluated *evaluated);
/* Draws and evaluates frame k. */
int evaluate_frame(struct evaluation *evaluation, ern_renderer *renderer, const ern_model *model, size_t k,
                   struct evaluated *evaluated);

#endif
