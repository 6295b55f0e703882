/* SPDX-License-Identifier: MIT */
#include "dub/spliced_sound.h"

#include <math.h>
#include <stdlib.h>

enum { TAPS = 16 };
#define FADE 0.01 /* seconds over which the recorded sound sets in, so that it does not click */
static const double pi = 3.14159265358979323846;

static double sample_of(const ern_sound *sound, size_t channel, double frame) {
  const bool there = frame >= 0 && frame < (double)sound->frames;
  return there ? sound->data[(size_t)frame * (size_t)sound->channels + channel] : 0;
}

/* A channel at `at`, in frames of the sound, for a rate that is not less than its own. Between two frames: the sum of
 * x[k] sinc(at - k) over 2 TAPS frames, under a Hann window. */
static double value_at(const ern_sound *sound, size_t channel, double at) {
  const double before = floor(at);
  double sum = 0;
  if (at == before) return sample_of(sound, channel, at);
  for (int k = 1 - TAPS; k <= TAPS; k++) {
    const double x = pi * (at - before - k);
    sum += sample_of(sound, channel, before + k) * sin(x) / x * (0.5 + 0.5 * cos(x / TAPS));
  }
  return sum;
}

/* What the output's channel has of the sound at `at`. One channel is heard left and right. */
static double heard(const ern_sound *sound, size_t channel, double at) {
  const bool mono = sound->channels == 1;
  if (channel >= (mono ? 2 : (size_t)sound->channels)) return 0;
  return value_at(sound, mono ? 0 : channel, at);
}

/* begin: frame of `recorded` at which the rest begins; first: frame of `spliced` with which it begins. */
static void splice(const ern_sound *speech, const ern_sound *recorded, double begin, size_t first, ern_sound *spliced) {
  const size_t channels = (size_t)spliced->channels;
  const double rate = spliced->rate, fade = FADE * rate;
  for (size_t i = 0; i < spliced->frames; i++) {
    const bool rest = i >= first;
    const double since = rest ? (double)(i - first) : (double)i;
    const double at = rest ? begin + since * recorded->rate / rate : since * speech->rate / rate;
    const double gain = rest ? fmin(since / fade, 1) : 1;
    for (size_t c = 0; c < channels; c++) {
      const double value = gain * heard(rest ? recorded : speech, c, at);
      spliced->data[i * channels + c] = (int16_t)lrint(fmin(fmax(value, INT16_MIN), INT16_MAX));
    }
  }
}

int spliced_sound_read(struct session *session, const char *audio, double words, const char *video, double from,
                       double rest, ern_sound *spliced) {
  ern_sound speech = {0}, recorded = {0};
  int status = 0;
  if (ern_sound_read(session->context, audio, &speech) != ERN_OK ||
      ern_sound_read(session->context, video, &recorded) != ERN_OK)
    status = session_fail(session);
  if (status == 0) {
    const int rate = speech.rate > recorded.rate ? speech.rate : recorded.rate;
    const int channels = speech.channels > recorded.channels ? speech.channels : recorded.channels;
    const size_t first = (size_t)lround(words * rate);
    *spliced = (ern_sound){.rate = rate, .channels = channels, .frames = first + (size_t)(rest * rate)};
    spliced->data = calloc(spliced->frames * (size_t)channels + 1, sizeof *spliced->data);
    if (spliced->data != NULL)
      splice(&speech, &recorded, round(from * recorded.rate), first, spliced);
    else
      status = session_fail_with(session, "%s: no memory for its sound", video);
  }
  ern_sound_free(session->context, &speech);
  ern_sound_free(session->context, &recorded);
  return status;
}
