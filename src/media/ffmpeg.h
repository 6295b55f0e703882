/* SPDX-License-Identifier: MIT
 * FFmpeg helpers for sound and video: FFmpeg's errors as ern_status, a decoder of one stream of a file, a muxer that
 * encodes the streams of a file. */
#ifndef ERN_MEDIA_FFMPEG_H
#define ERN_MEDIA_FFMPEG_H

#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <stdbool.h>

#include "core/status.h"
#include "media/provenance.h"

/* "PATH: cannot DOING: reason"; the code is ERN_E_IO, ERN_E_MISSING or ERN_E_NO_MEMORY where FFmpeg's error is the
 * operating system's, else `otherwise`. */
ern_status ern_av_fail(ern_context *context, ern_status otherwise, const char *path, const char *doing, int error);

/* av_read_frame; but where a demuxer takes a failed read for the end of the file (AVERROR_EOF), the error of that read.
 * A read that an interrupt ends (AVERROR_EXIT) is an end. */
int ern_av_read_packet(AVFormatContext *container, AVPacket *packet);

/* Stops FFmpeg from logging to stderr, which a library must not do. FFmpeg has one log level for the whole process. It
 * is set to AV_LOG_FATAL where the program has left it at FFmpeg's default; any other level stays. The error text of
 * the context has FFmpeg's errors in any case. */
void ern_av_disable_log(void);

/* "file:PATH", so that no name is taken for an address; owned by the caller (ern_release). */
ERN_NODISCARD ern_status ern_av_url(ern_context *context, const char *path, char **url);

/* Opens a regular file of any format but those that refer to other files, and finds its streams. *container: NULL
 * before; the caller closes it (avformat_close_input), also after an error. */
ERN_NODISCARD ern_status ern_av_open_file(ern_context *context, const char *path, AVFormatContext **container);

/* One stream of a file, decoded frame by frame. */
struct ern_decoder {
  ern_context *context;
  char *path;
  AVFormatContext *container;
  AVCodecContext *codec;
  AVPacket *packet;
  AVFrame *frame; /* the one decoded last */
  AVStream *stream;
  bool drained;       /* the file has ended and the codec is being flushed */
  bool reported_lost; /* of packets, in the log */
  /* set by the caller, once it is open */
  bool piped, open_ended; /* its path cannot be opened again; its header promises no size (ern_truncation_is_wav) */
};
/* The input of a decoder that does not open a file by its path. */
struct ern_decoder_input {
  const char *url;             /* for FFmpeg to open; NULL: `io` is read */
  AVIOContext *io;             /* the caller's; NULL: FFmpeg opens the url */
  const AVInputFormat *format; /* NULL: FFmpeg probes it */
  AVDictionary *options;       /* for the demuxer; owned by the caller */
  AVIOInterruptCB interrupt;
  bool whole; /* what is read to find out what is in it, up to half a second, is decoded too: a device or a server would
                 stay late by as much */
};
/* As ern_decoder_open, for live input: it reads no more input ahead than decoding needs. `path` is for messages. */
ERN_NODISCARD ern_status ern_decoder_open_live(ern_context *context, const char *path,
                                               const struct ern_decoder_input *input, struct ern_decoder *decoder);
/* The best stream of that type, decoded by `threads` threads (0: FFmpeg chooses). ERN_E_FORMAT where there is none. */
ERN_NODISCARD ern_status ern_decoder_open(ern_context *context, const char *path, enum AVMediaType type, int threads,
                                          struct ern_decoder *decoder);
/* Decodes the next frame into decoder->frame; *end is set where there is none. */
ERN_NODISCARD ern_status ern_decoder_next(struct ern_decoder *decoder, bool *end);
void ern_decoder_close(struct ern_decoder *decoder); /* accepts a zeroed one */

/* A muxer: an output file to which encoded streams are written. */
struct ern_muxer {
  ern_context *context;
  const char *path; /* for messages */
  AVFormatContext *container;
  AVPacket *packet;
  bool has_key; /* set where a picture's packet is a key frame; the caller clears it */
  bool from_0;  /* leaves out packets before 0 s: an encoder's delay */
};
/* Sets metadata tags of the container, before its header is written; does nothing where texts->xmp is NULL.
 * ERN_E_NO_MEMORY. */
ERN_NODISCARD ern_status ern_muxer_tag(struct ern_muxer *muxer, const struct ern_provenance_texts *texts);
/* Writes the container's trailer. Where xmp is not NULL, appends that packet: as a box of an mp4, as an extension of a
 * gif. */
ERN_NODISCARD ern_status ern_muxer_end(struct ern_muxer *muxer, const char *xmp);
/* Encodes a frame (NULL: flushes the encoder) and writes the packets that the encoder returns. */
ERN_NODISCARD ern_status ern_muxer_encode(struct ern_muxer *muxer, AVCodecContext *codec, AVStream *stream,
                                          const AVFrame *frame);

#endif
