/* SPDX-License-Identifier: MIT
 * The speech features of live sound: the latest feature rows, and the windows of them that are the model's input. */
#ifndef ERN_MEDIA_LIVE_SPEECH_H
#define ERN_MEDIA_LIVE_SPEECH_H

#include "ernerf/data.h"
#include "ernerf/model.h"
#include "ernerf/speech.h"

/* A tick is 40 ms, a frame at 25 a second. */
enum { ERN_LIVE_TICKS_A_SECOND = 25, ERN_LIVE_WINDOWS = 8, ERN_LIVE_WINDOWS_BEFORE = 4 };

struct ern_live_speech {
  ern_context *context;
  ern_speech_stream *stream; /* NULL: the caller pushes finished windows, and a row is a window */
  int window_length, width;
  size_t values;        /* values a row */
  uint64_t rows_a_tick; /* 2; 1 where a row is a window */
  ern_audio_pad pad;
  float *row; /* [capacity][values] */
  size_t capacity, count;
  uint64_t first;         /* number of row[0] */
  uint64_t skip_at, skip; /* the `skip` rows from number skip_at on are dropped */
  bool ended;
};

/* kind, rate, channels: of the sound and the features made of it; channels 0: the caller pushes windows. ticks: the
 * most that are kept. */
ERN_NODISCARD ern_status ern_live_speech_open(ern_context *context, const char *kind, int rate, int channels,
                                              int window_length, int width, size_t ticks,
                                              struct ern_live_speech *speech);
void ern_live_speech_close(struct ern_live_speech *speech); /* accepts a zeroed one */

/* data: [count] frames of samples, or windows. */
ERN_NODISCARD ern_status ern_live_speech_push(struct ern_live_speech *speech, const float *data, size_t count);
ERN_NODISCARD ern_status ern_live_speech_end(struct ern_live_speech *speech);

/* Discards all but the first `kept` of the `all` ticks of sound pushed so far. */
void ern_live_speech_cut(struct ern_live_speech *speech, uint64_t kept, uint64_t all);
/* Frees the rows that only windows before `tick` need. */
void ern_live_speech_forget(struct ern_live_speech *speech, uint64_t tick);

/* window[window_length][width] of tick `tick`, made of the rows before `end` alone: the last of them stands for later
 * ones. */
void ern_live_speech_window(const struct ern_live_speech *speech, int64_t tick, uint64_t end, float *window);

#endif
