/* SPDX-License-Identifier: MIT */
#include "train/divergence.h"

#include <math.h>

enum { MEMORY = 32 /* steps */, FIRST_MEAN = 4 /* steps before a mean counts */, FIRST = 64 };

/* dB. A single step may deviate 3 dB from the mean, and with far too high rates only the first step is a valid
 * reference. */
static const double fallen = 6, recovered = 3, chance = 3;

bool ern_divergence_step(struct ern_divergence *d, double psnr) {
  d->steps++;
  d->mean += (psnr - d->mean) / (double)(d->steps < MEMORY ? d->steps : MEMORY);
  if (d->steps == 1) d->best = psnr - chance;
  if (d->steps >= FIRST_MEAN) d->best = fmax(d->best, d->mean);
  if (d->reported && d->mean > d->best - recovered) d->reported = false;
  if (d->reported || d->steps < FIRST || d->mean > d->best - fallen) return false;
  d->reported = true;
  return true;
}
