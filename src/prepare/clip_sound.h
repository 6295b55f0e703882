/* SPDX-License-Identifier: MIT
 * The sound of a clip, and how late it is against the picture. */
#ifndef ERN_PREPARE_CLIP_SOUND_H
#define ERN_PREPARE_CLIP_SOUND_H

#include "prepare/prepare_job.h"

enum { ERN_PREPARE_SOUND_RATE = 16000 }; /* samples a second of aud.wav */

/* Reads options->sound_offset; *automatic: it is to be measured, and *seconds is 0. */
ERN_NODISCARD ern_status ern_sound_offset_read(ern_context *context, const char *text, double *seconds,
                                               bool *automatic);

/* The sound of `frames` frames in mono, as aud.wav has it: what is heard `offset` seconds later, silent where the video
 * has none; *missing: seconds at its end for which the video has no sound. data NULL: the video has no sound. The
 * caller owns it (ern_sound_free). */
ERN_NODISCARD ern_status ern_prepare_sound_read(struct ern_prepare_job *job, size_t frames, double offset,
                                                ern_sound *sound, double *missing);

/* How late the sound is: the lag at which the opening of the mouth, opening[frames], correlates best with the opening
 * of the jaw that a linear map predicts from cepstra. Changes slower than a second are left out. */
struct ern_sound_lag {
  double seconds;     /* above 0: the sound is late */
  double correlation; /* at that lag */
  bool certain;       /* no other lag, 0.16 s and more away, comes near */
};
ERN_NODISCARD ern_status ern_sound_lag_measure(ern_context *context, const ern_features *cepstra, const float *opening,
                                               size_t frames, struct ern_sound_lag *lag);

#endif
