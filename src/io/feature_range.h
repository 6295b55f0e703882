/* SPDX-License-Identifier: MIT
 * Valid speech features: the range of values, and the sizes of an array. */
#ifndef ERN_IO_FEATURE_RANGE_H
#define ERN_IO_FEATURE_RANGE_H

#include <stdbool.h>

#include "ernerf/data.h"

enum { ERN_FEATURE_WINDOW_MOST = 16, ERN_FEATURE_WIDTH_MOST = 4096 };

/* The magnitude of a feature is at most 1e30, so that sums in the audio networks do not overflow a float; features of
 * real speech are below 1e3. */
static inline bool ern_feature_fits(float value) { return value >= -1e30f && value <= 1e30f; }

/* ERN_E_ARGUMENT where a caller's array is empty, or a size is out of range; `where` begins the message ("train"). With
 * a NULL context the status alone. Values are not checked. */
ERN_NODISCARD ern_status ern_features_check(ern_context *context, const char *where, const ern_features *features);

/* ERN_E_NONFINITE or ERN_E_FORMAT where a value of features whose sizes are right does not fit; the message has its
 * index. */
ERN_NODISCARD ern_status ern_features_check_values(ern_context *context, const char *where,
                                                   const ern_features *features);

#endif
