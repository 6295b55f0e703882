/* SPDX-License-Identifier: MIT
 * One channel of many: their mean, of more than four a weighted sum; where it loses most of their energy, as with right
 * = -left, the loudest of them. */
#ifndef ERN_MEDIA_MONO_H
#define ERN_MEDIA_MONO_H

#include <stdbool.h>
#include <stddef.h>

enum { ERN_MONO_MOST = 8 /* channels */ };
#define ERN_MONO_WORDS "the channels of the sound cancel each other; the loudest is taken in place of all"

/* Zeroed at the start of a sound. */
struct ern_mono {
  double energy[ERN_MONO_MOST], of_sum; /* of the last half second, sums of squares with weights that decay */
  int taken;                            /* 0: none, else 1 + the channel */
  bool reported;
};

/* to[frames], samples[frames][channels]. Returns true where a channel is taken for the first time: say so. */
bool ern_mono_mix(struct ern_mono *mono, float *to, const float *samples, int channels, size_t frames, int rate);

#endif
