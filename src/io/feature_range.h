/* SPDX-License-Identifier: MIT */
#ifndef ERN_IO_FEATURE_RANGE_H
#define ERN_IO_FEATURE_RANGE_H

#include <stdbool.h>

/* A feature of speech is a number of 1e30 at most, whose sums in the audio networks stay floats; those of any speech
 * are below 1e3. */
static inline bool ern_feature_fits(float value) { return value >= -1e30f && value <= 1e30f; }

#endif
