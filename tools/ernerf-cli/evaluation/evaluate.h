/* SPDX-License-Identifier: MIT
 * Compares pictures, usually rendered by a model, with the recorded frames of a clip. Shared by `eval`, `compare` and
 * `ablate`. */
#ifndef ERN_CLI_EVALUATE_H
#define ERN_CLI_EVALUATE_H

#include "ernerf/media.h"
#include "ernerf/model.h"
#include "ernerf/render.h"
#include "evaluation/dubbed.h"
#include "evaluation/measures.h"
#include "session/background.h"
#include "session/frame_source.h"
#include "session/portrait.h"
#include "session/session.h"

/* Frames of a clip, and buffers for one rendered picture. */
struct evaluation {
  struct session *session;
  ern_clip *clip; /* the caller's */
  ern_clip_info info;
  const ern_features *features;
  float scale; /* of the camera's position */
  ern_audio_pad pad;
  struct frame_source frame_source;
  struct background background;
  bool recorded_torso;               /* a torso of the model is not drawn, but the frame's torso picture; false */
  struct dubbed *dubbed;             /* frames are dubbed ones; NULL: not so. The caller's */
  struct recorded_picture *recorded; /* what frames are compared with; NULL: the clip's gt_imgs. The caller's */
  float *windows, refined[16];
  const float *head_pose;    /* [16] used by evaluate_input in place of the frame's; NULL, the default: the frame's */
  float *rgb;                /* [height][width][3], drawn last; rgba likewise */
  uint8_t *rgba;             /* [height][width][4] */
  struct measures *measures; /* evaluate_picture adds its frame to them; NULL: not wanted */
  bool bytes_alone;          /* evaluate_draw does not fill rgb, so that it times 8-bit pixels alone; false */
};

/* Figures of one frame. */
struct evaluated {
  double psnr, ssim, head, mouth; /* head, mouth: PSNR in dB of the regions, where has_head, has_mouth */
  bool has_head, has_mouth;
  double ms; /* drawing to 8-bit pixels: without reading and evaluation */
  ern_frame_times times;
};

/* Returns 0, or EXIT_FAILURE after a message, as do the functions below. Call evaluate_close in either case. */
int evaluate_open(struct evaluation *evaluation, struct session *session, ern_clip *clip, enum frame_source_split split,
                  float scale, ern_audio_pad pad);
/* The same for a portrait, which it also opens: selects the frames by --split and --frames. Call portrait_close in
 * either case. measures: accumulates the evaluated frames. Returns 0, or an exit status after a message. */
int evaluate_open_portrait(struct evaluation *evaluation, struct portrait *portrait, struct session *session,
                           const struct args *args, struct measures *measures);
void evaluate_close(struct evaluation *evaluation);

/* Fills the renderer's input for frame k. Its pointers are valid until the next call. A head is drawn over the frame's
 * torso picture, head and torso over the background. */
int evaluate_input(struct evaluation *evaluation, const ern_model *model, size_t k, ern_frame_input *input);
/* What a frame is compared with: its recorded picture, or the clip's. Valid until the next call. */
int evaluate_truth(const struct evaluation *evaluation, const struct source_frame *frame, ern_image *truth);
/* Draws frame k; sets ms and times of `evaluated`. */
int evaluate_draw(struct evaluation *evaluation, ern_renderer *renderer, const ern_model *model, size_t k,
                  struct evaluated *evaluated);
/* Computes the figures of frame k from the picture in `rgb`, from any source; leaves ms and times unchanged. */
int evaluate_picture(struct evaluation *evaluation, size_t k, struct evaluated *evaluated);
/* Draws and evaluates frame k. */
int evaluate_frame(struct evaluation *evaluation, ern_renderer *renderer, const ern_model *model, size_t k,
                   struct evaluated *evaluated);

#endif
