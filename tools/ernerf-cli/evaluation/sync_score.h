/* SPDX-License-Identifier: MIT
 * Audio-visual synchronization score from embeddings of pictures and sound (Chung and Zisserman, 2016;
 * docs/evaluation.md). */
#ifndef ERN_CLI_SYNC_SCORE_H
#define ERN_CLI_SYNC_SCORE_H

#include <stddef.h>

enum { SYNC_SHIFT = 15, SYNC_SHIFTS = 2 * SYNC_SHIFT + 1 };

struct sync_score {
  double distance;   /* least mean distance over the shifts */
  double confidence; /* median minus minimum of the mean distances */
  int offset;        /* at the least distance: frames by which the sound is early */
};

/* video (pictures), audio (sound): [count][width]. Rows of `audio` that a shift takes from outside [0, count) count as
 * zeros. */
struct sync_score sync_score(const float *video, const float *audio, size_t count, size_t width);

#endif
