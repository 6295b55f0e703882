/* SPDX-License-Identifier: MIT
 * Keyframes: frames of the speech that differ much from each other; other frames are interpolated between them.
 *
 * A ray's colour is a smooth function of audio code and eye value nearly everywhere. Ordinary kriging interpolates it
 * between the keyframes z_k = (code/width of the speech, eye), with the kernel K_kj = k(|z_k - z_j|): Matern 5/2, its
 * length scale three times the width of the speech. At z the weights w of the keyframes solve
 *   [K 1; 1' 0] [w; m] = [k(|z - z_k|); 1].
 * Let B be the first rows and columns of the inverse matrix. The prediction of keyframe k from the others has the error
 *   e_k = sum_j B_kj y_j / B_kk (Dubrule 1983),
 * of the variance 1/B_kk. e_k tells for each ray how accurate the interpolation is. The variance tells for each frame
 * whether z is farther from the keyframes than they are from each other. */
#ifndef ERN_RENDER_KEYFRAMES_H
#define ERN_RENDER_KEYFRAMES_H

#include "core/backend.h"
#include "model/field.h"

enum { ERN_KEYFRAMES = 16 };

/* Speech and eyes of one frame. */
struct ern_speech_frame {
  const float *windows; /* [ERN_AUDIO_WINDOWS][window_length][width], on the host, finite */
  int window_length;
  float eye;
};

struct ern_keyframes {
  size_t count;
  float code[ERN_KEYFRAMES][ERN_AUDIO_CODE], eye[ERN_KEYFRAMES];
  double scale;                                         /* of codes: 1/the width of the speech, 1e-6 at least */
  double inverse[ERN_KEYFRAMES + 1][ERN_KEYFRAMES + 1]; /* of the matrix above */
  double variance;                                      /* the largest 1/B_kk */
};

/* *code = the audio code of the frame, real [A], in the stream's scratch. */
ERN_NODISCARD ern_status ern_speech_frame_code(struct ern_stream *stream, const struct ern_field *field,
                                               ern_span parameters, const struct ern_speech_frame *frame,
                                               ern_span *code);

/* Farthest-point sampling: the first frame, then each time the frame that is farthest from those already chosen. frame:
 * [count], >= 1. */
ERN_NODISCARD ern_status ern_keyframes_choose(struct ern_keyframes *keyframes, struct ern_stream *stream,
                                              const struct ern_field *field, ern_span parameters,
                                              const struct ern_speech_frame *frame, size_t count);

/* weight[k] of keyframe k, which sum to 1. False where audio code and eye are too far from all keyframes. */
bool ern_keyframes_weigh(float weight[ERN_KEYFRAMES], const struct ern_keyframes *keyframes,
                         const float code[ERN_AUDIO_CODE], float eye);

/* error[k] = the difference of value[k * stride] from its prediction by the other keyframes; INFINITY with fewer than 3
 * keyframes. */
void ern_keyframes_error(float error[ERN_KEYFRAMES], const struct ern_keyframes *keyframes, const float *value,
                         size_t stride);

#endif
