/* SPDX-License-Identifier: MIT
 * LPIPS between the pictures of `eval` or `compare` and the recorded frames of a clip. */
#ifndef ERN_CLI_PERCEPTUAL_DISTANCE_H
#define ERN_CLI_PERCEPTUAL_DISTANCE_H

#include "evaluation/evaluate.h"
#include "session/lpips_weights.h"

struct perceptual_distance {
  struct lpips_weights weights; /* from the command line */
  float *pictures;              /* [2][3][height][width] */
  size_t frames;
  double sum; /* of the distances of `frames` frames */
};

/* Does nothing without weights, as do the others. Returns 0, or EXIT_FAILURE after a message, as the next one does. */
int perceptual_distance_open(struct perceptual_distance *perceptual, const struct evaluation *evaluation);
/* Computes the distance of the picture drawn last, of frame k. The weights must be open. */
int perceptual_distance_of(struct perceptual_distance *perceptual, const struct evaluation *evaluation, size_t k,
                           double *distance);
/* The same; also adds the frame to the sum, and "lpips" to the frame's row. */
int perceptual_distance_add(struct perceptual_distance *perceptual, const struct evaluation *evaluation, size_t k,
                            json_t *row);
void perceptual_distance_close(struct perceptual_distance *perceptual);

#endif
