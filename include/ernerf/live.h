/* SPDX-License-Identifier: MIT
 * libernerf-media: speech as it comes, to frames as they are due. */
#ifndef ERNERF_LIVE_H
#define ERNERF_LIVE_H

#include <stdbool.h>

#include "ernerf/render.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What happens to sound for which there is no room, as frames are not pulled as fast as sound is pushed. */
typedef enum ern_live_policy {
  ERN_LIVE_WAIT = 0,  /* a push waits for room: every frame is given */
  ERN_LIVE_DROP = 1,  /* the oldest frames are left out, with their sound; a push never waits */
  ERN_LIVE_REPEAT = 2 /* once half of the room is taken, frames are marked ern_live_frame.repeat, so that the caller
                         catches up without drawing them; no sound is lost, and a push waits where there is no room */
} ern_live_policy;

enum { ERN_LIVE_LEAST_LOOK_AHEAD = 2, ERN_LIVE_LOOK_AHEAD = 7 };

/* Plain data, may grow. */
typedef struct ern_live_options {
  uint32_t cookie, size;    /* set by ern_live_options_default() */
  int rate, channels;       /* of the sound that is pushed: 1000..384000 samples a second, 1..8; default 16000, 1.
                               It becomes the built-in features (ERN_SPEECH_CEPSTRA) */
  int window_length, width; /* of windows of features that are pushed in the place of sound, 1..16, 1..4096;
                               default 0, 0: sound is pushed */
  int look_ahead;           /* 2..7, default 7: frame t (25 a second) hears the sound before 0.04 (t + look_ahead) s,
                               and is given once the sound up to 0.04 (t + look_ahead + 1) s was pushed. 7 is all
                               that a model hears; with less, what is not there yet is taken to be as the last
                               row of features that is. Windows: 3 at most count */
  int capacity;             /* most sound that waits, in frames at 25 a second: 20..1000, default 50 */
  int policy;               /* ern_live_policy, default ERN_LIVE_WAIT */
  int rate_numerator, rate_denominator; /* frames a second that are pulled, each 1..1000000; 1 to 100 a second, default
                                           25, 1. Between two frames at 25 a second windows are interpolated */
  ern_audio_pad pad; /* what a model hears before the sound and after it (ern_model_info), default edge */
  bool rests;        /* false (default): a frame waits for its sound. true, for a picture that must go on: where
                        sound is not there, a pull makes the rest that it needs; where the last sound is not
                        rest, it first gives frames that hear less, down to 2 of look_ahead, so that sound may
                        come up to 0.04 (look_ahead - 2) s late */
  const ern_silence *silence; /* tells pauses in what is pushed; NULL (default): only silence by ern_live_rest counts.
                                 Must outlive the session */
  const float *silence_code;  /* [32] the mean code of silence (ern_renderer_code), which is copied; NULL (default): the
                                 mouth follows the sound alone */
} ern_live_options;
ERN_API void ern_live_options_fill(ern_live_options *options, size_t bytes);
static inline ern_live_options ern_live_options_default(void) {
  ern_live_options options;
  ern_live_options_fill(&options, sizeof options);
  return options;
}

/* The speech of one speaker, from sound to what a frame is drawn with. It draws nothing itself: renderers on one model
 * do (ern_live_draw), so any number of sessions share a model. Its memory does not grow. Any thread may call any
 * function of a session at the same time, but ern_live_free; one thread pulls. */
typedef struct ern_live ern_live;

/* A frame that is due. Plain data, may grow: it is the session's, and valid until the next pull. */
typedef struct ern_live_frame {
  uint64_t number;      /* of the frame, from 0; a gap where frames were dropped */
  double seconds;       /* at which it is shown, number / frames a second, by the clock of the session's sound */
  const float *windows; /* [8][window_length][width] */
  int window_length, width;
  float silence_weight;      /* 0 speech .. 1 silence; it takes five frames to rise and three to fall */
  const float *silence_code; /* [32], or NULL */
  const float *sound;        /* [samples][channels]: what is heard while it is shown; NULL where windows are pushed */
  size_t samples;            /* rate / frames a second, to within one */
  bool resting;              /* its sound was made by ern_live_rest */
  bool repeat;               /* ERN_LIVE_REPEAT: not to be drawn, the last picture is shown again */
  uint64_t dropped;          /* frames so far that were left out */
  double waiting;            /* seconds of sound that wait after this frame's */
} ern_live_frame;

/* options NULL: the defaults. ERN_E_ARGUMENT names the option. On success the caller owns *live. */
ERN_API ERN_NODISCARD ern_status ern_live_open(ern_context *context, const ern_live_options *options, ern_live **live);
ERN_API void ern_live_free(ern_live **live); /* accepts NULL and a pointer to NULL; no other call may be under way */

/* samples: [frames][channels], full scale is 1; any number of them. A sample that is not finite, or beyond 1e6, is
 * ERN_E_NONFINITE or ERN_E_FORMAT, and nothing of the call is taken. How sound is cut into calls does not change a bit
 * of the frames. ERN_E_CANCELLED: ern_live_cancel came while it waited, the rest of the call is not taken. ERN_E_STATE:
 * the sound has ended, or windows are expected. */
ERN_API ERN_NODISCARD ern_status ern_live_push(ern_live *live, const float *samples, size_t frames);
/* The same of windows [count][window_length][width], one for each frame at 25 a second, -1e30 to 1e30. */
ERN_API ERN_NODISCARD ern_status ern_live_push_windows(ern_live *live, const float *windows, size_t count);

/* Nothing is said: silence to the end of the frame (25 a second) that has begun, at least one sample. Windows: the last
 * one again. ERN_E_STATE where there is no room, or the sound has ended. */
ERN_API ERN_NODISCARD ern_status ern_live_rest(ern_live *live);
/* So much silence that each frame with sound is given. What is pushed later follows it. */
ERN_API ERN_NODISCARD ern_status ern_live_flush(ern_live *live);
/* Forgets the sound that waits, but for 40 to 80 ms that fade out, and ends a push that waits. */
ERN_API ERN_NODISCARD ern_status ern_live_cancel(ern_live *live);
/* The sound ends: nothing can be pushed any more, and the last frames are given as if silence followed. */
ERN_API ERN_NODISCARD ern_status ern_live_end(ern_live *live);

/* *frame = the next one; NULL where its sound is not there after `wait` seconds (0: at once; at most 3600), or where
 * the sound has ended and all frames were given: then *ended is set. */
ERN_API ERN_NODISCARD ern_status ern_live_pull(ern_live *live, double wait, const ern_live_frame **frame, bool *ended);

/* Draws a frame: ern_renderer_frame, with windows and silence of `frame` in the place of the input's. */
ERN_API ERN_NODISCARD ern_status ern_live_draw_sized(const ern_live_frame *frame, ern_renderer *renderer,
                                                     const ern_frame_input *input, size_t input_bytes,
                                                     const ern_frame_output *output, size_t output_bytes,
                                                     ern_frame_times *times, size_t times_bytes);
static inline ERN_NODISCARD ern_status ern_live_draw(const ern_live_frame *frame, ern_renderer *renderer,
                                                     const ern_frame_input *input, const ern_frame_output *output,
                                                     ern_frame_times *times) {
  return ern_live_draw_sized(frame, renderer, input, sizeof *input, output, sizeof *output, times, sizeof *times);
}

#ifdef __cplusplus
}
#endif
#endif
