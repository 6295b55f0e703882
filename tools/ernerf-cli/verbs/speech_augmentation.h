/* SPDX-License-Identifier: MIT
 * Data augmentation of the speech that a head is trained on: copies in other voices, and noise. */
#ifndef ERN_CLI_SPEECH_AUGMENTATION_H
#define ERN_CLI_SPEECH_AUGMENTATION_H

#include "ernerf/media.h"
#include "session/session.h"

struct speech_augmentation {
  int off; /* index into the choices of --speech-augment */
};

enum { SPEECH_AUGMENTATION_OPTIONS = 1 };
void speech_augmentation_options(struct speech_augmentation *speech,
                                 struct option options[SPEECH_AUGMENTATION_OPTIONS]);

/* Makes the copies and sets the data's augmentation, as strong as the clip's length calls for, if the clip's features
 * are computed from a sound. Returns 0, or EXIT_FAILURE after a message. */
int speech_augmentation_make(const struct speech_augmentation *speech, struct session *session, ern_clip *clip,
                             ern_dataset *dataset);

#endif
