/* SPDX-License-Identifier: MIT
 * mp4: H.264 pictures, AAC sound, through FFmpeg. */
#include <libavutil/opt.h>
#include <libswscale/swscale.h>
#include <stdio.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "core/sized.h"
#include "ernerf/media.h"
#include "io/file.h"
#include "media/ffmpeg.h"
#include "media/image.h"
#include "media/video_sound.h"

/* With the settings below, libx264's crf of 15 gives what 18 gives with its own defaults (measured on a rendered 450 x
 * 450 portrait: 43.5 against 43.8 dB of RGB, 48.8 against 48.5 dB of luma) for half of their time and memory, and for
 * 29 percent more bytes. */
enum { OPTIONS_COOKIE = 0x45524e56, MAX_RATE_PART = 1000000, DEFAULT_CRF = 15 };
static const char *const preset = "veryfast";

struct ern_video_writer {
  ern_context *context;
  struct ern_file_writer file;
  ern_status broken; /* what the first frame that failed returned, and its words */
  char broken_text[1024];
  int width, height; /* of the caller's frames */
  AVRational rate;
  struct ern_muxer muxer;
  AVCodecContext *codec; /* its sides are even */
  AVStream *stream;
  struct SwsContext *convert;
  AVFrame *frame;  /* yuv420p */
  uint8_t *padded; /* [codec->height][codec->width][4]; NULL where the sides are even */
  int64_t count;   /* frames so far */
  struct ern_sound_track sound;
};

void ern_video_options_fill(ern_video_options *options, size_t bytes) {
  const ern_video_options own = {
      .cookie = OPTIONS_COOKIE, .rate_numerator = 25, .rate_denominator = 1, .crf = DEFAULT_CRF};
  ern_config_give(options, bytes, &own, sizeof own);
}

static ern_status check_options(ern_context *context, const char *path, const ern_video_options *options) {
  ern_status status = ERN_OK;
  const ern_sound *sound = options->sound;
  ERN_TRY(ern_image_check_sides(context, path, options->width, options->height));
  if (options->rate_numerator < 1 || options->rate_denominator < 1 || options->rate_numerator > MAX_RATE_PART ||
      options->rate_denominator > MAX_RATE_PART) {
    ERN_TRY(ern_fail(context, ERN_E_ARGUMENT, "%s: %d/%d frames a second, expected both parts in 1 to %d", path,
                     options->rate_numerator, options->rate_denominator, MAX_RATE_PART));
  }
  if (options->crf < 0 || options->crf > 51) {
    ERN_TRY(ern_fail(context, ERN_E_ARGUMENT, "%s: crf is %d, expected 0 to 51", path, options->crf));
  }
  if (!(options->sound_start >= 0 && options->sound_start < 1e9)) {
    ERN_TRY(
        ern_fail(context, ERN_E_ARGUMENT, "%s: sound starts at %g s, expected 0 to 1e9", path, options->sound_start));
  }
  if (sound != NULL && (sound->rate < 1 || sound->rate > 384000 || sound->channels < 1 || sound->channels > 8 ||
                        (sound->data == NULL && sound->frames > 0))) {
    ERN_TRY(ern_fail(context, ERN_E_ARGUMENT, "%s: sound has %d Hz and %d channels%s, expected 1 to 384000 and 1 to 8",
                     path, sound->rate, sound->channels, sound->data == NULL ? ", no samples" : ""));
  }
fail:
  return status;
}

/* libx264, else any encoder of H.264 that takes yuv420p. */
static const AVCodec *find_encoder(void) {
  const AVCodec *codec = avcodec_find_encoder_by_name("libx264");
  if (codec == NULL) codec = avcodec_find_encoder(AV_CODEC_ID_H264);
  if (codec == NULL || codec->pix_fmts == NULL) return NULL;
  for (const enum AVPixelFormat *format = codec->pix_fmts; *format != AV_PIX_FMT_NONE; format++) {
    if (*format == AV_PIX_FMT_YUV420P) return codec;
  }
  return NULL;
}

static ern_status open_encoder(ern_video_writer *writer, int crf) {
  ern_context *context = writer->context;
  const AVCodec *codec = find_encoder();
  if (codec == NULL) {
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: FFmpeg has no encoder for H.264 (libx264)", writer->file.path);
  }
  AVCodecContext *made = writer->codec = avcodec_alloc_context3(codec);
  writer->stream = avformat_new_stream(writer->muxer.container, NULL);
  if (made == NULL || writer->stream == NULL) {
    return ern_fail(context, ERN_E_NO_MEMORY, "%s: no memory for an encoder", writer->file.path);
  }
  made->width = writer->width + writer->width % 2;
  made->height = writer->height + writer->height % 2;
  made->pix_fmt = AV_PIX_FMT_YUV420P;
  made->colorspace = AVCOL_SPC_BT709;
  made->color_primaries = AVCOL_PRI_BT709;
  made->color_trc = AVCOL_TRC_BT709;
  made->color_range = AVCOL_RANGE_MPEG;
  made->chroma_sample_location = AVCHROMA_LOC_LEFT;
  made->framerate = writer->rate;
  made->time_base = (AVRational){writer->rate.den, writer->rate.num};
  made->sample_aspect_ratio = (AVRational){1, 1};
  if (writer->muxer.container->oformat->flags & AVFMT_GLOBALHEADER) made->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  int error = av_opt_set_double(made, "crf", crf, AV_OPT_SEARCH_CHILDREN);
  if (error == AVERROR_OPTION_NOT_FOUND) error = av_opt_set_int(made, "qp", crf, AV_OPT_SEARCH_CHILDREN);
  if (error < 0) {
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: FFmpeg's %s takes no quality, expected libx264", writer->file.path,
                    codec->name);
  }
  error = av_opt_set(made, "preset", preset, AV_OPT_SEARCH_CHILDREN);
  if (error < 0 && error != AVERROR_OPTION_NOT_FOUND) {
    return ern_av_fail(context, ERN_E_MEDIA, writer->file.path, "open an encoder of H.264", error);
  }
  /* The same pictures to the same bytes: libx264 164's macroblock tree reads memory that it has not written, and a
   * stream depends on the number of threads. */
  error = av_opt_set_int(made, "mbtree", 0, AV_OPT_SEARCH_CHILDREN);
  if (error < 0 && error != AVERROR_OPTION_NOT_FOUND) {
    return ern_av_fail(context, ERN_E_MEDIA, writer->file.path, "open an encoder of H.264", error);
  }
  made->thread_count = 2;
  error = avcodec_open2(made, codec, NULL);
  if (error >= 0) error = avcodec_parameters_from_context(writer->stream->codecpar, made);
  if (error < 0) return ern_av_fail(context, ERN_E_MEDIA, writer->file.path, "open an encoder of H.264", error);
  writer->stream->time_base = made->time_base;
  writer->stream->avg_frame_rate = writer->rate;
  writer->stream->sample_aspect_ratio = made->sample_aspect_ratio;
  return ERN_OK;
}

/* RGB, full range, to BT.709 Y'CbCr, limited range; chroma where H.264 has it by default: on the left of its pair,
 * between its rows. */
static ern_status open_conversion(ern_video_writer *writer) {
  const AVCodecContext *codec = writer->codec;
  const int *matrix = sws_getCoefficients(SWS_CS_ITU709);
  struct SwsContext *made = writer->convert = sws_alloc_context();
  int error = made != NULL ? 0 : AVERROR(ENOMEM);
  const struct {
    const char *name;
    int value;
  } options[] = {{"srcw", codec->width},
                 {"srch", codec->height},
                 {"src_format", AV_PIX_FMT_RGB0},
                 {"dstw", codec->width},
                 {"dsth", codec->height},
                 {"dst_format", codec->pix_fmt},
                 {"src_range", 1},
                 {"dst_range", 0},
                 {"dst_h_chr_pos", 0},
                 {"dst_v_chr_pos", 128},
                 {"sws_flags", SWS_BICUBIC | SWS_FULL_CHR_H_INP | SWS_ACCURATE_RND | SWS_BITEXACT}};
  for (size_t i = 0; i < sizeof options / sizeof *options && error >= 0; i++) {
    error = av_opt_set_int(made, options[i].name, options[i].value, 0);
  }
  if (error >= 0) error = sws_setColorspaceDetails(made, matrix, 1, matrix, 0, 0, 1 << 16, 1 << 16);
  if (error >= 0) error = sws_init_context(made, NULL, NULL);
  if (error < 0) return ern_av_fail(writer->context, ERN_E_MEDIA, writer->file.path, "convert the colours", error);
  return ERN_OK;
}

static ern_status open_frame(ern_video_writer *writer) {
  const AVCodecContext *codec = writer->codec;
  AVFrame *frame = writer->frame = av_frame_alloc();
  if (frame == NULL) return ern_fail(writer->context, ERN_E_NO_MEMORY, "%s: no memory for a frame", writer->file.path);
  frame->format = codec->pix_fmt;
  frame->width = codec->width;
  frame->height = codec->height;
  frame->colorspace = codec->colorspace;
  frame->color_primaries = codec->color_primaries;
  frame->color_trc = codec->color_trc;
  frame->color_range = codec->color_range;
  frame->chroma_location = codec->chroma_sample_location;
  const int error = av_frame_get_buffer(frame, 0);
  if (error < 0) return ern_av_fail(writer->context, ERN_E_NO_MEMORY, writer->file.path, "make a frame", error);
  if (codec->width == writer->width && codec->height == writer->height) return ERN_OK;
  return ERN_NEW(writer->context, 4 * (size_t)codec->width * (size_t)codec->height, &writer->padded);
}

/* FFmpeg opens the temporary file by its name, which `file` has locked, and writes the head of the container. */
static ern_status open_file(ern_video_writer *writer) {
  ern_context *context = writer->context;
  AVFormatContext *container = writer->muxer.container;
  ern_status status = ERN_OK;
  char *url = NULL;
  AVDictionary *options = NULL;
  ERN_TRY(ern_av_url(context, writer->file.temporary, &url));
  container->url = av_strdup(url); /* the second pass of faststart reads the file again by this name */
  int error = container->url != NULL ? avio_open(&container->pb, url, AVIO_FLAG_WRITE) : AVERROR(ENOMEM);
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_IO, writer->file.path, "write", error));
  error = av_dict_set(&options, "movflags", "+faststart", 0);
  if (error >= 0) error = avformat_write_header(container, &options);
  if (error >= 0) error = container->pb->error;
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_MEDIA, writer->file.path, "write the head of an mp4", error));
fail:
  av_dict_free(&options);
  ern_release(context, url);
  return status;
}

ern_status ern_video_writer_open(ern_context *context, const char *path, const ern_video_options *options,
                                 ern_video_writer **writer) {
  ERN_PLAIN_FLOATS;
  if (writer != NULL) *writer = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, options);
  ERN_NEED(context, writer);
  ern_status status = ERN_OK;
  ern_video_writer *made = NULL;
  ern_video_options chosen = ern_video_options_default(0, 0);
  ern_av_hush();
  ERN_TRY(ERN_TAKE_CONFIG(context, ern_video_options, &chosen, options));
  ERN_TRY(check_options(context, path, &chosen));
  ERN_TRY(ERN_NEW(context, 1, &made));
  made->context = context;
  made->width = chosen.width;
  made->height = chosen.height;
  av_reduce(&made->rate.num, &made->rate.den, chosen.rate_numerator, chosen.rate_denominator, MAX_RATE_PART);
  made->file.descriptor = -1;
  ERN_TRY(ern_file_writer_open(context, path, ERN_EXISTING_BY_CONTEXT, &made->file));
  made->muxer = (struct ern_muxer){.context = context, .path = made->file.path, .packet = av_packet_alloc()};
  const int error = avformat_alloc_output_context2(&made->muxer.container, NULL, "mp4", NULL);
  if (error < 0 || made->muxer.packet == NULL) {
    ERN_TRY(ern_av_fail(context, ERN_E_MEDIA, path, "make an mp4", error < 0 ? error : AVERROR(ENOMEM)));
  }
  ERN_TRY(open_encoder(made, chosen.crf));
  ERN_TRY(open_conversion(made));
  ERN_TRY(open_frame(made));
  ERN_TRY(ern_sound_track_open(&made->muxer, chosen.sound, chosen.sound_start, &made->sound));
  ERN_TRY(open_file(made));
  *writer = made;
  return ERN_OK;
fail:
  ern_video_writer_abandon(&made);
  return status;
}

/* The frame with its last column and row repeated where the sides are odd. */
static void pad(ern_video_writer *writer, const uint8_t *rgba) {
  const size_t from = (size_t)writer->width * 4, to = (size_t)writer->codec->width * 4;
  const size_t height = (size_t)writer->height;
  for (size_t y = 0; y < height; y++) {
    memcpy(writer->padded + y * to, rgba + y * from, from);
    if (to > from) memcpy(writer->padded + y * to + from, rgba + y * from + from - 4, 4);
  }
  if (writer->codec->height > writer->height) {
    memcpy(writer->padded + height * to, writer->padded + (height - 1) * to, to);
  }
}

static ern_status write_frame(ern_video_writer *writer, const uint8_t *rgba) {
  ern_context *context = writer->context;
  AVFrame *frame = writer->frame;
  ern_status status = ERN_OK;
  int error = av_frame_make_writable(frame); /* the codec may still hold the last one */
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_NO_MEMORY, writer->file.path, "make a frame", error));
  if (writer->padded != NULL) pad(writer, rgba);
  const uint8_t *const from[4] = {writer->padded != NULL ? writer->padded : rgba};
  const int from_bytes[4] = {writer->codec->width * 4};
  error = sws_scale(writer->convert, from, from_bytes, 0, writer->codec->height, frame->data, frame->linesize);
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_MEDIA, writer->file.path, "convert the colours", error));
  frame->pts = writer->count;
  ERN_TRY(ern_muxer_encode(&writer->muxer, writer->codec, writer->stream, frame));
  writer->count++;
  ERN_TRY(ern_sound_track_advance(&writer->muxer, &writer->sound, writer->count, writer->rate, false));
fail:
  return status;
}

ern_status ern_video_writer_frame(ern_video_writer *writer, const uint8_t *rgba) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, writer);
  ERN_NEED(writer->context, rgba);
  if (writer->broken == ERN_OK) {
    writer->broken = write_frame(writer, rgba);
    if (writer->broken == ERN_OK) return ERN_OK;
    (void)ern_last_error_copy(writer->context, writer->broken_text, sizeof writer->broken_text);
  }
  return ern_fail(writer->context, writer->broken, "%s", writer->broken_text);
}

/* Drains the encoders, writes the tail, closes the file. */
static ern_status finish(ern_video_writer *writer) {
  ern_context *context = writer->context;
  AVFormatContext *container = writer->muxer.container;
  ern_status status = ERN_OK;
  if (writer->broken != ERN_OK) ERN_TRY(ern_fail(context, writer->broken, "%s", writer->broken_text));
  if (writer->count == 0) {
    ERN_TRY(ern_fail(context, ERN_E_STATE, "%s: not made, for it has 0 frames, expected 1 or more", writer->file.path));
  }
  ERN_TRY(ern_sound_track_advance(&writer->muxer, &writer->sound, writer->count, writer->rate, true));
  ERN_TRY(ern_muxer_encode(&writer->muxer, writer->codec, writer->stream, NULL));
  int error = av_write_trailer(container);
  if (error >= 0) {
    avio_flush(container->pb);
    error = container->pb->error;
  }
  const int closed = avio_closep(&container->pb);
  if (error >= 0) error = closed;
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_IO, writer->file.path, "write the tail", error));
  status = ern_file_writer_commit(&writer->file);
fail:
  return status;
}

ern_status ern_video_writer_close(ern_video_writer **writer) {
  ERN_NEED(NULL, writer);
  ERN_NEED(NULL, *writer);
  const ern_status status = finish(*writer);
  ern_video_writer_abandon(writer);
  return status;
}

void ern_video_writer_abandon(ern_video_writer **writer) {
  if (writer == NULL || *writer == NULL) return;
  ern_video_writer *dying = *writer;
  ern_context *context = dying->context;
  *writer = NULL;
  ern_sound_track_close(&dying->sound);
  av_frame_free(&dying->frame);
  sws_freeContext(dying->convert);
  avcodec_free_context(&dying->codec);
  av_packet_free(&dying->muxer.packet);
  if (dying->muxer.container != NULL) avio_closep(&dying->muxer.container->pb);
  avformat_free_context(dying->muxer.container);
  ern_file_writer_abandon(&dying->file);
  ern_release(context, dying->padded);
  ern_release(context, dying);
}
