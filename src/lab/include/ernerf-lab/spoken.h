/* SPDX-License-Identifier: MIT
 * A text spoken by espeak-ng, with timed phonemes and a mouth that follows them: speech with known ground truth. */
#ifndef ERNERF_LAB_SPOKEN_H
#define ERNERF_LAB_SPOKEN_H

#include "ernerf/media.h"

typedef struct ern_phoneme {
  double start, end; /* seconds of the sound */
  char name[9];      /* espeak-ng's mnemonic, stress left out; "_": a pause */
} ern_phoneme;

typedef struct ern_spoken {
  ern_sound sound; /* mono */
  ern_phoneme *phoneme;
  size_t count;
} ern_spoken;

typedef struct ern_spoken_options {
  const char *voice;    /* as `espeak-ng --voices` lists them, with an optional suffix such as "+f3"; "en-us" */
  int words_per_minute; /* 80 to 450; 165 */
} ern_spoken_options;

/* Whether this program was built to use espeak-ng. */
bool ern_spoken_is_built(void);

/* text: UTF-8. The library libespeak-ng.so.1 is loaded for the call; it keeps its state in globals, so one thread at a
 * time. ERN_E_UNSUPPORTED: the library is missing; ERN_E_ARGUMENT: unknown voice. Free with ern_spoken_free. */
ERN_NODISCARD ern_status ern_spoken_make(ern_context *context, const char *text, const ern_spoken_options *options,
                                         ern_spoken *spoken);
void ern_spoken_free(ern_context *context, ern_spoken *spoken); /* accepts a zeroed one */

/* The mouth at `seconds`: jaw 0 closed .. 1 wide open, width -1 pursed .. 1 spread. Each phoneme has one target, a
 * diphthong two, smoothed by a Gaussian of 20 ms standard deviation. */
void ern_spoken_mouth(const ern_spoken *spoken, double seconds, float *jaw, float *width);

#endif
