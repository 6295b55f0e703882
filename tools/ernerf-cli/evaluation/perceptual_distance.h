/* SPDX-License-Identifier: MIT
 * LPIPS of the pictures that `eval` and `compare` hold against the frames of a clip. */
#ifndef ERN_CLI_PERCEPTUAL_DISTANCE_H
#define ERN_CLI_PERCEPTUAL_DISTANCE_H

#include "evaluation/evaluate.h"
#include "session/lpips_weights.h"

struct perceptual_distance {
  struct lpips_weights weights; /* from the command line */
  float *pictures;              /* [2][3][height][width] */
  size_t frames;
  double sum; /* over them */
};

/* Harmless without weights, as are the others. Returns 0, or EXIT_FAILURE after a message, as the next one does. */
int perceptual_distance_open(struct perceptual_distance *perceptual, const struct evaluation *evaluation);
/* Of the picture that was drawn last, of frame k. The weights are open. */
int perceptual_distance_of(struct perceptual_distance *perceptual, const struct evaluation *evaluation, size_t k,
                           double *distance);
/* The same; counts the frame, and adds "lpips" to the frame's row. */
int perceptual_distance_add(struct perceptual_distance *perceptual, const struct evaluation *evaluation, size_t k,
                            json_t *row);
void perceptual_distance_close(struct perceptual_distance *perceptual);

#endif
