/* SPDX-License-Identifier: MIT
 * A session of live speech. Its clock is the number of pushed samples, including silence of ern_live_insert_silence.
 * Pushed windows count as samples at 25 a second. */
#include "ernerf/live.h"

#include <errno.h>
#include <math.h>
#include <pthread.h>
#include <string.h>
#include <time.h>

#include "core/floats.h"
#include "core/memory.h"
#include "core/sized.h"
#include "io/feature_range.h"
#include "media/live/live_limits.h"
#include "media/live/live_speech.h"

enum {
  CODE = 32,
  SILENCE_TICKS = 2048, /* a power of two above ERN_LIVE_MOST_CAPACITY plus the ticks read before and after */
  PAUSE_BEFORE = 16,    /* ticks before and after a frame that are searched for a pause */
  PAUSE_AFTER = 3,
  PAUSE_TICKS = PAUSE_BEFORE + 1 + PAUSE_AFTER,
  WINDOWS_AFTER = 3,
  PART = 256 /* samples processed at a time */
};
static const float RISE = 0.2f, FALL = 1.0f / 3; /* rates of the silence's weight, a tick */

static const float zeros[PART * 8] = {0}; /* samples of 8 channels */

struct ern_live {
  ern_context *context;
  ern_live_options options;
  int rate; /* of samples, or of windows, a second */
  pthread_mutex_t mutex;
  pthread_cond_t moved;
  struct ern_live_speech speech;
  float *sound; /* [capacity][channels]: from the beginning of the next frame on */
  size_t capacity;
  uint64_t first, samples;      /* number of sound[0]; number of pushed samples */
  bool inserted[SILENCE_TICKS]; /* [t % SILENCE_TICKS]: ern_live_insert_silence made tick t */
  uint64_t next;                /* number of the next frame */
  uint64_t weighed;             /* tick of the last weight */
  uint64_t cancels, dropped;
  float weight, code[CODE];
  bool has_weight, ended;
  float *windows, *second, *pause; /* [8][...] of a frame; [8][...] to interpolate with; [PAUSE_TICKS][...] */
  float *frame_sound;              /* the sound of the current frame */
  ern_live_frame frame;
};

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static ern_status check_options(ern_context *context, const ern_live_options *o) {
  const ern_status status = ern_live_settings_check(context, o);
  if (status != ERN_OK) return status;
  if ((o->window_length == 0) != (o->width == 0))
    return ern_fail(context, ERN_E_ARGUMENT,
                    o->width != 0 ? "live: window_length is 0, expected 1 to 16, as width is %d"
                                  : "live: width is 0, expected 1 to 4096, as window_length is %d",
                    o->width + o->window_length);
  if (o->rate_numerator < o->rate_denominator || o->rate_numerator > 100 * (int64_t)o->rate_denominator)
    return ern_fail(context, ERN_E_ARGUMENT, "live: %d/%d frames a second, expected 1 to 100", o->rate_numerator,
                    o->rate_denominator);
  const int64_t ticks = (int64_t)ERN_LIVE_TICKS_A_SECOND * o->rate_denominator; /* of rate_numerator frames */
  const bool between = ticks % o->rate_numerator != 0;                          /* a frame may begin inside a tick */
  const int64_t frame = (ticks + o->rate_numerator - 1) / o->rate_numerator + between;
  if (o->capacity < frame)
    return ern_fail(context, ERN_E_ARGUMENT, "live: capacity is %d, expected %d to %d, which one frame of %d/%d needs",
                    o->capacity, (int)frame, ERN_LIVE_MOST_CAPACITY, o->rate_numerator, o->rate_denominator);
  for (int c = 0; o->silence_code != NULL && c < CODE; c++)
    if (!isfinite(o->silence_code[c]))
      return ern_fail(context, ERN_E_NONFINITE, "live: silence_code[%d] is not finite", c);
  return ERN_OK;
}

static ern_status make_lock(ern_live *live) {
  pthread_condattr_t monotonic;
  int error = pthread_condattr_init(&monotonic);
  if (error == 0) {
    error = pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
    if (error == 0) error = pthread_cond_init(&live->moved, &monotonic);
    (void)pthread_condattr_destroy(&monotonic);
  }
  if (error != 0) return ern_fail(live->context, ERN_E_NO_MEMORY, "live: no condition variable: %s", strerror(error));
  error = pthread_mutex_init(&live->mutex, NULL);
  if (error == 0) return ERN_OK;
  (void)pthread_cond_destroy(&live->moved);
  return ern_fail(live->context, ERN_E_NO_MEMORY, "live: no mutex: %s", strerror(error));
}

static void free_parts(ern_live *live) {
  ern_live_speech_close(&live->speech);
  ern_release(live->context, live->sound);
  ern_release(live->context, live->windows);
  ern_release(live->context, live->second);
  ern_release(live->context, live->pause);
  ern_release(live->context, live->frame_sound);
}

ern_status ern_live_open(ern_context *context, const ern_live_options *options, ern_live **live) {
  ERN_PLAIN_FLOATS;
  if (live != NULL) *live = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, live);
  ern_live_options chosen = ern_live_options_default();
  ern_live *made = NULL;
  ern_status status = ERN_OK;
  if (options != NULL) ERN_TRY(ERN_COPY_IN_CONFIG(context, ern_live_options, &chosen, options));
  if (chosen.speech == NULL) chosen.speech = ERN_SPEECH_CEPSTRA;
  ERN_TRY(check_options(context, &chosen));
  ERN_TRY(ERN_NEW(context, 1, &made));
  made->context = context;
  const bool windows = chosen.width > 0;
  if (windows) chosen.channels = 0;
  if (windows && chosen.look_ahead > WINDOWS_AFTER) chosen.look_ahead = WINDOWS_AFTER;
  for (int a = chosen.rate_numerator, b = chosen.rate_denominator; a != 0;) { /* lowest terms, against overflow */
    const int divisor = a;
    a = b % a;
    b = divisor;
    if (a != 0) continue;
    chosen.rate_numerator /= divisor;
    chosen.rate_denominator /= divisor;
  }
  made->options = chosen;
  made->rate = windows ? ERN_LIVE_TICKS_A_SECOND : chosen.rate;
  ERN_TRY(ern_live_speech_open(context, chosen.speech, chosen.rate, chosen.channels, chosen.window_length, chosen.width,
                               (size_t)chosen.capacity, &made->speech));
  made->options.speech = NULL;
  made->speech.pad = chosen.pad;
  const size_t window = (size_t)made->speech.window_length * (size_t)made->speech.width;
  const size_t tick = windows ? 1 : (size_t)made->rate / ERN_LIVE_TICKS_A_SECOND + 1;
  made->capacity = (size_t)chosen.capacity * tick;
  ERN_TRY(ERN_NEW(context, made->capacity * (size_t)chosen.channels, &made->sound));
  ERN_TRY(ERN_NEW(context, ERN_LIVE_WINDOWS * window, &made->windows));
  ERN_TRY(ERN_NEW(context, ERN_LIVE_WINDOWS * window, &made->second));
  ERN_TRY(ERN_NEW(context, PAUSE_TICKS * window, &made->pause));
  ERN_TRY(ERN_NEW(context, ((size_t)made->rate + 1) * (size_t)chosen.channels, &made->frame_sound));
  if (chosen.silence_code != NULL) memcpy(made->code, chosen.silence_code, sizeof made->code);
  ERN_TRY(make_lock(made));
  *live = made;
  return ERN_OK;
fail:
  if (made != NULL) free_parts(made);
  ern_release(context, made);
  return status;
}

void ern_live_free(ern_live **live) {
  if (live == NULL || *live == NULL) return;
  ern_live *dying = *live;
  *live = NULL;
  free_parts(dying);
  (void)pthread_mutex_destroy(&dying->mutex);
  (void)pthread_cond_destroy(&dying->moved);
  ern_release(dying->context, dying);
}

/* ---- the clock --------------------------------------------------------------------------------------------------- */

/* The first sample of a tick, and of a frame; the tick in which a frame begins, and whether it begins later than that.
 */
static uint64_t sample_of_tick(const ern_live *l, uint64_t tick) {
  const uint64_t ticks = ERN_LIVE_TICKS_A_SECOND;
  return (tick * (uint64_t)l->rate + ticks - 1) / ticks;
}
static uint64_t sample_of_frame(const ern_live *l, uint64_t number) {
  return number * (uint64_t)l->options.rate_denominator * (uint64_t)l->rate / (uint64_t)l->options.rate_numerator;
}
static uint64_t tick_of_frame(const ern_live *l, uint64_t number, double *toward) {
  const uint64_t place = number * (uint64_t)l->options.rate_denominator * ERN_LIVE_TICKS_A_SECOND,
                 rate = (uint64_t)l->options.rate_numerator;
  if (toward != NULL) *toward = (double)(place % rate) / (double)rate;
  return place / rate;
}
static uint64_t whole_ticks(const ern_live *l) { return l->samples * ERN_LIVE_TICKS_A_SECOND / (uint64_t)l->rate; }

/* Whether enough sound is there for frame `number` with `look_ahead` ticks of look-ahead; is_ready: for the next frame.
 */
static bool is_frame_ready(const ern_live *l, uint64_t number, int look_ahead) {
  double toward;
  const uint64_t tick = tick_of_frame(l, number, &toward);
  if (l->ended) return sample_of_frame(l, number) < l->samples;
  return whole_ticks(l) >= tick + (toward > 0) + (uint64_t)look_ahead + 1 &&
         l->samples >= sample_of_frame(l, number + 1);
}
static bool is_ready(const ern_live *l, int look_ahead) { return is_frame_ready(l, l->next, look_ahead); }

/* The number of rows, counted from the first, that the windows of tick `tick` may use. */
static uint64_t rows_available(const ern_live *l, uint64_t tick) {
  uint64_t ahead = (uint64_t)l->options.look_ahead;
  const uint64_t whole = whole_ticks(l);
  if (!l->ended && whole < tick + ahead + 1) ahead = whole > tick ? whole - tick - 1 : 0;
  return l->options.channels > 0 ? (tick + ahead) * l->speech.rows_a_tick : tick + ahead + 1;
}

/* Discards the sound before the next frame. */
static void forget(ern_live *l) {
  const uint64_t begin = sample_of_frame(l, l->next), end = begin < l->samples ? begin : l->samples;
  const size_t channels = (size_t)l->options.channels, left = (size_t)(l->samples - end);
  if (channels > 0 && end > l->first)
    memmove(l->sound, l->sound + (size_t)(end - l->first) * channels, left * channels * sizeof *l->sound);
  if (end > l->first) l->first = end;
  ern_live_speech_forget(&l->speech, tick_of_frame(l, l->next, NULL));
}

/* ---- sound in ---------------------------------------------------------------------------------------------------- */

/* Returns the free space in samples, 0: none; ERN_LIVE_DROP drops frames to make space. */
static size_t find_space(ern_live *l) {
  while (l->options.policy == ERN_LIVE_DROP && l->samples - l->first >= l->capacity) {
    l->next++;
    l->dropped++;
    forget(l);
  }
  return l->capacity - (size_t)(l->samples - l->first);
}

/* Appends samples, for which there must be space; silence: they are from ern_live_insert_silence. */
static ern_status take(ern_live *l, const float *data, size_t count, bool silence) {
  const size_t values = l->options.channels > 0 ? (size_t)l->options.channels : l->speech.values;
  const uint64_t from = l->samples * ERN_LIVE_TICKS_A_SECOND / (uint64_t)l->rate;
  const ern_status status = ern_live_speech_push(&l->speech, data, count);
  if (status != ERN_OK) return status;
  if (l->options.channels > 0)
    memcpy(l->sound + (size_t)(l->samples - l->first) * values, data, count * values * sizeof *data);
  const bool begun = l->samples == sample_of_tick(l, from);
  l->samples += count;
  const uint64_t to = (l->samples - 1) * ERN_LIVE_TICKS_A_SECOND / (uint64_t)l->rate;
  for (uint64_t t = from; t <= to; t++) {
    bool *inserted = &l->inserted[t % SILENCE_TICKS];
    *inserted = silence && (t > from || begun || *inserted);
  }
  (void)pthread_cond_broadcast(&l->moved);
  return ERN_OK;
}

static ern_status push_part(ern_live *l, const float *data, size_t values, size_t count, uint64_t cancels) {
  ern_status status = ERN_OK;
  do {
    if (l->ended) return ern_fail(l->context, ERN_E_STATE, "live: the sound has ended, no more can be pushed");
    if (l->cancels != cancels)
      return ern_fail(l->context, ERN_E_CANCELLED, "live: the sound that waited was cancelled");
    if (count == 0) break;
    size_t space = find_space(l);
    if (space == 0) {
      (void)pthread_cond_wait(&l->moved, &l->mutex);
      continue;
    }
    if (space > PART) space = PART;
    const size_t taken = count < space ? count : space;
    ERN_TRY(take(l, data, taken, false));
    data += taken * values;
    count -= taken;
  } while (count > 0);
fail:
  return status;
}

static ern_status check_samples(const ern_live *l, const float *samples, size_t values) {
  for (size_t i = 0; i < values; i++) {
    if (isfinite(samples[i]) && fabsf(samples[i]) <= 1e6f) continue;
    return ern_fail(l->context, isfinite(samples[i]) ? ERN_E_FORMAT : ERN_E_NONFINITE,
                    "live: sample %zu of those pushed is %g, expected a finite number, -1 to 1 as a rule",
                    i / (size_t)l->options.channels, (double)samples[i]);
  }
  return ERN_OK;
}

static ern_status push(ern_live *l, const float *data, size_t values, size_t count) {
  (void)pthread_mutex_lock(&l->mutex);
  const ern_status status = push_part(l, data, values, count, l->cancels);
  (void)pthread_mutex_unlock(&l->mutex);
  return status;
}

ern_status ern_live_push(ern_live *live, const float *samples, size_t frames) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, live);
  const size_t channels = (size_t)live->options.channels;
  if (frames > 0) ERN_NEED(live->context, samples);
  if (channels == 0)
    return ern_fail(live->context, ERN_E_STATE, "live: sound was pushed, expected windows of features");
  const ern_status status = check_samples(live, samples, frames * channels);
  return status == ERN_OK ? push(live, samples, channels, frames) : status;
}

ern_status ern_live_push_windows(ern_live *live, const float *windows, size_t count) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, live);
  if (count > 0) ERN_NEED(live->context, windows);
  if (live->options.channels > 0)
    return ern_fail(live->context, ERN_E_STATE, "live: windows of features were pushed, expected sound");
  for (size_t i = 0; i < count * live->speech.values; i++)
    if (!ern_feature_fits(windows[i]))
      return ern_fail(live->context, isfinite(windows[i]) ? ERN_E_FORMAT : ERN_E_NONFINITE,
                      "live: window %zu of those pushed has %g in place %zu, expected a finite number, -1e30 to 1e30",
                      i / live->speech.values, (double)windows[i], i % live->speech.values);
  return push(live, windows, live->speech.values, count);
}

/* The caller holds the lock. */
static ern_status insert_frame(ern_live *l) {
  const uint64_t until = sample_of_tick(l, whole_ticks(l) + 1);
  ern_status status = ERN_OK;
  if (l->ended) return ern_fail(l->context, ERN_E_STATE, "live: the sound has ended, no silence can follow");
  if (l->capacity - (size_t)(l->samples - l->first) < (size_t)(until - l->samples) &&
      l->options.policy != ERN_LIVE_DROP)
    return ern_fail(l->context, ERN_E_STATE, "live: no room for silence, %d frames of sound wait", l->options.capacity);
  while (l->samples < until) {
    const size_t space = find_space(l), left = (size_t)(until - l->samples), most = space < PART ? space : PART;
    if (l->options.channels > 0) {
      ERN_TRY(take(l, zeros, left < most ? left : most, true));
    } else {
      ern_live_speech_window(&l->speech, (int64_t)l->samples - 1, l->samples, l->second);
      ERN_TRY(take(l, l->second, 1, true));
    }
  }
fail:
  return status;
}

ern_status ern_live_insert_silence(ern_live *live) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, live);
  (void)pthread_mutex_lock(&live->mutex);
  const ern_status status = insert_frame(live);
  (void)pthread_mutex_unlock(&live->mutex);
  return status;
}

ern_status ern_live_flush(ern_live *live) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, live);
  ern_status status = ERN_OK;
  (void)pthread_mutex_lock(&live->mutex);
  const uint64_t samples = live->samples;
  uint64_t last = live->next; /* the last frame that has sound */
  while (sample_of_frame(live, last + 1) < samples) last++;
  if (live->ended) status = ern_fail(live->context, ERN_E_STATE, "live: the sound has ended, no silence can follow");
  while (status == ERN_OK && sample_of_frame(live, last) < samples &&
         !is_frame_ready(live, last, live->options.look_ahead))
    status = insert_frame(live);
  (void)pthread_mutex_unlock(&live->mutex);
  return status;
}

/* Discards the sound after the last tick that is kept; fades that tick out. */
static ern_status cancel(ern_live *l) {
  ern_status status = ERN_OK;
  double toward;
  const size_t channels = (size_t)l->options.channels;
  const uint64_t place = tick_of_frame(l, l->next, &toward), kept = place + (toward > 0) + (channels > 0);
  l->cancels++;
  (void)pthread_cond_broadcast(&l->moved);
  if (l->ended) return ern_fail(l->context, ERN_E_STATE, "live: the sound has ended, nothing can be cancelled");
  const uint64_t all = whole_ticks(l) + (l->samples > sample_of_tick(l, whole_ticks(l)));
  if (kept >= all) return ERN_OK;
  for (size_t left = (size_t)(sample_of_tick(l, all) - l->samples), part; left > 0; left -= part) {
    part = left < PART ? left : PART; /* rows are aligned to ticks */
    ERN_TRY(ern_live_speech_push(&l->speech, zeros, part));
  }
  ern_live_speech_cut(&l->speech, kept, all);
  const uint64_t end = sample_of_tick(l, kept), begin = sample_of_tick(l, kept - (channels > 0));
  l->samples = end;
  for (uint64_t i = begin < l->first ? l->first : begin; i < end; i++)
    for (size_t c = 0; c < channels; c++)
      l->sound[(size_t)(i - l->first) * channels + c] *= (float)(end - i) / (float)(end - begin + 1);
fail:
  return status;
}

ern_status ern_live_cancel(ern_live *live) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, live);
  (void)pthread_mutex_lock(&live->mutex);
  const ern_status status = cancel(live);
  (void)pthread_mutex_unlock(&live->mutex);
  return status;
}

uint64_t ern_live_samples(ern_live *live) {
  if (live == NULL) return 0;
  (void)pthread_mutex_lock(&live->mutex);
  const uint64_t samples = live->samples;
  (void)pthread_mutex_unlock(&live->mutex);
  return samples;
}

ern_status ern_live_end(ern_live *live) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, live);
  (void)pthread_mutex_lock(&live->mutex);
  const ern_status status = live->ended ? ERN_OK : ern_live_speech_end(&live->speech);
  live->ended = live->ended || status == ERN_OK;
  (void)pthread_cond_broadcast(&live->moved);
  (void)pthread_mutex_unlock(&live->mutex);
  return status;
}

/* ---- frames out -------------------------------------------------------------------------------------------------- */

/* Writes the 8 windows of tick `tick`. */
static void make_windows(const ern_live *l, uint64_t tick, float *windows) {
  const struct ern_live_speech *s = &l->speech;
  const size_t window = (size_t)s->window_length * (size_t)s->width;
  const uint64_t end = rows_available(l, tick);
  for (int k = 0; k < ERN_LIVE_WINDOWS; k++)
    ern_live_speech_window(s, (int64_t)tick + k - ERN_LIVE_WINDOWS_BEFORE, end, windows + (size_t)k * window);
}

/* *pause: whether the features around a tick are silence. */
static ern_status find_pause(ern_live *l, uint64_t tick, bool *pause) {
  const struct ern_live_speech *s = &l->speech;
  const size_t window = (size_t)s->window_length * (size_t)s->width;
  const uint64_t first = tick > PAUSE_BEFORE ? tick - PAUSE_BEFORE : 0, end = rows_available(l, tick);
  const size_t here = (size_t)(tick - first);
  ern_features around = {
      .data = l->pause, .windows = here + 1 + PAUSE_AFTER, .window_length = s->window_length, .width = s->width};
  float weight[PAUSE_TICKS];
  for (size_t i = 0; i < around.windows; i++)
    ern_live_speech_window(s, (int64_t)(first + i), end, l->pause + i * window);
  const ern_status status = ern_silence_weights(l->options.silence, &around, weight);
  if (status != ERN_OK) return status;
  *pause = true;
  for (size_t i = here; i < here + PAUSE_AFTER; i++) *pause &= weight[i] > 0.5f;
  return ERN_OK;
}

/* Moves the weight of silence by a step toward the target of tick `tick`. */
static ern_status weigh(ern_live *l, uint64_t tick) {
  bool quiet = true;
  ern_status status = ERN_OK;
  if (l->options.silence_code == NULL) return ERN_OK;
  const uint64_t known = whole_ticks(l);
  for (uint64_t t = tick; t <= tick + PAUSE_AFTER && t < known; t++) quiet &= l->inserted[t % SILENCE_TICKS];
  if (!quiet && l->options.silence != NULL) ERN_TRY(find_pause(l, tick, &quiet));
  const float target = quiet ? 1 : 0, ticks = (float)(tick - l->weighed);
  if (!l->has_weight)
    l->weight = target;
  else if (target > l->weight)
    l->weight = fminf(target, l->weight + RISE * ticks);
  else
    l->weight = fmaxf(target, l->weight - FALL * ticks);
  l->has_weight = true;
  l->weighed = tick;
fail:
  return status;
}

static ern_status give(ern_live *l) {
  double toward;
  const uint64_t number = l->next, tick = tick_of_frame(l, number, &toward), begin = sample_of_frame(l, number),
                 after = sample_of_frame(l, number + 1), end = after < l->samples ? after : l->samples;
  const size_t channels = (size_t)l->options.channels,
               values = ERN_LIVE_WINDOWS * (size_t)l->speech.window_length * (size_t)l->speech.width;
  ern_live_frame *f = &l->frame;
  ern_status status = ERN_OK;
  make_windows(l, tick, l->windows);
  if (toward > 0) {
    make_windows(l, tick + 1, l->second);
    for (size_t i = 0; i < values; i++) l->windows[i] += (float)toward * (l->second[i] - l->windows[i]);
  }
  ERN_TRY(weigh(l, tick));
  if (channels > 0)
    memcpy(l->frame_sound, l->sound + (size_t)(begin - l->first) * channels,
           (size_t)(end - begin) * channels * sizeof(float));
  *f = (ern_live_frame){.number = number,
                        .seconds = (double)number * l->options.rate_denominator / l->options.rate_numerator,
                        .windows = l->windows,
                        .window_length = l->speech.window_length,
                        .width = l->speech.width,
                        .silence_weight = l->weight,
                        .silence_code = l->options.silence_code != NULL ? l->code : NULL,
                        .sound = channels > 0 ? l->frame_sound : NULL,
                        .samples = channels > 0 ? (size_t)(end - begin) : 0,
                        .inserted_silence = l->inserted[tick % SILENCE_TICKS],
                        .dropped = l->dropped,
                        .waiting = (double)(l->samples - end) / l->rate};
  f->repeat = l->options.policy == ERN_LIVE_REPEAT &&
              (size_t)(l->samples - end) > l->capacity / 2 + (size_t)sample_of_tick(l, (uint64_t)l->options.look_ahead);
  l->next++;
  forget(l);
  (void)pthread_cond_broadcast(&l->moved);
fail:
  return status;
}

/* Implements ern_live_options.insert_silence. *ahead: the look-ahead of the next frame. */
static ern_status fill_missing(ern_live *l, int *ahead) {
  ern_status status = ERN_OK;
  while (status == ERN_OK && !is_ready(l, *ahead)) {
    const uint64_t whole = whole_ticks(l);
    const bool silent = whole == 0 || l->inserted[(whole - 1) % SILENCE_TICKS];
    const int least = l->options.channels > 0 ? ERN_LIVE_LEAST_LOOK_AHEAD : 1;
    if (!silent && is_ready(l, least)) {
      *ahead = least;
      return ERN_OK;
    }
    status = insert_frame(l);
  }
  return status;
}

static struct timespec after_seconds(double seconds) {
  struct timespec at;
  (void)clock_gettime(CLOCK_MONOTONIC, &at);
  const double whole = floor(seconds);
  at.tv_sec += (time_t)whole;
  at.tv_nsec += (long)((seconds - whole) * 1e9);
  if (at.tv_nsec >= 1000000000) {
    at.tv_nsec -= 1000000000;
    at.tv_sec++;
  }
  return at;
}

ern_status ern_live_pull(ern_live *live, double wait, const ern_live_frame **frame, bool *ended) {
  ERN_PLAIN_FLOATS;
  if (frame != NULL) *frame = NULL;
  if (ended != NULL) *ended = false;
  ERN_NEED(NULL, live);
  ERN_NEED(live->context, frame);
  ERN_NEED(live->context, ended);
  if (!(wait >= 0 && wait <= 3600))
    return ern_fail(live->context, ERN_E_ARGUMENT, "live: wait is %g s, expected 0 to 3600", wait);
  ern_status status = ERN_OK;
  const struct timespec until = after_seconds(wait);
  int ahead = live->options.look_ahead;
  (void)pthread_mutex_lock(&live->mutex);
  for (int error = 0; !is_ready(live, ahead) && !live->ended && error != ETIMEDOUT && wait > 0;)
    error = pthread_cond_timedwait(&live->moved, &live->mutex, &until);
  if (live->options.insert_silence && !live->ended) status = fill_missing(live, &ahead);
  if (status == ERN_OK && is_ready(live, ahead)) {
    status = give(live);
    if (status == ERN_OK) *frame = &live->frame;
  } else if (status == ERN_OK) {
    *ended = live->ended;
  }
  (void)pthread_mutex_unlock(&live->mutex);
  return status;
}

ern_status ern_live_draw_sized(const ern_live_frame *frame, ern_renderer *renderer, const ern_frame_input *input,
                               size_t input_bytes, const ern_frame_output *output, size_t output_bytes,
                               ern_frame_times *times, size_t times_bytes) {
  ERN_NEED(NULL, frame);
  ERN_NEED(NULL, renderer);
  ern_frame_input own = {0};
  const ern_features windows = {.data = (float *)(uintptr_t)frame->windows,
                                .windows = ERN_LIVE_WINDOWS,
                                .window_length = frame->window_length,
                                .width = frame->width};
  if (input == NULL ||
      ERN_COPY_IN(NULL, ern_frame_input, &own, input, input_bytes) != ERN_OK) /* ERN_COPY_IN reports the error */
    return ern_renderer_frame_sized(renderer, input, input_bytes, output, output_bytes, times, times_bytes);
  const ern_status status = ern_renderer_accepts(renderer, &windows, "live");
  if (status != ERN_OK) return status;
  own.windows = frame->windows;
  own.window_length = frame->window_length;
  own.silence_code = frame->silence_code;
  own.silence_weight = frame->silence_weight;
  return ern_renderer_frame_sized(renderer, &own, sizeof own, output, output_bytes, times, times_bytes);
}
