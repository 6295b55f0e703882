/* SPDX-License-Identifier: MIT
 * Detects files that are damaged or truncated, which FFmpeg reads as shorter files without an error. `format`: FFmpeg's
 * name of its container. */
#ifndef ERN_MEDIA_TRUNCATION_H
#define ERN_MEDIA_TRUNCATION_H

#include <stdbool.h>
#include <stddef.h>

#include "core/status.h"

enum { ERN_TRUNCATION_HEAD = 4096 };
/* Whether these first bytes, up to ERN_TRUNCATION_HEAD, are those of a WAV, up to its first sample or further;
 * *open_ended: of unknown size, so that its sound goes on to the end. */
bool ern_truncation_is_wav(const void *head, size_t bytes, bool *open_ended);
/* Call it where a packet of a file, not of a pipe, has fewer bytes than its container claims: ERN_E_FORMAT, except for
 * a WAV file that was written to a pipe, whose header cannot know the size. */
ERN_NODISCARD ern_status ern_truncation_check_packet(ern_context *context, const char *path, const char *format);
/* Call it where a stream ends. seconds: its length. expected: the length that its header states, 0: none. ERN_E_FORMAT
 * where it should be longer; logs a warning where the file lacks its format's end marker (Ogg). */
ERN_NODISCARD ern_status ern_truncation_check_end(ern_context *context, const char *path, const char *format,
                                                  double seconds, double expected);
/* Logs a warning where a stream, "video" or "sound", of an mp4 or a video ends early: what is there is of use. */
void ern_truncation_warn_end(ern_context *context, const char *path, const char *stream, double seconds,
                             double expected);

#endif
