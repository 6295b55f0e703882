/* SPDX-License-Identifier: MIT
 * The speech of a frame. Internal. */
#ifndef ERN_TRAIN_TRAINER_SPEECH_H
#define ERN_TRAIN_TRAINER_SPEECH_H

#include "train/parts/trainer_shared.h"

struct ern_trainer_speech {
  const struct ern_training *training;
  float *windows;   /* [8][window_length][width]: room for those of a frame */
  float *deviation; /* [width]: standard deviations of the features; NULL without noise */
};

/* Needs ern_trainer_speech_free also after an error. */
ERN_NODISCARD ern_status ern_trainer_speech_make(struct ern_trainer_speech *speech,
                                                 const struct ern_training *training);
void ern_trainer_speech_free(struct ern_trainer_speech *speech, ern_context *context);
/* The speech of a frame: host [8][window_length][width]. */
ERN_NODISCARD ern_status ern_trainer_windows(const struct ern_trainer_speech *speech, int split, size_t frame,
                                             float *host);
/* That of a training frame, frame k of the step, with data augmentation, uploaded to `windows` (taken from scratch). */
ERN_NODISCARD ern_status ern_trainer_upload_windows(const struct ern_trainer_speech *speech, size_t frame, size_t k,
                                                    ern_span *windows);
/* real [ERN_AUDIO_CODE], taken from scratch: the code of a training frame's speech. */
ERN_NODISCARD ern_status ern_trainer_audio_code(const struct ern_trainer_speech *speech, size_t frame, ern_span *code);

#endif
