/* SPDX-License-Identifier: MIT
 * Reads video files frame by frame as RGB. */
#include <libavutil/opt.h>
#include <libavutil/parseutils.h>
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
#include "media/live/picture_track.h"
#include "media/truncation.h"
#include "media/video/video_frame.h"
#include "media/video/video_sdr.h"

/* What a conversion to RGB depends on. */
struct form {
  int width, height, format;
  enum AVColorSpace space;
  enum AVColorRange range;
  enum AVColorTransferCharacteristic transfer;
  enum AVColorPrimaries primaries;
};

struct ern_video_reader {
  ern_context *context;
  struct ern_decoder decoder;
  ern_video_info info;
  struct SwsContext *convert; /* for frames of this form: */
  struct form form;
  struct ern_video_sdr *sdr; /* NULL for SDR */
  uint16_t *deep;            /* [height][width][3]: RGB before `sdr` */
  int orientation;           /* EXIF's, 1..8: how the file asks to turn and mirror its frames */
  ern_image lying;           /* the frame before that */
  bool found;                /* decoder.frame is the frame that a seek found, and the next one to be read */
  int64_t first, until;      /* time stamps: of the first frame, and of the end of the last one so far */
  bool has_first, sought;    /* sought: not read from the beginning on */
  int64_t delay;             /* by which the decoder's time stamps are late */
  int64_t due;               /* when the frame after the last decoded one is due; AV_NOPTS_VALUE: not known */
  bool told_transparent, told_aspect, told_interlaced;
};

static void copy_name(char to[32], const char *name) { snprintf(to, 32, "%s", name != NULL ? name : "unknown"); }

/* EXIF's orientation of the stream's display matrix (a b . c d . ...): it maps a pixel (p, q) to (a p + c q, b p + d
 * q). The angle is rounded to quarter turns. */
static int orientation_of(const AVStream *stream) {
  static const int orientation[2][2][2] = {{{1, 4}, {2, 3}}, {{5, 6}, {8, 7}}};
  size_t bytes = 0;
  const uint8_t *data = av_stream_get_side_data(stream, AV_PKT_DATA_DISPLAYMATRIX, &bytes);
  if (data == NULL || bytes < 9 * sizeof(int32_t)) return 1;
  const int32_t *matrix = (const int32_t *)(const void *)data;
  const double a = matrix[0], b = matrix[1], c = matrix[3], d = matrix[4];
  const bool swapped = fabs(b) + fabs(c) > fabs(a) + fabs(d);
  return orientation[swapped][(swapped ? b : a) < 0][(swapped ? c : d) < 0];
}

/* info->other_streams: in words. sound: the index of the one that is read; negative: none. */
static void name_others(ern_video_reader *reader, int sound) {
  const AVFormatContext *container = reader->decoder.container;
  char *text = reader->info.other_streams;
  size_t used = 0;
  for (unsigned i = 0; i < container->nb_streams; i++) {
    const AVStream *stream = container->streams[i];
    const enum AVMediaType type = stream->codecpar->codec_type;
    const bool ordinary = type == AVMEDIA_TYPE_AUDIO || type == AVMEDIA_TYPE_SUBTITLE ||
                          (type == AVMEDIA_TYPE_VIDEO && (stream->disposition & AV_DISPOSITION_ATTACHED_PIC) == 0);
    if (!ordinary || (int)i == sound || stream == reader->decoder.stream) continue;
    const int added =
        snprintf(text + used, sizeof reader->info.other_streams - used, "%sstream %u (%s, %s)", used > 0 ? ", " : "", i,
                 av_get_media_type_string(type), avcodec_get_name(stream->codecpar->codec_id));
    if (added < 0 || used + (size_t)added >= sizeof reader->info.other_streams) {
      text[used] = 0; /* whole names alone */
      return;
    }
    used += (size_t)added;
  }
}

/* Width over height of a pixel as it is shown, by the frame (NULL: the header) where the container does not say it. */
static double pixel_aspect(const ern_video_reader *reader, AVFrame *frame) {
  const AVRational guess = av_guess_sample_aspect_ratio(reader->decoder.container, reader->decoder.stream, frame);
  const double aspect = guess.num > 0 && guess.den > 0 ? av_q2d(guess) : 1;
  return reader->orientation >= 5 ? 1 / aspect : aspect;
}

/* Warns once where the shape of the pixels changes: what is read has no place for a second one. */
static void check_aspect(ern_video_reader *reader, double seconds) {
  const double found = pixel_aspect(reader, reader->decoder.frame), expected = reader->info.pixel_aspect;
  if (reader->told_aspect || fabs(found / expected - 1) < 0.01) return;
  reader->told_aspect = true;
  ern_log(reader->context, ERN_LOG_WARNING,
          "%s: from %.2f s on its pixels are %.3g times as wide as high, expected %.3g times, as in its header; they "
          "are taken as %.3g times, so what is there is stretched",
          reader->decoder.path, seconds, found, expected, expected);
}

static void describe(ern_video_reader *reader) {
  AVFormatContext *container = reader->decoder.container;
  const AVCodecContext *codec = reader->decoder.codec;
  ern_video_info *info = &reader->info;
  AVRational rate = av_guess_frame_rate(container, reader->decoder.stream, NULL);
  av_reduce(&rate.num, &rate.den, rate.num, rate.den, ERN_RATE_PART);
  *info = (ern_video_info){
      .width = codec->width, .height = codec->height, .rate_numerator = rate.num, .rate_denominator = rate.den};
  reader->orientation = orientation_of(reader->decoder.stream);
  const bool swapped = reader->orientation >= 5; /* rows are stored as columns */
  if (swapped) {
    info->width = codec->height;
    info->height = codec->width;
  }
  info->pixel_aspect = pixel_aspect(reader, NULL);
  if (container->start_time != AV_NOPTS_VALUE) info->start = (double)container->start_time / AV_TIME_BASE;
  if (container->duration != AV_NOPTS_VALUE) info->duration = (double)container->duration / AV_TIME_BASE;
  copy_name(info->video_codec, avcodec_get_name(codec->codec_id));
  copy_name(info->pixel_format, av_get_pix_fmt_name(codec->pix_fmt));
  const int sound = av_find_best_stream(container, AVMEDIA_TYPE_AUDIO, -1, -1, NULL, 0);
  name_others(reader, sound);
  if (sound < 0) return;
  const AVCodecParameters *parameters = container->streams[sound]->codecpar;
  info->has_sound = true;
  info->sound_rate = parameters->sample_rate;
  info->sound_channels = parameters->ch_layout.nb_channels;
  copy_name(info->sound_codec, avcodec_get_name(parameters->codec_id));
}

/* An AVI has no times of display: FFmpeg gives a frame that of the packet which the decoder needed before it gave the
 * frame out, and with B-frames that is a later one. */
static int64_t delay_of(const struct ern_decoder *decoder) {
  const AVStream *stream = decoder->stream;
  const int packets = decoder->codec->has_b_frames;
  if (strcmp(decoder->container->iformat->name, "avi") != 0 || packets <= 0 || stream->avg_frame_rate.num <= 0)
    return 0;
  return av_rescale_q(packets, av_inv_q(stream->avg_frame_rate), stream->time_base);
}

static void warn_interlaced(ern_video_reader *reader) {
  if (reader->told_interlaced) return;
  reader->told_interlaced = true;
  ern_log(reader->context, ERN_LOG_WARNING,
          "%s: is interlaced: each of its frames shows two instants, in alternate rows; expected one that is not, as "
          "FFmpeg's filter bwdif makes it",
          reader->decoder.path);
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
  made->delay = delay_of(&made->decoder);
  if (made->decoder.stream->codecpar->field_order > AV_FIELD_PROGRESSIVE) warn_interlaced(made);
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

/* *made: the conversion to RGB of `target` for width x height pixels of such frames. */
static int make_convert(const AVFrame *frame, int width, int height, enum AVPixelFormat target,
                        struct SwsContext **made) {
  *made = sws_alloc_context();
  int error = *made != NULL ? 0 : AVERROR(ENOMEM);
  bool full = frame->color_range == AVCOL_RANGE_JPEG;
  const enum AVPixelFormat format = plain_format((enum AVPixelFormat)frame->format, &full);
  const AVPixFmtDescriptor *about = av_pix_fmt_desc_get(format);
  const bool left = frame->chroma_location == AVCHROMA_LOC_LEFT || frame->chroma_location == AVCHROMA_LOC_UNSPECIFIED;
  const struct {
    const char *name;
    int value;
  } options[] = {{"srcw", width},
                 {"srch", height},
                 {"src_format", format},
                 {"dstw", width},
                 {"dsth", height},
                 {"dst_format", target},
                 {"src_range", full},
                 {"dst_range", 1},
                 {"src_h_chr_pos", about != NULL && about->log2_chroma_w == 1 && left ? 0 : -513},
                 {"sws_flags", SWS_BICUBIC | SWS_FULL_CHR_H_INT | SWS_ACCURATE_RND | SWS_BITEXACT}};
  for (size_t i = 0; i < sizeof options / sizeof *options && error >= 0; i++) {
    error = av_opt_set_int(*made, options[i].name, options[i].value, 0);
  }
  /* fails for sources that are RGB already: nothing to set there */
  if (error >= 0) {
    (void)sws_setColorspaceDetails(*made, matrix_of(frame), full, sws_getCoefficients(SWS_CS_DEFAULT), 1, 0, 1 << 16,
                                   1 << 16);
    error = sws_init_context(*made, NULL, NULL);
  }
  return error;
}

static void free_convert(ern_video_reader *reader) {
  sws_freeContext(reader->convert);
  reader->convert = NULL;
  ern_release(reader->context, reader->sdr);
  reader->sdr = NULL;
  ern_release(reader->context, reader->deep);
  reader->deep = NULL;
}

/* Makes the conversion for width x height pixels of frames of this form, unless the present one fits. */
static ern_status prepare(ern_video_reader *reader, const AVFrame *frame, int width, int height) {
  ern_context *context = reader->context;
  const char *path = reader->decoder.path;
  const struct form old = reader->form, form = {.width = width,
                                                .height = height,
                                                .format = frame->format,
                                                .space = frame->colorspace,
                                                .range = frame->color_range,
                                                .transfer = frame->color_trc,
                                                .primaries = frame->color_primaries};
  ern_status status = ERN_OK;
  if (reader->convert != NULL && form.width == old.width && form.height == old.height && form.format == old.format &&
      form.space == old.space && form.range == old.range && form.transfer == old.transfer &&
      form.primaries == old.primaries)
    return ERN_OK;
  free_convert(reader);
  ERN_TRY(ern_video_sdr_make(context, form.transfer, form.primaries, &reader->sdr));
  /* sides are checked: at most 8192 * 8192 * 3 */
  if (reader->sdr != NULL) {
    ERN_TRY(ERN_NEW(context, (size_t)form.width * (size_t)form.height * 3, &reader->deep));
    ern_log(context, ERN_LOG_INFO, "%s: %s, converted to SDR (BT.709)", path, ern_video_sdr_words(reader->sdr));
  }
  const enum AVPixelFormat target = reader->sdr != NULL ? AV_PIX_FMT_RGB48 : AV_PIX_FMT_RGB24;
  const int error = make_convert(frame, width, height, target, &reader->convert);
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_MEDIA, path, "convert the colours", error));
  reader->form = form;
  return ERN_OK;
fail:
  free_convert(reader);
  return status;
}

/* *image, of the part's size, = the part of the frame as RGB. */
static ern_status convert(ern_video_reader *reader, const AVFrame *frame, const int part[4], ern_image *image) {
  struct ern_video_sdr *sdr = reader->sdr;
  const uint8_t *from[4];
  uint8_t *const to[4] = {sdr != NULL ? (uint8_t *)reader->deep : image->data};
  const int to_bytes[4] = {part[2] * 3 * (sdr != NULL ? (int)sizeof *reader->deep : 1)};
  ern_video_frame_planes(frame, part, from);
  const int error = sws_scale(reader->convert, from, frame->linesize, 0, part[3], to, to_bytes);
  if (error < 0) return ern_av_fail(reader->context, ERN_E_MEDIA, reader->decoder.path, "convert the colours", error);
  if (sdr != NULL) ern_video_sdr_convert(sdr, reader->deep, (size_t)part[2] * (size_t)part[3], image->data);
  return ERN_OK;
}

/* Seconds of the pictures by the header, in Matroska by a tag; 0: it has none. */
static double length_by_header(const AVStream *stream) {
  const AVDictionaryEntry *tag = av_dict_get(stream->metadata, "DURATION", NULL, 0);
  int64_t microseconds = 0;
  if (stream->duration > 0) return (double)stream->duration * av_q2d(stream->time_base);
  if (tag == NULL || av_parse_time(&microseconds, tag->value, 1) < 0) return 0;
  return 1e-6 * (double)microseconds;
}

/* Warns where the pictures end before the length that the header states, in which other streams do not count. */
static void check_end(ern_video_reader *reader) {
  const AVStream *stream = reader->decoder.stream;
  const double unit = av_q2d(stream->time_base);
  const int64_t from = stream->duration > 0 ? reader->first : 0; /* a tag counts from second 0 */
  if (!reader->has_first || reader->sought ||
      reader->decoder.container->duration_estimation_method == AVFMT_DURATION_FROM_BITRATE)
    return;
  ern_truncation_warn_end(reader->context, reader->decoder.path, "video", (double)(reader->until - from) * unit,
                          length_by_header(stream));
  reader->has_first = false; /* once */
}

static void note_time(ern_video_reader *reader, const AVFrame *frame) {
  const int64_t at = frame->best_effort_timestamp, end = at + frame->pkt_duration;
  if (!reader->has_first) reader->first = reader->until = at;
  reader->has_first = true;
  if (end > reader->until) reader->until = end;
}

/* Warns once where a pixel is transparent: its colour is taken as it is. */
static ern_status look_for_transparent(ern_video_reader *reader, const AVFrame *frame) {
  const AVPixFmtDescriptor *about = av_pix_fmt_desc_get((enum AVPixelFormat)frame->format);
  const int width = frame->width, height = frame->height;
  const size_t pixels = (size_t)width * (size_t)height; /* sides are checked */
  uint8_t *rgba = NULL;
  ern_status status = ERN_OK;
  if (reader->told_transparent || about == NULL || (about->flags & AV_PIX_FMT_FLAG_ALPHA) == 0) return ERN_OK;
  struct SwsContext *to_rgba = sws_getContext(width, height, (enum AVPixelFormat)frame->format, width, height,
                                              AV_PIX_FMT_RGBA, SWS_POINT, NULL, NULL, NULL);
  if (to_rgba == NULL) return ERN_OK; /* the conversion to RGB will say why */
  ERN_TRY(ERN_NEW(reader->context, 4 * pixels, &rgba));
  (void)sws_scale(to_rgba, (const uint8_t *const *)frame->data, frame->linesize, 0, height, (uint8_t *const[]){rgba},
                  (const int[]){4 * width});
  for (size_t i = 0; i < pixels && !reader->told_transparent; i++) reader->told_transparent = rgba[4 * i + 3] < 250;
  if (reader->told_transparent)
    ern_log(reader->context, ERN_LOG_WARNING,
            "%s: has transparent pixels, which are taken as opaque; expected a video over its background",
            reader->decoder.path);
fail:
  ern_release(reader->context, rgba);
  sws_freeContext(to_rgba);
  return status;
}

/* *image = the part of the frame (of one with another orientation than 1: the whole frame) as RGB, upright. */
static ern_status rgb_of(ern_video_reader *reader, const AVFrame *frame, const int part[4], ern_image *image) {
  ern_context *context = reader->context;
  const char *path = reader->decoder.path;
  ern_status status = ERN_OK;
  ERN_TRY(look_for_transparent(reader, frame));
  ERN_TRY(prepare(reader, frame, part[2], part[3]));
  ern_image *straight = reader->orientation != 1 ? &reader->lying : image;
  ERN_TRY(ern_image_fit(context, path, part[2], part[3], 3, straight));
  ERN_TRY(convert(reader, frame, part, straight));
  if (reader->orientation != 1) ERN_TRY(ern_image_turn(context, path, straight, reader->orientation, image));
fail:
  return status;
}

/* Decodes the next frame. One without a time, as the last one of an AVI with B-frames, gets the time when it is due. */
static ern_status next_frame(ern_video_reader *reader, bool *end) {
  AVFrame *frame = reader->decoder.frame;
  const AVStream *stream = reader->decoder.stream;
  const ern_status status = ern_decoder_next(&reader->decoder, end);
  if (status != ERN_OK || *end) return status;
  if (frame->best_effort_timestamp == AV_NOPTS_VALUE)
    frame->best_effort_timestamp = reader->due;
  else
    frame->best_effort_timestamp -= reader->delay;
  int64_t lasts = frame->pkt_duration;
  if (lasts <= 0 && stream->avg_frame_rate.num > 0)
    lasts = av_rescale_q(1, av_inv_q(stream->avg_frame_rate), stream->time_base);
  const bool known = frame->best_effort_timestamp != AV_NOPTS_VALUE && lasts > 0;
  reader->due = known ? frame->best_effort_timestamp + lasts : AV_NOPTS_VALUE;
  return ERN_OK;
}

/* The next frame, into decoder.frame, and its time. */
static ern_status decode(ern_video_reader *reader, double *seconds, bool *end) {
  const AVFrame *frame = reader->decoder.frame;
  ern_status status = ERN_OK;
  *end = false;
  if (!reader->found) ERN_TRY(next_frame(reader, end));
  reader->found = false;
  if (*end) {
    check_end(reader);
    return ERN_OK;
  }
  ERN_TRY(ern_image_check_sides(reader->context, reader->decoder.path, frame->width, frame->height));
  if (frame->best_effort_timestamp == AV_NOPTS_VALUE)
    ERN_TRY(ern_fail(reader->context, ERN_E_FORMAT, "%s: a frame has no time", reader->decoder.path));
  note_time(reader, frame);
  const AVRational unit = reader->decoder.stream->time_base;
  *seconds = (double)frame->best_effort_timestamp * unit.num / unit.den; /* rounded once where num is 1 */
  check_aspect(reader, *seconds);
  if (frame->interlaced_frame) warn_interlaced(reader); /* a DV has it in its frames alone */
fail:
  return status;
}

ern_status ern_video_reader_frame(ern_video_reader *reader, ern_image *image, double *seconds, bool *end) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, reader);
  ern_context *context = reader->context;
  ERN_NEED(context, image);
  ERN_NEED(context, seconds);
  ERN_NEED(context, end);
  const AVFrame *frame = reader->decoder.frame;
  const ern_status status = decode(reader, seconds, end);
  if (status != ERN_OK || *end) return status;
  return rgb_of(reader, frame, (const int[4]){0, 0, frame->width, frame->height}, image);
}

/* Whether a writer of yuv420p would code such pixels as they are: 8 bits, 4:2:0, BT.709 or no tags, limited range. */
static bool is_plain(const ern_video_reader *reader, const AVFrame *frame) {
  const bool usual = (frame->color_trc == AVCOL_TRC_BT709 || frame->color_trc == AVCOL_TRC_UNSPECIFIED) &&
                     (frame->color_primaries == AVCOL_PRI_BT709 || frame->color_primaries == AVCOL_PRI_UNSPECIFIED);
  const bool left = frame->chroma_location == AVCHROMA_LOC_LEFT || frame->chroma_location == AVCHROMA_LOC_UNSPECIFIED;
  return reader->orientation == 1 && usual && frame->format == AV_PIX_FMT_YUV420P && left &&
         frame->color_range != AVCOL_RANGE_JPEG && matrix_of(frame) == sws_getCoefficients(SWS_CS_ITU709) &&
         frame->width % 2 == 0 && frame->height % 2 == 0;
}

/* Whether the decoded frame has the size of ern_video_reader_info. */
static ern_status check_size(const ern_video_reader *reader, double seconds) {
  const AVFrame *frame = reader->decoder.frame;
  const ern_video_info *info = &reader->info;
  const bool swapped = reader->orientation >= 5; /* rows are stored as columns */
  const int width = swapped ? frame->height : frame->width, height = swapped ? frame->width : frame->height;
  if (width == info->width && height == info->height) return ERN_OK;
  return ern_fail(reader->context, ERN_E_SHAPE,
                  "%s: its picture at %.2f s has %d x %d pixels, expected %d x %d, as the first one has",
                  reader->decoder.path, seconds, width, height, info->width, info->height);
}

ern_status ern_video_reader_decode(ern_video_reader *reader, ern_video_frame **frame, double *seconds) {
  ERN_PLAIN_FLOATS;
  if (frame != NULL) *frame = NULL;
  ERN_NEED(NULL, reader);
  ern_context *context = reader->context;
  ERN_NEED(context, frame);
  ERN_NEED(context, seconds);
  const AVFrame *decoded = reader->decoder.frame;
  bool end = false;
  ern_status status = ERN_OK;
  ERN_TRY(decode(reader, seconds, &end));
  if (end) return ERN_OK;
  ERN_TRY(check_size(reader, *seconds));
  ERN_TRY(ern_video_frame_make(context, decoded, is_plain(reader, decoded), frame));
fail:
  return status;
}

ern_status ern_video_reader_rgb(ern_video_reader *reader, const ern_video_frame *frame, const int part[4],
                                ern_image *image) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, reader);
  ERN_NEED(reader->context, frame);
  ERN_NEED(reader->context, image);
  const int whole[4] = {0, 0, frame->frame->width, frame->frame->height};
  if (part == NULL) return rgb_of(reader, frame->frame, whole, image);
  const ern_status status = ern_video_frame_check(reader->context, reader->decoder.path, frame, part);
  return status == ERN_OK ? rgb_of(reader, frame->frame, part, image) : status;
}

/* Decodes from the last key frame on that lies at or before `at`, until a frame of that time or a later one. */
static ern_status seek(ern_video_reader *reader, int64_t at) {
  struct ern_decoder *decoder = &reader->decoder;
  const AVRational unit = decoder->stream->time_base;
  const int64_t second = av_rescale_q(1, (AVRational){1, 1}, unit), begins = decoder->stream->start_time;
  const int64_t first = begins != AV_NOPTS_VALUE ? begins : 0;
  bool end = false;
  ern_status status = ERN_OK;
  /* an index of decoding times may lead to a key frame that is shown later */
  for (int64_t to = at, back = second;; to -= back, back *= 2) {
    if (to < first) to = first;
    const int error = av_seek_frame(decoder->container, decoder->stream->index, to, AVSEEK_FLAG_BACKWARD);
    if (error < 0) ERN_TRY(ern_av_fail(reader->context, ERN_E_UNSUPPORTED, decoder->path, "go back in it", error));
    avcodec_flush_buffers(decoder->codec);
    decoder->drained = false;
    reader->due = AV_NOPTS_VALUE;
    ERN_TRY(next_frame(reader, &end));
    if (to == first || (!end && decoder->frame->best_effort_timestamp <= at)) break;
  }
  while (!end && decoder->frame->best_effort_timestamp < at) ERN_TRY(next_frame(reader, &end));
  reader->found = !end;
fail:
  return status;
}

ern_status ern_video_reader_seek(ern_video_reader *reader, double seconds) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, reader);
  if (!(fabs(seconds) < 1e9))
    return ern_fail(reader->context, ERN_E_ARGUMENT, "%s: second %g, expected a time in it", reader->decoder.path,
                    seconds);
  reader->found = false;
  reader->sought = true;
  return seek(reader, (int64_t)ceil(seconds / av_q2d(reader->decoder.stream->time_base) - 1e-3));
}

void ern_video_reader_free(ern_video_reader **reader) {
  if (reader == NULL || *reader == NULL) return;
  ern_video_reader *dying = *reader;
  ern_context *context = dying->context;
  *reader = NULL;
  free_convert(dying);
  ern_image_free(context, &dying->lying);
  ern_decoder_close(&dying->decoder);
  ern_release(context, dying);
}
