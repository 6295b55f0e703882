/* SPDX-License-Identifier: MIT
 * The speech of a frame: as it is, and with the data augmentation of a training step (copies, noise). */
#include "train/parts/trainer_speech.h"

#include <math.h>
#include <string.h>

#include "core/memory.h"
#include "core/rng.h"
#include "core/status.h"
#include "render/frame_input.h"
#include "render/render_ops.h"
#include "train/parts/trainer_data.h"

static size_t window_values(const ern_features *features) {
  return (size_t)features->window_length * (size_t)features->width;
}

/* audio_pad edge: indexed by window of the features; zero: by position in the split, as in the public code. */
static ern_status read_windows(const struct ern_training *t, const ern_features *features, int split, size_t frame,
                               float *host) {
  const int64_t frames = (int64_t)t->data.frames[split], last = (int64_t)features->windows - 1;
  const size_t size = window_values(features);
  ern_dataset_frame about;
  ern_status status = ern_trainer_frame(t, split, frame, &about);
  if (status != ERN_OK) return status;
  if (t->config.audio_pad == ERN_AUDIO_PAD_EDGE) {
    ern_audio_windows(host, features, about.aud_id < last ? about.aud_id : last, ERN_AUDIO_PAD_EDGE);
    return ERN_OK;
  }
  for (int w = 0; w < ERN_AUDIO_WINDOWS && status == ERN_OK; w++) {
    const int64_t at = (int64_t)frame - 4 + w;
    float *to = host + (size_t)w * size;
    memset(to, 0, size * sizeof *to);
    if (at < 0 || at >= frames) continue;
    status = ern_trainer_frame(t, split, (size_t)at, &about);
    if (status != ERN_OK) break;
    const int64_t row = about.aud_id < last ? about.aud_id : last;
    memcpy(to, features->data + (size_t)row * size, size * sizeof *to);
  }
  return status;
}

ern_status ern_trainer_windows(const struct ern_trainer_speech *s, int split, size_t frame, float *host) {
  return read_windows(s->training, s->training->data.features, split, frame, host);
}

ern_status ern_trainer_speech_make(struct ern_trainer_speech *s, const struct ern_training *t) {
  const ern_features *features = t->data.features;
  const size_t width = (size_t)features->width, vectors = features->windows * (size_t)features->window_length;
  ern_status status = ERN_OK;
  *s = (struct ern_trainer_speech){.training = t};
  ERN_TRY(ERN_NEW(t->context, ERN_AUDIO_WINDOWS * window_values(features), &s->windows));
  if (!(t->data.speech_noise > 0)) return ERN_OK;
  ERN_TRY(ERN_NEW(t->context, width, &s->deviation));
  for (size_t c = 0; c < width; c++) {
    double sum = 0, squares = 0;
    for (size_t i = 0; i < vectors; i++) sum += (double)features->data[i * width + c];
    const double mean = sum / (double)vectors;
    for (size_t i = 0; i < vectors; i++) {
      const double off = (double)features->data[i * width + c] - mean;
      squares += off * off;
    }
    s->deviation[c] = (float)sqrt(squares / (double)vectors);
  }
fail:
  return status;
}

void ern_trainer_speech_free(struct ern_trainer_speech *s, ern_context *context) {
  ern_release(context, s->windows);
  ern_release(context, s->deviation);
}

/* Vectors of speech are 50 a second and windows 25, so window w has the vectors 2w, 2w + 1, ... A vector has the same
 * noise in all windows that it is in. A sum of 32 random bits is close to normal: mean 16, variance 8. */
static void add_noise(const struct ern_trainer_speech *s, size_t k, float *host) {
  const struct ern_training *t = s->training;
  const size_t length = (size_t)t->data.features->window_length, width = (size_t)t->data.features->width;
  const size_t vectors = 2 * (ERN_AUDIO_WINDOWS - 1) + length;
  const float scale = t->data.speech_noise / sqrtf(8);
  for (size_t v = 0; v < vectors; v++) {
    const size_t first = v < length ? 0 : (v - length) / 2 + 1, last = v / 2;
    for (size_t c = 0; c < width; c += 4) {
      const uint32_t index = (uint32_t)((k * vectors + v) * width + c);
      const struct ern_random random = ern_random_at(t->config.seed, t->step, index, ERN_RNG_SPEECH_NOISE);
      for (size_t i = 0; i < 4 && c + i < width; i++) {
        const float noise = scale * s->deviation[c + i] * (float)(__builtin_popcount(random.word[i]) - 16);
        for (size_t w = first; w <= last && w < ERN_AUDIO_WINDOWS; w++)
          host[(w * length + v - 2 * w) * width + c + i] += noise;
      }
    }
  }
}

/* The windows of training frame `frame` with the data augmentation of frame k of the step. */
static ern_status step_windows(const struct ern_trainer_speech *s, size_t frame, size_t k, float *host) {
  const struct ern_training *t = s->training;
  const ern_dataset *data = &t->data;
  const struct ern_random random = ern_random_at(t->config.seed, t->step, (uint32_t)k, ERN_RNG_SPEECH);
  const bool copy = data->copy_count > 0 && ern_uniform(random.word[0]) < data->copy_share;
  const ern_features *features =
      copy ? &data->copies[ern_below(random.word[1], (uint32_t)data->copy_count)] : data->features;
  const ern_status status = read_windows(t, features, 0, frame, host);
  if (status == ERN_OK && data->speech_noise > 0) add_noise(s, k, host);
  return status;
}

ern_status ern_trainer_upload_windows(const struct ern_trainer_speech *s, size_t frame, size_t k, ern_span *windows) {
  const struct ern_training *t = s->training;
  const size_t values = ERN_AUDIO_WINDOWS * window_values(t->data.features);
  ern_status status = ERN_OK;
  ERN_TRY(step_windows(s, frame, k, s->windows));
  ERN_TRY(ern_scratch_take(t->stream, ERN_ELEMENT_REAL, values, windows));
  ERN_TRY(t->backend->upload_reals(t->stream, *windows, s->windows, values));
fail:
  return status;
}

ern_status ern_trainer_audio_code(const struct ern_trainer_speech *s, size_t frame, ern_span *code) {
  const struct ern_training *t = s->training;
  struct ern_audio_fwd_args audio = {.parameters = t->parameters, .net = t->model->field.audio};
  ern_status status = ERN_OK;
  ERN_TRY(ern_trainer_upload_windows(s, frame, 0, &audio.windows));
  ERN_TRY(ern_scratch_take(t->stream, ERN_ELEMENT_REAL, ERN_AUDIO_CODE, &audio.code));
  ERN_TRY(t->backend->audio_fwd(t->stream, &audio));
  *code = audio.code;
fail:
  return status;
}
