/* SPDX-License-Identifier: MIT
 * libernerf-media: from sound while it comes in to the speech input of each video frame. base.h defines the terms
 * "plain data" and "may grow", and what all functions do with NULL and after errors. */
#ifndef ERNERF_LIVE_H
#define ERNERF_LIVE_H

#include <stdbool.h>

#include "ernerf/render.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What a push does where `capacity` is used up, as frames are pulled more slowly than sound is pushed. With WAIT
 * and REPEAT a push can block until another thread pulls: where more than 0.04 capacity - `waiting` s are pushed after
 * a frame was pulled (ern_live_frame.waiting; 0 before the first frame). A program with a single thread pushes no more
 * than that between two pulls. */
typedef enum ern_live_policy {
  ERN_LIVE_WAIT = 0,  /* it blocks until a pull makes room: every frame is given */
  ERN_LIVE_DROP = 1,  /* it drops the oldest frames with their sound, and never blocks */
  ERN_LIVE_REPEAT = 2 /* it blocks as with ERN_LIVE_WAIT; a frame is marked ern_live_frame.repeat where more than
                         0.04 (capacity/2 + look_ahead) s of sound wait after it, so that the caller catches up */
} ern_live_policy;

enum { ERN_LIVE_LEAST_LOOK_AHEAD = 2, ERN_LIVE_LOOK_AHEAD = 7 };

/* Plain data, may grow. */
typedef struct ern_live_options {
  uint32_t cookie, size;    /* set by ern_live_options_default() */
  int rate, channels;       /* of the sound that is pushed: 1000..384000 samples a second, 1..8; default 48000, 1, as of
                               ern_sound_reader_options. The session computes built-in features of all channels
                               (ern_speech_stream_open_kind) */
  int window_length, width; /* of windows of features that are pushed instead of sound, 1..16, 1..4096; default 0, 0:
                               sound is pushed. A window has window_length vectors of `width` numbers and belongs to one
                               frame at 25 a second (ern_features) */
  int look_ahead; /* 2..7, default 7. Frame t (25 a second) depends on the sound before 0.04 (t + look_ahead) s
                     and can be pulled when the sound up to 0.04 (t + look_ahead + 1) s was pushed. At another
                     rate t is the frame's place at 25 a second, rounded up, and all of its own sound must have
                     been pushed. A frame's windows reach 7 frames ahead; with less, the last known vector (or pushed
                     window) is repeated in place of those that are missing. Where windows are pushed, above 3
                     acts as 3 */
  int capacity;   /* most sound that waits, the look-ahead included, in frames at 25 a second: 20..1000, and not
                     less than one frame of the session; default 50 */
  int policy;     /* ern_live_policy, default ERN_LIVE_WAIT */
  int rate_numerator, rate_denominator; /* frames a second that are pulled, each 1..1000000; 1 to 100 a second, default
                                           25, 1. Between two frames at 25 a second windows are interpolated */
  ern_audio_pad pad; /* the windows before the first and after the last: ern_model_info.audio_pad of the model; default
                        ERN_AUDIO_PAD_EDGE */
  /* false (default): a pull returns no frame before its sound is there. true: every ern_live_pull returns a frame until
   * ern_live_end. Where sound is missing after its `wait` seconds, it first uses less look-ahead, down to 2 (windows:
   * 1), then inserts silence as ern_live_insert_silence does. So sound may come up to 0.04 (look_ahead - 2) s late
   * without inserted silence */
  bool insert_silence;
  const ern_silence *silence; /* finds pauses in the speech that is pushed (ern_silence_learn); NULL (default): only
                                 inserted silence counts as a pause. Must outlive the session */
  const float *silence_code;  /* [32] the silence code of a clip (ern_renderer_code), which the mouth takes in pauses;
                                 copied. NULL (default): the mouth follows the sound alone */
  const char *speech;         /* built-in kind (speech.h) that the session computes of the sound that is pushed:
                                 ern_model_info.speech; NULL (default): ERN_SPEECH_CEPSTRA; read by ern_live_open alone */
} ern_live_options;

/* The members of ern_live_options in their order, cookie and size left out (setting.h); NULL past the last. */
ERN_API const ern_setting *ern_live_setting(size_t index);

/* The defaults. */
ERN_API void ern_live_options_fill(ern_live_options *options, size_t bytes);
static inline ern_live_options ern_live_options_default(void) {
  ern_live_options options;
  ern_live_options_fill(&options, sizeof options);
  return options;
}

/* A session: the speech of one speaker. It holds no model and no renderer (ern_live_draw takes one), so any number of
 * sessions share a model. Its memory does not grow. Any thread may call any function at any time, with two exceptions:
 * one thread at a time pulls, and no call may be under way when ern_live_free is called. Samples of two threads that
 * push at the same time may mix. */
typedef struct ern_live ern_live;

/* The speech input of a frame. Plain data, may grow: it belongs to the session and is valid until the next pull. */
typedef struct ern_live_frame {
  uint64_t number;      /* of the frame, from 0; a gap where frames were dropped */
  double seconds;       /* at which it is shown, number / frames a second, by the clock of the session's sound */
  const float *windows; /* [8][window_length][width]: 4 before the frame's own, its own, 3 after (ern_audio_windows) */
  int window_length, width; /* vectors in a window, and numbers in a vector */
  float silence_weight;     /* 0 speech .. 1 silence; it rises in 0.2 s, and falls in the 0.12 s before speech begins */
  const float *silence_code; /* [32], or NULL */
  const float *sound;        /* [samples][channels]: what is heard while it is shown; NULL where windows are pushed */
  size_t samples;            /* of `sound`, in a channel: rate / frames a second, to within one; in the last frame after
                                ern_live_end 1 or more */
  bool inserted_silence;     /* its sound is inserted silence */
  bool repeat;               /* ERN_LIVE_REPEAT: the caller shows the last picture again and need not render this one */
  uint64_t dropped;          /* frames so far that ERN_LIVE_DROP dropped */
  double waiting;            /* seconds of sound that wait after this frame's */
} ern_live_frame;

/* options NULL: the defaults. ERN_E_ARGUMENT names the option. On success the caller owns *live. */
ERN_API ERN_NODISCARD ern_status ern_live_open(ern_context *context, const ern_live_options *options, ern_live **live);
ERN_API void ern_live_free(ern_live **live); /* accepts NULL and a pointer to NULL; no other call may be under way */

/* samples: [frames][channels], a frame being one sample of each channel here; full scale is 1; any number. A sample
 * that is not finite, or beyond 1e6, is ERN_E_NONFINITE or ERN_E_FORMAT, and nothing of the call is taken. The frames
 * are the same, bit for bit, however the sound is divided among calls. ERN_E_CANCELLED: ern_live_cancel was called
 * while the push was blocked; the rest of the call is not taken, and how much was taken is not reported. ERN_E_STATE:
 * the sound has ended, or windows are expected. */
ERN_API ERN_NODISCARD ern_status ern_live_push(ern_live *live, const float *samples, size_t frames);
/* The same of windows [count][window_length][width], one for each frame at 25 a second, -1e30 to 1e30. */
ERN_API ERN_NODISCARD ern_status ern_live_push_windows(ern_live *live, const float *windows, size_t count);

/* Inserts silence up to the end of the frame (25 a second) that has begun, at least one sample. Windows: the last one
 * again. It does not block. ERN_E_STATE: there is no room (never with ERN_LIVE_DROP), or the sound has ended. */
ERN_API ERN_NODISCARD ern_status ern_live_insert_silence(ern_live *live);
/* Inserts so much silence that every frame with sound can be pulled. What is pushed later follows it. It does not
 * block; errors as ern_live_insert_silence. Where there is no room for all of the silence, a part of it may be
 * inserted. */
ERN_API ERN_NODISCARD ern_status ern_live_flush(ern_live *live);
/* Drops the sound that waits, except the next 40 to 80 ms, which fade out (windows: drops all), and ends a push that is
 * blocked. ERN_E_STATE: the sound has ended. */
ERN_API ERN_NODISCARD ern_status ern_live_cancel(ern_live *live);
/* Number of samples (windows: of windows) so far, pushed and inserted, without those that were dropped by
 * ern_live_cancel: where in the sound of the frames the next one that is pushed will be, unless silence is inserted
 * before it. 0 for NULL. Any thread. */
ERN_API uint64_t ern_live_samples(ern_live *live);
/* The sound ends: nothing can be pushed any more, and the remaining frames can be pulled. The windows after the last
 * follow `pad`. */
ERN_API ERN_NODISCARD ern_status ern_live_end(ern_live *live);

/* *frame is the next frame. It is NULL, also with ERN_OK, where its sound is not there after `wait` seconds (0..3600,
 * 0: at once), and where the sound has ended and all frames were given: *ended is then true, else false. */
ERN_API ERN_NODISCARD ern_status ern_live_pull(ern_live *live, double wait, const ern_live_frame **frame, bool *ended);

/* Renders a frame, before the next pull: ern_renderer_frame with windows and silence of `frame` in place of the
 * input's; `output` and `times` are as in that function. It renders a frame that is marked `repeat` too. Another thread
 * may push meanwhile. ERN_E_MISMATCH: the renderer's model takes features of another width or window length than the
 * session's (where sound is pushed 16 vectors of the kind `speech`). The text of an error
 * is in the renderer's context. */
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
