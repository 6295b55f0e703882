/* SPDX-License-Identifier: MIT
 * libernerf-media: sound from anything that FFmpeg opens as it comes, and streams of pictures and sound to files, pipes
 * and addresses. */
#ifndef ERNERF_STREAM_H
#define ERNERF_STREAM_H

#include <stdbool.h>

#include "ernerf/media.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- sound in ---------------------------------------------------------------------------------------------------- */

/* Plain data, may grow. */
typedef struct ern_sound_reader_options {
  uint32_t cookie, size;            /* set by ern_sound_reader_options_default() */
  int rate, channels;               /* of what is read, 1000..384000 samples a second and 1..8; default 48000, 1 (the
                                       mean of all channels). Resampled where the input has others */
  const char *format;               /* FFmpeg's name of the input's form, such as "s16le"; NULL (default): found out */
  int format_rate, format_channels; /* of samples without a header, in the same ranges; default 16000, 1 */
  int (*stop)(void *user);          /* asked ten times a second while it waits; anything but 0 ends the wait with
                                       ERN_E_CANCELLED; NULL (default): never */
  void *user;
} ern_sound_reader_options;
ERN_API void ern_sound_reader_options_fill(ern_sound_reader_options *options, size_t bytes);
static inline ern_sound_reader_options ern_sound_reader_options_default(void) {
  ern_sound_reader_options options;
  ern_sound_reader_options_fill(&options, sizeof options);
  return options;
}

/* Whether a url is "DEVICE:NAME". Any thread. false for NULL. */
ERN_API bool ern_sound_reader_is_device(const char *url);

/* One thread at a time uses a reader. */
typedef struct ern_sound_reader ern_sound_reader;

/* url: a file or FIFO by its name; "-", standard input; an address ("http://", "rtsp://", "udp://" ...); or
 * "DEVICE:NAME" of libavdevice, which is loaded for it, such as "alsa:hw:0" and "pulse:default". Files may not name
 * other files. ERN_E_MISSING, ERN_E_IO, ERN_E_FORMAT: it cannot be opened, or is no sound; ERN_E_UNSUPPORTED: no such
 * format or device here. options NULL: the defaults. On success the caller owns *reader. */
ERN_API ERN_NODISCARD ern_status ern_sound_reader_open(ern_context *context, const char *url,
                                                       const ern_sound_reader_options *options,
                                                       ern_sound_reader **reader);
ERN_API void ern_sound_reader_free(ern_sound_reader **reader); /* accepts NULL and a pointer to NULL */

/* samples[*frames][channels], full scale is 1; *frames <= capacity (>= 1). Waits until there is one at least, and for
 * FFmpeg's packets, which have up to 1024 samples of sound without a header; 0 where the sound has ended.
 * ERN_E_NONFINITE: the input has a sample that is not a number; ERN_E_FORMAT: it breaks off. */
ERN_API ERN_NODISCARD ern_status ern_sound_reader_read(ern_sound_reader *reader, float *samples, size_t capacity,
                                                       size_t *frames);

/* ---- pictures and sound out -------------------------------------------------------------------------------------- */

/* Plain data, may grow. */
typedef struct ern_stream_options {
  uint32_t cookie, size; /* set by ern_stream_options_default() */
  int width, height;     /* of the pictures; odd sizes are padded by a repeated row or column, but in "raw" */
  int rate_numerator, rate_denominator; /* pictures a second, each 1..1000000; default 25, 1 */
  int sound_rate, sound_channels;       /* 0, 0 (default): silent; else 1..384000 samples a second, 1..8 */
  int crf;                              /* H.264's quality 0..51, default 18 */
  const char *format; /* "y4m" (4:2:0, without sound), "nut" (4:2:0 and 16-bit samples), "mpegts", "flv", "mp4" and
                         "matroska" (H.264, AAC), "raw" (RGBA8, without sound); NULL (default): by the url */
  const ern_provenance *provenance; /* what the stream says of how it was made (media.h), where its form has a place for
                                       it; NULL (default): nothing */
  int (*stop)(void *user);          /* as of ern_sound_reader_options, while a reader is awaited or too slow */
  void *user;
} ern_stream_options;
ERN_API void ern_stream_options_fill(ern_stream_options *options, size_t bytes);
static inline ern_stream_options ern_stream_options_default(int width, int height) {
  ern_stream_options options;
  ern_stream_options_fill(&options, sizeof options);
  options.width = width;
  options.height = height;
  return options;
}

/* Picture k is shown at exactly k / rate seconds, and sample k of the sound is heard at exactly k / sound_rate: the
 * caller gives each picture the samples of its time. One thread at a time uses a writer. */
typedef struct ern_stream_writer ern_stream_writer;

/* url: "-", standard output; a FIFO or device by its name, which is written to; another name, a file: it is put at its
 * place by ern_stream_writer_close (base.h, "How files are written"); an address ("rtmp://", "udp://", "tcp://" ...);
 * or "http://HOST:PORT/PATH", where the call waits for one reader, such as a browser, and serves him. A program that
 * writes to pipes ignores SIGPIPE. On success the caller owns *writer. */
ERN_API ERN_NODISCARD ern_status ern_stream_writer_open(ern_context *context, const char *url,
                                                        const ern_stream_options *options, ern_stream_writer **writer);
/* rgba: [height][width][4], alpha is not looked at; NULL: the last picture again. samples: [frames][sound_channels].
 * ERN_E_IO where the reader has gone away, or the disk is full. */
ERN_API ERN_NODISCARD ern_status ern_stream_writer_frame(ern_stream_writer *writer, const uint8_t *rgba,
                                                         const float *samples, size_t frames);
/* Ends the stream and frees the writer, also on failure. */
ERN_API ERN_NODISCARD ern_status ern_stream_writer_close(ern_stream_writer **writer);
/* Frees the writer and removes a file that it has begun; accepts NULL and a pointer to NULL. */
ERN_API void ern_stream_writer_abandon(ern_stream_writer **writer);

#ifdef __cplusplus
}
#endif
#endif
