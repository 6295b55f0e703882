/* SPDX-License-Identifier: MIT
 * What is looked at before a library of media formats gets a name: such libraries take some names for more than files.
 */
#ifndef ERN_MEDIA_INPUT_H
#define ERN_MEDIA_INPUT_H

#include "core/status.h"

/* ERN_E_MISSING, or ERN_E_IO where `path` is a folder, a device or a pipe, or may not be looked at. */
ERN_NODISCARD ern_status ern_input_check(ern_context *context, const char *path);

#endif
