/* SPDX-License-Identifier: MIT
 * The internals of a network that computes speech features. */
#ifndef ERN_MEDIA_SPEECH_NETWORK_H
#define ERN_MEDIA_SPEECH_NETWORK_H

#include "ernerf/speech.h"
#include "io/speech_description.h"
#include "vision/vision.h"

struct ern_speech_network {
  ern_context *context;
  char *path;
  struct ern_speech_description description;
  char text[ERN_SPEECH_DESCRIPTION_BYTES]; /* the description as text */
  char output[128];                        /* name of the output to compute */
  int dims, shape[ERN_VISION_DIMS];        /* of the input: 1, ..., 1, piece_samples */
  void *library;
  const struct ern_vision *vision;
  struct ern_vision_network *network;
  int (*watch)(void *user, size_t done, size_t pieces);
  void *user;
};

/* Reads the sound of a file, resampled to `rate`, as the mean of its channels; the caller owns *samples (ern_release),
 * full scale is 1. */
ERN_NODISCARD ern_status ern_speech_wave(ern_context *context, const char *path, int rate, float **samples,
                                         size_t *count);

#endif
