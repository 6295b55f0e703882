/* SPDX-License-Identifier: MIT
 * LPIPS of the pictures that `eval` draws. */
#ifndef ERN_CLI_PERCEPTUAL_DISTANCE_H
#define ERN_CLI_PERCEPTUAL_DISTANCE_H

#include "evaluation/evaluate.h"
#include "session/lpips_weights.h"

struct perceptual_distance {
  struct lpips_weights weights; /* from the command line */
  float *pictures;              /* [2][3][height][width] */
  double sum;                   /* over the frames */
};

/* Harmless without weights, as are the others. Returns 0, or EXIT_FAILURE after a message, as the next one does. */
int perceptual_distance_open(struct perceptual_distance *perceptual, const struct evaluation *evaluation);
/* Of the picture that was drawn last, of frame k; adds "lpips" to the frame's row. */
int perceptual_distance_add(struct perceptual_distance *perceptual, const struct evaluation *evaluation, size_t k,
                            json_t *row);
void perceptual_distance_close(struct perceptual_distance *perceptual);

void perceptual_distance_print(const struct perceptual_distance *perceptual, size_t frames);
/* "lpips" of the report: its network, the mean over the frames, or null and what it needs. */
json_t *perceptual_distance_json(const struct perceptual_distance *perceptual, size_t frames);

#endif
