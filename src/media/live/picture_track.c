/* SPDX-License-Identifier: MIT */
#include "media/live/picture_track.h"

#include <libavutil/imgutils.h>
#include <libavutil/opt.h>
#include <string.h>

#include "core/format.h"
#include "core/machine.h"
#include "core/memory.h"
#include "media/video/video_frame.h"

enum { MOST_ASPECT = 4095 }; /* numerator and denominator of a pixel's aspect ratio that all encoders take */

static const char *const default_preset = "veryfast"; /* thin/defaults.c compares its crf with that of x264's default */

ern_status ern_picture_rate_check(ern_context *context, const char *path, int numerator, int denominator) {
  const int64_t n = numerator, d = denominator;
  if (n >= 1 && n <= ERN_RATE_PART && d >= 1 && d <= ERN_RATE_PART && 100 * n >= d && n <= 1000 * d) return ERN_OK;
  return ern_fail(
      context, ERN_E_ARGUMENT,
      "%s: rate_numerator/rate_denominator is %d/%d frames a second, expected 1/100 to 1000, both parts 1 to %d", path,
      numerator, denominator, ERN_RATE_PART);
}

/* The encoder of that name, else any encoder of the codec that supports its pixel format. */
static const AVCodec *find_encoder(const struct ern_video_codec *wanted) {
  const AVCodec *codec = avcodec_find_encoder_by_name(wanted->encoder);
  if (codec == NULL) codec = avcodec_find_encoder(wanted->id);
  if (codec == NULL || codec->pix_fmts == NULL) return NULL;
  for (const enum AVPixelFormat *format = codec->pix_fmts; *format != AV_PIX_FMT_NONE; format++) {
    if (*format == wanted->format) return codec;
  }
  return NULL;
}

/* Sets an optional option; an encoder without it is no error. */
static int set_if_there(AVCodecContext *codec, const char *name, const char *value) {
  const int error = av_opt_set(codec, name, value, AV_OPT_SEARCH_CHILDREN);
  return error == AVERROR_OPTION_NOT_FOUND ? 0 : error;
}

/* The encoder's own options. */
static int set_options(AVCodecContext *codec, const struct ern_picture_settings *settings) {
  const struct ern_video_codec *wanted = settings->codec;
  int error = 0;
  if (wanted->most_crf > 0) {
    error = av_opt_set_double(codec, "crf", settings->crf, AV_OPT_SEARCH_CHILDREN);
    if (error == AVERROR_OPTION_NOT_FOUND) error = av_opt_set_int(codec, "qp", settings->crf, AV_OPT_SEARCH_CHILDREN);
    if (error < 0) return AVERROR_OPTION_NOT_FOUND;
    codec->bit_rate = 0; /* constant quality */
  }
  for (size_t i = 0; i < 3 && wanted->settings[i][0] != NULL && error >= 0; i++)
    error = set_if_there(codec, wanted->settings[i][0], wanted->settings[i][1]);
  if (wanted->has_preset && error >= 0)
    error = set_if_there(codec, "preset", settings->preset != NULL ? settings->preset : default_preset);
  if (settings->profile != NULL && error >= 0) error = set_if_there(codec, "profile", settings->profile);
  if (error < 0) return error;
  if (settings->coding == ERN_PICTURES_LIVE) {
    error = set_if_there(codec, "tune", "zerolatency");
    codec->gop_size = (int)(av_q2d(codec->framerate) + 0.5);
    codec->max_b_frames = 0;
    return error;
  }
  /* For reproducible files: the macroblock tree of libx264 164 reads uninitialised memory, and the result depends on
   * the number of threads. */
  return set_if_there(codec, "mbtree", "0");
}

static bool is_rgb(enum AVPixelFormat format) { return format == AV_PIX_FMT_0RGB32 || format == AV_PIX_FMT_BGR8; }

static void set_picture(AVCodecContext *made, const struct ern_picture_track *track, enum AVPixelFormat format,
                        AVRational rate, double aspect) {
  made->width = track->width + track->width % 2;
  made->height = track->height + track->height % 2;
  made->pix_fmt = format;
  if (!is_rgb(format)) {
    made->colorspace = AVCOL_SPC_BT709;
    made->color_primaries = AVCOL_PRI_BT709;
    made->color_trc = AVCOL_TRC_BT709;
    made->color_range = AVCOL_RANGE_MPEG;
    made->chroma_sample_location = AVCHROMA_LOC_LEFT;
  }
  made->framerate = rate;
  made->time_base = (AVRational){rate.den, rate.num};
  made->sample_aspect_ratio = av_d2q(aspect > 0 ? aspect : 1, MOST_ASPECT);
}

/* Fixed numbers: an encoder's threads decide bits of the file. x264 codes a frame in each of six threads, and looks
 * ahead in two more. */
static int threads_of(const struct ern_picture_settings *settings) {
  if (settings->coding != ERN_PICTURES_FILE) return 1;
  return settings->codec->id == AV_CODEC_ID_H264 ? 6 : 2;
}

static ern_status open_encoder(struct ern_muxer *muxer, struct ern_picture_track *track, AVRational rate,
                               const struct ern_picture_settings *settings) {
  ern_context *context = muxer->context;
  const enum ern_picture_coding coding = settings->coding;
  const bool raw = coding == ERN_PICTURES_RAW || coding == ERN_PICTURES_WRAPPED;
  const enum AVCodecID id = coding == ERN_PICTURES_RAW ? AV_CODEC_ID_RAWVIDEO : AV_CODEC_ID_WRAPPED_AVFRAME;
  const AVCodec *codec = raw ? avcodec_find_encoder(id) : find_encoder(settings->codec);
  if (codec == NULL) {
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: FFmpeg has no encoder for %s", muxer->path,
                    raw ? "raw pictures" : settings->codec->name);
  }
  AVCodecContext *made = track->codec = avcodec_alloc_context3(codec);
  track->stream = avformat_new_stream(muxer->container, NULL);
  if (made == NULL || track->stream == NULL) {
    return ern_fail(context, ERN_E_NO_MEMORY, "%s: no memory for an encoder", muxer->path);
  }
  set_picture(made, track, raw ? AV_PIX_FMT_YUV420P : settings->codec->format, rate, settings->pixel_aspect);
  if (!raw && settings->codec->id == AV_CODEC_ID_HEVC)
    made->codec_tag = MKTAG('h', 'v', 'c', '1'); /* which Apple's players need */
  if (muxer->container->oformat->flags & AVFMT_GLOBALHEADER) made->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  const locale_t host = ern_locale_plain(); /* settings of encoders are text, and x264 writes them into the stream */
  int error = raw ? 0 : set_options(made, settings);
  made->thread_count = threads_of(settings);
  const int opened = error >= 0 ? avcodec_open2(made, codec, NULL) : error;
  ern_locale_restore(host);
  if (error == AVERROR_OPTION_NOT_FOUND) {
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: FFmpeg's %s takes no quality, expected %s", muxer->path,
                    codec->name, settings->codec->encoder);
  }
  error = opened >= 0 ? avcodec_parameters_from_context(track->stream->codecpar, made) : opened;
  if (error < 0) return ern_av_fail(context, ERN_E_MEDIA, muxer->path, "open an encoder of pictures", error);
  track->stream->time_base = made->time_base;
  track->stream->avg_frame_rate = rate;
  track->stream->sample_aspect_ratio = made->sample_aspect_ratio;
  return ERN_OK;
}

/* Threads of the conversion of a file's pictures; they change no bit of it. */
static int conversion_threads(enum ern_picture_coding coding) {
  const int cores = ern_machine_cores();
  if (coding != ERN_PICTURES_FILE) return 1;
  return cores < 4 ? cores : 4;
}

/* For width x height pixels. RGB, full range, to BT.709 Y'CbCr, limited range; chroma sited as H.264's default
 * ("left"). Or to another RGB format. */
static ern_status open_conversion(struct ern_muxer *muxer, const AVCodecContext *codec, int width, int height,
                                  int threads, struct SwsContext **convert) {
  const int *matrix = sws_getCoefficients(SWS_CS_ITU709);
  const bool rgb = is_rgb(codec->pix_fmt);
  struct SwsContext *made = *convert = sws_alloc_context();
  int error = made != NULL ? 0 : AVERROR(ENOMEM);
  const struct {
    const char *name;
    int value;
  } options[] = {{"srcw", width},
                 {"srch", height},
                 {"src_format", AV_PIX_FMT_RGB0},
                 {"dstw", width},
                 {"dsth", height},
                 {"dst_format", codec->pix_fmt},
                 {"src_range", 1},
                 {"dst_range", rgb},
                 {"dst_h_chr_pos", 0},
                 {"dst_v_chr_pos", 128},
                 {"threads", rgb ? 1 : threads},
                 {"sws_flags", SWS_BICUBIC | SWS_FULL_CHR_H_INP | SWS_ACCURATE_RND | SWS_BITEXACT}};
  for (size_t i = 0; i < sizeof options / sizeof *options && error >= 0; i++) {
    error = av_opt_set_int(made, options[i].name, options[i].value, 0);
  }
  if (error >= 0 && !rgb) error = sws_setColorspaceDetails(made, matrix, 1, matrix, 0, 0, 1 << 16, 1 << 16);
  if (error >= 0) error = sws_init_context(made, NULL, NULL);
  if (error >= 0 && !rgb && threads > 1) /* the threads' own contexts exist now */
    error = sws_setColorspaceDetails(made, matrix, 1, matrix, 0, 0, 1 << 16, 1 << 16);
  if (error < 0) return ern_av_fail(muxer->context, ERN_E_MEDIA, muxer->path, "convert the colours", error);
  return ERN_OK;
}

static ern_status make_frame(struct ern_muxer *muxer, const AVCodecContext *codec, int width, int height,
                             AVFrame **made) {
  AVFrame *frame = *made = av_frame_alloc();
  if (frame == NULL) return ern_fail(muxer->context, ERN_E_NO_MEMORY, "%s: no memory for a frame", muxer->path);
  frame->format = codec->pix_fmt;
  frame->width = width;
  frame->height = height;
  frame->colorspace = codec->colorspace;
  frame->color_primaries = codec->color_primaries;
  frame->color_trc = codec->color_trc;
  frame->color_range = codec->color_range;
  frame->chroma_location = codec->chroma_sample_location;
  const int error = av_frame_get_buffer(frame, 0);
  return error < 0 ? ern_av_fail(muxer->context, ERN_E_NO_MEMORY, muxer->path, "make a frame", error) : ERN_OK;
}

static ern_status open_frame(struct ern_muxer *muxer, struct ern_picture_track *track) {
  const AVCodecContext *codec = track->codec;
  const ern_status status = make_frame(muxer, codec, codec->width, codec->height, &track->frame);
  if (status != ERN_OK || (codec->width == track->width && codec->height == track->height)) return status;
  return ERN_NEW(muxer->context, 4 * (size_t)codec->width * (size_t)codec->height, &track->padded);
}

ern_status ern_picture_track_open(struct ern_muxer *muxer, int width, int height, AVRational rate,
                                  const struct ern_picture_settings *settings, struct ern_picture_track *track) {
  ern_status status = ERN_OK;
  *track = (struct ern_picture_track){.width = width, .height = height};
  ERN_TRY(open_encoder(muxer, track, rate, settings));
  ERN_TRY(open_conversion(muxer, track->codec, track->codec->width, track->codec->height,
                          conversion_threads(settings->coding), &track->convert));
  ERN_TRY(open_frame(muxer, track));
fail:
  return status;
}

/* Pads a picture with odd sides to even ones by repeating its last column and row. */
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

static void keep_bytes(void *user, uint8_t *bytes) { (void)user, (void)bytes; }

/* Writes rgba [codec->height][codec->width][4] to track->frame. */
static int convert(struct ern_picture_track *track, const uint8_t *rgba) {
  const int width = track->codec->width, height = track->codec->height;
  int error = AVERROR(ENOMEM);
  AVFrame *from = av_frame_alloc();
  if (from == NULL) return error;
  from->format = AV_PIX_FMT_RGB0;
  from->width = width;
  from->height = height;
  from->data[0] = (uint8_t *)rgba; /* is read alone */
  from->linesize[0] = 4 * width;
  from->buf[0] =
      av_buffer_create(from->data[0], 4 * (size_t)width * (size_t)height, keep_bytes, NULL, AV_BUFFER_FLAG_READONLY);
  if (from->buf[0] != NULL) error = sws_scale_frame(track->convert, track->frame, from);
  av_frame_free(&from);
  return error;
}

/* Encodes track->frame. */
static ern_status encode(struct ern_muxer *muxer, struct ern_picture_track *track) {
  track->frame->pts = track->count;
  const ern_status status = ern_muxer_encode(muxer, track->codec, track->stream, track->frame);
  track->count += status == ERN_OK;
  return status;
}

ern_status ern_picture_track_add(struct ern_muxer *muxer, struct ern_picture_track *track, const uint8_t *rgba) {
  ern_context *context = muxer->context;
  AVFrame *frame = track->frame;
  ern_status status = ERN_OK;
  int error = av_frame_make_writable(frame); /* the codec may still hold a reference to the last picture */
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_NO_MEMORY, muxer->path, "make a frame", error));
  if (rgba == NULL && track->count == 0)
    error = av_image_fill_black(frame->data,
                                (const ptrdiff_t[4]){frame->linesize[0], frame->linesize[1], frame->linesize[2]},
                                AV_PIX_FMT_YUV420P, AVCOL_RANGE_MPEG, frame->width, frame->height);
  if (rgba != NULL && track->padded != NULL) pad(track, rgba);
  if (rgba != NULL) error = convert(track, track->padded != NULL ? track->padded : rgba);
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_MEDIA, muxer->path, "convert the colours", error));
  status = encode(muxer, track);
fail:
  return status;
}

/* Makes the conversion and the frame for a part of that size, unless the present ones fit. */
static ern_status prepare_patch(struct ern_muxer *muxer, struct ern_picture_track *track, int width, int height) {
  ern_status status = ERN_OK;
  if (track->patch != NULL && track->patch->width == width && track->patch->height == height) return ERN_OK;
  av_frame_free(&track->patch);
  sws_freeContext(track->convert_patch);
  ERN_TRY(open_conversion(muxer, track->codec, width, height, 1, &track->convert_patch));
  ERN_TRY(make_frame(muxer, track->codec, width, height, &track->patch));
fail:
  return status;
}

/* Converts rgba and puts it into its place of track->frame. swscale writes whole vectors, past a row's end too, so it
 * does not write there itself. */
static ern_status put_patch(struct ern_muxer *muxer, struct ern_picture_track *track, const int part[4],
                            const uint8_t *rgba) {
  const uint8_t *const from[4] = {rgba};
  const int from_bytes[4] = {4 * part[2]};
  ern_status status = ERN_OK;
  ERN_TRY(prepare_patch(muxer, track, part[2], part[3]));
  const AVFrame *patch = track->patch, *frame = track->frame;
  const int error = sws_scale(track->convert_patch, from, from_bytes, 0, part[3], patch->data, patch->linesize);
  if (error < 0) ERN_TRY(ern_av_fail(muxer->context, ERN_E_MEDIA, muxer->path, "convert the colours", error));
  for (int i = 0; i < 3; i++) {
    const int half = i > 0;
    uint8_t *to = frame->data[i] + (ptrdiff_t)(part[1] >> half) * frame->linesize[i] + (part[0] >> half);
    av_image_copy_plane(to, frame->linesize[i], patch->data[i], patch->linesize[i], part[2] >> half, part[3] >> half);
  }
fail:
  return status;
}

ern_status ern_picture_track_add_patched(struct ern_muxer *muxer, struct ern_picture_track *track,
                                         const AVFrame *recorded, const int part[4], const uint8_t *rgba) {
  AVFrame *frame = track->frame;
  ern_status status = ERN_OK;
  if (frame->format != recorded->format || frame->width != recorded->width || frame->height != recorded->height)
    ERN_TRY(ern_fail(muxer->context, ERN_E_UNSUPPORTED,
                     "%s: a frame of %d x %d pixels of yuv420p, expected the video's size and pixel format",
                     muxer->path, recorded->width, recorded->height));
  int error = av_frame_make_writable(frame);
  if (error >= 0) error = av_frame_copy(frame, recorded);
  if (error < 0) ERN_TRY(ern_av_fail(muxer->context, ERN_E_NO_MEMORY, muxer->path, "make a frame", error));
  if (part != NULL) ERN_TRY(put_patch(muxer, track, part, rgba));
  status = encode(muxer, track);
fail:
  return status;
}

void ern_picture_track_close(ern_context *context, struct ern_picture_track *track) {
  av_frame_free(&track->frame);
  sws_freeContext(track->convert);
  av_frame_free(&track->patch);
  sws_freeContext(track->convert_patch);
  avcodec_free_context(&track->codec);
  ern_release(context, track->padded);
  *track = (struct ern_picture_track){0};
}
