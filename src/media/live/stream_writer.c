/* SPDX-License-Identifier: MIT
 * Writes streams of pictures and sound to files, pipes and URLs. */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "core/floats.h"
#include "core/memory.h"
#include "core/sized.h"
#include "ernerf/stream.h"
#include "io/file.h"
#include "media/image.h"
#include "media/live/address.h"
#include "media/live/descriptor_io.h"
#include "media/live/http_listener.h"
#include "media/live/picture_track.h"
#include "media/video/video_frame.h"
#include "media/video/video_sound.h"

enum {
  FRAGMENT = 80000,       /* microseconds of an mp4 fragment of a stream */
  FILE_FRAGMENT = 1000000 /* the same of a file: what a killed process loses */
};

/* Each form plays up to where it is cut. muxer NULL: no container. endings: file extensions and URL schemes that select
 * the format. */
static const struct form {
  const char *name, *muxer, *endings[5];
  enum ern_picture_coding coding;
  enum AVCodecID sound;
} forms[] = {{"mp4", "mp4", {".mp4", "http://", NULL}, ERN_PICTURES_LIVE, AV_CODEC_ID_AAC},
             {"matroska", "matroska", {".mkv", NULL}, ERN_PICTURES_LIVE, AV_CODEC_ID_AAC},
             {"mpegts", "mpegts", {".ts", "udp://", "srt://", "rtp://", NULL}, ERN_PICTURES_LIVE, AV_CODEC_ID_AAC},
             {"flv", "flv", {".flv", "rtmp://", NULL}, ERN_PICTURES_LIVE, AV_CODEC_ID_AAC},
             {"nut", "nut", {".nut", "tcp://", NULL}, ERN_PICTURES_RAW, AV_CODEC_ID_PCM_S16LE},
             {"y4m", "yuv4mpegpipe", {".y4m", NULL}, ERN_PICTURES_WRAPPED, AV_CODEC_ID_NONE},
             {"raw", NULL, {".rgba", NULL}, ERN_PICTURES_RAW, AV_CODEC_ID_NONE}};
enum { FORMS = sizeof forms / sizeof *forms };

enum target {
  TARGET_FILE,
  TARGET_PIPE,
  TARGET_ADDRESS,
  TARGET_VIEWER, /* of this program as an HTTP server */
  TARGET_CALL    /* of the caller's `write` */
};

struct ern_stream_writer {
  ern_context *context;
  ern_stream_options options;
  const struct form *form;
  enum target target;
  char *url;
  struct ern_file_writer file;
  struct ern_descriptor_io pipe;
  AVIOContext *io; /* opened by FFmpeg, for a file or a URL */
  struct ern_muxer muxer;
  struct ern_picture_track pictures;
  struct ern_sound_track sound;
  uint8_t *last; /* for "raw": the last picture */
  struct ern_provenance_texts provenance;
  bool has_head;       /* TARGET_CALL: the head was handed over */
  int64_t head, whole; /* bytes of a file: of its header; up to the end of its last whole packet */
  ern_status broken;
  char reason[ERN_ERROR_BYTES]; /* the text of `broken` */
};

/* ---- what is asked for ------------------------------------------------------------------------------------------- */

static ern_status check_profile(ern_context *context, const char *url, const char *profile, int crf) {
  static const char *const known[] = {"baseline", "main", "high"};
  bool is_known = false;
  if (profile == NULL) return ERN_OK;
  for (size_t i = 0; i < sizeof known / sizeof *known; i++) is_known |= strcmp(profile, known[i]) == 0;
  if (!is_known)
    return ern_fail(context, ERN_E_ARGUMENT, "%s: profile is \"%s\", expected baseline, main or high", url, profile);
  if (crf > 0) return ERN_OK;
  return ern_fail(context, ERN_E_ARGUMENT,
                  "%s: crf is %d, lossless, which H.264 has not in its %s profile, expected 1 to 51", url, crf,
                  profile);
}

static ern_status check_options(ern_context *context, const char *url, const ern_stream_options *o) {
  const bool sound = o->sound_rate != 0 || o->sound_channels != 0;
  const struct {
    const char *name;
    int value, least, most;
  } rows[] = {{"sound_rate", o->sound_rate, sound ? 1 : 0, 384000},
              {"sound_channels", o->sound_channels, sound ? 1 : 0, 8}};
  for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
    if (rows[i].value < rows[i].least || rows[i].value > rows[i].most)
      return ern_fail(context, ERN_E_ARGUMENT, "%s: %s is %d, expected %d to %d", url, rows[i].name, rows[i].value,
                      rows[i].least, rows[i].most);
  if (!(o->pixel_aspect >= 0.01 && o->pixel_aspect <= 100))
    return ern_fail(context, ERN_E_ARGUMENT, "%s: pixel_aspect is %g, expected 0.01 to 100", url, o->pixel_aspect);
  ern_status status = ern_video_codec_check(context, url, ern_video_codec_live(), o->crf, o->preset);
  if (status == ERN_OK) status = check_profile(context, url, o->profile, o->crf);
  if (status == ERN_OK) status = ern_picture_rate_check(context, url, o->rate_numerator, o->rate_denominator);
  return status == ERN_OK ? ern_image_check_sides(context, url, o->width, o->height) : status;
}

/* Whether `url` begins with one of the form's schemes, or ends with one of its endings. */
static bool means(const struct form *form, const char *url, bool scheme) {
  const size_t length = strlen(url);
  for (size_t i = 0; form->endings[i] != NULL; i++) {
    const size_t own = strlen(form->endings[i]);
    if (scheme == (form->endings[i][0] == '.') || own > length) continue;
    if (strncmp(scheme ? url : url + length - own, form->endings[i], own) == 0) return true;
  }
  return false;
}

static bool is_rtp(const ern_stream_writer *w) {
  return w->target == TARGET_ADDRESS && strncmp(w->url, "rtp://", 6) == 0;
}

/* Chooses the format by its name; else by the scheme of a URL, whatever its extension; else by the extension. */
static ern_status choose_form(ern_stream_writer *w) {
  const char *name = w->options.write == NULL ? w->options.format : forms[0].name;
  if (w->options.write != NULL && w->options.format != NULL && strcmp(w->options.format, name) != 0)
    return ern_fail(w->context, ERN_E_UNSUPPORTED, "%s: format is \"%s\", expected mp4 where `write` takes the stream",
                    w->url, w->options.format);
  for (size_t i = 0; i < FORMS && w->form == NULL; i++)
    if (name != NULL ? strcmp(name, forms[i].name) == 0 : means(&forms[i], w->url, true)) w->form = &forms[i];
  for (size_t i = 0; i < FORMS && w->form == NULL && name == NULL; i++)
    if (means(&forms[i], w->url, false)) w->form = &forms[i];
  if (w->form != NULL && is_rtp(w) && strcmp(w->form->name, "mpegts") != 0)
    return ern_fail(w->context, ERN_E_UNSUPPORTED, "%s: format is \"%s\", expected mpegts, which rtp:// carries",
                    w->url, w->form->name);
  if (w->form != NULL) return ERN_OK;
  if (w->options.format != NULL)
    return ern_fail(w->context, ERN_E_UNSUPPORTED,
                    "%s: format is \"%s\", expected mp4, matroska, mpegts, flv, nut, y4m or raw", w->url,
                    w->options.format);
  return ern_fail(
      w->context, ERN_E_UNSUPPORTED,
      "%s: the format does not follow from its name, expected a format, or NAME.mp4, .mkv, .ts, .flv, .nut or .y4m",
      w->url);
}

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static bool asks_to_stop(const ern_stream_writer *w) {
  return w->options.stop != NULL && w->options.stop(w->options.user) != 0;
}

/* Replaces an error that the caller's request to stop caused by ERN_E_CANCELLED. A file waits for nobody. */
static ern_status or_stopped(const ern_stream_writer *w, ern_status status) {
  const bool waits = w->target != TARGET_FILE;
  if (status == ERN_OK || status == ERN_E_CANCELLED || !waits || !asks_to_stop(w)) return status;
  return ern_fail(w->context, ERN_E_CANCELLED, "%s: stopped", w->url);
}

static ern_status open_tracks(ern_stream_writer *w) {
  const ern_stream_options *o = &w->options;
  AVRational rate;
  ern_status status = ERN_OK;
  av_reduce(&rate.num, &rate.den, o->rate_numerator, o->rate_denominator, ERN_RATE_PART);
  if (w->form->muxer == NULL) return ERN_NEW(w->context, 4 * (size_t)o->width * (size_t)o->height, &w->last);
  w->muxer = (struct ern_muxer){.context = w->context, .path = w->url, .packet = av_packet_alloc()};
  w->muxer.from_0 = w->target == TARGET_CALL; /* its head goes out before the first sound, and cannot say the delay */
  const char *muxer = is_rtp(w) ? "rtp_mpegts" : w->form->muxer; /* the packets of RTP have a header each */
  const int error = avformat_alloc_output_context2(&w->muxer.container, NULL, muxer, NULL);
  if (error < 0 || w->muxer.packet == NULL)
    ERN_TRY(ern_av_fail(w->context, ERN_E_MEDIA, w->url, "make a stream", error < 0 ? error : AVERROR(ENOMEM)));
  const struct ern_picture_settings settings = {.coding = w->form->coding,
                                                .codec = ern_video_codec_live(),
                                                .preset = o->preset,
                                                .profile = o->profile,
                                                .crf = o->crf,
                                                .pixel_aspect = o->pixel_aspect};
  ERN_TRY(ern_picture_track_open(&w->muxer, o->width, o->height, rate, &settings, &w->pictures));
  if (o->sound_rate > 0 && w->form->sound != AV_CODEC_ID_NONE)
    ERN_TRY(ern_sound_track_open_live(&w->muxer, o->sound_rate, o->sound_channels, w->form->sound, &w->sound));
fail:
  return status;
}

static ern_status open_file(ern_stream_writer *w) {
  ern_status status = ERN_OK;
  char *name = NULL;
  ERN_TRY(ern_file_writer_open(w->context, w->url, ERN_EXISTING_BY_CONTEXT, &w->file));
  w->file.stays = true; /* what was said live cannot be recorded again */
  ERN_TRY(ern_av_url(w->context, w->file.temporary, &name));
  if (w->muxer.container != NULL) w->muxer.container->url = av_strdup(name); /* faststart reopens it */
  const int error = avio_open(&w->io, name, AVIO_FLAG_WRITE);
  if (error < 0) ERN_TRY(ern_av_fail(w->context, ERN_E_IO, w->url, "write", error));
fail:
  ern_release(w->context, name);
  return status;
}

static ern_status open_address(ern_stream_writer *w) {
  const AVIOInterruptCB interrupt = {w->options.stop, w->options.user};
  AVDictionary *options = NULL;
  int error = strncmp(w->url, "udp://", 6) == 0 ? av_dict_set(&options, "pkt_size", "1316", 0) : 0;
  if (error >= 0) error = avio_open2(&w->io, w->url, AVIO_FLAG_WRITE, &interrupt, &options);
  av_dict_free(&options);
  return error >= 0 ? ERN_OK : ern_av_fail(w->context, ERN_E_IO, w->url, "connect to it", error);
}

static int hand_over(void *user, const uint8_t *bytes, size_t count) {
  const ern_stream_writer *w = user;
  return w->options.write(w->options.user, bytes, count, ERN_STREAM_MORE);
}

static ern_status open_call(ern_stream_writer *w) {
  w->pipe.take = hand_over;
  w->pipe.user = w;
  return ern_descriptor_io_call(w->context, w->url, &w->pipe);
}

static ern_status open_target(ern_stream_writer *w) {
  if (w->target == TARGET_CALL) return open_call(w);
  if (w->target == TARGET_FILE) return open_file(w);
  if (w->target == TARGET_ADDRESS) return open_address(w);
  w->pipe.stop = w->options.stop;
  w->pipe.user = w->options.user;
  if (w->target == TARGET_PIPE) return ern_descriptor_io_open(w->context, w->url, true, &w->pipe);
  return ern_http_serve(w->context, w->url, w->form == &forms[0] ? "video/mp4" : "video/unknown", &w->pipe);
}

static AVIOContext *io_of(const ern_stream_writer *w) { return w->pipe.io != NULL ? w->pipe.io : w->io; }

/* Hands `bytes` that the muxer holds to the caller, and says what ends with them. */
static ern_status end_piece(ern_stream_writer *w, ern_stream_piece piece) {
  AVIOContext *io = io_of(w);
  int error = av_write_frame(w->muxer.container, NULL);
  avio_flush(io);
  if (error >= 0) error = io->error;
  if (error >= 0 && w->options.write(w->options.user, "", 0, piece) != 0) error = AVERROR(EIO);
  return error >= 0 ? ERN_OK : ern_av_fail(w->context, ERN_E_IO, w->url, "write", error);
}

/* Ends a fragment. The first call also ends the head (delay_moov), with the first picture; the sound's first packet
 * comes later. */
static ern_status end_fragment(ern_stream_writer *w) {
  const ern_stream_piece piece = w->muxer.has_key ? ERN_STREAM_KEY : ERN_STREAM_FRAME;
  ern_status status = ERN_OK;
  w->muxer.has_key = false;
  const int error = av_interleaved_write_frame(w->muxer.container, NULL);
  if (error < 0) ERN_TRY(ern_av_fail(w->context, ERN_E_IO, w->url, "write", error));
  if (!w->has_head) ERN_TRY(end_piece(w, ERN_STREAM_HEAD));
  w->has_head = true;
  ERN_TRY(end_piece(w, piece));
fail:
  return status;
}

/* Hands all bytes to the output. Those of a file are then whole packets. */
static ern_status flush(ern_stream_writer *w) {
  AVIOContext *io = io_of(w);
  avio_flush(io);
  if (io->error < 0) return ern_av_fail(w->context, ERN_E_IO, w->url, "write", io->error);
  w->whole = avio_tell(io);
  return ERN_OK;
}

static int set_head_options(const ern_stream_writer *w, AVDictionary **options) {
  const bool file = w->target == TARGET_FILE;
  const char *muxer = w->form->muxer;
  int error = 0;
  if (strcmp(muxer, "mp4") == 0) {
    error = av_dict_set(options, "movflags", "+empty_moov+delay_moov+default_base_moof+use_metadata_tags", 0);
    if (error >= 0 && !file) /* else FFmpeg keeps a table of all fragments, 7 MB in an hour, for the end of the file */
      error = av_dict_set(options, "movflags", "+skip_trailer", AV_DICT_APPEND);
    if (error >= 0 && w->target == TARGET_CALL)
      error = av_dict_set(options, "movflags", "+frag_custom", AV_DICT_APPEND);
    if (error >= 0 && w->target != TARGET_CALL)
      error = av_dict_set_int(options, "frag_duration", file ? FILE_FRAGMENT : FRAGMENT, 0);
  }
  if (!file && strcmp(muxer, "flv") == 0) error = av_dict_set(options, "flvflags", "no_duration_filesize", 0);
  if (strcmp(muxer, "matroska") == 0) /* of a file: milliseconds of a cluster */
    error = file ? av_dict_set_int(options, "cluster_time_limit", FILE_FRAGMENT / 1000, 0)
                 : av_dict_set(options, "live", "1", 0);
  return error;
}

/* Writes the container's header. All is flushed after each packet, so that a killed process leaves what plays. */
static ern_status write_head(ern_stream_writer *w) {
  AVFormatContext *container = w->muxer.container;
  AVDictionary *options = NULL;
  if (container == NULL) return ERN_OK;
  container->pb = io_of(w);
  container->flags |= AVFMT_FLAG_FLUSH_PACKETS;
  if (w->target != TARGET_FILE) container->max_interleave_delta = AV_TIME_BASE / 5;
  container->max_delay = 0;
  int error = set_head_options(w, &options);
  if (error >= 0) error = avformat_write_header(container, &options);
  if (error >= 0) error = container->pb->error;
  av_dict_free(&options);
  if (error < 0) return ern_av_fail(w->context, ERN_E_IO, w->url, "write the head of the stream", error);
  const ern_status status = flush(w);
  w->head = w->whole;
  return status;
}

ern_status ern_stream_writer_open(ern_context *context, const char *url, const ern_stream_options *options,
                                  ern_stream_writer **writer) {
  ERN_PLAIN_FLOATS;
  if (writer != NULL) *writer = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, url);
  ERN_NEED(context, options);
  ERN_NEED(context, writer);
  ern_status status = ERN_OK;
  ern_stream_writer *made = NULL;
  ern_stream_options chosen = ern_stream_options_default(0, 0);
  const char *path = NULL;
  ern_av_disable_log();
  ERN_TRY(ERN_COPY_IN_CONFIG(context, ern_stream_options, &chosen, options));
  ERN_TRY(check_options(context, url, &chosen));
  ERN_TRY(ERN_NEW(context, 1, &made));
  made->context = context;
  made->options = chosen;
  made->file.descriptor = -1;
  if (chosen.write == NULL) ERN_TRY(ern_address_parse(context, url, &path));
  made->target = chosen.write != NULL              ? TARGET_CALL
                 : strncmp(url, "http://", 7) == 0 ? TARGET_VIEWER
                 : path == NULL                    ? TARGET_ADDRESS
                 : ern_is_pipe(path)               ? TARGET_PIPE
                                                   : TARGET_FILE;
  ERN_TRY(ern_string_copy(context, path != NULL ? path : url, &made->url));
  ERN_TRY(choose_form(made));
  ERN_TRY(open_tracks(made));
  ERN_TRY(ern_provenance_texts_make(context, chosen.provenance, &made->provenance));
  if (made->muxer.container != NULL) ERN_TRY(ern_muxer_tag(&made->muxer, &made->provenance));
  ERN_TRY(or_stopped(made, open_target(made)));
  ERN_TRY(or_stopped(made, write_head(made)));
  *writer = made;
  return ERN_OK;
fail:
  ern_stream_writer_abandon(&made);
  return status;
}

/* ---- writing ----------------------------------------------------------------------------------------------------- */

static ern_status write_raw(ern_stream_writer *w, const uint8_t *rgba) {
  const size_t bytes = 4 * (size_t)w->options.width * (size_t)w->options.height; /* at most 2^28 */
  AVIOContext *io = io_of(w);
  if (rgba != NULL) memcpy(w->last, rgba, bytes);
  avio_write(io, w->last, (int)bytes);
  return flush(w);
}

/* recorded: NULL, or a frame of which rgba replaces `part`. */
static ern_status write_frame(ern_stream_writer *w, const ern_video_frame *recorded, const int part[4],
                              const uint8_t *rgba, const float *samples, size_t frames) {
  ern_status status = ERN_OK;
  if (w->form->muxer == NULL) return write_raw(w, rgba);
  if (w->sound.codec != NULL && frames > 0) ERN_TRY(ern_sound_track_add(&w->muxer, &w->sound, samples, frames));
  ERN_TRY(recorded == NULL ? ern_picture_track_add(&w->muxer, &w->pictures, rgba)
                           : ern_picture_track_add_patched(&w->muxer, &w->pictures, recorded->frame, part, rgba));
  ERN_TRY(w->target == TARGET_CALL ? end_fragment(w) : flush(w));
fail:
  return status;
}

static ern_status write_checked(ern_stream_writer *writer, const ern_video_frame *recorded, const int part[4],
                                const uint8_t *rgba, const float *samples, size_t frames) {
  if (writer->broken != ERN_OK)
    return ern_fail(writer->context, writer->broken, "%s: an earlier call failed, nothing more can be written",
                    writer->url);
  const size_t channels = writer->sound.codec != NULL ? (size_t)writer->options.sound_channels : 0;
  for (size_t i = 0; i < frames * channels; i++)
    if (!isfinite(samples[i]))
      return ern_fail(writer->context, ERN_E_NONFINITE, "%s: sample %zu of channel %zu is %g, expected a finite number",
                      writer->url, i / channels, i % channels, (double)samples[i]);
  writer->broken = or_stopped(writer, write_frame(writer, recorded, part, rgba, samples, frames));
  if (writer->broken != ERN_OK) (void)ern_last_error_copy(writer->context, writer->reason, sizeof writer->reason);
  return writer->broken;
}

ern_status ern_stream_writer_frame(ern_stream_writer *writer, const uint8_t *rgba, const float *samples,
                                   size_t frames) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, writer);
  if (frames > 0) ERN_NEED(writer->context, samples);
  return write_checked(writer, NULL, NULL, rgba, samples, frames);
}

ern_status ern_stream_writer_patch(ern_stream_writer *writer, const ern_video_frame *frame, const int part[4],
                                   const uint8_t *rgba, const float *samples, size_t frames) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, writer);
  ern_context *context = writer->context;
  ERN_NEED(context, frame);
  if (part != NULL) ERN_NEED(context, rgba);
  if (frames > 0) ERN_NEED(context, samples);
  const ern_stream_options *o = &writer->options;
  const int whole[4] = {0, 0, frame->frame->width, frame->frame->height};
  const ern_status status = ern_video_frame_check(context, writer->url, frame, part != NULL ? part : whole);
  if (status != ERN_OK) return status;
  if (writer->form->muxer == NULL || whole[2] != o->width || whole[3] != o->height)
    return ern_fail(context, ERN_E_UNSUPPORTED,
                    "%s: a frame of %d x %d pixels of yuv420p, expected the size of the stream, %d x %d, and a format "
                    "other than raw",
                    writer->url, whole[2], whole[3], o->width, o->height);
  return write_checked(writer, frame, part, rgba, samples, frames);
}

/* Flushes the encoders, writes the trailer, closes the file. */
static ern_status finish(ern_stream_writer *w) {
  AVFormatContext *container = w->muxer.container;
  ern_status status = ERN_OK;
  if (w->broken != ERN_OK) return ern_fail(w->context, w->broken, "%s", w->reason);
  if (container != NULL) {
    if (w->target == TARGET_FILE && w->pictures.count == 0)
      ERN_TRY(ern_fail(w->context, ERN_E_STATE, "%s: not made, for it has 0 frames, expected 1 or more", w->url));
    if (w->sound.codec != NULL) ERN_TRY(ern_sound_track_add(&w->muxer, &w->sound, NULL, 0));
    ERN_TRY(ern_muxer_encode(&w->muxer, w->pictures.codec, w->pictures.stream, NULL));
    if (w->target == TARGET_CALL && w->pictures.count > 0) ERN_TRY(end_fragment(w));
    const bool boxed = w->target == TARGET_FILE && strcmp(w->form->muxer, "mp4") == 0;
    ERN_TRY(ern_muxer_end(&w->muxer, boxed ? w->provenance.xmp : NULL));
  }
  avio_flush(io_of(w));
  int error = io_of(w)->error;
  const int closed = w->io != NULL ? avio_closep(&w->io) : 0;
  if (error >= 0) error = closed;
  if (error < 0) ERN_TRY(ern_av_fail(w->context, ERN_E_IO, w->url, "write the tail", error));
  if (w->target == TARGET_FILE) ERN_TRY(ern_file_writer_commit(&w->file));
fail:
  return or_stopped(w, status);
}

/* Puts a file in place that could not be written to its end: cut after its last whole packet. */
static ern_status keep_cut(ern_stream_writer *w, ern_status why) {
  ern_status status = ERN_OK;
  (void)ern_last_error_copy(w->context, w->reason, sizeof w->reason);
  if (w->io != NULL) (void)avio_closep(&w->io);
  if (ftruncate(w->file.descriptor, w->whole) != 0) ERN_TRY(ern_file_fail(w->context, w->url, "cut"));
  ERN_TRY(ern_file_writer_commit(&w->file));
  return ern_fail(w->context, why, "%s; the file is kept up to there: it is cut", w->reason);
fail:
  return status;
}

ern_status ern_stream_writer_close(ern_stream_writer **writer) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, writer);
  ERN_NEED(NULL, *writer);
  ern_status status = finish(*writer);
  const bool fails = status != ERN_OK && status != ERN_E_CANCELLED;
  if (fails && (*writer)->file.temporary != NULL && (*writer)->whole > (*writer)->head)
    status = keep_cut(*writer, status);
  ern_stream_writer_abandon(writer);
  return status;
}

void ern_stream_writer_abandon(ern_stream_writer **writer) {
  if (writer == NULL || *writer == NULL) return;
  ern_stream_writer *w = *writer;
  ern_context *context = w->context;
  *writer = NULL;
  ern_sound_track_close(&w->sound);
  ern_picture_track_close(context, &w->pictures);
  av_packet_free(&w->muxer.packet);
  if (w->io != NULL) avio_closep(&w->io);
  if (w->muxer.container != NULL) w->muxer.container->pb = NULL;
  avformat_free_context(w->muxer.container);
  ern_descriptor_io_close(&w->pipe);
  ern_file_writer_abandon(&w->file);
  ern_provenance_texts_free(context, &w->provenance);
  ern_release(context, w->last);
  ern_release(context, w->url);
  ern_release(context, w);
}
