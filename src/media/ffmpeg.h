/* SPDX-License-Identifier: MIT
 * What sound and video share of FFmpeg: its errors as ours, one decoded stream of a file, one encoded stream of a file.
 */
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

/* FFmpeg writes what it thinks to stderr, by one level for the whole process, and a library must not. The level is set
 * to AV_LOG_FATAL where the program has left it at FFmpeg's default; any other choice of the program stays. What goes
 * wrong is in our error text in any case. */
void ern_av_disable_log(void);

/* "file:PATH", so that no name is taken for an address; owned by the caller (ern_release). */
ERN_NODISCARD ern_status ern_av_url(ern_context *context, const char *path, char **url);

/* One stream of a file, decoded frame by frame. */
struct ern_decoder {
  ern_context *context;
  char *path;
  AVFormatContext *container;
  AVCodecContext *codec;
  AVPacket *packet;
  AVFrame *frame; /* the one decoded last */
  AVStream *stream;
  bool drained; /* the end of the file has been told to the codec */
};
/* Where a stream comes from, if not from a file by its name. */
struct ern_decoder_input {
  const char *url;             /* for FFmpeg; NULL: `io` has it */
  AVIOContext *io;             /* the caller's; NULL: FFmpeg opens the url */
  const AVInputFormat *format; /* NULL: found out */
  AVDictionary *options;       /* of the format; the caller's */
  AVIOInterruptCB interrupt;
};
/* As ern_decoder_open; it decodes what comes without waiting for more than it needs. `path` is for messages. */
ERN_NODISCARD ern_status ern_decoder_open_live(ern_context *context, const char *path,
                                               const struct ern_decoder_input *input, struct ern_decoder *decoder);
/* The best stream of that type, decoded by `threads` threads (0: as FFmpeg likes). ERN_E_FORMAT where there is none. */
ERN_NODISCARD ern_status ern_decoder_open(ern_context *context, const char *path, enum AVMediaType type, int threads,
                                          struct ern_decoder *decoder);
/* The next frame, in decoder->frame; *end where there is none. */
ERN_NODISCARD ern_status ern_decoder_next(struct ern_decoder *decoder, bool *end);
void ern_decoder_close(struct ern_decoder *decoder); /* accepts a zeroed one */

/* A file being made of encoded streams. */
struct ern_muxer {
  ern_context *context;
  const char *path; /* as the user knows it */
  AVFormatContext *container;
  AVPacket *packet;
};
/* Tags of the container, before its head; none without texts. ERN_E_NO_MEMORY. */
ERN_NODISCARD ern_status ern_muxer_tag(struct ern_muxer *muxer, const struct ern_provenance_texts *texts);
/* Writes the tail, and behind it, where xmp is not NULL, that packet: a box of an mp4, an extension of a gif. */
ERN_NODISCARD ern_status ern_muxer_end(struct ern_muxer *muxer, const char *xmp);
/* Encodes a frame (NULL: the rest) and writes what comes of it. */
ERN_NODISCARD ern_status ern_muxer_encode(struct ern_muxer *muxer, AVCodecContext *codec, AVStream *stream,
                                          const AVFrame *frame);

#endif
