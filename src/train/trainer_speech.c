/* SPDX-License-Identifier: MIT
 * The speech of a frame: as it is, and with the data augmentation of a training step (copies, noise). */
#include <math.h>
#include <string.h>

#include "core/memory.h"
#include "core/rng.h"
#include "core/status.h"
#include "render/frame_input.h"
#include "train/trainer.h"

static size_t window_values(const ern_features *features) {
  return (size_t)features->window_length * (size_t)features->width;
}

/* audio_pad edge: indexed by window of the features; zero: by position in the split, as in the public code. */
static ern_status read_windows(ern_trainer *t, const ern_features *features, int split, size_t frame, float *host) {
  const int64_t frames = (int64_t)t->shared.data.frames[split], last = (int64_t)features->windows - 1;
  const size_t size = window_values(features);
  ern_dataset_frame about;
  ern_status status = ern_trainer_frame(t, split, frame, &about);
  if (status != ERN_OK) return status;
  if (t->shared.config.audio_pad == ERN_AUDIO_PAD_EDGE) {
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

ern_status ern_trainer_windows(ern_trainer *t, int split, size_t frame, float *host) {
  return read_windows(t, t->shared.data.features, split, frame, host);
}

ern_status ern_trainer_speech_make(ern_trainer *t) {
  const ern_features *features = t->shared.data.features;
  const size_t width = (size_t)features->width, vectors = features->windows * (size_t)features->window_length;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(t->shared.context, ERN_AUDIO_WINDOWS * window_values(features), &t->host_windows));
  if (!(t->shared.data.speech_noise > 0)) return ERN_OK;
  ERN_TRY(ERN_NEW(t->shared.context, width, &t->speech_deviation));
  for (size_t c = 0; c < width; c++) {
    double sum = 0, squares = 0;
    for (size_t i = 0; i < vectors; i++) sum += (double)features->data[i * width + c];
    const double mean = sum / (double)vectors;
    for (size_t i = 0; i < vectors; i++) {
      const double off = (double)features->data[i * width + c] - mean;
      squares += off * off;
    }
    t->speech_deviation[c] = (float)sqrt(squares / (double)vectors);
  }
fail:
  return status;
}

/* Vectors of speech are 50 a second and windows 25, so window w has the vectors 2w, 2w + 1, ... A vector has the same
 * noise in all windows that it is in. A sum of 32 random bits is close to normal: mean 16, variance 8. */
static void add_noise(const ern_trainer *t, size_t k, float *host) {
  const size_t length = (size_t)t->shared.data.features->window_length, width = (size_t)t->shared.data.features->width;
  const size_t vectors = 2 * (ERN_AUDIO_WINDOWS - 1) + length;
  const float scale = t->shared.data.speech_noise / sqrtf(8);
  for (size_t v = 0; v < vectors; v++) {
    const size_t first = v < length ? 0 : (v - length) / 2 + 1, last = v / 2;
    for (size_t c = 0; c < width; c += 4) {
      const uint32_t index = (uint32_t)((k * vectors + v) * width + c);
      const struct ern_random random =
          ern_random_at(t->shared.config.seed, t->shared.step, index, ERN_RNG_SPEECH_NOISE);
      for (size_t i = 0; i < 4 && c + i < width; i++) {
        const float noise = scale * t->speech_deviation[c + i] * (float)(__builtin_popcount(random.word[i]) - 16);
        for (size_t w = first; w <= last && w < ERN_AUDIO_WINDOWS; w++)
          host[(w * length + v - 2 * w) * width + c + i] += noise;
      }
    }
  }
}

/* The windows of training frame `frame` with the data augmentation of frame k of the step. */
static ern_status step_windows(ern_trainer *t, size_t frame, size_t k, float *host) {
  const ern_dataset *data = &t->shared.data;
  const struct ern_random random = ern_random_at(t->shared.config.seed, t->shared.step, (uint32_t)k, ERN_RNG_SPEECH);
  const bool copy = data->copy_count > 0 && ern_uniform(random.word[0]) < data->copy_share;
  const ern_features *features =
      copy ? &data->copies[ern_below(random.word[1], (uint32_t)data->copy_count)] : data->features;
  const ern_status status = read_windows(t, features, 0, frame, host);
  if (status == ERN_OK && data->speech_noise > 0) add_noise(t, k, host);
  return status;
}

ern_status ern_trainer_upload_windows(ern_trainer *t, size_t frame, size_t k, ern_span *windows) {
  const size_t values = ERN_AUDIO_WINDOWS * window_values(t->shared.data.features);
  ern_status status = ERN_OK;
  ERN_TRY(step_windows(t, frame, k, t->host_windows));
  ERN_TRY(ern_scratch_take(t->shared.stream, ERN_ELEMENT_REAL, values, windows));
  ERN_TRY(t->shared.backend->upload_reals(t->shared.stream, *windows, t->host_windows, values));
fail:
  return status;
}
