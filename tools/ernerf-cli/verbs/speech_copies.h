/* SPDX-License-Identifier: MIT
 * Copies of a clip's speech in other voices, which a training hears beside it. */
#ifndef ERN_CLI_SPEECH_COPIES_H
#define ERN_CLI_SPEECH_COPIES_H

#include "ernerf/media.h"
#include "session/session.h"

struct speech_copies {
  /* from the command line */
  int count;         /* 0: none */
  struct pair range; /* of the frequencies' factor */
  float share;       /* of the steps that hear a copy */
};

#define SPEECH_COPIES_NAMES "speech-copies speech-warp speech-share"
enum { SPEECH_COPIES_OPTIONS = 3 };
/* The defaults, and --speech-copies --speech-warp --speech-share. */
void speech_copies_options(struct speech_copies *copies, struct option options[SPEECH_COPIES_OPTIONS]);

/* Makes the copies where the clip's features are made of a sound, else none: with a sentence where they were asked for.
 * What was not asked for is chosen by the clip's length.
 * Returns 0, or EXIT_FAILURE after a message. */
int speech_copies_make(struct speech_copies *copies, struct session *session, const struct args *args, ern_clip *clip);

#endif
