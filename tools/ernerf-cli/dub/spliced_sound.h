/* SPDX-License-Identifier: MIT
 * New words, and after them the sound of the recorded video. */
#ifndef ERN_CLI_SPLICED_SOUND_H
#define ERN_CLI_SPLICED_SOUND_H

#include "ernerf/media.h"
#include "session/session.h"

/* *spliced, with the larger rate and number of channels of the two: `words` seconds of the file `audio`, silence after
 * its end, then `rest` seconds of the sound of `video` from its second `from` on. The caller frees spliced->data
 * (free). Returns 0, or EXIT_FAILURE after a message. */
int spliced_sound_read(struct session *session, const char *audio, double words, const char *video, double from,
                       double rest, ern_sound *spliced);

#endif
