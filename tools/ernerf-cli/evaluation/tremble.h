/* SPDX-License-Identifier: MIT
 * Measures temporal jitter of the rendered head: how unevenly it moves from frame to frame, compared with the recorded
 * one. */
#ifndef ERN_CLI_TREMBLE_H
#define ERN_CLI_TREMBLE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "ernerf/media.h"

enum { TREMBLE_TRUE, TREMBLE_RENDERED, TREMBLE_KINDS };

/* State over consecutive frames, 1/25 s apart. Zeroed: no frame yet. */
struct tremble {
  uint8_t *last[TREMBLE_KINDS]; /* [pixels]: the previous frame, grey */
  float *flow;                  /* [pixels][2] */
  size_t pixels;
  int64_t time;                    /* of the previous frame, in frames */
  size_t frames;                   /* length of the run of consecutive frames, up to the previous one */
  double motion[TREMBLE_KINDS][2]; /* mean flow of the face up to the previous frame, pixels */
  double uneven[TREMBLE_KINDS];    /* sums of squared second differences of the face's position */
  size_t count;                    /* number of these */
};

/* Adds a frame; a frame without landmarks ends the run of consecutive frames. truth, rendered: grey [height][width],
 * 0..1. The face is the box of its landmarks without mouth and eyes. Returns errors of the optical flow. */
ern_status tremble_add(struct tremble *tremble, ern_context *context, const ern_clip_frame *frame, int width,
                       int height, const float *truth, const float *rendered);
/* Root mean square of the second differences, rendered over true; NaN without three consecutive frames. */
double tremble_ratio(const struct tremble *tremble);
void tremble_free(struct tremble *tremble);

#endif
