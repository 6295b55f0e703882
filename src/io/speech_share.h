/* SPDX-License-Identifier: MIT
 * How much of a sound is speech. */
#ifndef ERN_IO_SPEECH_SHARE_H
#define ERN_IO_SPEECH_SHARE_H

#include "ernerf/media.h"

/* Less speech than this share of the time leaves a mouth little to be learnt from. */
#define ERN_SPEECH_SHARE 0.2

/* The share of a sound's time in which somebody speaks: within 30 dB of its loudest 0.2 s, and 6 dB above its quietest
 * tenth, as hiss is not. */
double ern_speech_share(const ern_sound *sound);

#endif
