/* SPDX-License-Identifier: MIT
 * Joins several mp4 files into one: copies their coded pictures, and encodes the sound once for all of them.
 *
 * Each segment is a sequence of closed groups of pictures, so that only the timestamps change. All segments are read
 * twice: those that cannot be joined are refused before anything is written. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "ernerf/media.h"
#include "io/file.h"
#include "media/ffmpeg.h"
#include "media/live/picture_track.h"
#include "media/video/video_sound.h"

enum { MOST_XMP = 1 << 20 };

struct segment {
  const char *path;
  AVFormatContext *container;
  AVStream *stream;
  AVPacket *packet;
};

struct joined {
  ern_context *context;
  struct ern_file_writer file;
  struct ern_muxer muxer;
  AVStream *stream;
  AVRational rate;
  int64_t delay; /* reorder delay: pictures that are decoded before the first is shown */
  int64_t pictures;
  struct ern_sound_track sound;
  char *xmp;
};

/* ---- reading ----------------------------------------------------------------------------------------------------- */

static void close_segment(struct segment *s) {
  av_packet_free(&s->packet);
  avformat_close_input(&s->container);
}

static ern_status open_segment(ern_context *context, const char *path, struct segment *s) {
  ern_status status = ERN_OK;
  *s = (struct segment){.path = path, .packet = av_packet_alloc()};
  if (s->packet == NULL) ERN_TRY(ern_fail(context, ERN_E_NO_MEMORY, "%s: no memory for a packet", path));
  ERN_TRY(ern_av_open_file(context, path, &s->container));
  const int best = av_find_best_stream(s->container, AVMEDIA_TYPE_VIDEO, -1, -1, NULL, 0);
  if (best < 0) ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: has no pictures, expected a video", path));
  s->stream = s->container->streams[best];
fail:
  return status;
}

/* Reads the next coded picture into the packet; *end is set where there is none. */
static ern_status next_packet(ern_context *context, struct segment *s, bool *end) {
  for (*end = false;;) {
    av_packet_unref(s->packet);
    const int error = ern_av_read_packet(s->container, s->packet);
    if (error == AVERROR_EOF) *end = true;
    if (*end) return ERN_OK;
    if (error < 0) return ern_av_fail(context, ERN_E_FORMAT, s->path, "read a picture", error);
    if (s->packet->stream_index == s->stream->index) return ERN_OK;
  }
}

/* The index of a picture in its segment, by its presentation time; -1 where that is between two pictures. */
static int64_t number_of(const struct segment *s, AVRational rate, int64_t pts) {
  const AVRational each = {rate.den, rate.num};
  const int64_t number = av_rescale_q(pts, s->stream->time_base, each);
  return pts != AV_NOPTS_VALUE && av_rescale_q(number, each, s->stream->time_base) == pts ? number : -1;
}

/* ---- the look before --------------------------------------------------------------------------------------------- */

static bool same_coding(const AVCodecParameters *a, const AVCodecParameters *b) {
  return a->codec_id == b->codec_id && a->width == b->width && a->height == b->height && a->format == b->format &&
         av_cmp_q(a->sample_aspect_ratio, b->sample_aspect_ratio) == 0 && a->extradata_size == b->extradata_size &&
         (a->extradata_size == 0 || memcmp(a->extradata, b->extradata, (size_t)a->extradata_size) == 0);
}

static bool same_tag(const AVDictionary *a, const AVDictionary *b, const char *name) {
  const AVDictionaryEntry *one = av_dict_get(a, name, NULL, 0), *other = av_dict_get(b, name, NULL, 0);
  return (one == NULL) == (other == NULL) && (one == NULL || strcmp(one->value, other->value) == 0);
}

/* Checks a segment against the first; first NULL: it is the first. */
static ern_status look_at(struct joined *j, struct segment *s, const struct segment *first) {
  const AVRational rate = s->stream->avg_frame_rate;
  bool end = false;
  int64_t count = 0, last = -1;
  ern_status status = ERN_OK;
  if (first == NULL) {
    j->rate = rate;
    ERN_TRY(ern_picture_rate_check(j->context, s->path, rate.num, rate.den));
  }
  if (av_cmp_q(rate, j->rate) != 0)
    return ern_fail(j->context, ERN_E_MISMATCH, "%s: has %d/%d pictures a second, expected %d/%d", s->path, rate.num,
                    rate.den, j->rate.num, j->rate.den);
  if (av_stream_get_side_data(s->stream, AV_PKT_DATA_DISPLAYMATRIX, NULL) != NULL)
    return ern_fail(j->context, ERN_E_FORMAT,
                    "%s: is turned or mirrored where it is shown (display matrix); expected a segment that render "
                    "wrote",
                    s->path);
  if (first != NULL && !same_coding(s->stream->codecpar, first->stream->codecpar))
    return ern_fail(j->context, ERN_E_MISMATCH,
                    "%s: is of %d x %d pixels or coded with other settings, expected those of %s, %d x %d", s->path,
                    s->stream->codecpar->width, s->stream->codecpar->height, first->path,
                    first->stream->codecpar->width, first->stream->codecpar->height);
  if (first != NULL && (!same_tag(s->container->metadata, first->container->metadata, "AIGC") ||
                        !same_tag(s->container->metadata, first->container->metadata, "DigitalSourceType")))
    return ern_fail(j->context, ERN_E_MISMATCH, "%s: says that it was made of another model or speech than %s", s->path,
                    first->path);
  ERN_TRY(next_packet(j->context, s, &end));
  for (; !end; count++) {
    const int64_t number = number_of(s, j->rate, s->packet->pts);
    if (number < 0 || (count == 0 && (number != 0 || !(s->packet->flags & AV_PKT_FLAG_KEY))))
      return ern_fail(j->context, ERN_E_FORMAT,
                      "%s: picture %lld has a time that is no multiple of the frame's, or the first one is no key "
                      "frame at time 0; expected a segment that render wrote",
                      s->path, (long long)count);
    if (count - number > j->delay) j->delay = count - number;
    if (number > last) last = number;
    ERN_TRY(next_packet(j->context, s, &end));
  }
  if (count == 0 || last != count - 1)
    return ern_fail(j->context, ERN_E_FORMAT, "%s: has %lld pictures, the last of them is number %lld", s->path,
                    (long long)count, (long long)last);
fail:
  return status;
}

static ern_status look_at_all(struct joined *j, const char *const *segments, size_t count, struct segment *first) {
  ern_status status = open_segment(j->context, segments[0], first);
  if (status == ERN_OK) status = look_at(j, first, NULL);
  for (size_t k = 1; k < count && status == ERN_OK; k++) {
    struct segment s;
    status = open_segment(j->context, segments[k], &s);
    if (status == ERN_OK) status = look_at(j, &s, first);
    close_segment(&s);
  }
  return status;
}

static uint64_t big_endian(const unsigned char *from, size_t bytes) {
  uint64_t value = 0;
  for (size_t i = 0; i < bytes; i++) value = value << 8 | from[i];
  return value;
}

/* Removes what the first segment says is synthetic of it (make_member of provenance.c): the whole has other seconds. */
static void drop_description(char *xmp) {
  char *line = strstr(xmp, "   <dc:description>"), *end = line != NULL ? strchr(line, '\n') : NULL;
  if (end != NULL) memmove(line, end + 1, strlen(end + 1) + 1);
}

/* The XMP packet in the last box of the first segment, where there is one. A read that fails is no end of the file. */
static ern_status read_xmp(struct joined *j, const char *path) {
  unsigned char head[24];
  FILE *file = fopen(path, "rb");
  ern_status status = ERN_OK;
  if (file == NULL) return ern_fail(j->context, ERN_E_IO, "%s: cannot be opened again", path);
  while (fread(head, 1, 8, file) == 8) {
    uint64_t size = big_endian(head, 4), header = 8;
    if (size == 1) { /* the size follows in 64 bits */
      if (fread(head + 8, 1, 8, file) != 8) break;
      size = big_endian(head + 8, 8);
      header = 16;
    }
    if (size < header || size > INT64_MAX) goto fail; /* size 0: up to the file's end, not a box of ours */
    const bool is_xmp = memcmp(head + 4, "uuid", 4) == 0 && header == 8 && size > sizeof head && size < MOST_XMP;
    if (!is_xmp && fseeko(file, (off_t)(size - header), SEEK_CUR) != 0) goto fail; /* no place in a file */
    if (!is_xmp) continue;
    ERN_TRY(ERN_NEW(j->context, size - sizeof head + 1, &j->xmp));
    if (fread(head + 8, 1, 16, file) == 16 && fread(j->xmp, 1, size - sizeof head, file) == size - sizeof head) {
      drop_description(j->xmp);
      goto fail;
    }
    ern_release(j->context, j->xmp);
    j->xmp = NULL;
    break;
  }
  if (!feof(file)) ERN_TRY(ern_fail(j->context, ERN_E_IO, "%s: cannot read its boxes", path));
fail:
  fclose(file);
  return status;
}

/* ---- writing ----------------------------------------------------------------------------------------------------- */

static ern_status open_output(struct joined *j, const char *path, const struct segment *first, const ern_sound *sound,
                              double sound_start) {
  struct ern_muxer *muxer = &j->muxer;
  AVDictionary *options = NULL;
  char *url = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ern_file_writer_open(j->context, path, ERN_EXISTING_BY_CONTEXT, &j->file));
  *muxer = (struct ern_muxer){.context = j->context, .path = j->file.path, .packet = av_packet_alloc()};
  int error = avformat_alloc_output_context2(&muxer->container, NULL, "mp4", NULL);
  if (error >= 0 && muxer->packet != NULL) j->stream = avformat_new_stream(muxer->container, NULL);
  if (j->stream == NULL) ERN_TRY(ern_fail(j->context, ERN_E_NO_MEMORY, "%s: no memory for an mp4", path));
  error = avcodec_parameters_copy(j->stream->codecpar, first->stream->codecpar);
  if (error >= 0) error = av_dict_copy(&j->stream->metadata, first->stream->metadata, 0);
  if (error >= 0) error = av_dict_copy(&muxer->container->metadata, first->container->metadata, 0);
  if (error >= 0) error = av_dict_set(&muxer->container->metadata, "description", NULL, 0);
  if (error < 0) ERN_TRY(ern_av_fail(j->context, ERN_E_NO_MEMORY, path, "make an mp4", error));
  const unsigned tag = j->stream->codecpar->codec_tag; /* kept where mp4 knows it, such as hvc1 instead of hev1 */
  if (av_codec_get_id(muxer->container->oformat->codec_tag, tag) != j->stream->codecpar->codec_id)
    j->stream->codecpar->codec_tag = 0;
  j->stream->time_base = (AVRational){j->rate.den, j->rate.num};
  j->stream->avg_frame_rate = j->rate;
  ERN_TRY(ern_sound_track_open(muxer, sound, sound_start, AV_CODEC_ID_AAC, &j->sound));
  ERN_TRY(ern_av_url(j->context, j->file.temporary, &url));
  muxer->container->url = av_strdup(url);
  error = muxer->container->url != NULL ? avio_open(&muxer->container->pb, url, AVIO_FLAG_WRITE) : AVERROR(ENOMEM);
  if (error < 0) ERN_TRY(ern_av_fail(j->context, ERN_E_IO, path, "write", error));
  error = av_dict_set(&options, "movflags", j->xmp != NULL ? "+faststart+use_metadata_tags" : "+faststart", 0);
  if (error >= 0) error = avformat_write_header(muxer->container, &options);
  if (error < 0) ERN_TRY(ern_av_fail(j->context, ERN_E_MEDIA, path, "write the head of an mp4", error));
fail:
  av_dict_free(&options);
  ern_release(j->context, url);
  return status;
}

static ern_status add_segment(struct joined *j, const char *path) {
  const AVRational each = {j->rate.den, j->rate.num};
  struct segment s;
  bool end = false;
  int64_t count = 0;
  ern_status status = ERN_OK;
  ERN_TRY(open_segment(j->context, path, &s));
  ERN_TRY(next_packet(j->context, &s, &end));
  for (; !end; count++) {
    AVPacket *packet = s.packet;
    packet->pts = j->pictures + number_of(&s, j->rate, packet->pts);
    packet->dts = j->pictures + count - j->delay;
    packet->duration = 1;
    packet->stream_index = j->stream->index;
    packet->pos = -1;
    av_packet_rescale_ts(packet, each, j->stream->time_base);
    int error = av_interleaved_write_frame(j->muxer.container, packet);
    if (error >= 0) error = j->muxer.container->pb->error;
    if (error < 0) ERN_TRY(ern_av_fail(j->context, ERN_E_IO, j->file.path, "write", error));
    ERN_TRY(ern_sound_track_advance(&j->muxer, &j->sound, j->pictures + count + 1, j->rate, false));
    ERN_TRY(next_packet(j->context, &s, &end));
  }
  j->pictures += count;
fail:
  close_segment(&s);
  return status;
}

/* Where the sound ends more than a frame before the pictures, of them or of speech, 25 a second. */
static void warn_of_silence(const struct joined *j, const ern_sound *sound, double start) {
  if (sound == NULL) return;
  const double there = fmax((double)sound->frames / sound->rate - start, 0);
  const double each = av_q2d(av_inv_q(j->rate)), needed = (double)j->pictures * each;
  if (there < needed - fmax(each, 1.0 / 25))
    ern_log(j->context, ERN_LOG_WARNING,
            "%s: %.2f s of sound from the first frame on, the pictures last %.2f s: the rest is silent", j->file.path,
            there, needed);
}

static ern_status finish(struct joined *j) {
  AVFormatContext *container = j->muxer.container;
  ern_status status = ERN_OK;
  ERN_TRY(ern_sound_track_advance(&j->muxer, &j->sound, j->pictures, j->rate, true));
  ERN_TRY(ern_muxer_end(&j->muxer, j->xmp));
  avio_flush(container->pb);
  int error = container->pb->error;
  const int closed = avio_closep(&container->pb);
  if (error >= 0) error = closed;
  if (error < 0) ERN_TRY(ern_av_fail(j->context, ERN_E_IO, j->file.path, "write the tail", error));
  status = ern_file_writer_commit(&j->file);
fail:
  return status;
}

ern_status ern_video_join(ern_context *context, const char *path, const char *const *segments, size_t count,
                          const ern_sound *sound, double sound_start) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, segments);
  struct joined j = {.context = context, .file = {.descriptor = -1}};
  struct segment first = {.path = NULL};
  ern_status status = ERN_OK;
  if (count == 0) return ern_fail(context, ERN_E_ARGUMENT, "%s: 0 videos are to be joined, expected 1 or more", path);
  ERN_TRY(ern_sound_track_check(context, path, sound, sound_start));
  for (size_t k = 0; k < count; k++)
    if (segments[k] == NULL) return ern_fail(context, ERN_E_ARGUMENT, "ern_video_join: segments[%zu] is NULL", k);
  ERN_TRY(look_at_all(&j, segments, count, &first));
  ERN_TRY(read_xmp(&j, segments[0]));
  ERN_TRY(open_output(&j, path, &first, sound, sound_start));
  for (size_t k = 0; k < count; k++) ERN_TRY(add_segment(&j, segments[k]));
  warn_of_silence(&j, sound, sound_start);
  ERN_TRY(finish(&j));
fail:
  close_segment(&first);
  ern_sound_track_close(&j.sound);
  av_packet_free(&j.muxer.packet);
  if (j.muxer.container != NULL) avio_closep(&j.muxer.container->pb);
  avformat_free_context(j.muxer.container);
  ern_file_writer_abandon(&j.file);
  ern_release(context, j.xmp);
  return status;
}
