/* SPDX-License-Identifier: MIT
 * FID: the Frechet distance between a network's features of drawn and of recorded frames (docs/evaluation.md). */
#ifndef ERN_CLI_INCEPTION_H
#define ERN_CLI_INCEPTION_H

#include "evaluation/evaluate.h"

/* Features over the frames of an evaluation. Initial state: zero except for `path`. */
struct inception {
  const char *path; /* FILE.onnx; NULL: not wanted */
  ern_network *network;
  int width, height;     /* of its input */
  float *input;          /* [3][height][width] */
  double *drawn, *truth; /* [capacity][features] */
  size_t features, frames, capacity;
  double distance; /* by inception_finish */
};

/* Converts a picture (0..255, `channels` values a pixel, the first three RGB) to the network's input
 * [3][to_height][to_width], -1..1, by bilinear interpolation between pixel centres. */
void inception_input(float *input, int to_width, int to_height, const uint8_t *pixels, int channels, int width,
                     int height);

/* Each returns 0, or EXIT_FAILURE after a message. Call inception_close in either case. */
int inception_open(struct inception *inception, const struct evaluation *evaluation);
/* Adds frame k, as evaluate_frame has drawn it. */
int inception_add(struct inception *inception, const struct evaluation *evaluation, size_t k);
int inception_finish(struct inception *inception, struct session *session);
void inception_close(struct inception *inception);

#endif
