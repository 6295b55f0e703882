/* SPDX-License-Identifier: MIT
 * Speech features of live sound: resamples it to 16 kHz mono, then computes row by row. */
#include <libavutil/channel_layout.h>
#include <libswresample/swresample.h>
#include <math.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "ernerf/speech.h"
#include "media/ffmpeg.h"
#include "media/mono.h"
#include "media/speech/articulatory.h"
#include "media/speech/cepstra.h"

enum { MOST_RATE = 384000, MOST_CHANNELS = ERN_MONO_MOST, HALF_OVERLAP = (ERN_CEPSTRA_FRAME - ERN_CEPSTRA_HOP) / 2 };

struct ern_speech_stream {
  ern_context *context;
  int rate, channels;
  size_t width; /* numbers a row */
  struct ern_cepstra *cepstra;
  struct ern_articulatory *articulatory; /* NULL: rows are cepstra */
  SwrContext *resampler;
  struct ern_mono mono;
  float *wide, *block; /* [block_frames][channels] as pushed, [block_frames] mono, at the sound's rate: the resampler */
  size_t block_frames, filled; /* gets only whole blocks, so that rows do not depend on how the caller cut the sound */
  float frame[ERN_CEPSTRA_FRAME]; /* the first `waiting` samples of the next row */
  size_t waiting;                 /* samples in `frame` */
  float *row;                     /* [row_capacity][width]: computed and not yet pulled */
  size_t rows, row_capacity;
  uint64_t pushed, made; /* frames pushed; rows computed */
  bool ended;
  ern_status failed; /* the error of a call after which rows are missing */
};

static ern_status make_resampler(ern_speech_stream *s) {
  AVChannelLayout mono = AV_CHANNEL_LAYOUT_MONO;
  int error = swr_alloc_set_opts2(&s->resampler, &mono, AV_SAMPLE_FMT_FLT, ERN_CEPSTRA_RATE, &mono, AV_SAMPLE_FMT_FLT,
                                  s->rate, 0, NULL);
  if (error >= 0) error = swr_init(s->resampler);
  return error >= 0 ? ERN_OK : ern_av_fail(s->context, ERN_E_MEDIA, "speech", "convert its samples", error);
}

ern_status ern_speech_stream_open(ern_context *context, int rate, int channels, float warp,
                                  ern_speech_stream **stream) {
  return ern_speech_stream_open_kind(context, ERN_SPEECH_CEPSTRA, rate, channels, warp, stream);
}

ern_status ern_speech_stream_open_kind(ern_context *context, const char *kind, int rate, int channels, float warp,
                                       ern_speech_stream **stream) {
  ERN_PLAIN_FLOATS;
  if (stream != NULL) *stream = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, kind);
  ERN_NEED(context, stream);
  ern_status status = ERN_OK;
  ern_speech_stream *s = NULL;
  if (rate < ERN_CEPSTRA_LEAST_RATE || rate > MOST_RATE || channels < 1 || channels > MOST_CHANNELS)
    return ern_fail(context, ERN_E_ARGUMENT,
                    "speech: sound has %d samples a second and %d channels, expected 1000 to %d and 1 to %d", rate,
                    channels, MOST_RATE, MOST_CHANNELS);
  ERN_TRY(ern_speech_check_kind(context, kind));
  ERN_TRY(ern_cepstra_check_warp(context, warp));
  ERN_TRY(ERN_NEW(context, 1, &s));
  s->width = (size_t)ern_speech_width(kind);
  s->context = context;
  s->rate = rate;
  s->channels = channels;
  s->block_frames = (size_t)rate / 100;
  s->waiting = HALF_OVERLAP; /* zeros before the sound */
  ERN_TRY(ERN_NEW(context, s->block_frames * (size_t)channels, &s->wide));
  ERN_TRY(ERN_NEW(context, s->block_frames, &s->block));
  ERN_TRY(ern_cepstra_make(context, warp, &s->cepstra));
  if (strcmp(kind, ERN_SPEECH_ARTICULATORY) == 0) ERN_TRY(ern_articulatory_make(context, &s->articulatory));
  ERN_TRY(make_resampler(s));
  *stream = s;
  return ERN_OK;
fail:
  ern_speech_stream_free(&s);
  return status;
}

void ern_speech_stream_free(ern_speech_stream **stream) {
  if (stream == NULL || *stream == NULL) return;
  ern_speech_stream *s = *stream;
  *stream = NULL;
  swr_free(&s->resampler);
  ern_cepstra_free(s->context, s->cepstra);
  ern_articulatory_free(s->context, s->articulatory);
  ern_release(s->context, s->wide);
  ern_release(s->context, s->block);
  ern_release(s->context, s->row);
  ern_release(s->context, s);
}

static void compute_row(ern_speech_stream *s, float *row) {
  float band[ERN_CEPSTRA_BANDS];
  const bool audible = ern_cepstra_bands(s->cepstra, s->frame, band);
  ern_cepstra_row(s->cepstra, band, row);
  if (s->articulatory != NULL) ern_articulatory_row(s->articulatory, band, audible, row + ERN_CEPSTRA_WIDTH);
}

static ern_status make_row(ern_speech_stream *s) {
  if (s->rows == s->row_capacity) {
    const size_t more = s->row_capacity > 0 ? 2 * s->row_capacity : 64;
    float *larger = NULL;
    const ern_status status = ERN_NEW(s->context, more * s->width, &larger);
    if (status != ERN_OK) return status;
    if (s->rows > 0) memcpy(larger, s->row, s->rows * s->width * sizeof *s->row);
    ern_release(s->context, s->row);
    s->row = larger;
    s->row_capacity = more;
  }
  compute_row(s, s->row + s->rows++ * s->width);
  s->made++;
  memmove(s->frame, s->frame + ERN_CEPSTRA_HOP, (ERN_CEPSTRA_FRAME - ERN_CEPSTRA_HOP) * sizeof *s->frame);
  s->waiting = ERN_CEPSTRA_FRAME - ERN_CEPSTRA_HOP;
  return ERN_OK;
}

/* Takes samples at 16 kHz. */
static ern_status take_samples(ern_speech_stream *s, const float *samples, size_t count) {
  while (count > 0) {
    const size_t left = ERN_CEPSTRA_FRAME - s->waiting, part = count < left ? count : left;
    memcpy(s->frame + s->waiting, samples, part * sizeof *samples);
    s->waiting += part;
    samples += part;
    count -= part;
    if (s->waiting < ERN_CEPSTRA_FRAME) continue;
    const ern_status status = make_row(s);
    if (status != ERN_OK) return status;
  }
  return ERN_OK;
}

/* Mixes and resamples the block; count 0: flushes the resampler. */
static ern_status resample(ern_speech_stream *s, size_t count) {
  if (ern_mono_mix(&s->mono, s->block, s->wide, s->channels, count, s->rate))
    ern_log(s->context, ERN_LOG_WARNING, "speech: " ERN_MONO_WORDS);
  float out[1024];
  const uint8_t *from = (const uint8_t *)s->block;
  for (int given = (int)count;; given = 0) {
    uint8_t *to = (uint8_t *)out;
    const int most = sizeof out / sizeof *out;
    const bool flush = s->ended && given == 0;
    const int made = swr_convert(s->resampler, &to, most, flush ? NULL : &from, given);
    if (made < 0) return ern_av_fail(s->context, ERN_E_MEDIA, "speech", "convert its samples", made);
    const ern_status status = take_samples(s, out, (size_t)made);
    if (status != ERN_OK || made < most) return status;
  }
}

static ern_status refuse_failed(const ern_speech_stream *s) {
  return ern_fail(s->context, ERN_E_STATE,
                  "speech: an earlier call failed (%s) and left rows out, so the stream cannot be used any more",
                  ern_status_name(s->failed));
}

ern_status ern_speech_stream_push(ern_speech_stream *stream, const float *samples, size_t frames) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, stream);
  ern_speech_stream *s = stream;
  if (frames > 0) ERN_NEED(s->context, samples);
  if (s->failed != ERN_OK) return refuse_failed(s);
  if (s->ended) return ern_fail(s->context, ERN_E_STATE, "speech: the sound has ended, no more can be pushed");
  for (size_t i = 0; i < frames; i++) {
    for (int c = 0; c < s->channels; c++) {
      const float sample = samples[i * (size_t)s->channels + (size_t)c];
      if (!isfinite(sample) || fabsf(sample) > 1e6f)
        return ern_fail(s->context, isfinite(sample) ? ERN_E_FORMAT : ERN_E_NONFINITE,
                        "speech: the sample at %.3f s is %g, expected a finite number, -1 to 1 as a rule",
                        (double)s->pushed / s->rate, (double)sample);
      s->wide[s->filled * (size_t)s->channels + (size_t)c] = sample;
    }
    s->filled++;
    s->pushed++;
    if (s->filled < s->block_frames) continue;
    const ern_status status = resample(s, s->filled);
    s->filled = 0;
    if (status != ERN_OK) return s->failed = status;
  }
  return ERN_OK;
}

ern_status ern_speech_stream_end(ern_speech_stream *stream) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, stream);
  ern_speech_stream *s = stream;
  ern_status status = ERN_OK;
  static const float zeros[ERN_CEPSTRA_FRAME] = {0};
  if (s->failed != ERN_OK) return refuse_failed(s);
  if (s->ended) return ERN_OK;
  if (s->filled > 0) ERN_TRY(resample(s, s->filled));
  s->ended = true;
  ERN_TRY(resample(s, 0));
  /* one row for each 20 ms begun */
  const uint64_t samples = (s->pushed * ERN_CEPSTRA_RATE + (uint64_t)s->rate - 1) / (uint64_t)s->rate,
                 rows = (samples + ERN_CEPSTRA_HOP - 1) / ERN_CEPSTRA_HOP;
  while (s->made < rows) ERN_TRY(take_samples(s, zeros, ERN_CEPSTRA_FRAME - s->waiting));
  if (s->made > rows) s->rows -= (size_t)(s->made - rows); /* the resampler's last samples */
fail:
  return s->failed = status;
}

size_t ern_speech_stream_pull(ern_speech_stream *stream, float *rows, size_t count) {
  if (stream == NULL || rows == NULL) return 0;
  const size_t pulled = count < stream->rows ? count : stream->rows;
  if (pulled == 0) return 0;
  memcpy(rows, stream->row, pulled * stream->width * sizeof *rows);
  stream->rows -= pulled;
  memmove(stream->row, stream->row + pulled * stream->width, stream->rows * stream->width * sizeof *rows);
  return pulled;
}
