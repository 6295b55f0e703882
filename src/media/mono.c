/* SPDX-License-Identifier: MIT */
#include "media/mono.h"

#include <math.h>

/* Energy of the sum over that of the weighted channels: `channels` where they are equal, 1 where they have nothing in
 * common or all but one are silent. */
#define CANCELLED 0.25
#define AUDIBLE 0.5     /* the sum is taken again */
#define HALF_SECOND 0.5 /* s */

/* Of fewer than 5 channels the mean. Of more the downmix to one channel of ITU-R BS.775, as speech is in the centre:
 * channels are left, right, centre and others, of which those of low frequencies are not told from others. The weights
 * are not divided by their sum (3.9 of six channels): speech in the centre would be 12 dB quieter than the same speech
 * in a file of one channel. So channels that are loud together exceed full scale, by 12 dB at most. */
static double weight(int channels, int c) {
  return channels < 5 ? 1.0 / channels : c == 2 ? 1 : c < 2 ? sqrt(0.5) : 0.5;
}

/* energy: of the channels as they are weighted. */
static void measure(struct ern_mono *mono, const float *mixed, const float *samples, int channels, size_t frames,
                    int rate) {
  const double keep = exp(-(double)frames / (HALF_SECOND * rate));
  double sum = 0;
  for (size_t i = 0; i < frames; i++) sum += (double)mixed[i] * (double)mixed[i];
  mono->of_sum = keep * mono->of_sum + sum;
  for (int c = 0; c < channels; c++) {
    sum = 0;
    for (size_t i = 0; i < frames; i++) {
      const double sample = weight(channels, c) * (double)samples[i * (size_t)channels + (size_t)c];
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
  if (mono->taken == 0 && mono->of_sum < CANCELLED * all) mono->taken = 1 + loudest;
  if (mono->taken > 0 && mono->of_sum > AUDIBLE * all) mono->taken = 0;
}

bool ern_mono_mix(struct ern_mono *mono, float *to, const float *samples, int channels, size_t frames, int rate) {
  for (size_t i = 0; i < frames; i++) {
    double sum = 0;
    for (int c = 0; c < channels; c++) sum += weight(channels, c) * (double)samples[i * (size_t)channels + (size_t)c];
    to[i] = (float)sum;
  }
  if (channels == 1) return false;
  measure(mono, to, samples, channels, frames, rate);
  choose(mono, channels);
  if (mono->taken == 0) return false;
  for (size_t i = 0; i < frames; i++) to[i] = samples[i * (size_t)channels + (size_t)mono->taken - 1];
  const bool first = !mono->reported;
  mono->reported = true;
  return first;
}
