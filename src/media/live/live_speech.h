/* SPDX-License-Identifier: MIT
 * The features of sound that goes on: rows that came last, and the windows that a model hears of them. */
#ifndef ERN_MEDIA_LIVE_SPEECH_H
#define ERN_MEDIA_LIVE_SPEECH_H

#include "ernerf/data.h"
#include "ernerf/model.h"
#include "ernerf/speech.h"

/* A tick is 40 ms, a frame at 25 a second. */
enum { ERN_LIVE_TICKS_A_SECOND = 25, ERN_LIVE_WINDOWS = 8, ERN_LIVE_WINDOWS_BEFORE = 4 };

struct ern_live_speech {
  ern_context *context;
  ern_speech_stream *stream; /* NULL: windows come ready, and a row is one of them */
  int window_length, width;
  size_t values;        /* of a row */
  uint64_t rows_a_tick; /* 2, of windows 1 */
  ern_audio_pad pad;
  float *row; /* [capacity][values] */
  size_t capacity, count;
  uint64_t first;         /* number of row[0] */
  uint64_t skip_at, skip; /* so many rows are left out once row skip_at is the next */
  bool ended;
};

/* rate, channels: of the sound; 0: windows. ticks: most that are kept. */
ERN_NODISCARD ern_status ern_live_speech_open(ern_context *context, int rate, int channels, int window_length,
                                              int width, size_t ticks, struct ern_live_speech *speech);
void ern_live_speech_close(struct ern_live_speech *speech); /* accepts a zeroed one */

/* data: samples, or windows. */
ERN_NODISCARD ern_status ern_live_speech_push(struct ern_live_speech *speech, const float *data, size_t count);
ERN_NODISCARD ern_status ern_live_speech_end(struct ern_live_speech *speech);

/* Of the sound pushed so far, which is `all` ticks, only the first `kept` count. */
void ern_live_speech_cut(struct ern_live_speech *speech, uint64_t kept, uint64_t all);
/* Rows that only windows before `tick` need may go. */
void ern_live_speech_forget(struct ern_live_speech *speech, uint64_t tick);

/* window[window_length][width] of tick `tick`, which hears rows before `end` alone: past them the last row. */
void ern_live_speech_window(const struct ern_live_speech *speech, int64_t tick, uint64_t end, float *window);

#endif
