/* SPDX-License-Identifier: MIT
 * The window of the structural similarity, as matrices: a Gaussian of 1.5 pixels, cut off after ERN_PATCH_RADIUS and at
 * the edge of the patch, in each row divided by its sum. */
#include "train/patch_filter.h"

#include <math.h>

#include "train/patches_ops.h"

static double window(size_t from, size_t to) {
  const double sigma = 1.5, apart = from > to ? (double)(from - to) : (double)(to - from);
  return apart > ERN_PATCH_RADIUS ? 0 : exp(-apart * apart / (2 * sigma * sigma));
}

void ern_patch_filter(float *filter, int side) {
  for (int scale = 0; scale < ERN_PATCH_SCALES; scale++) {
    const size_t n = (size_t)side >> scale;
    float *transposed = filter + n * n;
    for (size_t r = 0; r < n; r++) {
      double sum = 0;
      for (size_t c = 0; c < n; c++) sum += window(r, c);
      for (size_t c = 0; c < n; c++) filter[r * n + c] = transposed[c * n + r] = (float)(window(r, c) / sum);
    }
    filter += 2 * n * n;
  }
}
