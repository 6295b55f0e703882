/* SPDX-License-Identifier: MIT
 * Detects a banner that moves sideways through the picture without pause, as the running text of news does. A person
 * and a still camera have no place that moves in one direction at one speed in the whole clip. */
#ifndef ERN_PREPARE_BANNER_H
#define ERN_PREPARE_BANNER_H

#include "prepare/prepare_job.h"

enum {
  ERN_BANNER_GAP = 2, /* frames between the two of a pair */
  ERN_BANNER_PAIRS = 32,
  ERN_BANNER_ROWS = 32, /* bands of the picture's height */
  ERN_BANNER_COLUMNS = 4
};

struct ern_banner { /* {0} at first */
  size_t pairs;
  int8_t shift[ERN_BANNER_ROWS][ERN_BANNER_COLUMNS]
              [ERN_BANNER_PAIRS]; /* 1/256 of the picture; 0: still, or no detail */
};

/* Adds a pair of frames, RGB, ERN_BANNER_GAP apart, from anywhere in the clip. Does nothing after ERN_BANNER_PAIRS. */
ERN_NODISCARD ern_status ern_banner_add(struct ern_banner *banner, ern_context *context, const ern_image *first,
                                        const ern_image *second);
/* Whether there is a banner in the clip of `frames` frames; its rows *top to *bottom, shares of the picture's height.
 */
bool ern_banner_find(const struct ern_banner *banner, size_t frames, double *top, double *bottom);

#endif
