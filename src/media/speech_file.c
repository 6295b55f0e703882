/* SPDX-License-Identifier: MIT
 * Speech features of a sound file, decoded piece by piece. */
#include <stdio.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "ernerf/speech.h"
#include "media/input.h"
#include "media/sound_decoder.h"
#include "media/speech/cepstra.h"

enum { WINDOW = 16, BEFORE = 8 /* rows of a window before its frame */ };

struct job {
  ern_context *context;
  const char *path, *kind;
  float warp;
  ern_speech_stream *stream;
  uint64_t frames;
  int rate;
};

static ern_status push(void *user, int rate, int channels, const float *samples, size_t frames) {
  struct job *job = user;
  ern_status status = ERN_OK;
  if (job->stream == NULL && rate < ERN_CEPSTRA_LEAST_RATE)
    return ern_fail(job->context, ERN_E_SHAPE, "%s: sound has %d samples a second, expected at least %d", job->path,
                    rate, ERN_CEPSTRA_LEAST_RATE);
  if (job->stream == NULL)
    status = ern_speech_stream_open_kind(job->context, job->kind, rate, channels, job->warp, &job->stream);
  if (status != ERN_OK) return status;
  job->rate = rate;
  job->frames += frames;
  status = ern_speech_stream_push(job->stream, samples, frames);
  if (status == ERN_OK) return status;
  char reason[ERN_ERROR_BYTES];
  ern_error_keep(job->context, reason);
  return ern_fail(job->context, status, "%s: %.1800s", job->path, reason);
}

/* Window t is rows 2t-8 .. 2t+7; past the ends the nearest row. */
static void make_windows(const float *row, size_t rows, ern_features *features) {
  const size_t width = (size_t)features->width;
  for (size_t t = 0; t < features->windows; t++)
    for (size_t k = 0; k < WINDOW; k++) {
      const size_t at = 2 * t + k, wanted = at > BEFORE ? at - BEFORE : 0, from = wanted < rows ? wanted : rows - 1;
      memcpy(features->data + (t * WINDOW + k) * width, row + from * width, width * sizeof *row);
    }
}

static ern_status take_rows(struct job *job, ern_features *features) {
  const int width = ern_speech_width(job->kind);
  float *row = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ern_speech_stream_end(job->stream));
  const size_t most = (size_t)(job->frames * ERN_CEPSTRA_RATE / (uint64_t)job->rate) / ERN_CEPSTRA_HOP + 2;
  ERN_TRY(ERN_NEW(job->context, most * (size_t)width, &row));
  const size_t rows = ern_speech_stream_pull(job->stream, row, most);
  *features = (ern_features){.windows = (rows + 1) / 2, .window_length = WINDOW, .width = width};
  ERN_TRY(ERN_NEW(job->context, features->windows * WINDOW * (size_t)width, &features->data));
  make_windows(row, rows, features);
fail:
  ern_release(job->context, row);
  return status;
}

ern_status ern_speech_check_kind(ern_context *context, const char *kind) {
  if (ern_speech_width(kind) > 0) return ERN_OK;
  return ern_fail(context, ERN_E_ARGUMENT, "speech: kind is \"%s\", expected %s or %s", kind, ERN_SPEECH_ARTICULATORY,
                  ERN_SPEECH_CEPSTRA);
}

ern_status ern_speech_features(ern_context *context, const char *path, float warp, ern_features *features) {
  return ern_speech_features_kind(context, path, ERN_SPEECH_CEPSTRA, warp, features);
}

ern_status ern_speech_features_kind(ern_context *context, const char *path, const char *kind, float warp,
                                    ern_features *features) {
  ERN_PLAIN_FLOATS;
  if (features != NULL) *features = (ern_features){0};
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, kind);
  ERN_NEED(context, features);
  struct job job = {.context = context, .path = path, .kind = kind, .warp = warp};
  ern_status status = ERN_OK;
  ERN_TRY(ern_speech_check_kind(context, kind));
  ERN_TRY(ern_cepstra_check_warp(context, warp));
  ERN_TRY(ern_sound_decode(context, path, push, &job));
  ERN_TRY(take_rows(&job, features));
fail:
  if (status != ERN_OK) ern_features_free(context, features);
  ern_speech_stream_free(&job.stream);
  return status;
}

/* ---- features or sound ------------------------------------------------------------------------------------------- */

ern_status ern_speech_open(ern_context *context, const char *path, const char *kind, ern_features *features) {
  if (features != NULL) *features = (ern_features){0};
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, features);
  ern_status status = ERN_OK;
  ERN_TRY(ern_input_check(context, path));
  if (ern_speech_is_sound(path)) {
    if (kind != NULL && ern_speech_width(kind) == 0)
      ERN_TRY(ern_fail(context, ERN_E_UNSUPPORTED,
                       "%s: features of %s%s are needed, and only %s and %s are made of a sound without a network; "
                       "expected a .npy file, or the network that makes them",
                       path, kind[0] != 0 ? "the kind " : "an unknown kind", kind, ERN_SPEECH_ARTICULATORY,
                       ERN_SPEECH_CEPSTRA));
    ERN_TRY(ern_speech_features_kind(context, path, kind != NULL ? kind : ERN_SPEECH_CEPSTRA, 1, features));
    return ERN_OK;
  }
  ERN_TRY(ern_features_load(context, path, features));
fail:
  if (status != ERN_OK) ern_features_free(context, features);
  return status;
}
