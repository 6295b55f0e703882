/* SPDX-License-Identifier: MIT
 * Keyframes: frames of the speech that are far from each other, between which others are interpolated.
 *
 * A ray's light is a smooth function of audio code and eye value nearly everywhere, so it is interpolated: between the
 * keyframes z_k = (code/width of the speech, eye) with a kernel K_kj = k(|z_k - z_j|) and a constant (ordinary kriging;
 * Matern's kernel 5/2, as wide as three times the speech). At z the weights w of the keyframes solve
 *   [K 1; 1' 0] [w; m] = [k(|z - z_k|); 1].
 * With B the first rows and columns of the inverse, keyframe k itself is predicted from the others with the error
 *   e_k = sum_j B_kj y_j / B_kk (Dubrule 1983),
 * of the variance 1/B_kk: so it is known, ray by ray, how well it goes, and frame by frame, whether z is any farther
 * from the keyframes than they are from each other. */
#ifndef ERN_RENDER_KEYFRAMES_H
#define ERN_RENDER_KEYFRAMES_H

#include "core/backend.h"
#include "model/field.h"

enum { ERN_KEYFRAMES = 16 };

/* What a frame of the speech shows. */
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

/* The first frame, then always the one that is farthest from those that were chosen. frame: [count], >= 1. */
ERN_NODISCARD ern_status ern_keyframes_choose(struct ern_keyframes *keyframes, struct ern_stream *stream,
                                              const struct ern_field *field, ern_span parameters,
                                              const struct ern_speech_frame *frame, size_t count);

/* weight[k] of keyframe k, which sum to 1. False where audio code and eye are too far from all keyframes. */
bool ern_keyframes_weigh(float weight[ERN_KEYFRAMES], const struct ern_keyframes *keyframes,
                         const float code[ERN_AUDIO_CODE], float eye);

/* error[k] = what value[k * stride] differs by from what the other keyframes say; fewer than 3 keyframes say nothing.
 */
void ern_keyframes_error(float error[ERN_KEYFRAMES], const struct ern_keyframes *keyframes, const float *value,
                         size_t stride);

#endif
