/* SPDX-License-Identifier: MIT
 * The check of a path before a media library opens it: such libraries take some paths for URLs, devices or patterns. */
#ifndef ERN_MEDIA_INPUT_H
#define ERN_MEDIA_INPUT_H

#include "core/status.h"

/* ERN_E_MISSING, or ERN_E_IO where `path` is a folder, a device or a pipe, or stat fails; ERN_E_FORMAT where it is
 * empty. */
ERN_NODISCARD ern_status ern_input_check(ern_context *context, const char *path);

#endif
