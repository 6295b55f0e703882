/* SPDX-License-Identifier: MIT
 * Data augmentation of the speech that a head is trained on: copies in other voices, and noise. */
#ifndef ERN_CLI_SPEECH_AUGMENTATION_H
#define ERN_CLI_SPEECH_AUGMENTATION_H

#include "ernerf/media.h"
#include "session/session.h"

struct speech_augmentation {
  /* from the command line */
  int copies;        /* 0: none */
  struct pair range; /* of the factor that scales the frequencies */
  float share;       /* share of the steps that train on a copy */
  float noise;       /* ern_dataset.speech_noise */
};

#define SPEECH_AUGMENTATION_NAMES "speech-copies speech-warp speech-share speech-noise"
enum { SPEECH_AUGMENTATION_OPTIONS = 4 };
/* The defaults, and --speech-copies --speech-warp --speech-share --speech-noise. */
void speech_augmentation_options(struct speech_augmentation *speech,
                                 struct option options[SPEECH_AUGMENTATION_OPTIONS]);

/* Makes the copies if the clip's features are computed from a sound. Otherwise makes none, with a message if they were
 * requested. Options that were not given depend on the clip's length; where `published`, they are off. Returns 0, or
 * EXIT_FAILURE after a message. */
int speech_augmentation_make(struct speech_augmentation *speech, struct session *session, const struct args *args,
                             bool published, ern_clip *clip);

#endif
