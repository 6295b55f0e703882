/* SPDX-License-Identifier: MIT */
#include "media/ffmpeg.h"

#include <errno.h>
#include <libavutil/avstring.h>
#include <libavutil/log.h>
#include <stdio.h>
#include <string.h>

#include "core/format.h"
#include "core/memory.h"
#include "media/image.h"
#include "media/input.h"
#include "media/truncation.h"

/* Whether an error is the operating system's. FFmpeg's own codes are far below errno's range; it also uses these four
 * errno values for its own errors. */
static bool is_of_the_system(int error) {
  return error < 0 && error > -4096 && error != AVERROR(EINVAL) && error != AVERROR(EPERM) &&
         error != AVERROR(ENOSYS) && error != AVERROR(EAGAIN);
}

ern_status ern_av_fail(ern_context *context, ern_status otherwise, const char *path, const char *doing, int error) {
  char reason[AV_ERROR_MAX_STRING_SIZE];
  if (av_strerror(error, reason, sizeof reason) < 0) snprintf(reason, sizeof reason, "error %d", error);
  if (error == AVERROR(EIO) && strstr(path, "://") != NULL) /* FFmpeg says no more of an address */
    snprintf(reason, sizeof reason, "its host is not known, or nobody answers there");
  ern_status code = is_of_the_system(error) ? ERN_E_IO : otherwise;
  if (error == AVERROR(ENOMEM)) code = ERN_E_NO_MEMORY;
  if (error == AVERROR(ENOENT) || error == AVERROR(ENOTDIR)) code = ERN_E_MISSING;
  return ern_fail(context, code, "%s: cannot %s: %s", path, doing, reason);
}

void ern_av_disable_log(void) {
  if (av_log_get_level() == AV_LOG_INFO) av_log_set_level(AV_LOG_FATAL);
}

ern_status ern_av_url(ern_context *context, const char *path, char **url) {
  static const char protocol[] = "file:";
  const size_t bytes = strlen(path) + sizeof protocol;
  const ern_status status = ERN_NEW(context, bytes, url);
  if (status != ERN_OK) return status;
  snprintf(*url, bytes, "%s%s", protocol, path);
  return ERN_OK;
}

/* Limits a decoder's memory: FFmpeg allocates by the size that a stream claims, even while it probes the stream. */
static const int64_t most_pixels = (int64_t)ERN_IMAGE_MAX_SIDE * ERN_IMAGE_MAX_SIDE;

static int find_streams(AVFormatContext *container) {
  const unsigned count = container->nb_streams;
  AVDictionary **options = av_calloc(count > 0 ? count : 1, sizeof *options);
  int error = options != NULL ? 0 : AVERROR(ENOMEM);
  for (unsigned i = 0; i < count && error >= 0; i++) error = av_dict_set_int(&options[i], "max_pixels", most_pixels, 0);
  if (error >= 0) error = avformat_find_stream_info(container, count > 0 ? options : NULL);
  for (unsigned i = 0; i < count && options != NULL; i++) av_dict_free(&options[i]);
  av_freep(&options);
  return error;
}

/* Allows all formats but those that refer to other files, which may be URLs, pipes or endless lists. */
static int allow_formats(AVDictionary **options) {
  static const char of_lists[] = "concat,hls,dash,imf,mlv,rtsp,sdp,sap,lavfi,avisynth,vapoursynth";
  void *at = NULL;
  int error = 0;
  const AVInputFormat *format = av_demuxer_iterate(&at);
  for (bool first = true; format != NULL && error >= 0; format = av_demuxer_iterate(&at)) {
    if (av_match_list(format->name, of_lists, ',') > 0) continue;
    if (!first) error = av_dict_set(options, "format_whitelist", ",", AV_DICT_APPEND);
    if (error >= 0) error = av_dict_set(options, "format_whitelist", format->name, AV_DICT_APPEND);
    first = false;
  }
  return error;
}

enum { MOST_CHUNK_BYTES = 1 << 24 };

/* Whether the header of a sound file has no end. FFmpeg reads chunk after chunk behind the samples: gigabytes of zeros,
 * as in a file whose space was reserved, are chunks of 8 bytes and take hours. */
static int header_is_endless(void *user) {
  static const char of_chunks[] = "aiff,caf,w64,wav";
  const AVFormatContext *container = user;
  return container->opaque == NULL && container->iformat != NULL && container->pb != NULL &&
         av_match_list(container->iformat->name, of_chunks, ',') > 0 && container->pb->bytes_read > MOST_CHUNK_BYTES;
}

ern_status ern_av_open_file(ern_context *context, const char *path, AVFormatContext **container) {
  ern_status status = ERN_OK;
  char *url = NULL;
  AVDictionary *options = NULL;
  ern_av_disable_log();
  ERN_TRY(ern_input_check(context, path));
  ERN_TRY(ern_av_url(context, path, &url));
  int error = av_dict_set(&options, "protocol_whitelist", "file", 0);
  if (error >= 0) error = allow_formats(&options);
  *container = error >= 0 ? avformat_alloc_context() : NULL;
  if (error >= 0 && *container == NULL) error = AVERROR(ENOMEM);
  if (error >= 0) {
    (*container)->interrupt_callback = (AVIOInterruptCB){header_is_endless, *container};
    error = avformat_open_input(container, url, NULL, &options);
  }
  if (error == AVERROR_EXIT || (error >= 0 && header_is_endless(*container)))
    ERN_TRY(ern_fail(context, ERN_E_FORMAT,
                     "%s: has over %d bytes of chunks that hold no sound, such as zeros after the samples; expected a "
                     "file that ends with the samples",
                     path, (int)MOST_CHUNK_BYTES));
  if (error >= 0) (*container)->opaque = *container; /* the header is read */
  if (error == AVERROR(EINVAL))
    ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: is a playlist or no sound or video at all", path));
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_FORMAT, path, "read it as sound or video", error));
  error = find_streams(*container);
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_FORMAT, path, "find out what is in it", error));
fail:
  av_dict_free(&options);
  ern_release(context, url);
  return status;
}

/* Other tracks may be other languages, or a microphone that was recorded apart. */
static void warn_of_other_sound(const struct ern_decoder *decoder) {
  unsigned tracks = 0;
  for (unsigned i = 0; i < decoder->container->nb_streams; i++)
    tracks += decoder->container->streams[i]->codecpar->codec_type == AVMEDIA_TYPE_AUDIO;
  if (tracks > 1)
    ern_log(decoder->context, ERN_LOG_WARNING,
            "%s: has %u tracks of sound, of which stream %d is taken, as players do; expected one", decoder->path,
            tracks, decoder->stream->index);
}

static ern_status open_decoder(struct ern_decoder *decoder, enum AVMediaType type, int threads) {
  ern_context *context = decoder->context;
  const char *kind = type == AVMEDIA_TYPE_AUDIO ? "sound" : "video";
  const AVCodec *codec = NULL;
  const int index = av_find_best_stream(decoder->container, type, -1, -1, &codec, 0);
  if (index == AVERROR_DECODER_NOT_FOUND) {
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: FFmpeg has no decoder for its %s", decoder->path, kind);
  }
  if (index < 0) return ern_fail(context, ERN_E_FORMAT, "%s: has no %s", decoder->path, kind);
  if (decoder->container->streams[index]->disposition & AV_DISPOSITION_ATTACHED_PIC)
    return ern_fail(context, ERN_E_FORMAT, "%s: has no video, a cover picture alone", decoder->path);
  for (unsigned i = 0; i < decoder->container->nb_streams; i++) {
    if ((int)i != index) decoder->container->streams[i]->discard = AVDISCARD_ALL;
  }
  decoder->stream = decoder->container->streams[index];
  if (type == AVMEDIA_TYPE_AUDIO) warn_of_other_sound(decoder);
  const AVCodecParameters *claimed = decoder->stream->codecpar;
  if (type == AVMEDIA_TYPE_VIDEO && (claimed->width > ERN_IMAGE_MAX_SIDE || claimed->height > ERN_IMAGE_MAX_SIDE))
    return ern_image_check_sides(context, decoder->path, claimed->width, claimed->height);
  decoder->codec = avcodec_alloc_context3(codec);
  decoder->packet = av_packet_alloc();
  decoder->frame = av_frame_alloc();
  if (decoder->codec == NULL || decoder->packet == NULL || decoder->frame == NULL) {
    return ern_fail(context, ERN_E_NO_MEMORY, "%s: no memory for a decoder", decoder->path);
  }
  int error = avcodec_parameters_to_context(decoder->codec, decoder->stream->codecpar);
  decoder->codec->pkt_timebase = decoder->stream->time_base;
  decoder->codec->thread_count = threads;
  decoder->codec->max_pixels = most_pixels;
  decoder->codec->flags |= AV_CODEC_FLAG_UNALIGNED; /* else FFmpeg leaves columns that the stream crops at the left */
  if (error >= 0) error = avcodec_open2(decoder->codec, codec, NULL);
  if (error < 0) return ern_av_fail(context, ERN_E_MEDIA, decoder->path, "open a decoder", error);
  return ERN_OK;
}

ern_status ern_decoder_open(ern_context *context, const char *path, enum AVMediaType type, int threads,
                            struct ern_decoder *decoder) {
  ern_status status = ERN_OK;
  *decoder = (struct ern_decoder){.context = context};
  ERN_TRY(ern_string_copy(context, path, &decoder->path));
  ERN_TRY(ern_av_open_file(context, path, &decoder->container));
  ERN_TRY(open_decoder(decoder, type, threads));
  return ERN_OK;
fail:
  ern_decoder_close(decoder);
  return status;
}

/* Whether the header has all parameters that an audio decoder needs. */
static bool knows_sound(const AVFormatContext *container) {
  for (unsigned i = 0; i < container->nb_streams; i++) {
    const AVCodecParameters *p = container->streams[i]->codecpar;
    if (p->codec_type == AVMEDIA_TYPE_AUDIO && p->codec_id != AV_CODEC_ID_NONE && p->sample_rate > 0 &&
        p->ch_layout.nb_channels > 0)
      return true;
  }
  return false;
}

static ern_status open_live(struct ern_decoder *decoder, const struct ern_decoder_input *input) {
  ern_context *context = decoder->context;
  AVDictionary *options = NULL;
  ern_status status = ERN_OK;
  decoder->container = avformat_alloc_context();
  if (decoder->container == NULL)
    ERN_TRY(ern_fail(context, ERN_E_NO_MEMORY, "%s: no memory for a decoder", decoder->path));
  decoder->container->pb = input->io;
  decoder->container->interrupt_callback = input->interrupt;
  if (!input->whole) decoder->container->flags |= AVFMT_FLAG_NOBUFFER;
  int error = av_dict_copy(&options, input->options, 0);
  if (error >= 0 && input->io != NULL) error = av_dict_set(&options, "protocol_whitelist", "none", 0);
  if (error >= 0 && input->format == NULL) error = allow_formats(&options);
  if (error >= 0) error = avformat_open_input(&decoder->container, input->url, input->format, &options);
  if (error == AVERROR(EINVAL) || error == AVERROR_INVALIDDATA || error == AVERROR_EOF)
    ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: is no sound that FFmpeg knows", decoder->path));
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_FORMAT, decoder->path, "read it as sound", error));
  decoder->container->max_analyze_duration = AV_TIME_BASE / 2;
  /* else it holds 32 KiB of a WAV back, to see whether it is coded sound (DTS) */
  if (input->io != NULL && strcmp(decoder->container->iformat->name, "wav") == 0) decoder->container->probesize = 32;
  error = knows_sound(decoder->container) ? 0 : find_streams(decoder->container);
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_FORMAT, decoder->path, "find out what is in it", error));
fail:
  av_dict_free(&options);
  return status;
}

ern_status ern_decoder_open_live(ern_context *context, const char *path, const struct ern_decoder_input *input,
                                 struct ern_decoder *decoder) {
  ern_status status = ERN_OK;
  *decoder = (struct ern_decoder){.context = context};
  ern_av_disable_log();
  ERN_TRY(ern_string_copy(context, path, &decoder->path));
  ERN_TRY(open_live(decoder, input));
  ERN_TRY(open_decoder(decoder, AVMEDIA_TYPE_AUDIO, 1));
  return ERN_OK;
fail:
  ern_decoder_close(decoder);
  return status;
}

int ern_av_read_packet(AVFormatContext *container, AVPacket *packet) {
  const int error = av_read_frame(container, packet);
  const AVIOContext *io = container->pb;
  return error == AVERROR_EOF && io != NULL && io->error < 0 && io->error != AVERROR_EXIT ? io->error : error;
}

/* Whether the file is a video, and ends within the packet that was read, as where a copy was broken off. */
static bool is_cut_video(const struct ern_decoder *decoder) {
  const AVFormatContext *container = decoder->container;
  const AVIOContext *io = container->pb;
  bool pictures = false;
  for (unsigned i = 0; i < container->nb_streams; i++)
    pictures |= container->streams[i]->codecpar->codec_type == AVMEDIA_TYPE_VIDEO &&
                (container->streams[i]->disposition & AV_DISPOSITION_ATTACHED_PIC) == 0;
  return pictures && io != NULL && io->eof_reached && io->buf_ptr == io->buf_end && io->error >= 0;
}

/* In an MPEG transport stream FFmpeg calls each packet damaged that does not continue the one before, as where packets
 * were lost on their way or files were joined: players go on there. */
static ern_status check_packet(struct ern_decoder *decoder) {
  const char *format = decoder->container->iformat->name;
  if ((decoder->packet->flags & AV_PKT_FLAG_CORRUPT) == 0) return ERN_OK;
  const bool ts = strcmp(format, "mpegts") == 0;
  if (decoder->open_ended) return ERN_OK;
  if (!ts && decoder->piped) /* which cannot be opened again, to look at its header */
    return ern_fail(decoder->context, ERN_E_FORMAT, "%s: is damaged or cut short", decoder->path);
  if (!ts) return ern_truncation_check_packet(decoder->context, decoder->path, format);
  if (!decoder->reported_lost)
    ern_log(decoder->context, ERN_LOG_WARNING,
            "%s: has lost or damaged packets, or is several files in one; what is there is taken", decoder->path);
  decoder->reported_lost = true;
  return ERN_OK;
}

/* Sends the codec the next packet of the stream, or the end of the stream (NULL). */
static ern_status feed(struct ern_decoder *decoder) {
  ern_context *context = decoder->context;
  AVPacket *packet = decoder->packet;
  for (;;) {
    int error = ern_av_read_packet(decoder->container, packet);
    if (error >= 0 && (packet->flags & AV_PKT_FLAG_CORRUPT) != 0 && is_cut_video(decoder)) {
      ern_log(context, ERN_LOG_WARNING, "%s: is cut short: its last packet is not whole, and is left out",
              decoder->path);
      av_packet_unref(packet);
      error = AVERROR_EOF;
    }
    if (error == AVERROR_EOF) {
      decoder->drained = true;
      error = avcodec_send_packet(decoder->codec, NULL);
      return error >= 0 ? ERN_OK : ern_av_fail(context, ERN_E_FORMAT, decoder->path, "decode the end", error);
    }
    if (error < 0) return ern_av_fail(context, ERN_E_FORMAT, decoder->path, "read on", error);
    if (packet->stream_index == decoder->stream->index) {
      const ern_status cut = check_packet(decoder);
      error = cut != ERN_OK ? 0 : avcodec_send_packet(decoder->codec, packet);
      av_packet_unref(packet);
      if (cut != ERN_OK) return cut;
      return error >= 0 ? ERN_OK : ern_av_fail(context, ERN_E_FORMAT, decoder->path, "decode it", error);
    }
    av_packet_unref(packet);
  }
}

ern_status ern_decoder_next(struct ern_decoder *decoder, bool *end) {
  *end = false;
  for (;;) {
    const int error = avcodec_receive_frame(decoder->codec, decoder->frame);
    if (error >= 0) return ERN_OK;
    if (error == AVERROR_EOF) {
      *end = true;
      return ERN_OK;
    }
    if (error != AVERROR(EAGAIN) || decoder->drained) {
      return ern_av_fail(decoder->context, ERN_E_FORMAT, decoder->path, "decode it", error);
    }
    const ern_status status = feed(decoder);
    if (status != ERN_OK) return status;
  }
}

void ern_decoder_close(struct ern_decoder *decoder) {
  av_frame_free(&decoder->frame);
  av_packet_free(&decoder->packet);
  avcodec_free_context(&decoder->codec);
  avformat_close_input(&decoder->container);
  ern_release(decoder->context, decoder->path);
  *decoder = (struct ern_decoder){0};
}

ern_status ern_muxer_tag(struct ern_muxer *muxer, const struct ern_provenance_texts *texts) {
  AVDictionary **tags = &muxer->container->metadata;
  if (texts->xmp == NULL) return ERN_OK;
  int error = av_dict_set(tags, "DigitalSourceType", texts->source_type, 0);
  if (error >= 0) error = av_dict_set(tags, "AIGC", texts->aigc, 0);
  if (error >= 0 && texts->description[0] != 0) error = av_dict_set(tags, "description", texts->description, 0);
  /* where ffmpeg copies or transcodes an mp4 without options, of these tags it keeps only the track names */
  const bool mp4 = strcmp(muxer->container->oformat->name, "mp4") == 0;
  for (unsigned i = 0; mp4 && error >= 0 && i < muxer->container->nb_streams; i++)
    error = av_dict_set(&muxer->container->streams[i]->metadata, "handler_name", texts->source_type, 0);
  return error < 0 ? ern_av_fail(muxer->context, ERN_E_NO_MEMORY, muxer->path, "tag it", error) : ERN_OK;
}

ern_status ern_muxer_end(struct ern_muxer *muxer, const char *xmp) {
  AVIOContext *io = muxer->container->pb;
  uint8_t *box = NULL;
  size_t bytes = 0;
  ern_status status = ERN_OK;
  const locale_t host = ern_locale_plain(); /* Matroska has its duration as text */
  const int error = av_write_trailer(muxer->container);
  ern_locale_restore(host);
  if (error < 0) ERN_TRY(ern_av_fail(muxer->context, ERN_E_IO, muxer->path, "write the tail", error));
  if (xmp != NULL) {
    avio_flush(io);
    const bool gif = strcmp(muxer->container->oformat->name, "gif") == 0;
    ERN_TRY(gif ? ern_provenance_extension(muxer->context, xmp, &box, &bytes)
                : ern_provenance_box(muxer->context, xmp, &box, &bytes));
    const int64_t end = avio_size(io); /* faststart leaves the position after the header */
    const int64_t place = end >= 0 ? avio_seek(io, gif ? end - 1 : end, SEEK_SET) : end; /* a gif's trailer is 1 byte */
    if (place < 0) ERN_TRY(ern_av_fail(muxer->context, ERN_E_IO, muxer->path, "write the tail", (int)place));
    avio_write(io, box, (int)bytes);
  }
fail:
  ern_release(muxer->context, box);
  return status;
}

static ern_status encode(struct ern_muxer *muxer, AVCodecContext *codec, AVStream *stream, const AVFrame *frame) {
  ern_context *context = muxer->context;
  int error = avcodec_send_frame(codec, frame);
  if (error < 0) return ern_av_fail(context, ERN_E_MEDIA, muxer->path, "encode", error);
  for (;;) {
    error = avcodec_receive_packet(codec, muxer->packet);
    if (error == AVERROR(EAGAIN) || error == AVERROR_EOF) return ERN_OK;
    if (error < 0) return ern_av_fail(context, ERN_E_MEDIA, muxer->path, "encode", error);
    if (muxer->from_0 && muxer->packet->pts < 0) continue; /* avcodec_receive_packet frees it */
    av_packet_rescale_ts(muxer->packet, codec->time_base, stream->time_base);
    muxer->packet->stream_index = stream->index;
    if (codec->codec_type == AVMEDIA_TYPE_VIDEO && (muxer->packet->flags & AV_PKT_FLAG_KEY) != 0) muxer->has_key = true;
    error = av_interleaved_write_frame(muxer->container, muxer->packet); /* takes ownership of the packet's data */
    if (error >= 0) error = muxer->container->pb->error;
    if (error < 0) return ern_av_fail(context, ERN_E_IO, muxer->path, "write", error);
  }
}

ern_status ern_muxer_encode(struct ern_muxer *muxer, AVCodecContext *codec, AVStream *stream, const AVFrame *frame) {
  const locale_t host = ern_locale_plain(); /* x264 writes its settings into the stream, as text */
  const ern_status status = encode(muxer, codec, stream, frame);
  ern_locale_restore(host);
  return status;
}
