/* SPDX-License-Identifier: MIT
 * Passes a coded stream on to an address: its packets go into another container as they are. */
#include <libavutil/intreadwrite.h>
#include <libavutil/time.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "ernerf/stream.h"
#include "media/ffmpeg.h"
#include "media/live/address.h"

enum { BLOCK = 32768, BOX_HEAD = 8, PATIENCE = 10 * 1000000 /* microseconds that an address may take to go on */ };

struct copy {
  ern_context *context;
  const char *url;
  ptrdiff_t (*read)(void *user, void *bytes, size_t most);
  int (*stop)(void *user);
  void *user;
  uint64_t inside; /* bytes of the mp4's box that are still to be read; 0: a box begins */
  ptrdiff_t wrong; /* what `read` returned out of its range; 0: nothing */
  int64_t until;   /* microseconds: when the address has taken too long; INT64_MAX: it is not waited for */
  AVIOContext *from, *to;
  AVFormatContext *in, *out;
  AVPacket *packet;
};

static int is_late(void *user) {
  const struct copy *c = user;
  return (c->stop != NULL && c->stop(c->user) != 0) || av_gettime_relative() > c->until;
}

/* What `read` returned; 0 at the end. */
static size_t read_some(struct copy *c, uint8_t *bytes, size_t most) {
  const ptrdiff_t count = c->wrong == 0 ? c->read(c->user, bytes, most) : 0;
  if (count < 0 || (size_t)count > most) c->wrong = count;
  return c->wrong == 0 ? (size_t)count : 0;
}

static bool read_all(struct copy *c, uint8_t *bytes, size_t count) {
  size_t done = 0, more = 1;
  for (; done < count && more > 0; done += more) more = read_some(c, bytes + done, count - done);
  return done == count;
}

/* FFmpeg goes back within the boxes that describe pictures and sound, which it can do in what one call has read: they
 * are handed over whole, however few bytes `read` has at a time. */
static int take(void *user, uint8_t *bytes, int most) {
  struct copy *c = user;
  const size_t room = (size_t)most;
  if (c->inside > 0) {
    const size_t count = read_some(c, bytes, c->inside < room ? (size_t)c->inside : room);
    c->inside -= count;
    return count > 0 ? (int)count : AVERROR_EOF;
  }
  if (room < BOX_HEAD || !read_all(c, bytes, BOX_HEAD)) return AVERROR_EOF;
  const uint32_t size = AV_RB32(bytes);
  c->inside = size >= BOX_HEAD ? size - BOX_HEAD : UINT64_MAX; /* UINT64_MAX: up to the end */
  if (memcmp(bytes + 4, "mdat", 4) == 0 || c->inside > room - BOX_HEAD) return BOX_HEAD;
  if (!read_all(c, bytes + BOX_HEAD, (size_t)c->inside)) return AVERROR_EOF;
  c->inside = 0;
  return (int)size;
}

static const char *muxer_of(const char *url) {
  static const char *const known[][2] = {
      {"rtmp://", "flv"}, {"rtmps://", "flv"}, {"srt://", "mpegts"}, {"udp://", "mpegts"}};
  for (size_t i = 0; i < sizeof known / sizeof *known; i++)
    if (strncmp(url, known[i][0], strlen(known[i][0])) == 0) return known[i][1];
  return NULL;
}

static ern_status connect_to(struct copy *c) {
  const AVIOInterruptCB interrupt = {is_late, c};
  AVDictionary *options = NULL;
  int error = strncmp(c->url, "udp://", 6) == 0 ? av_dict_set(&options, "pkt_size", "1316", 0) : 0;
  c->until = av_gettime_relative() + PATIENCE;
  if (error >= 0) error = avio_open2(&c->to, c->url, AVIO_FLAG_WRITE, &interrupt, &options);
  c->until = INT64_MAX;
  av_dict_free(&options);
  return error >= 0 ? ERN_OK : ern_av_fail(c->context, ERN_E_IO, c->url, "connect to it", error);
}

/* Reads the head, which says all of the tracks. */
static ern_status open_stream(struct copy *c) {
  uint8_t *block = av_malloc(BLOCK);
  c->from = block != NULL ? avio_alloc_context(block, BLOCK, 0, c, take, NULL, NULL) : NULL;
  c->in = avformat_alloc_context();
  c->packet = av_packet_alloc();
  if (c->from == NULL) av_free(block);
  if (c->from == NULL || c->in == NULL || c->packet == NULL)
    return ern_av_fail(c->context, ERN_E_NO_MEMORY, c->url, "read the stream", AVERROR(ENOMEM));
  c->in->pb = c->from;
  const int error = avformat_open_input(&c->in, NULL, av_find_input_format("mp4"), NULL);
  return error >= 0 ? ERN_OK : ern_av_fail(c->context, ERN_E_FORMAT, c->url, "read the head of the stream", error);
}

static ern_status write_head(struct copy *c) {
  AVDictionary *options = NULL;
  int error = avformat_alloc_output_context2(&c->out, NULL, muxer_of(c->url), NULL);
  for (unsigned i = 0; i < c->in->nb_streams && error >= 0; i++) {
    AVStream *made = avformat_new_stream(c->out, NULL);
    error = made != NULL ? avcodec_parameters_copy(made->codecpar, c->in->streams[i]->codecpar) : AVERROR(ENOMEM);
    if (error < 0) break;
    made->codecpar->codec_tag = 0; /* of the mp4 */
    made->time_base = c->in->streams[i]->time_base;
  }
  if (error >= 0) error = av_dict_copy(&c->out->metadata, c->in->metadata, 0);
  if (error >= 0) error = av_dict_set(&options, "flvflags", "no_duration_filesize", 0);
  if (error < 0) return ern_av_fail(c->context, ERN_E_MEDIA, c->url, "make a stream", error);
  c->out->pb = c->to;
  c->out->flags |= AVFMT_FLAG_FLUSH_PACKETS;
  c->out->avoid_negative_ts = AVFMT_AVOID_NEG_TS_MAKE_ZERO; /* the stream may be hours old */
  c->out->max_interleave_delta = AV_TIME_BASE / 5;
  c->out->max_delay = 0;
  c->until = av_gettime_relative() + PATIENCE;
  error = avformat_write_header(c->out, &options);
  c->until = INT64_MAX;
  av_dict_free(&options);
  return error >= 0 ? ERN_OK : ern_av_fail(c->context, ERN_E_IO, c->url, "write the head of the stream", error);
}

static ern_status copy_packets(struct copy *c) {
  for (;;) {
    int error = ern_av_read_packet(c->in, c->packet);
    if (error == AVERROR_EOF) break;
    if (error < 0) return ern_av_fail(c->context, ERN_E_FORMAT, c->url, "read the stream", error);
    const int k = c->packet->stream_index;
    av_packet_rescale_ts(c->packet, c->in->streams[k]->time_base, c->out->streams[k]->time_base);
    c->packet->pos = -1;
    c->until = av_gettime_relative() + PATIENCE;
    error = av_interleaved_write_frame(c->out, c->packet);
    if (error >= 0) error = c->to->error;
    c->until = INT64_MAX;
    if (error < 0) return ern_av_fail(c->context, ERN_E_IO, c->url, "write", error);
  }
  c->until = av_gettime_relative() + PATIENCE;
  const int error = av_write_trailer(c->out);
  return error >= 0 ? ERN_OK : ern_av_fail(c->context, ERN_E_IO, c->url, "write the tail", error);
}

static void close_copy(struct copy *c) {
  av_packet_free(&c->packet);
  avformat_close_input(&c->in);
  if (c->from != NULL) av_freep(&c->from->buffer);
  avio_context_free(&c->from);
  if (c->out != NULL) c->out->pb = NULL;
  avformat_free_context(c->out);
  c->until = 0; /* what is left is not sent */
  (void)avio_closep(&c->to);
}

ern_status ern_stream_copy(ern_context *context, const char *url,
                           ptrdiff_t (*read)(void *user, void *bytes, size_t most), int (*stop)(void *user),
                           void *user) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(context, context);
  ERN_NEED(context, url);
  ERN_NEED(context, read);
  struct copy copy = {.context = context, .url = url, .read = read, .stop = stop, .user = user, .until = INT64_MAX};
  const char *path = NULL;
  ern_av_disable_log();
  ern_status status = ern_address_parse(context, url, &path);
  if (status == ERN_OK && muxer_of(url) == NULL)
    status = ern_fail(context, ERN_E_UNSUPPORTED,
                      "%s: expected an address that begins with rtmp://, rtmps://, srt:// or udp://", url);
  if (status == ERN_OK) status = connect_to(&copy);
  if (status == ERN_OK) status = open_stream(&copy);
  if (status == ERN_OK) status = write_head(&copy);
  if (status == ERN_OK) status = copy_packets(&copy);
  close_copy(&copy);
  if (copy.wrong != 0)
    return ern_fail(context, ERN_E_ARGUMENT,
                    "%s: read returned %td bytes, expected 0, or 1 to as many as it was asked for", url, copy.wrong);
  if (status != ERN_OK && stop != NULL && stop(user) != 0)
    return ern_fail(context, ERN_E_CANCELLED, "%s: stopped", url);
  return status;
}
