/* SPDX-License-Identifier: MIT
 * Sync: whether the lips of drawn frames agree with the sound, by the two networks of SyncNet (docs/evaluation.md). */
#ifndef ERN_CLI_SYNCNET_H
#define ERN_CLI_SYNCNET_H

#include "evaluation/evaluate.h"
#include "evaluation/sync_score.h"

enum { SYNC_DRAWN, SYNC_TRUE, SYNC_SIDES };

/* A square crop of a frame. */
struct sync_crop {
  double x, y, side; /* position of the top left corner, and side; pixels */
};

/* Over the frames of an evaluation. Initial state: zero except for the paths. */
struct syncnet {
  const char *video_path, *audio_path; /* FILE.onnx each; NULL: not wanted */
  ern_network *video, *audio;
  int side;                            /* of the video network's input */
  size_t width;                        /* of an embedding */
  size_t windows;                      /* of 5 frames */
  struct sync_crop *crops;             /* [frames] */
  float *input[SYNC_SIDES];            /* [3][5][side][side]: the last five frames */
  float *video_embeddings[SYNC_SIDES]; /* [windows][width] */
  float *audio_embeddings;             /* [windows][width] */
  struct sync_score score[SYNC_SIDES]; /* by syncnet_finish */
  bool known;
  bool drawn_alone; /* set before syncnet_open: the recorded frames do not belong to the sound, and get no score */
};

/* The crop of frame k of `count` frames with these landmarks: see docs/evaluation.md. */
struct sync_crop sync_crop_of(const ern_clip_frame *const *frames, size_t count, size_t k);

/* `sound`: the speech that drives the frames. Each returns 0, or EXIT_FAILURE after a message. Call syncnet_close in
 * either case. */
int syncnet_open(struct syncnet *sync, const struct evaluation *evaluation, const char *sound);
/* Adds frame k, as evaluate_frame has drawn it. */
int syncnet_add(struct syncnet *sync, const struct evaluation *evaluation, size_t k);
void syncnet_finish(struct syncnet *sync);
void syncnet_close(struct syncnet *sync);

#endif
