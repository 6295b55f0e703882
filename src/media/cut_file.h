/* SPDX-License-Identifier: MIT
 * Whether a file was damaged or cut short, which FFmpeg takes as a shorter one. `format`: FFmpeg's name of its
 * container.
 */
#ifndef ERN_MEDIA_CUT_FILE_H
#define ERN_MEDIA_CUT_FILE_H

#include "core/status.h"

/* A packet has fewer bytes than its container claims: ERN_E_FORMAT, except where that is the habit of what is written
 * into a pipe. */
ERN_NODISCARD ern_status ern_cut_packet(ern_context *context, const char *path, const char *format);
/* A stream ended after so many seconds; expected: as its header says, 0 where it does not. ERN_E_FORMAT where it should
 * be longer; a warning where the file does not say that it is whole, though its format provides for it. */
ERN_NODISCARD ern_status ern_cut_end(ern_context *context, const char *path, const char *format, double seconds,
                                     double expected);

#endif
