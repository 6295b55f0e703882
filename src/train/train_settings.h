/* SPDX-License-Identifier: MIT
 * The ranges of a training's settings. Internal. */
#ifndef ERN_TRAIN_TRAIN_SETTINGS_H
#define ERN_TRAIN_TRAIN_SETTINGS_H

#include "ernerf/train.h"

#define ERN_TRAIN_MOST_RATE 1e3
#define ERN_TRAIN_MOST_SECONDS 1e9

ERN_NODISCARD ern_status ern_train_settings_check(ern_context *context, const ern_train_config *config);

#endif
