/* SPDX-License-Identifier: MIT
 * libernerf-media: reads sound while it comes in, from files, pipes, addresses and devices that FFmpeg opens; writes
 * streams of pictures and sound to files, pipes and addresses. base.h defines the terms "plain data", "may grow" and
 * "how files are written", and what all functions do with NULL and after errors. */
#ifndef ERNERF_STREAM_H
#define ERNERF_STREAM_H

#include <stdbool.h>
#include <stddef.h>

#include "ernerf/media.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- names ------------------------------------------------------------------------------------------------------- */

/* What `url` names for the functions below, as a path: `url` itself, or what follows "file:"; NULL where it is an
 * address "SCHEME://..." of http, https, rtmp, rtmps, rtmpt, rtmpts, rtp, rtsp, srt, tcp, tls, udp or icecast. They
 * refuse names that begin with another of FFmpeg's protocols ("concat:"), or with an unknown scheme and "://"; "./"
 * before the name of a file makes it one. Any thread. The result points into `url`. NULL for NULL. */
ERN_API const char *ern_stream_file(const char *url);

/* ---- sound in ---------------------------------------------------------------------------------------------------- */

/* Plain data, may grow. */
typedef struct ern_sound_reader_options {
  uint32_t cookie, size;            /* set by ern_sound_reader_options_default() */
  int rate, channels;               /* of the samples that ern_sound_reader_read returns: 1000..384000 a second, 1..8
                                       channels; default 48000, 1. An input with another rate is resampled, and one with
                                       other channels mixed: one channel is the mean of all, of
                                       five and more the downmix of ITU-R BS.775, or the loudest
                                       where that loses most of their energy */
  const char *format;               /* FFmpeg's name of the input's format, such as "s16le"; read by
                                       ern_sound_reader_open alone. NULL (default): FFmpeg detects the format */
  int format_rate, format_channels; /* of an input without a header, such as "s16le", in the same ranges; default 16000,
                                       1; others state their own */
  int (*stop)(void *user);          /* called on the calling thread, about ten times a second, while a call waits.
                                       Anything but 0 ends that call with ERN_E_CANCELLED. NULL (default): none */
  void *user;                       /* handed to `stop` */
} ern_sound_reader_options;

/* The defaults. */
ERN_API void ern_sound_reader_options_fill(ern_sound_reader_options *options, size_t bytes);
static inline ern_sound_reader_options ern_sound_reader_options_default(void) {
  ern_sound_reader_options options;
  ern_sound_reader_options_fill(&options, sizeof options);
  return options;
}

/* Whether ern_sound_reader_open takes a url for a device, "DEVICE:NAME": it has a colon that is not its first
 * character, no "/", and does not begin with "file:". To open a file with such a name, write "./" before the name. Any
 * thread. false for NULL. */
ERN_API bool ern_sound_reader_is_device(const char *url);

/* An input that is being read. One thread at a time uses a reader. */
typedef struct ern_sound_reader ern_sound_reader;

/* url: a file or FIFO by its name; "-", standard input; an address ("http://", "rtsp://", "udp://" ...;
 * ern_stream_file); or
 * "DEVICE:NAME", such as "alsa:hw:0" and "pulse:default", for which libavdevice is loaded. A playlist, or another file
 * that names files or addresses, is refused unless options.format names its format. options NULL: the defaults.
 * ERN_E_MISSING: no such file. ERN_E_IO: the system refused, or no server answers. ERN_E_FORMAT: there is no sound in
 * it, or it is a playlist. ERN_E_UNSUPPORTED: this system has no such format, decoder or device, or the url begins with
 * a protocol that is neither "file:" nor of a network. ERN_E_CANCELLED:
 * `stop` ended the call. On success the caller owns *reader. */
ERN_API ERN_NODISCARD ern_status ern_sound_reader_open(ern_context *context, const char *url,
                                                       const ern_sound_reader_options *options,
                                                       ern_sound_reader **reader);
ERN_API void ern_sound_reader_free(ern_sound_reader **reader); /* accepts NULL and a pointer to NULL */

/* samples: [*frames][channels], full scale is 1; the caller's memory, with room for `capacity` frames (>= 1). A frame
 * is one sample of each channel. The call blocks until it has at least one frame. FFmpeg returns sound in packets, so
 * it may wait for a whole packet: at most 1024 frames of an input without a header, at most 1024 bytes of WAV. *frames
 * is 0 when the sound has ended, and in every later call. ERN_E_NONFINITE: a sample is not finite. ERN_E_FORMAT,
 * ERN_E_MEDIA: the input is damaged or cut off. ERN_E_IO: the system failed. ERN_E_SHAPE: the input has more than
 * 384,000 samples a second or 8 channels. ERN_E_CANCELLED: `stop` ended the call. */
ERN_API ERN_NODISCARD ern_status ern_sound_reader_read(ern_sound_reader *reader, float *samples, size_t capacity,
                                                       size_t *frames);

/* ---- pictures and sound out -------------------------------------------------------------------------------------- */

/* What ends with the bytes that ern_stream_options.write has been given. */
typedef enum ern_stream_piece {
  ERN_STREAM_MORE = 0,  /* nothing: more of the same part follows */
  ERN_STREAM_HEAD = 1,  /* the head, which every receiver needs first (mp4: the initialisation segment) */
  ERN_STREAM_KEY = 2,   /* a part that begins with a key frame: a receiver that has the head can begin with it */
  ERN_STREAM_FRAME = 3, /* a part that needs those before it */
} ern_stream_piece;

/* Plain data, may grow. */
typedef struct ern_stream_options {
  uint32_t cookie, size; /* set by ern_stream_options_default() */
  int width, height;     /* of the pictures in pixels, 1..ERN_IMAGE_MAX_SIDE. Except in "raw", an odd size is padded by
                            a repeated row or column */
  int rate_numerator, rate_denominator; /* numerator/denominator pictures a second, 1/100 to 1000, each part 1..1000000;
                                           default 25, 1 */
  int sound_rate, sound_channels;       /* 0, 0 (default): no sound; else 1..384000 samples a second, 1..8 channels */
  int crf;            /* quality of H.264, 0 (best)..51, default 18; "y4m", "nut" and "raw" ignore it */
  const char *format; /* "mp4", "matroska", "mpegts", "flv": H.264 and AAC. "nut": uncompressed 4:2:0 and 16-bit
                         samples. "y4m": uncompressed 4:2:0, without sound. "raw": RGBA, 8 bits, without sound or
                         header. NULL (default): by the url; mp4 for .mp4 and http://, matroska for .mkv, mpegts for
                         .ts, udp://, srt:// and rtp://, which takes no other, flv for .flv and rtmp://, nut for .nut
                         and tcp://, y4m for .y4m, raw for .rgba; any other url, also "-", is then
                         ERN_E_UNSUPPORTED. Read by ern_stream_writer_open alone */
  const ern_provenance *provenance; /* what the stream says of how it was made (media.h), where its format has a place
                                       for it; read by ern_stream_writer_open alone; NULL (default): nothing */
  int (*stop)(void *user); /* as in ern_sound_reader_options, while a call waits for the receiver of the stream */
  void *user;              /* handed to `stop` and `write` */
  double pixel_aspect;     /* width of a pixel over its height, as it is to be shown: 0.01 to 100, default 1 */
  const char *preset;      /* of x264, "ultrafast" to "placebo": how much time H.264 takes; NULL (default): "veryfast".
                              Read by ern_stream_writer_open alone */
  int (*write)(void *user, const void *bytes, size_t count, ern_stream_piece piece); /* takes the stream in place of a
                              file or address; the url is then a name for messages, and the format mp4, in fragments of
                              one picture and its sound. It is called in ern_stream_writer_frame, _patch and _close, on
                              their thread; the end of a part has 0 bytes. Anything but 0 is ERN_E_IO. Read by
                              ern_stream_writer_open alone; NULL (default): none */
  const char *profile; /* of H.264: "baseline" (constrained), "main" or "high", of which a receiver may decode only
                          the first ones, and which have no lossless crf 0; NULL (default): what the preset makes,
                          mostly high. Read by ern_stream_writer_open alone */
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

/* A stream that is being written. Let rate be rate_numerator / rate_denominator. Picture k is shown at exactly k / rate
 * seconds, and sample k of each channel is heard at exactly k / sound_rate seconds; both count from 0. matroska and flv
 * round to 1 ms, mpegts to 1/90000 s, and in these three all is later by 1024 samples where there is sound. The caller
 * hands over picture k together with the samples floor(k sound_rate / rate) to floor((k + 1) sound_rate / rate) - 1,
 * which ern_live_frame has. The writer does not check that. It does not wait for the clock either: it writes as fast as
 * it is called. One thread at a time uses a writer. */
typedef struct ern_stream_writer ern_stream_writer;

/* url: one of
 * - "-": standard output;
 * - the name of an existing FIFO or device;
 * - the name of a file: the file gets its name in ern_stream_writer_close (base.h, "How files are written"); mp4 is
 *   written in fragments of a second;
 * - an address of a server to connect to, or to send to ("rtmp://", "udp://", "tcp://" ...; ern_stream_file);
 * - "http://HOST:PORT/PATH": the writer is the server; the call waits for one receiver (reader in docs/live.md), such
 *   as a browser. It admits a GET request whose Host is an IP address, "localhost" or HOST and whose Origin is that or
 *   absent, so that no page of another site reads the stream; a receiver that takes nothing for 30 s has left.
 *
 * A program that writes to pipes or addresses must ignore SIGPIPE: otherwise the signal ends it when the receiver
 * leaves. ERN_E_SHAPE: width or height is out of its range. ERN_E_UNSUPPORTED: no such format, none follows from the
 * url, or it begins with a protocol that is neither "file:" nor of a network. ERN_E_IO: the system or the server
 * refused. ERN_E_BUSY: nobody can listen at HOST:PORT. ERN_E_ARGUMENT: "http://" without them. ERN_E_CANCELLED: `stop`
 * ended the call. On success the caller owns *writer. */
ERN_API ERN_NODISCARD ern_status ern_stream_writer_open(ern_context *context, const char *url,
                                                        const ern_stream_options *options, ern_stream_writer **writer);
/* Writes the next picture and its sound. rgba: [height][width][4]; only "raw" keeps alpha. NULL repeats the picture
 * before; as the first picture it is black ("raw": zeros). samples: [frames][sound_channels], a frame being one sample
 * of each channel here; full scale is 1, and what is beyond it is clipped; may be NULL where frames is 0; ignored where
 * the stream has no sound. ERN_E_NONFINITE: a sample is not finite, and nothing is written. ERN_E_IO: the receiver has
 * left, or the disk is full. ERN_E_CANCELLED: `stop` ended the call. After an error other than ERN_E_ARGUMENT and
 * ERN_E_NONFINITE every later call fails with the same status, ern_stream_writer_close too; that one keeps what a file
 * has. */
ERN_API ERN_NODISCARD ern_status ern_stream_writer_frame(ern_stream_writer *writer, const uint8_t *rgba,
                                                         const float *samples, size_t frames);
/* As ern_stream_writer_frame, of a plain frame of a video reader whose part (x, y, width, height, even numbers; NULL:
 * none) is replaced by rgba, [height][width][4]. The other pixels are coded as they were decoded. ERN_E_UNSUPPORTED:
 * the frame is not plain or has another size than the stream, or the stream is "raw". */
ERN_API ERN_NODISCARD ern_status ern_stream_writer_patch(ern_stream_writer *writer, const ern_video_frame *frame,
                                                         const int part[4], const uint8_t *rgba, const float *samples,
                                                         size_t frames);
/* Writes what the encoders still hold and the end of the container, closes the output, and frees the writer, also on
 * failure. A file without a picture is not made, and the call is ERN_E_STATE; "raw" makes an empty file. A file that
 * could not be written to its end, as the disk was full, is put in place up to its last whole packet, where there is
 * one, and the error says that it is cut; every format plays up to there. So does the temporary file that a killed
 * process leaves, of which mp4 and matroska lack the last second at most. */
ERN_API ERN_NODISCARD ern_status ern_stream_writer_close(ern_stream_writer **writer);
/* Frees the writer without an end of the stream, and removes the temporary file; accepts NULL and a pointer to NULL. */
ERN_API void ern_stream_writer_abandon(ern_stream_writer **writer);

/* ---- a stream, passed on ------------------------------------------------------------------------------------------
 */

/* Sends a coded stream to an address, without coding it again, until it ends: "rtmp://" and "rtmps://" as flv, "srt://"
 * and "udp://" as MPEG-TS. It connects first, and then reads. read: stores 1 to `most` bytes of what
 * ern_stream_options.write was given, from the head and a part with a key frame on, waits while there are none, and
 * returns their number; 0: the stream has ended. stop: as in ern_sound_reader_options; NULL: none. Both are called on
 * the calling thread. ERN_E_IO: no server answers, it left, or took nothing for 10 s. ERN_E_FORMAT: what was read is no
 * stream. ERN_E_UNSUPPORTED: another address. ERN_E_CANCELLED: `stop` ended the call. */
ERN_API ERN_NODISCARD ern_status ern_stream_copy(ern_context *context, const char *url,
                                                 ptrdiff_t (*read)(void *user, void *bytes, size_t most),
                                                 int (*stop)(void *user), void *user);

#ifdef __cplusplus
}
#endif
#endif
