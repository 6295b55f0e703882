/* SPDX-License-Identifier: MIT */
#include "media/live/live_speech.h"

#include <string.h>

#include "core/memory.h"
#include "core/status.h"

/* KEPT_BEFORE: ticks before the next frame that its windows and the search for pauses may need. SPARE: ticks that
 * interpolation and look-ahead need after the last queued tick. */
enum { WINDOW = 16, WINDOW_BEFORE = 8, KEPT_BEFORE = 32, SPARE = 32, PULLED = 16 };

ern_status ern_live_speech_open(ern_context *context, const char *kind, int rate, int channels, int window_length,
                                int width, size_t ticks, struct ern_live_speech *speech) {
  ern_status status = ERN_OK;
  const bool sound = channels > 0;
  *speech = (struct ern_live_speech){.context = context,
                                     .window_length = sound ? WINDOW : window_length,
                                     .width = sound ? ern_speech_width(kind) : width,
                                     .rows_a_tick = sound ? 2 : 1};
  const size_t window = (size_t)speech->window_length * (size_t)speech->width;
  speech->values = sound ? (size_t)speech->width : window;
  speech->capacity = (ticks + KEPT_BEFORE + SPARE) * (size_t)speech->rows_a_tick;
  if (sound) ERN_TRY(ern_speech_stream_open_kind(context, kind, rate, channels, 1, &speech->stream));
  ERN_TRY(ERN_NEW(context, speech->capacity * speech->values, &speech->row));
fail:
  if (status != ERN_OK) ern_live_speech_close(speech);
  return status;
}

void ern_live_speech_close(struct ern_live_speech *speech) {
  ern_speech_stream_free(&speech->stream);
  ern_release(speech->context, speech->row);
  *speech = (struct ern_live_speech){0};
}

static ern_status add_row(struct ern_live_speech *s, const float *row) {
  if (s->skip > 0 && s->first + s->count == s->skip_at) {
    s->skip--;
    return ERN_OK;
  }
  if (s->count == s->capacity)
    return ern_fail(s->context, ERN_E_STATE, "live: %zu rows of speech wait, which is all that there is room for",
                    s->count);
  memcpy(s->row + s->count++ * s->values, row, s->values * sizeof *row);
  return ERN_OK;
}

static ern_status take_rows(struct ern_live_speech *s) {
  float rows[PULLED * ERN_SPEECH_MOST_WIDTH];
  for (;;) {
    const size_t pulled = ern_speech_stream_pull(s->stream, rows, PULLED);
    for (size_t i = 0; i < pulled; i++) {
      const ern_status status = add_row(s, rows + i * s->values);
      if (status != ERN_OK) return status;
    }
    if (pulled < PULLED) return ERN_OK;
  }
}

ern_status ern_live_speech_push(struct ern_live_speech *s, const float *data, size_t count) {
  ern_status status = ERN_OK;
  if (s->stream != NULL) {
    ERN_TRY(ern_speech_stream_push(s->stream, data, count));
    return take_rows(s);
  }
  for (size_t i = 0; i < count; i++) ERN_TRY(add_row(s, data + i * s->values));
fail:
  return status;
}

ern_status ern_live_speech_end(struct ern_live_speech *s) {
  ern_status status = ERN_OK;
  if (s->stream != NULL) {
    ERN_TRY(ern_speech_stream_end(s->stream));
    ERN_TRY(take_rows(s));
  }
  s->ended = true;
fail:
  return status;
}

void ern_live_speech_cut(struct ern_live_speech *s, uint64_t kept, uint64_t all) {
  const uint64_t from = kept * s->rows_a_tick, made = s->first + s->count;
  const uint64_t gone = made > from ? made - from : 0; /* discarded rows that exist already */
  s->count -= (size_t)(gone < s->count ? gone : s->count);
  s->skip += (all - kept) * s->rows_a_tick - gone;
  s->skip_at = from;
}

void ern_live_speech_forget(struct ern_live_speech *s, uint64_t tick) {
  if (tick <= KEPT_BEFORE) return;
  const uint64_t first = (tick - KEPT_BEFORE) * s->rows_a_tick;
  if (first <= s->first) return;
  const size_t old = (size_t)(first - s->first) < s->count ? (size_t)(first - s->first) : s->count;
  memmove(s->row, s->row + old * s->values, (s->count - old) * s->values * sizeof *s->row);
  s->count -= old;
  s->first += old;
}

/* The row nearest to `r` among the stored rows before `end`. */
static const float *row_at(const struct ern_live_speech *s, int64_t r, uint64_t end) {
  const uint64_t made = s->first + s->count;
  const int64_t last = (int64_t)(end < made ? end : made) - 1, first = (int64_t)s->first;
  if (r > last) r = last;
  if (r < first) r = first;
  return s->row + (size_t)(r - first) * s->values;
}

void ern_live_speech_window(const struct ern_live_speech *s, int64_t tick, uint64_t end, float *window) {
  const uint64_t made = s->first + s->count, last = (made + s->rows_a_tick - 1) / s->rows_a_tick;
  const size_t bytes = s->values * sizeof *window;
  const bool outside = tick < 0 || (s->ended && tick >= (int64_t)last);
  if (s->pad == ERN_AUDIO_PAD_ZERO && outside) {
    memset(window, 0, (size_t)s->window_length * (size_t)s->width * sizeof *window);
    return;
  }
  if (tick < 0) tick = 0; /* the nearest window */
  if (s->ended && tick >= (int64_t)last) tick = (int64_t)last - 1;
  if (s->stream == NULL) {
    memcpy(window, row_at(s, tick, end), bytes);
    return;
  }
  for (int i = 0; i < WINDOW; i++)
    memcpy(window + (size_t)i * s->values, row_at(s, 2 * tick - WINDOW_BEFORE + i, end), bytes);
}
