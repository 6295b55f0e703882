/* SPDX-License-Identifier: MIT
 * How well pictures and sound agree, by embeddings of both (Chung and Zisserman, 2016; docs/evaluation.md). */
#ifndef ERN_CLI_SYNC_SCORE_H
#define ERN_CLI_SYNC_SCORE_H

#include <stddef.h>

enum { SYNC_SHIFT = 15, SYNC_SHIFTS = 2 * SYNC_SHIFT + 1 };

struct sync_score {
  double distance;   /* least mean distance over the shifts */
  double confidence; /* the median of the mean distances less the least */
  int offset;        /* frames that the sound is early by where the distance is least */
};

/* seen, heard: [count][width]. Heard ones that the shift takes from before the first or after the last are zeros. */
struct sync_score sync_score(const float *seen, const float *heard, size_t count, size_t width);

#endif
