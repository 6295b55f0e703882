/* SPDX-License-Identifier: MIT
 * Reads video files frame by frame as RGB. */
#include <libavutil/display.h>
#include <libavutil/opt.h>
#include <libavutil/pixdesc.h>
#include <libswscale/swscale.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "core/sized.h"
#include "ernerf/media.h"
#include "media/ffmpeg.h"
#include "media/image.h"

struct ern_video_reader {
  ern_context *context;
  struct ern_decoder decoder;
  ern_video_info info;
  struct SwsContext *convert; /* for frames of this form: */
  int width, height, format;
  int quarters;    /* clockwise rotations by 90 degrees that the file asks for: 0..3 */
  ern_image lying; /* the frame before rotation */
  enum AVColorSpace space;
  enum AVColorRange range;
};

static void copy_name(char to[32], const char *name) { snprintf(to, 32, "%s", name != NULL ? name : "unknown"); }

/* The rotation by the stream's display matrix (how a telephone was held), rounded to quarter turns. */
static int quarters_of(const AVStream *stream) {
  size_t bytes = 0;
  const uint8_t *matrix = av_stream_get_side_data(stream, AV_PKT_DATA_DISPLAYMATRIX, &bytes);
  if (matrix == NULL || bytes < 9 * sizeof(int32_t)) return 0;
  const double degrees = -av_display_rotation_get((const int32_t *)(const void *)matrix);
  return isfinite(degrees) ? (int)lround(degrees / 90) & 3 : 0;
}

static void describe(ern_video_reader *reader) {
  AVFormatContext *container = reader->decoder.container;
  const AVCodecContext *codec = reader->decoder.codec;
  ern_video_info *info = &reader->info;
  const AVRational rate = av_guess_frame_rate(container, reader->decoder.stream, NULL);
  *info = (ern_video_info){
      .width = codec->width, .height = codec->height, .rate_numerator = rate.num, .rate_denominator = rate.den};
  reader->quarters = quarters_of(reader->decoder.stream);
  if (reader->quarters % 2 != 0) {
    info->width = codec->height;
    info->height = codec->width;
  }
  const AVRational aspect = av_guess_sample_aspect_ratio(container, reader->decoder.stream, NULL);
  info->pixel_aspect = aspect.num > 0 && aspect.den > 0 ? av_q2d(aspect) : 1;
  if (reader->quarters % 2 != 0) info->pixel_aspect = 1 / info->pixel_aspect;
  if (container->start_time != AV_NOPTS_VALUE) info->start = (double)container->start_time / AV_TIME_BASE;
  if (container->duration != AV_NOPTS_VALUE) info->duration = (double)container->duration / AV_TIME_BASE;
  copy_name(info->video_codec, avcodec_get_name(codec->codec_id));
  copy_name(info->pixel_format, av_get_pix_fmt_name(codec->pix_fmt));
  const int sound = av_find_best_stream(container, AVMEDIA_TYPE_AUDIO, -1, -1, NULL, 0);
  if (sound < 0) return;
  const AVCodecParameters *parameters = container->streams[sound]->codecpar;
  info->has_sound = true;
  info->sound_rate = parameters->sample_rate;
  info->sound_channels = parameters->ch_layout.nb_channels;
  copy_name(info->sound_codec, avcodec_get_name(parameters->codec_id));
}

ern_status ern_video_reader_open(ern_context *context, const char *path, ern_video_reader **reader) {
  ERN_PLAIN_FLOATS;
  if (reader != NULL) *reader = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, reader);
  ern_status status = ERN_OK;
  ern_video_reader *made = NULL;
  ERN_TRY(ERN_NEW(context, 1, &made));
  made->context = context;
  ERN_TRY(ern_decoder_open(context, path, AVMEDIA_TYPE_VIDEO, 0, &made->decoder));
  ERN_TRY(ern_image_check_sides(context, path, made->decoder.codec->width, made->decoder.codec->height));
  describe(made);
  *reader = made;
  return ERN_OK;
fail:
  ern_video_reader_free(&made);
  return status;
}

void ern_video_reader_info_sized(const ern_video_reader *reader, ern_video_info *info, size_t bytes) {
  const ern_video_info none = {0};
  ern_struct_copy_out(info, bytes, reader != NULL ? &reader->info : &none, sizeof none);
}

/* The file's colour matrix; where the file has none, the choice of players: BT.709 from 720 rows on, BT.601 below. */
static const int *matrix_of(const AVFrame *frame) {
  switch (frame->colorspace) {
    case AVCOL_SPC_BT709: return sws_getCoefficients(SWS_CS_ITU709);
    case AVCOL_SPC_BT470BG:
    case AVCOL_SPC_SMPTE170M: return sws_getCoefficients(SWS_CS_ITU601);
    case AVCOL_SPC_SMPTE240M: return sws_getCoefficients(SWS_CS_SMPTE240M);
    case AVCOL_SPC_FCC: return sws_getCoefficients(SWS_CS_FCC);
    case AVCOL_SPC_BT2020_NCL:
    case AVCOL_SPC_BT2020_CL: return sws_getCoefficients(SWS_CS_BT2020);
    default: return sws_getCoefficients(frame->height >= 720 ? SWS_CS_ITU709 : SWS_CS_ITU601);
  }
}

/* The formats "yuvj" are full range by name; swscale needs the plain formats and the range as a separate value. */
static enum AVPixelFormat plain_format(enum AVPixelFormat format, bool *full) {
  switch (format) {
    case AV_PIX_FMT_YUVJ420P: *full = true; return AV_PIX_FMT_YUV420P;
    case AV_PIX_FMT_YUVJ422P: *full = true; return AV_PIX_FMT_YUV422P;
    case AV_PIX_FMT_YUVJ440P: *full = true; return AV_PIX_FMT_YUV440P;
    case AV_PIX_FMT_YUVJ444P: *full = true; return AV_PIX_FMT_YUV444P;
    default: return format;
  }
}

/* Makes the conversion to RGB for frames of this format, unless the present conversion fits. */
static ern_status prepare(ern_video_reader *reader, const AVFrame *frame) {
  if (reader->convert != NULL && reader->width == frame->width && reader->height == frame->height &&
      reader->format == frame->format && reader->space == frame->colorspace && reader->range == frame->color_range) {
    return ERN_OK;
  }
  sws_freeContext(reader->convert);
  struct SwsContext *made = reader->convert = sws_alloc_context();
  int error = made != NULL ? 0 : AVERROR(ENOMEM);
  bool full = frame->color_range == AVCOL_RANGE_JPEG;
  const enum AVPixelFormat format = plain_format((enum AVPixelFormat)frame->format, &full);
  const AVPixFmtDescriptor *about = av_pix_fmt_desc_get(format);
  const bool left = frame->chroma_location == AVCHROMA_LOC_LEFT || frame->chroma_location == AVCHROMA_LOC_UNSPECIFIED;
  const struct {
    const char *name;
    int value;
  } options[] = {{"srcw", frame->width},
                 {"srch", frame->height},
                 {"src_format", format},
                 {"dstw", frame->width},
                 {"dsth", frame->height},
                 {"dst_format", AV_PIX_FMT_RGB24},
                 {"src_range", full},
                 {"dst_range", 1},
                 {"src_h_chr_pos", about != NULL && about->log2_chroma_w == 1 && left ? 0 : -513},
                 {"sws_flags", SWS_BICUBIC | SWS_FULL_CHR_H_INT | SWS_ACCURATE_RND | SWS_BITEXACT}};
  for (size_t i = 0; i < sizeof options / sizeof *options && error >= 0; i++) {
    error = av_opt_set_int(made, options[i].name, options[i].value, 0);
  }
  /* fails for sources that are RGB already: nothing to set there */
  if (error >= 0) {
    (void)sws_setColorspaceDetails(made, matrix_of(frame), full, sws_getCoefficients(SWS_CS_DEFAULT), 1, 0, 1 << 16,
                                   1 << 16);
    error = sws_init_context(made, NULL, NULL);
  }
  if (error < 0) {
    sws_freeContext(made);
    reader->convert = NULL;
    return ern_av_fail(reader->context, ERN_E_MEDIA, reader->decoder.path, "convert the colours", error);
  }
  reader->width = frame->width;
  reader->height = frame->height;
  reader->format = frame->format;
  reader->space = frame->colorspace;
  reader->range = frame->color_range;
  return ERN_OK;
}

/* to = from, turned clockwise by quarters. */
static void turn(const ern_image *from, int quarters, ern_image *to) {
  for (int y = 0; y < to->height; y++)
    for (int x = 0; x < to->width; x++) {
      const int u = quarters == 1 ? y : quarters == 2 ? from->width - 1 - x : from->width - 1 - y;
      const int v = quarters == 1 ? from->height - 1 - x : quarters == 2 ? from->height - 1 - y : x;
      memcpy(to->data + 3 * ((size_t)y * (size_t)to->width + (size_t)x),
             from->data + 3 * ((size_t)v * (size_t)from->width + (size_t)u), 3);
    }
}

/* Makes *image anew where its size differs. */
static ern_status fit(const ern_video_reader *reader, int width, int height, ern_image *image) {
  if (image->data != NULL && image->width == width && image->height == height && image->channels == 3) return ERN_OK;
  ern_image_free(reader->context, image);
  return ern_image_make(reader->context, reader->decoder.path, width, height, 3, image);
}

ern_status ern_video_reader_frame(ern_video_reader *reader, ern_image *image, double *seconds, bool *end) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, reader);
  ern_context *context = reader->context;
  const char *path = reader->decoder.path;
  ERN_NEED(context, image);
  ERN_NEED(context, seconds);
  ERN_NEED(context, end);
  ern_status status = ERN_OK;
  const AVFrame *frame = reader->decoder.frame;
  ERN_TRY(ern_decoder_next(&reader->decoder, end));
  if (*end) return ERN_OK;
  ERN_TRY(ern_image_check_sides(context, path, frame->width, frame->height));
  ERN_TRY(prepare(reader, frame));
  const bool upright = reader->quarters % 2 == 0;
  ERN_TRY(fit(reader, upright ? frame->width : frame->height, upright ? frame->height : frame->width, image));
  if (reader->quarters != 0) ERN_TRY(fit(reader, frame->width, frame->height, &reader->lying));
  const ern_image *straight = reader->quarters != 0 ? &reader->lying : image;
  uint8_t *const to[4] = {straight->data};
  const int to_bytes[4] = {frame->width * 3};
  const int error =
      sws_scale(reader->convert, (const uint8_t *const *)frame->data, frame->linesize, 0, frame->height, to, to_bytes);
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_MEDIA, path, "convert the colours", error));
  if (reader->quarters != 0) turn(straight, reader->quarters, image);
  if (frame->best_effort_timestamp == AV_NOPTS_VALUE) {
    ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: a frame has no time", path));
  }
  const AVRational unit = reader->decoder.stream->time_base;
  *seconds = (double)frame->best_effort_timestamp * unit.num / unit.den;
fail:
  return status;
}

void ern_video_reader_free(ern_video_reader **reader) {
  if (reader == NULL || *reader == NULL) return;
  ern_video_reader *dying = *reader;
  ern_context *context = dying->context;
  *reader = NULL;
  sws_freeContext(dying->convert);
  ern_image_free(context, &dying->lying);
  ern_decoder_close(&dying->decoder);
  ern_release(context, dying);
}
