/* SPDX-License-Identifier: MIT */
#include "evaluation/sync_score.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Added to each difference, as torch's pairwise_distance does. */
static const double epsilon = 1e-6;

static int by_value(const void *left, const void *right) {
  const double a = *(const double *)left, b = *(const double *)right;
  return a < b ? -1 : a > b;
}

struct sync_score sync_score(const float *video, const float *audio, size_t count, size_t width) {
  double means[SYNC_SHIFTS] = {0}, sorted[SYNC_SHIFTS];
  struct sync_score score = {.distance = INFINITY};
  for (int s = 0; s < SYNC_SHIFTS; s++) {
    for (size_t i = 0; i < count; i++) {
      const size_t at = i + (size_t)s; /* index + SYNC_SHIFT */
      const float *other = at >= SYNC_SHIFT && at - SYNC_SHIFT < count ? audio + (at - SYNC_SHIFT) * width : NULL;
      double square = 0;
      for (size_t k = 0; k < width; k++)
        square += pow((double)video[i * width + k] - (other != NULL ? (double)other[k] : 0) + epsilon, 2);
      means[s] += sqrt(square) / (double)count;
    }
    if (means[s] < score.distance) {
      score.distance = means[s];
      score.offset = SYNC_SHIFT - s;
    }
  }
  memcpy(sorted, means, sizeof sorted);
  qsort(sorted, SYNC_SHIFTS, sizeof *sorted, by_value);
  score.confidence = sorted[SYNC_SHIFT] - score.distance;
  return score;
}
