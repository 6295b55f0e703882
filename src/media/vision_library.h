/* SPDX-License-Identifier: MIT
 * Loads libernerf-vision on first use. */
#ifndef ERN_MEDIA_VISION_LIBRARY_H
#define ERN_MEDIA_VISION_LIBRARY_H

#include "core/status.h"
#include "vision/vision.h"

/* `what`: what needs the library, for error messages. The caller closes *library (dlclose). */
ERN_NODISCARD ern_status ern_vision_load(ern_context *context, const char *what, void **library,
                                         const struct ern_vision **vision);

#endif
