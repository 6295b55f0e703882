/* SPDX-License-Identifier: MIT
 * The eight windows of speech around a frame. */
#include <string.h>

#include "ernerf/render.h"
#include "io/feature_range.h"
#include "mlp/audio_ops.h"

enum { BEFORE = 4 }; /* windows before the frame's own: t-4 .. t+3 */

static size_t window_size(const ern_features *features) {
  return (size_t)features->window_length * (size_t)features->width;
}

/* Whether the sizes of the features are valid. */
static bool are_whole(const ern_features *features) {
  return features != NULL && ern_features_check(NULL, "", features) == ERN_OK;
}

static int64_t clamped(int64_t index, size_t count) {
  const int64_t last = (int64_t)count - 1;
  return index < 0 ? 0 : index > last ? last : index;
}

/* Clamps an index so that adding window offsets cannot overflow. All indices far outside the features have the same
 * windows. */
static int64_t near(int64_t index, size_t count) {
  const int64_t most = (int64_t)(count < INT64_MAX / 2 ? count : INT64_MAX / 2) + ERN_AUDIO_WINDOWS;
  return index < -most ? -most : index > most ? most : index;
}

void ern_audio_windows(float *windows, const ern_features *features, int64_t index, ern_audio_pad pad) {
  if (windows == NULL || !are_whole(features)) return;
  const size_t size = window_size(features);
  index = near(index, features->windows);
  for (int k = 0; k < ERN_AUDIO_WINDOWS; k++) {
    const int64_t at = index - BEFORE + k, nearest = clamped(at, features->windows);
    float *to = windows + (size_t)k * size;
    if (pad == ERN_AUDIO_PAD_ZERO && at != nearest)
      memset(to, 0, size * sizeof *to);
    else
      memcpy(to, features->data + (size_t)nearest * size, size * sizeof *to);
  }
}

void ern_audio_windows_of_rows(float *windows, const ern_features *features, const int64_t *rows, size_t count,
                               int64_t index) {
  if (windows == NULL || !are_whole(features) || (rows == NULL && count > 0)) return;
  const size_t size = window_size(features);
  index = near(index, count);
  for (int k = 0; k < ERN_AUDIO_WINDOWS; k++) {
    const int64_t at = index - BEFORE + k;
    float *to = windows + (size_t)k * size;
    if (at < 0 || at >= (int64_t)count)
      memset(to, 0, size * sizeof *to);
    else
      memcpy(to, features->data + (size_t)clamped(rows[at], features->windows) * size, size * sizeof *to);
  }
}
