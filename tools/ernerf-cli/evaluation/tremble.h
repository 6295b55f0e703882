/* SPDX-License-Identifier: MIT
 * Whether the rendered head trembles: how unevenly it moves from frame to frame, against the true one. */
#ifndef ERN_CLI_TREMBLE_H
#define ERN_CLI_TREMBLE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "ernerf/media.h"

enum { TREMBLE_TRUE, TREMBLE_RENDERED, TREMBLE_KINDS };

/* Of frames that follow each other, 1/25 s apart. Zeroed: none yet. */
struct tremble {
  uint8_t *last[TREMBLE_KINDS]; /* [pixels]: the frame before, grey */
  float *flow;                  /* [pixels][2] */
  size_t pixels;
  int64_t time;                    /* of the frame before, in frames */
  size_t frames;                   /* that follow each other, up to that one */
  double motion[TREMBLE_KINDS][2]; /* mean flow of the face up to that one, pixels */
  double uneven[TREMBLE_KINDS];    /* sums of squared second differences of the face's place */
  size_t count;                    /* of these */
};

/* Adds a frame; one without landmarks ends what follows each other. truth, rendered: grey [height][width], 0..1. The
 * face is the box of its landmarks without mouth and eyes. An error is that of the optical flow. */
ern_status tremble_add(struct tremble *tremble, ern_context *context, const ern_clip_frame *frame, int width,
                       int height, const float *truth, const float *rendered);
/* Root mean square of the second differences, rendered over true; NaN without three frames that follow each other. */
double tremble_ratio(const struct tremble *tremble);
void tremble_free(struct tremble *tremble);

#endif
