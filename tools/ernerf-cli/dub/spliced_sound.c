/* SPDX-License-Identifier: MIT */
#include "dub/spliced_sound.h"

#include <math.h>
#include <stdlib.h>

#include "ernerf/stream.h"

enum { READ_FRAMES = 4096, MAX_CHANNELS = 8 };
#define FADE 0.01 /* seconds over which the recorded sound sets in, so that it does not click */

/* The file's sound at spliced's rate and channels, up to `frames` frames. */
static int read_words(struct session *session, const char *audio, size_t frames, const ern_sound *spliced) {
  float samples[READ_FRAMES * MAX_CHANNELS];
  const size_t channels = (size_t)spliced->channels;
  ern_sound_reader_options options = ern_sound_reader_options_default();
  ern_sound_reader *reader = NULL;
  size_t count = 1;
  options.rate = spliced->rate;
  options.channels = spliced->channels;
  ern_status status = ern_sound_reader_open(session->context, audio, &options, &reader);
  for (size_t at = 0; status == ERN_OK && count > 0 && at < frames; at += count) {
    status = ern_sound_reader_read(reader, samples, frames - at < READ_FRAMES ? frames - at : READ_FRAMES, &count);
    for (size_t i = 0; status == ERN_OK && i < count * channels; i++)
      spliced->data[at * channels + i] = (int16_t)lrintf(32767 * fminf(fmaxf(samples[i], -1), 1));
  }
  ern_sound_reader_free(&reader);
  return status == ERN_OK ? 0 : session_fail(session);
}

int spliced_sound_read(struct session *session, const char *audio, double words, const char *video, double from,
                       double rest, ern_sound *spliced) {
  ern_sound recorded = {0};
  if (ern_sound_read(session->context, video, &recorded) != ERN_OK) return session_fail(session);
  const double rate = recorded.rate, fade = FADE * rate;
  const size_t channels = (size_t)recorded.channels, first = (size_t)lround(words * rate);
  const int64_t shift = llround(from * rate) - (int64_t)first;
  *spliced = (ern_sound){.rate = recorded.rate, .channels = recorded.channels, .frames = first + (size_t)(rest * rate)};
  spliced->data = calloc(spliced->frames * channels + 1, sizeof *spliced->data);
  int status = spliced->data != NULL ? read_words(session, audio, first, spliced)
                                     : session_fail_with(session, "%s: no memory for its sound", video);
  for (size_t i = first; status == 0 && i < spliced->frames; i++) {
    const int64_t at = (int64_t)i + shift;
    const double gain = fmin((double)(i - first) / fade, 1);
    for (size_t c = 0; at >= 0 && (size_t)at < recorded.frames && c < channels; c++)
      spliced->data[i * channels + c] = (int16_t)lrint(gain * recorded.data[(size_t)at * channels + c]);
  }
  ern_sound_free(session->context, &recorded);
  return status;
}
