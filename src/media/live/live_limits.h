/* SPDX-License-Identifier: MIT */
#ifndef ERN_MEDIA_LIVE_LIMITS_H
#define ERN_MEDIA_LIVE_LIMITS_H

#include "core/status.h"
#include "ernerf/live.h"

enum { ERN_LIVE_MOST_CAPACITY = 1000, ERN_LIVE_MOST_RATE_PART = 1000000 };

/* ERN_E_ARGUMENT where a member is outside of its range. */
ERN_NODISCARD ern_status ern_live_settings_check(ern_context *context, const ern_live_options *options);

#endif
