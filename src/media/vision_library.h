/* SPDX-License-Identifier: MIT
 * libernerf-vision, opened when something of it is asked for. */
#ifndef ERN_MEDIA_VISION_LIBRARY_H
#define ERN_MEDIA_VISION_LIBRARY_H

#include "core/status.h"
#include "vision/vision.h"

/* `what` needs it, in an error's words. The caller closes *library (dlclose). */
ERN_NODISCARD ern_status ern_vision_load(ern_context *context, const char *what, void **library,
                                         const struct ern_vision **vision);

#endif
