/* SPDX-License-Identifier: MIT */
#include "media/live/picture_track.h"

#include <libavutil/imgutils.h>
#include <libavutil/opt.h>
#include <string.h>

#include "core/memory.h"

static const char *const preset = "veryfast"; /* thin/defaults.c says what its crf is worth */

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

/* H.264's own options. A codec that lacks one of those that are not needed goes without. */
static int set_options(AVCodecContext *codec, enum ern_picture_coding coding, int crf) {
  int error = av_opt_set_double(codec, "crf", crf, AV_OPT_SEARCH_CHILDREN);
  if (error == AVERROR_OPTION_NOT_FOUND) error = av_opt_set_int(codec, "qp", crf, AV_OPT_SEARCH_CHILDREN);
  if (error < 0) return AVERROR_OPTION_NOT_FOUND;
  error = av_opt_set(codec, "preset", preset, AV_OPT_SEARCH_CHILDREN);
  if (error < 0 && error != AVERROR_OPTION_NOT_FOUND) return error;
  if (coding == ERN_PICTURES_LIVE) {
    error = av_opt_set(codec, "tune", "zerolatency", AV_OPT_SEARCH_CHILDREN);
    if (error < 0 && error != AVERROR_OPTION_NOT_FOUND) return error;
    codec->gop_size = (int)(av_q2d(codec->framerate) + 0.5);
    codec->max_b_frames = 0;
    return 0;
  }
  /* The same pictures to the same bytes: libx264 164's macroblock tree reads memory that it has not written, and a
   * stream depends on the number of threads. */
  error = av_opt_set_int(codec, "mbtree", 0, AV_OPT_SEARCH_CHILDREN);
  return error == AVERROR_OPTION_NOT_FOUND ? 0 : error;
}

static void set_picture(AVCodecContext *made, const struct ern_picture_track *track, AVRational rate) {
  made->width = track->width + track->width % 2;
  made->height = track->height + track->height % 2;
  made->pix_fmt = AV_PIX_FMT_YUV420P;
  made->colorspace = AVCOL_SPC_BT709;
  made->color_primaries = AVCOL_PRI_BT709;
  made->color_trc = AVCOL_TRC_BT709;
  made->color_range = AVCOL_RANGE_MPEG;
  made->chroma_sample_location = AVCHROMA_LOC_LEFT;
  made->framerate = rate;
  made->time_base = (AVRational){rate.den, rate.num};
  made->sample_aspect_ratio = (AVRational){1, 1};
}

static ern_status open_encoder(struct ern_muxer *muxer, struct ern_picture_track *track, AVRational rate,
                               enum ern_picture_coding coding, int crf) {
  ern_context *context = muxer->context;
  const bool raw = coding == ERN_PICTURES_RAW || coding == ERN_PICTURES_WRAPPED;
  const enum AVCodecID id = coding == ERN_PICTURES_RAW ? AV_CODEC_ID_RAWVIDEO : AV_CODEC_ID_WRAPPED_AVFRAME;
  const AVCodec *codec = raw ? avcodec_find_encoder(id) : find_encoder();
  if (codec == NULL) {
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: FFmpeg has no encoder for %s", muxer->path,
                    raw ? "raw pictures" : "H.264 (libx264)");
  }
  AVCodecContext *made = track->codec = avcodec_alloc_context3(codec);
  track->stream = avformat_new_stream(muxer->container, NULL);
  if (made == NULL || track->stream == NULL) {
    return ern_fail(context, ERN_E_NO_MEMORY, "%s: no memory for an encoder", muxer->path);
  }
  set_picture(made, track, rate);
  if (muxer->container->oformat->flags & AVFMT_GLOBALHEADER) made->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  int error = raw ? 0 : set_options(made, coding, crf);
  if (error == AVERROR_OPTION_NOT_FOUND) {
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: FFmpeg's %s takes no quality, expected libx264", muxer->path,
                    codec->name);
  }
  made->thread_count = coding == ERN_PICTURES_FILE ? 2 : 1;
  if (error >= 0) error = avcodec_open2(made, codec, NULL);
  if (error >= 0) error = avcodec_parameters_from_context(track->stream->codecpar, made);
  if (error < 0) return ern_av_fail(context, ERN_E_MEDIA, muxer->path, "open an encoder of pictures", error);
  track->stream->time_base = made->time_base;
  track->stream->avg_frame_rate = rate;
  track->stream->sample_aspect_ratio = made->sample_aspect_ratio;
  return ERN_OK;
}

/* RGB, full range, to BT.709 Y'CbCr, limited range; chroma where H.264 has it by default: on the left of its pair,
 * between its rows. */
static ern_status open_conversion(struct ern_muxer *muxer, struct ern_picture_track *track) {
  const AVCodecContext *codec = track->codec;
  const int *matrix = sws_getCoefficients(SWS_CS_ITU709);
  struct SwsContext *made = track->convert = sws_alloc_context();
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
  if (error < 0) return ern_av_fail(muxer->context, ERN_E_MEDIA, muxer->path, "convert the colours", error);
  return ERN_OK;
}

static ern_status open_frame(struct ern_muxer *muxer, struct ern_picture_track *track) {
  const AVCodecContext *codec = track->codec;
  AVFrame *frame = track->frame = av_frame_alloc();
  if (frame == NULL) return ern_fail(muxer->context, ERN_E_NO_MEMORY, "%s: no memory for a frame", muxer->path);
  frame->format = codec->pix_fmt;
  frame->width = codec->width;
  frame->height = codec->height;
  frame->colorspace = codec->colorspace;
  frame->color_primaries = codec->color_primaries;
  frame->color_trc = codec->color_trc;
  frame->color_range = codec->color_range;
  frame->chroma_location = codec->chroma_sample_location;
  const int error = av_frame_get_buffer(frame, 0);
  if (error < 0) return ern_av_fail(muxer->context, ERN_E_NO_MEMORY, muxer->path, "make a frame", error);
  if (codec->width == track->width && codec->height == track->height) return ERN_OK;
  return ERN_NEW(muxer->context, 4 * (size_t)codec->width * (size_t)codec->height, &track->padded);
}

ern_status ern_picture_track_open(struct ern_muxer *muxer, int width, int height, AVRational rate,
                                  enum ern_picture_coding coding, int crf, struct ern_picture_track *track) {
  ern_status status = ERN_OK;
  *track = (struct ern_picture_track){.width = width, .height = height};
  ERN_TRY(open_encoder(muxer, track, rate, coding, crf));
  ERN_TRY(open_conversion(muxer, track));
  ERN_TRY(open_frame(muxer, track));
fail:
  return status;
}

/* The frame with its last column and row repeated where the sides are odd. */
static void pad(struct ern_picture_track *track, const uint8_t *rgba) {
  const size_t from = (size_t)track->width * 4, to = (size_t)track->codec->width * 4;
  const size_t height = (size_t)track->height;
  for (size_t y = 0; y < height; y++) {
    memcpy(track->padded + y * to, rgba + y * from, from);
    if (to > from) memcpy(track->padded + y * to + from, rgba + y * from + from - 4, 4);
  }
  if (track->codec->height > track->height) {
    memcpy(track->padded + height * to, track->padded + (height - 1) * to, to);
  }
}

ern_status ern_picture_track_add(struct ern_muxer *muxer, struct ern_picture_track *track, const uint8_t *rgba) {
  ern_context *context = muxer->context;
  AVFrame *frame = track->frame;
  ern_status status = ERN_OK;
  int error = av_frame_make_writable(frame); /* the codec may still hold the last one */
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_NO_MEMORY, muxer->path, "make a frame", error));
  if (rgba == NULL && track->count == 0)
    error = av_image_fill_black(frame->data,
                                (const ptrdiff_t[4]){frame->linesize[0], frame->linesize[1], frame->linesize[2]},
                                AV_PIX_FMT_YUV420P, AVCOL_RANGE_MPEG, frame->width, frame->height);
  if (rgba != NULL && track->padded != NULL) pad(track, rgba);
  const uint8_t *const from[4] = {track->padded != NULL ? track->padded : rgba};
  const int from_bytes[4] = {track->codec->width * 4};
  if (rgba != NULL)
    error = sws_scale(track->convert, from, from_bytes, 0, track->codec->height, frame->data, frame->linesize);
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_MEDIA, muxer->path, "convert the colours", error));
  frame->pts = track->count;
  ERN_TRY(ern_muxer_encode(muxer, track->codec, track->stream, frame));
  track->count++;
fail:
  return status;
}

void ern_picture_track_close(ern_context *context, struct ern_picture_track *track) {
  av_frame_free(&track->frame);
  sws_freeContext(track->convert);
  avcodec_free_context(&track->codec);
  ern_release(context, track->padded);
  *track = (struct ern_picture_track){0};
}
