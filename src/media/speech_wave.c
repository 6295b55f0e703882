/* SPDX-License-Identifier: MIT
 * The sound of a file as one wave at a given rate. */
#include <libavutil/channel_layout.h>
#include <libswresample/swresample.h>
#include <math.h>
#include <string.h>

#include "core/memory.h"
#include "media/mono.h"
#include "media/sound_decoder.h"
#include "media/speech_network.h"

enum { LEAST_RATE = 1000, BLOCK = 4096 };

struct wave {
  ern_context *context;
  const char *path;
  int rate, from; /* samples a second: wanted, and of the file */
  SwrContext *resampler;
  struct ern_mono mono;
  float *samples; /* [capacity] */
  size_t count, capacity;
  uint64_t frames; /* of the file */
};

static ern_status append(struct wave *wave, const float *samples, size_t count) {
  if (wave->count + count > wave->capacity) {
    const size_t capacity = 2 * wave->capacity + count;
    float *larger = NULL;
    const ern_status status = ERN_NEW(wave->context, capacity, &larger);
    if (status != ERN_OK) return status;
    if (wave->count > 0) memcpy(larger, wave->samples, wave->count * sizeof *larger);
    ern_release(wave->context, wave->samples);
    wave->samples = larger;
    wave->capacity = capacity;
  }
  if (count > 0) memcpy(wave->samples + wave->count, samples, count * sizeof *samples);
  wave->count += count;
  return ERN_OK;
}

/* Resamples a block; NULL: flushes the resampler. */
static ern_status resample(struct wave *wave, const float *block, size_t count) {
  float out[BLOCK];
  const uint8_t *from = (const uint8_t *)block;
  for (int given = (int)count;; given = 0) {
    uint8_t *to = (uint8_t *)out;
    const int made = swr_convert(wave->resampler, &to, BLOCK, block == NULL ? NULL : &from, given);
    if (made < 0) return ern_av_fail(wave->context, ERN_E_MEDIA, wave->path, "convert its samples", made);
    const ern_status status = append(wave, out, (size_t)made);
    if (status != ERN_OK || made < BLOCK) return status;
  }
}

static ern_status start(struct wave *wave, int rate) {
  AVChannelLayout mono = AV_CHANNEL_LAYOUT_MONO;
  wave->from = rate;
  if (rate < LEAST_RATE)
    return ern_fail(wave->context, ERN_E_SHAPE, "%s: sound has %d samples a second, expected at least %d", wave->path,
                    rate, LEAST_RATE);
  if (rate == wave->rate) return ERN_OK;
  int error = swr_alloc_set_opts2(&wave->resampler, &mono, AV_SAMPLE_FMT_FLT, wave->rate, &mono, AV_SAMPLE_FMT_FLT,
                                  rate, 0, NULL);
  if (error >= 0) error = swr_init(wave->resampler);
  return error >= 0 ? ERN_OK : ern_av_fail(wave->context, ERN_E_MEDIA, wave->path, "convert its samples", error);
}

static ern_status take(void *user, int rate, int channels, const float *samples, size_t frames) {
  struct wave *wave = user;
  float block[BLOCK];
  ern_status status = wave->from == 0 ? start(wave, rate) : ERN_OK;
  for (size_t at = 0, count = 0; at < frames && status == ERN_OK; at += count) {
    count = frames - at < BLOCK ? frames - at : BLOCK;
    const float *from = samples + at * (size_t)channels;
    for (size_t i = 0; i < count * (size_t)channels; i++)
      if (!isfinite(from[i]) || fabsf(from[i]) > 1e6f)
        return ern_fail(wave->context, isfinite(from[i]) ? ERN_E_FORMAT : ERN_E_NONFINITE,
                        "%s: the sample at %.3f s is %g, expected a finite number, -1 to 1 as a rule", wave->path,
                        (double)(wave->frames + at + i / (size_t)channels) / rate, (double)from[i]);
    if (ern_mono_mix(&wave->mono, block, from, channels, count, rate))
      ern_log(wave->context, ERN_LOG_WARNING, "%s: " ERN_MONO_WORDS, wave->path);
    status = wave->resampler != NULL ? resample(wave, block, count) : append(wave, block, count);
  }
  wave->frames += frames;
  return status;
}

ern_status ern_speech_wave(ern_context *context, const char *path, int rate, float **samples, size_t *count) {
  struct wave wave = {.context = context, .path = path, .rate = rate};
  ern_status status = ERN_OK;
  static const float zeros[BLOCK] = {0};
  ERN_TRY(ern_sound_decode(context, path, take, &wave));
  if (wave.resampler != NULL) ERN_TRY(resample(&wave, NULL, 0));
  const size_t wanted = (size_t)(wave.frames * (uint64_t)rate / (uint64_t)wave.from);
  while (wave.count < wanted) ERN_TRY(append(&wave, zeros, wanted - wave.count < BLOCK ? wanted - wave.count : BLOCK));
  *samples = wave.samples;
  *count = wanted;
  wave.samples = NULL;
fail:
  swr_free(&wave.resampler);
  ern_release(context, wave.samples);
  return status;
}
