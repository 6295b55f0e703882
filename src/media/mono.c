/* SPDX-License-Identifier: MIT */
#include "media/mono.h"

#include <math.h>

/* Energy of the mean over the mean energy of the channels: 1 where they are equal, 1 / channels where they have nothing
 * in common or all but one are silent. */
#define CANCELLED 0.25  /* of 1 / channels */
#define AUDIBLE 0.5     /* of it: the mean is taken again */
#define HALF_SECOND 0.5 /* s */

static void measure(struct ern_mono *mono, const float *mean, const float *samples, int channels, size_t frames,
                    int rate) {
  const double keep = exp(-(double)frames / (HALF_SECOND * rate));
  double sum = 0;
  for (size_t i = 0; i < frames; i++) sum += (double)mean[i] * (double)mean[i];
  mono->of_mean = keep * mono->of_mean + sum;
  for (int c = 0; c < channels; c++) {
    sum = 0;
    for (size_t i = 0; i < frames; i++) {
      const double sample = (double)samples[i * (size_t)channels + (size_t)c];
      sum += sample * sample;
    }
    mono->energy[c] = keep * mono->energy[c] + sum;
  }
}

static void choose(struct ern_mono *mono, int channels) {
  int loudest = 0;
  double all = 0;
  for (int c = 0; c < channels; c++) {
    all += mono->energy[c];
    if (mono->energy[c] > mono->energy[loudest]) loudest = c;
  }
  if (mono->taken == 0 && mono->of_mean * channels * channels < CANCELLED * all) mono->taken = 1 + loudest;
  if (mono->taken > 0 && mono->of_mean * channels * channels > AUDIBLE * all) mono->taken = 0;
}

bool ern_mono_mix(struct ern_mono *mono, float *to, const float *samples, int channels, size_t frames, int rate) {
  for (size_t i = 0; i < frames; i++) {
    double sum = 0;
    for (int c = 0; c < channels; c++) sum += (double)samples[i * (size_t)channels + (size_t)c];
    to[i] = (float)(sum / channels);
  }
  if (channels == 1) return false;
  measure(mono, to, samples, channels, frames, rate);
  choose(mono, channels);
  if (mono->taken == 0) return false;
  for (size_t i = 0; i < frames; i++) to[i] = samples[i * (size_t)channels + (size_t)mono->taken - 1];
  const bool first = !mono->told;
  mono->told = true;
  return first;
}
