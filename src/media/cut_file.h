/* SPDX-License-Identifier: MIT
 * Whether a file was damaged or cut short, which FFmpeg takes as a shorter one. */
#ifndef ERN_MEDIA_CUT_FILE_H
#define ERN_MEDIA_CUT_FILE_H

#include "media/ffmpeg.h"

/* A packet has fewer bytes than its container claims: ERN_E_FORMAT, except where that is the habit of what is written
 * into a pipe. */
ERN_NODISCARD ern_status ern_cut_packet(const struct ern_decoder *decoder);
/* The stream at hand ended after so many seconds. ERN_E_FORMAT where the file says that it is longer; a warning where
 * it does not say that it is whole, though its format provides for it. */
ERN_NODISCARD ern_status ern_cut_end(const struct ern_decoder *decoder, double seconds);

#endif
