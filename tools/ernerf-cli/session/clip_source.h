/* SPDX-License-Identifier: MIT
 * The clip of a verb, the choice of its speech features, and the memory for its frames. */
#ifndef ERN_CLI_CLIP_SOURCE_H
#define ERN_CLI_CLIP_SOURCE_H

#include "args.h"
#include "ernerf/media.h"
#include "session/session.h"
#include "session/speech_model.h"

enum { CLIP_SOURCE_OPTIONS = 2 + SPEECH_MODEL_OPTIONS };

struct clip_source {
  const char *path, *asr_model;
  const char *features; /* a file in place of the clip's features; NULL: the clip's */
  uint64_t memory;      /* bytes that frames may take; 0: the library's choice */
  struct speech_model speech_model;
};

/* --asr-model --speech-model --speech-preset, and --set memory. */
void clip_source_options(struct clip_source *source, struct option options[CLIP_SOURCE_OPTIONS]);

/* Opens the speech network, if one was requested and is not open yet, and the clip. With an asr_model the network is
 * not used. Returns 0, or EXIT_FAILURE after a message. */
int clip_source_open(struct clip_source *source, struct session *session, ern_clip **clip);

#endif
