/* SPDX-License-Identifier: MIT
 * Compares the motion of the rendered mouth with that of the recorded one, over the frames of a clip. */
#ifndef ERN_CLI_MOUTH_MOTION_H
#define ERN_CLI_MOUTH_MOTION_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "ernerf/media.h"

/* Grey crops around the mouth, 48 x 32 pixels. In units of the distance between the eyes: 1.24 wide, from 0.34 above
 * the mean of landmarks 48..67 to 0.465 below. */
enum { MOUTH_WIDTH = 48, MOUTH_HEIGHT = 32, MOUTH_PIXELS = MOUTH_WIDTH * MOUTH_HEIGHT };

struct mouth_motion {
  float *truth, *rendered; /* [capacity][MOUTH_PIXELS], 0..1 */
  size_t count, capacity;
};

struct mouth_figures {
  bool known;       /* at least three frames with landmarks, in which the recorded mouth moves */
  double explained; /* 1 - sum |(p - mean p) - (q - mean q)|^2 / sum |p - mean p|^2, p true, q rendered; 1 at most */
  /* of the projections on the first principal component of the true crops: */
  double correlation; /* -1..1; NaN where the rendered mouth does not move */
  double amplitude;   /* standard deviation, rendered over true */
};

/* Adds a frame; skips it if it has no landmarks or its crop leaves the picture. truth, rendered: grey, [height][width].
 * False without memory. */
bool mouth_motion_add(struct mouth_motion *motion, const ern_clip_frame *frame, int width, int height,
                      const float *truth, const float *rendered);
struct mouth_figures mouth_motion_figures(const struct mouth_motion *motion);
void mouth_motion_free(struct mouth_motion *motion);

#endif
