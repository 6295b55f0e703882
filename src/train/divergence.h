/* SPDX-License-Identifier: MIT
 * Detects a training that diverges although all its values are finite: dead units, saturated colours. Internal. */
#ifndef ERN_TRAIN_DIVERGENCE_H
#define ERN_TRAIN_DIVERGENCE_H

#include <stdbool.h>
#include <stdint.h>

/* Zeros to begin with. */
struct ern_divergence {
  uint64_t steps;    /* counted so far */
  double mean, best; /* dB: mean over about the last 32 steps; its highest, at least the first step's minus 3 */
  bool reported;     /* the fall */
};

/* Adds a step's PSNR, in dB, over 64 rays or more. Returns true from the 64th step on where the mean is 6 dB or more
 * below its best; then not again until it is back within 3 dB. On data/tiny healthy trainings stay within 1 dB,
 * diverged ones fall by 9. */
bool ern_divergence_step(struct ern_divergence *divergence, double psnr);

#endif
