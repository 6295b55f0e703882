/* SPDX-License-Identifier: MIT
 * Whether a training goes wrong while all of its values are finite: units that are off for good, colours that saturate.
 * Internal. */
#ifndef ERN_TRAIN_DIVERGENCE_H
#define ERN_TRAIN_DIVERGENCE_H

#include <stdbool.h>
#include <stdint.h>

/* Zeros to begin with. */
struct ern_divergence {
  uint64_t steps;    /* looked at */
  double mean, best; /* dB: over about the last 32 steps, and the highest that it was, or the first step less 3 */
  bool told;
};

/* One more step's PSNR, in dB, over 64 rays or more. True at the step that is the 64th or later and has the mean 6 dB
 * or more below its best, once until it is within 3 dB of it again. On data/tiny healthy trainings stay within 1 dB,
 * dead ones fall by 9. */
bool ern_divergence_step(struct ern_divergence *divergence, double psnr);

#endif
