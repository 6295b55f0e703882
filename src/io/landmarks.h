/* SPDX-License-Identifier: MIT
 * The 68 face landmarks of a frame (the 300-W order): one "x y" a line, in pixels. */
#ifndef ERN_IO_LANDMARKS_H
#define ERN_IO_LANDMARKS_H

#include "core/status.h"

enum { ERN_LANDMARKS = 68 };

/* Exactly 68 pairs of finite numbers, else ERN_E_SHAPE or ERN_E_FORMAT with the line. */
ERN_NODISCARD ern_status ern_landmarks_read(ern_context *context, const char *path, float points[ERN_LANDMARKS][2]);

#endif
