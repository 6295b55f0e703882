/* SPDX-License-Identifier: MIT
 * libernerf-media: sound from files, pipes, addresses and devices that FFmpeg opens, while it comes in; streams of
 * pictures and sound to files, pipes and addresses. base.h defines the terms "plain data", "may grow" and "how files
 * are written", and what all functions do with NULL and after errors. */
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
  const char *format;               /* FFmpeg's name of the input's format, such as "s16le", read during the call alone;
                                       NULL (default): found out */
  int format_rate, format_channels; /* of samples without a header, in the same ranges; default 16000, 1 */
  int (*stop)(void *user);          /* called on the calling thread, about ten times a second, while a call waits; where
                                       it returns anything but 0 the call ends with ERN_E_CANCELLED; NULL (default):
                                       none */
  void *user;                       /* handed to `stop` */
} ern_sound_reader_options;

/* The defaults. */
ERN_API void ern_sound_reader_options_fill(ern_sound_reader_options *options, size_t bytes);
static inline ern_sound_reader_options ern_sound_reader_options_default(void) {
  ern_sound_reader_options options;
  ern_sound_reader_options_fill(&options, sizeof options);
  return options;
}

/* Whether a url is "DEVICE:NAME": it has a colon that is not its first character, and no "/". A file of such a name is
 * opened as "./NAME". Any thread. false for NULL. */
ERN_API bool ern_sound_reader_is_device(const char *url);

/* One thread at a time uses a reader. */
typedef struct ern_sound_reader ern_sound_reader;

/* url: a file or FIFO by its name; "-", standard input; an address ("http://", "rtsp://", "udp://" ...); or
 * "DEVICE:NAME" of libavdevice, which is loaded for it, such as "alsa:hw:0" and "pulse:default". Playlists and other
 * files that name files or addresses are refused, unless options.format names theirs. ERN_E_MISSING: no such file;
 * ERN_E_IO: the system refused, or nobody answers; ERN_E_FORMAT: there is no sound in it; ERN_E_UNSUPPORTED: no such
 * format, decoder or device here; ERN_E_CANCELLED: `stop`. options NULL: the defaults. On success the caller owns
 * *reader. */
ERN_API ERN_NODISCARD ern_status ern_sound_reader_open(ern_context *context, const char *url,
                                                       const ern_sound_reader_options *options,
                                                       ern_sound_reader **reader);
ERN_API void ern_sound_reader_free(ern_sound_reader **reader); /* accepts NULL and a pointer to NULL */

/* samples[*frames][channels], full scale is 1; *frames <= capacity (>= 1). Blocks until one frame of samples is there;
 * FFmpeg hands sound on in packets, so that may last a whole packet (samples without a header: 1024 or less, WAV:
 * 1024 bytes or less). *frames is 0 where the sound has ended, and again in later calls. ERN_E_NONFINITE: a sample is
 * not finite; ERN_E_FORMAT, ERN_E_MEDIA: damaged or cut; ERN_E_IO: the system failed; ERN_E_SHAPE: more than 384,000
 * samples a second or 8 channels; ERN_E_CANCELLED: `stop`. */
ERN_API ERN_NODISCARD ern_status ern_sound_reader_read(ern_sound_reader *reader, float *samples, size_t capacity,
                                                       size_t *frames);

/* ---- pictures and sound out -------------------------------------------------------------------------------------- */

/* Plain data, may grow. */
typedef struct ern_stream_options {
  uint32_t cookie, size; /* set by ern_stream_options_default() */
  int width, height;     /* of the pictures, 1..ERN_IMAGE_MAX_SIDE; odd sizes are padded by a repeated row or column,
                            but in "raw" */
  int rate_numerator, rate_denominator; /* pictures a second, each 1..1000000; default 25, 1 */
  int sound_rate, sound_channels;       /* 0, 0 (default): silent; else 1..384000 samples a second, 1..8 */
  int crf;                              /* quality of H.264, 0 (best)..51, default 18; other codings ignore it */
  const char *format; /* "y4m" (4:2:0, without sound), "nut" (4:2:0 and 16-bit samples), "mpegts", "flv", "mp4" and
                         "matroska" (H.264, AAC), "raw" (RGBA8, without sound). NULL (default): .mp4, http:// mp4; .mkv
                         matroska; .ts, udp://, srt:// mpegts; .flv, rtmp:// flv; .nut, tcp:// nut; .y4m y4m; .rgba raw;
                         any other url, also "-", is ERN_E_UNSUPPORTED */
  const ern_provenance *provenance; /* what the stream says of how it was made (media.h), where its format has a place
                                       for it; read by ern_stream_writer_open alone; NULL (default): nothing */
  int (*stop)(void *user);          /* as in ern_sound_reader_options, while a call waits for the stream's reader */
  void *user;                       /* handed to `stop` */
} ern_stream_options;

/* The defaults. */
ERN_API void ern_stream_options_fill(ern_stream_options *options, size_t bytes);
static inline ern_stream_options ern_stream_options_default(int width, int height) {
  ern_stream_options options;
  ern_stream_options_fill(&options, sizeof options);
  options.width = width;
  options.height = height;
  return options;
}

/* Picture k is shown at exactly k / rate seconds, and sample k of the sound is heard at exactly k / sound_rate. The
 * caller gives picture k the samples from floor(k sound_rate / rate) to before floor((k + 1) sound_rate / rate), as
 * ern_live_frame has them; the writer does not check that. It writes as fast as it is called. One thread at a time uses
 * a writer. */
typedef struct ern_stream_writer ern_stream_writer;

/* url: "-", standard output; a FIFO or device by its name, which is written to; another name, a file: it is put at its
 * place by ern_stream_writer_close (base.h, "How files are written"); an address ("rtmp://", "udp://", "tcp://" ...);
 * or "http://HOST:PORT/PATH", where the call waits for one reader, such as a browser, and serves it. A program that
 * writes to pipes or addresses must ignore SIGPIPE, which else ends it when the reader leaves. On success the caller
 * owns *writer. */
ERN_API ERN_NODISCARD ern_status ern_stream_writer_open(ern_context *context, const char *url,
                                                        const ern_stream_options *options, ern_stream_writer **writer);
/* rgba: [height][width][4], alpha is ignored (but "raw" keeps it); NULL: the last picture again, before the first one
 * black ("raw": zeros). samples: [frames][sound_channels], full scale is 1; NULL with frames 0; ignored where the
 * stream has no sound. ERN_E_IO: the reader has left, or the disk is full; ERN_E_CANCELLED: `stop`. After an error
 * every later call, close too, fails with the same status. */
ERN_API ERN_NODISCARD ern_status ern_stream_writer_frame(ern_stream_writer *writer, const uint8_t *rgba,
                                                         const float *samples, size_t frames);
/* Ends the stream and frees the writer, also on failure. A file without a picture is not made, with ERN_E_STATE ("raw":
 * an empty file). */
ERN_API ERN_NODISCARD ern_status ern_stream_writer_close(ern_stream_writer **writer);
/* Frees the writer and removes a file that it has begun; accepts NULL and a pointer to NULL. */
ERN_API void ern_stream_writer_abandon(ern_stream_writer **writer);

#ifdef __cplusplus
}
#endif
#endif
