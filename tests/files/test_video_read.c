/* SPDX-License-Identifier: MIT
 * Videos as other programs write them: turned and mirrored, with sound that begins earlier or later, cut short. */
#include <libavcodec/avcodec.h>
#include <libavcodec/bsf.h>
#include <libavformat/avformat.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/memory.h"
#include "ernerf/media.h"
#include "io/file.h"
#include "support.h"

static ern_context *context;
static char warned[1024]; /* the last warning of the log */
static int warnings;

static void keep_warning(void *user, ern_log_level level, const char *line) {
  (void)user;
  warnings += level == ERN_LOG_WARNING;
  if (level == ERN_LOG_WARNING) snprintf(warned, sizeof warned, "%s", line);
}

static int set_up(void **state) {
  ern_context_config config = ern_context_config_default();
  (void)state;
  config.log = keep_warning;
  return ern_context_create(&context, &config) == ERN_OK ? 0 : -1;
}

static int tear_down(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

/* Writes the display matrix (ISO/IEC 14496-12, tkhd: a b 0 c d 0 0 0 1) of the first track of an mp4. */
static void put_matrix(uint8_t *bytes, size_t count, const int numbers[4]) {
  static const size_t places[4] = {0, 4, 12, 16};
  size_t at = 0;
  while (at + 80 < count && memcmp(bytes + at, "tkhd", 4) != 0) at++;
  assert_true(at + 80 < count);
  for (size_t i = 0; i < 4; i++) { /* 16.16, big end first */
    const uint8_t number[4] = {numbers[i] < 0 ? 0xff : 0, (uint8_t)numbers[i], 0, 0};
    memcpy(bytes + at + 44 + places[i], number, 4);
  }
}

/* A frame whose quarters are grey 40, 100, 160 and 220, by each of the eight matrices. A pixel (p, q) is shown at
 * (a p + c q, b p + d q). */
static void test_display_matrix(void **state) {
  (void)state;
  enum { WIDE = 64, HIGH = 32 };
  static const int matrices[8][4] = {{1, 0, 0, 1}, {-1, 0, 0, 1}, {-1, 0, 0, -1}, {1, 0, 0, -1},
                                     {0, 1, 1, 0}, {0, 1, -1, 0}, {0, -1, -1, 0}, {0, -1, 1, 0}};
  const ern_video_options options = ern_video_options_default(WIDE, HIGH);
  ern_video_writer *writer = NULL;
  uint8_t rgba[WIDE * HIGH * 4], *bytes = NULL;
  size_t count = 0;
  for (int i = 0; i < WIDE * HIGH; i++)
    memset(rgba + 4 * i, 40 + 60 * ((i / WIDE >= HIGH / 2) * 2 + (i % WIDE >= WIDE / 2)), 4);
  support_ok(context, ern_video_writer_open(context, "lying.mp4", &options, &writer));
  support_ok(context, ern_video_writer_frame(writer, rgba));
  support_ok(context, ern_video_writer_close(&writer));
  support_ok(context, ern_file_read(context, "lying.mp4", 1 << 20, &bytes, &count));
  for (int k = 0; k < 8; k++) {
    const int *m = matrices[k];
    ern_video_reader *reader = NULL;
    ern_image shown = {0};
    double seconds = 0;
    bool end = true;
    put_matrix(bytes, count, m);
    support_write("shown.mp4", bytes, count);
    support_ok(context, ern_video_reader_open(context, "shown.mp4", &reader));
    support_ok(context, ern_video_reader_frame(reader, &shown, &seconds, &end));
    assert_false(end);
    assert_int_equal(shown.width, m[0] != 0 ? WIDE : HIGH);
    assert_int_equal(shown.height, m[0] != 0 ? HIGH : WIDE);
    for (int place = 0; place < 4; place++) {
      const int p = place % 2 * 2 - 1, q = place / 2 * 2 - 1; /* a corner of the stored frame, from its centre */
      const int x = m[0] * p + m[2] * q > 0 ? shown.width - 1 : 0, y = m[1] * p + m[3] * q > 0 ? shown.height - 1 : 0;
      const int found = shown.data[3 * (y * shown.width + x)];
      if (abs(found - 40 - 60 * place) > 8)
        fail_msg("matrix %d %d %d %d: quarter %d is %d, expected %d", m[0], m[1], m[2], m[3], place, found,
                 40 + 60 * place);
    }
    ern_image_free(context, &shown);
    ern_video_reader_free(&reader);
  }
  ern_release(context, bytes);
}

/* An MP3 whose ID3 tag has a cover picture: FFmpeg gives that as a stream of video. */
static void test_cover_alone(void **state) {
  (void)state;
  enum { FRAMES = 20, FRAME = 104 }; /* MPEG 1, layer III, 32 kbit/s, 44.1 kHz */
  static const char apic[] = "\0image/png\0\3";
  uint8_t grey[3 * 8 * 8] = {0}, file[65536] = "ID3\3", *picture = NULL, *at = file + 10;
  const ern_image image = {.width = 8, .height = 8, .channels = 3, .data = grey};
  ern_video_reader *reader = NULL;
  ern_sound sound = {0};
  size_t bytes = 0;
  support_ok(context, ern_image_write(context, "cover.png", &image, 100));
  support_ok(context, ern_file_read(context, "cover.png", 1024, &picture, &bytes));
  const size_t body = sizeof apic + bytes, tag = body + 10;
  file[8] = (uint8_t)(tag >> 7), file[9] = tag & 127; /* 7 bits a byte */
  memcpy(at, "APIC", 4);
  at[6] = (uint8_t)(body >> 8), at[7] = (uint8_t)body;
  memcpy(at + 10, apic, sizeof apic);
  memcpy(at + 10 + sizeof apic, picture, bytes);
  at += tag;
  for (int k = 0; k < FRAMES; k++, at += FRAME) memcpy(at, "\xff\xfb\x10\xc4", 4);
  support_write("song.mp3", file, (size_t)(at - file));
  ern_release(context, picture);
  support_expect(context, ern_video_reader_open(context, "song.mp3", &reader), ERN_E_FORMAT,
                 "song.mp3: has no video, a cover picture alone", NULL);
  support_ok(context, ern_sound_read(context, "song.mp3", &sound));
  ern_sound_free(context, &sound);
}

/* ---- remuxed ----------------------------------------------------------------------------------------------------- */

/* Copies the coded streams of an mp4 to another, its sound `later` seconds. Up to `until` seconds of each are
 * there when its place ends; *cut: bytes of the file up to there. */
static void remux(const char *from, const char *to, double later, double until, int64_t *cut) {
  AVFormatContext *in = NULL, *out = NULL;
  AVPacket *packet = av_packet_alloc();
  AVDictionary *options = NULL;
  assert_true(avformat_open_input(&in, from, NULL, NULL) >= 0 && avformat_find_stream_info(in, NULL) >= 0);
  assert_true(avformat_alloc_output_context2(&out, NULL, "mp4", to) >= 0);
  for (unsigned i = 0; i < in->nb_streams; i++) {
    AVStream *stream = avformat_new_stream(out, NULL);
    assert_true(avcodec_parameters_copy(stream->codecpar, in->streams[i]->codecpar) >= 0);
    stream->time_base = in->streams[i]->time_base;
  }
  av_dict_set(&options, "moov_size", "100000", 0); /* reserved before the packets */
  assert_true(avio_open(&out->pb, to, AVIO_FLAG_WRITE) >= 0 && avformat_write_header(out, &options) >= 0);
  *cut = 0;
  while (av_read_frame(in, packet) >= 0) {
    AVStream *stream = out->streams[packet->stream_index];
    const AVRational unit = in->streams[packet->stream_index]->time_base;
    const bool sound = stream->codecpar->codec_type == AVMEDIA_TYPE_AUDIO;
    const int64_t shift = (int64_t)(fmax(sound ? later : -later, 0) / av_q2d(unit));
    if (*cut == 0 && (double)packet->dts * av_q2d(unit) > until) {
      avio_flush(out->pb);
      *cut = avio_tell(out->pb);
    }
    packet->pts += shift, packet->dts += shift;
    packet->pos = -1;
    av_packet_rescale_ts(packet, unit, stream->time_base);
    assert_true(av_write_frame(out, packet) >= 0);
    av_packet_unref(packet);
  }
  assert_true(av_write_trailer(out) >= 0);
  avio_closep(&out->pb);
  avformat_free_context(out);
  avformat_close_input(&in);
  av_packet_free(&packet);
  av_dict_free(&options);
}

/* Copies the coded pictures of a file to one of another format. change: FFmpeg's filter of H.264. */
static void copy_changed(const char *from, const char *to, enum AVFieldOrder order, const char *change) {
  AVFormatContext *in = NULL, *out = NULL;
  AVPacket *packet = av_packet_alloc();
  AVBSFContext *plain = NULL;
  int64_t begin = AV_NOPTS_VALUE;
  assert_true(avformat_open_input(&in, from, NULL, NULL) >= 0);
  assert_true(avformat_alloc_output_context2(&out, NULL, NULL, to) >= 0);
  AVStream *stream = avformat_new_stream(out, NULL);
  assert_true(avcodec_parameters_copy(stream->codecpar, in->streams[0]->codecpar) >= 0);
  stream->codecpar->codec_tag = 0;
  stream->codecpar->field_order = order;
  stream->time_base = (AVRational){1, 25}; /* in AVI the duration of a frame */
  const bool h264 = stream->codecpar->codec_id == AV_CODEC_ID_H264;
  assert_true(av_bsf_list_parse_str(h264 ? change : "null", &plain) >= 0);
  assert_true(avcodec_parameters_copy(plain->par_in, stream->codecpar) >= 0 && av_bsf_init(plain) >= 0);
  assert_true(avio_open(&out->pb, to, AVIO_FLAG_WRITE) >= 0 && avformat_write_header(out, NULL) >= 0);
  while (av_read_frame(in, packet) >= 0) {
    assert_int_equal(packet->stream_index, 0);
    if (begin == AV_NOPTS_VALUE) begin = packet->dts; /* below 0 with B-frames */
    packet->dts -= begin, packet->pts -= begin;
    av_packet_rescale_ts(packet, in->streams[0]->time_base, stream->time_base);
    assert_true(av_bsf_send_packet(plain, packet) >= 0 && av_bsf_receive_packet(plain, packet) >= 0);
    assert_true(av_write_frame(out, packet) >= 0);
    av_packet_unref(packet);
  }
  assert_true(av_write_trailer(out) >= 0);
  avio_closep(&out->pb);
  avformat_free_context(out);
  avformat_close_input(&in);
  av_packet_free(&packet);
  av_bsf_free(&plain);
}

static void copy_pictures(const char *from, const char *to, enum AVFieldOrder order) {
  copy_changed(from, to, order, "h264_mp4toannexb"); /* for AVI */
}

/* 4 s of grey and of sound that begins with a click. */
static void write_clicks(const char *path) {
  enum { SIDE = 32, RATE = 16000, SECONDS = 4 };
  static int16_t samples[SECONDS * RATE];
  static uint8_t rgba[SIDE * SIDE * 4];
  ern_video_options options = ern_video_options_default(SIDE, SIDE);
  ern_video_writer *writer = NULL;
  for (int i = 0; i < SECONDS * RATE; i++) samples[i] = (int16_t)(i < RATE / 10 ? (i % 40 < 20 ? 12000 : -12000) : 0);
  options.sound = &(ern_sound){.rate = RATE, .channels = 1, .frames = SECONDS * RATE, .data = samples};
  support_ok(context, ern_video_writer_open(context, path, &options, &writer));
  for (int k = 0; k < 25 * SECONDS; k++) {
    for (size_t i = 0; i < sizeof rgba; i++) rgba[i] = (uint8_t)(rand() % 256); /* so that no packet is tiny */
    support_ok(context, ern_video_writer_frame(writer, rgba));
  }
  support_ok(context, ern_video_writer_close(&writer));
}

/* Seconds from the first picture to the first loud sample, as a player shows them. */
static double click_after_picture(const char *path) {
  ern_video_reader *reader = NULL;
  ern_video_info info;
  ern_image image = {0};
  ern_sound sound = {0};
  double first = 0;
  bool end = true;
  size_t i = 0;
  support_ok(context, ern_video_reader_open(context, path, &reader));
  ern_video_reader_info(reader, &info);
  support_ok(context, ern_video_reader_frame(reader, &image, &first, &end));
  support_ok(context, ern_sound_read(context, path, &sound));
  while (i < sound.frames && abs(sound.data[i]) < 3000) i++;
  const double click = info.start + (double)i / sound.rate;
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
  ern_sound_free(context, &sound);
  return click - first;
}

/* Sound that begins after the picture, or before it, keeps its time. */
static void test_sound_and_picture_in_step(void **state) {
  (void)state;
  static const double later[] = {0, 1, 0.3, -0.3};
  int64_t cut = 0;
  write_clicks("clicks.mp4");
  for (size_t i = 0; i < sizeof later / sizeof *later; i++) {
    remux("clicks.mp4", "shifted.mp4", later[i], 0, &cut);
    const double found = click_after_picture("shifted.mp4");
    if (fabs(found - later[i]) > 0.01) fail_msg("sound %g s later: its click is %g s later", later[i], found);
  }
}

/* An AVI has no times of display: with B-frames FFmpeg gives the last frame none, and the others are late by two. */
static void test_avi_with_b_frames(void **state) {
  (void)state;
  enum { SIDE = 32, FRAMES = 20 };
  static uint8_t rgba[SIDE * SIDE * 4];
  const ern_video_options options = ern_video_options_default(SIDE, SIDE);
  ern_video_writer *writer = NULL;
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  double seconds = 0;
  bool end = false;
  int count = 0;
  support_ok(context, ern_video_writer_open(context, "b.mp4", &options, &writer));
  for (size_t k = 0; k < FRAMES; k++) {
    for (size_t i = 0; i < sizeof rgba; i++) rgba[i] = (uint8_t)(i / 4 + k);
    support_ok(context, ern_video_writer_frame(writer, rgba));
  }
  support_ok(context, ern_video_writer_close(&writer));
  copy_pictures("b.mp4", "b.avi", AV_FIELD_PROGRESSIVE);
  support_ok(context, ern_video_reader_open(context, "b.avi", &reader));
  for (;; count++) {
    support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
    if (end) break;
    assert_true(seconds == count / 25.0);
  }
  assert_int_equal(count, FRAMES);
  for (int k = FRAMES - 1; k >= 0; k--) {
    support_ok(context, ern_video_reader_seek(reader, k / 25.0));
    support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
    assert_true(!end && seconds == k / 25.0);
  }
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
}

/* Pictures of four frames of grey, as a transport stream without a shape of its pixels of its own. */
static void write_stream(const char *path, double pixel_aspect) {
  enum { SIDE = 32 };
  static uint8_t rgba[SIDE * SIDE * 4];
  ern_video_options options = ern_video_options_default(SIDE, SIDE);
  ern_video_writer *writer = NULL;
  options.pixel_aspect = pixel_aspect;
  support_ok(context, ern_video_writer_open(context, "one.mp4", &options, &writer));
  for (int k = 0; k < 4; k++) support_ok(context, ern_video_writer_frame(writer, rgba));
  support_ok(context, ern_video_writer_close(&writer));
  copy_pictures("one.mp4", path, AV_FIELD_PROGRESSIVE);
}

/* A broadcast whose pixels become wider: one warning, at the first frame of them. */
static void test_pixel_aspect_changes(void **state) {
  (void)state;
  for (int changes = 0; changes < 2; changes++) {
    uint8_t *bytes[2] = {NULL};
    size_t count[2], told = 0;
    ern_video_reader *reader = NULL;
    ern_image image = {0};
    double seconds = 0;
    write_stream("first.ts", 1);
    write_stream("second.ts", changes ? 4.0 / 3 : 1);
    support_ok(context, ern_file_read(context, "first.ts", 1 << 20, &bytes[0], &count[0]));
    support_ok(context, ern_file_read(context, "second.ts", 1 << 20, &bytes[1], &count[1]));
    FILE *file = fopen("both.ts", "wb");
    assert_non_null(file);
    for (int k = 0; k < 2; k++) {
      assert_int_equal(fwrite(bytes[k], 1, count[k], file), count[k]);
      ern_release(context, bytes[k]);
    }
    assert_int_equal(fclose(file), 0);
    support_ok(context, ern_video_reader_open(context, "both.ts", &reader));
    for (bool end = false; !end;) {
      warned[0] = 0;
      support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
      told += strstr(warned, "pixels are 1.33 times as wide as high, expected 1 times") != NULL;
    }
    assert_int_equal(told, changes);
    ern_image_free(context, &image);
    ern_video_reader_free(&reader);
  }
}

/* A stream that crops its pictures at all four edges shows what it crops to, at the left too. */
static void test_cropped(void **state) {
  (void)state;
  enum { SIDE = 128, LEFT = 32, RIGHT = 16, TOP = 8, BOTTOM = 24 };
  static uint8_t rgba[SIDE * SIDE * 4];
  ern_video_options options = ern_video_options_default(SIDE, SIDE);
  ern_video_writer *writer = NULL;
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  double seconds = 0;
  bool end = false;
  for (int k = 0; k < SIDE * SIDE; k++) memset(rgba + 4 * k, 40 + k % SIDE / 2 + k / SIDE, 4);
  support_ok(context, ern_video_writer_open(context, "whole.mp4", &options, &writer));
  for (int k = 0; k < 4; k++) support_ok(context, ern_video_writer_frame(writer, rgba));
  support_ok(context, ern_video_writer_close(&writer));
  copy_changed("whole.mp4", "cropped.ts", AV_FIELD_PROGRESSIVE,
               "h264_mp4toannexb,h264_metadata=crop_left=32:crop_right=16:crop_top=8:crop_bottom=24");
  support_ok(context, ern_video_reader_open(context, "cropped.ts", &reader));
  support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
  assert_false(end);
  assert_int_equal(image.width, SIDE - LEFT - RIGHT);
  assert_int_equal(image.height, SIDE - TOP - BOTTOM);
  for (int y = 0; y < image.height; y++)
    for (int x = 0; x < image.width; x++)
      assert_true(abs(image.data[image.channels * (y * image.width + x)] - (40 + (x + LEFT) / 2 + y + TOP)) <= 4);
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
}

/* A file that ends between two packets, its header first, is read up to there, with a warning for each stream. */
static void test_cut_between_packets(void **state) {
  (void)state;
  uint8_t *bytes = NULL;
  size_t count = 0;
  int64_t cut = 0;
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  ern_sound sound = {0};
  double seconds = 0;
  bool end = false;
  write_clicks("clicks.mp4");
  remux("clicks.mp4", "whole.mp4", 0, 2, &cut);
  support_ok(context, ern_file_read(context, "whole.mp4", 1 << 24, &bytes, &count));
  assert_true(cut > 100000 && (size_t)cut < count);
  for (int whole = 0; whole < 2; whole++) {
    support_write("cut.mp4", bytes, whole ? count : (size_t)cut);
    end = false;
    warned[0] = 0;
    support_ok(context, ern_video_reader_open(context, "cut.mp4", &reader));
    warnings = 0;
    for (int ends = 0; ends < 3; ends += end) /* it is read on at its end */
      support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
    ern_video_reader_free(&reader);
    assert_int_equal(warnings, whole ? 0 : 1);
    if ((strstr(warned, "cut.mp4: may be cut short: its video ends at 2.") == NULL) != whole) fail_msg("%s", warned);
    warned[0] = 0;
    support_ok(context, ern_sound_read(context, "cut.mp4", &sound));
    ern_sound_free(context, &sound);
    if ((strstr(warned, "its sound ends at 2.") == NULL) != whole) fail_msg("%s", warned);
    if (!whole) assert_non_null(strstr(warned, "of the 4.00 s that its header promises"));
  }
  ern_image_free(context, &image);
  ern_release(context, bytes);
}

/* A file that ends within a packet: the same, but with a warning also where less than a second is missing. */
static void test_cut_within_a_packet(void **state) {
  (void)state;
  uint8_t *bytes = NULL;
  size_t count = 0, frames = 0;
  int64_t cut = 0;
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  ern_sound sound = {0};
  double seconds = 0;
  write_clicks("clicks.mp4");
  remux("clicks.mp4", "whole.mp4", 0, 3.9, &cut);
  support_ok(context, ern_file_read(context, "whole.mp4", 1 << 24, &bytes, &count));
  support_write("inside.mp4", bytes, (size_t)cut - 10);
  warned[0] = 0;
  support_ok(context, ern_video_reader_open(context, "inside.mp4", &reader));
  for (bool end = false; !end; frames += !end)
    support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
  ern_video_reader_free(&reader);
  assert_in_range(frames, 90, 99);
  assert_non_null(strstr(warned, "inside.mp4: is cut short: its last packet is not whole, and is left out"));
  support_ok(context, ern_sound_read(context, "inside.mp4", &sound)); /* it passes over packets of pictures */
  assert_in_range(sound.frames, (size_t)(3.5 * sound.rate), (size_t)(4 * sound.rate));
  ern_sound_free(context, &sound);
  ern_image_free(context, &image);
  ern_release(context, bytes);
}

/* Matroska has the length of each stream as a tag. */
static void test_cut_matroska(void **state) {
  (void)state;
  uint8_t *bytes = NULL;
  size_t count = 0;
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  double seconds = 0;
  write_clicks("clicks.mkv");
  support_ok(context, ern_file_read(context, "clicks.mkv", 1 << 24, &bytes, &count));
  for (int whole = 0; whole < 2; whole++) {
    support_write("cut.mkv", bytes, whole ? count : count / 2);
    warned[0] = 0;
    support_ok(context, ern_video_reader_open(context, "cut.mkv", &reader));
    for (bool end = false; !end;) support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
    ern_video_reader_free(&reader);
    if ((strstr(warned, "cut.mkv: may be cut short: its video ends at ") == NULL) != whole) fail_msg("%s", warned);
  }
  ern_image_free(context, &image);
  ern_release(context, bytes);
}

/* A tape of a camcorder: three frames of DV, one after another. */
static void write_tape(const char *path) {
  AVCodecContext *codec = avcodec_alloc_context3(avcodec_find_encoder(AV_CODEC_ID_DVVIDEO));
  AVFrame *frame = av_frame_alloc();
  AVPacket *packet = av_packet_alloc();
  assert_true(codec != NULL && frame != NULL && packet != NULL);
  codec->width = frame->width = 720, codec->height = frame->height = 576;
  codec->pix_fmt = AV_PIX_FMT_YUV420P, frame->format = AV_PIX_FMT_YUV420P;
  codec->time_base = (AVRational){1, 25};
  assert_true(avcodec_open2(codec, NULL, NULL) >= 0 && av_frame_get_buffer(frame, 0) >= 0);
  for (int plane = 0; plane < 3; plane++)
    memset(frame->data[plane], 128, (size_t)frame->linesize[plane] * (plane == 0 ? 576 : 288));
  assert_true(avcodec_send_frame(codec, frame) >= 0 && avcodec_receive_packet(codec, packet) >= 0);
  FILE *file = fopen(path, "wb");
  assert_non_null(file);
  for (int k = 0; k < 3; k++)
    assert_int_equal(fwrite(packet->data, 1, (size_t)packet->size, file), (size_t)packet->size);
  assert_int_equal(fclose(file), 0);
  av_packet_free(&packet);
  av_frame_free(&frame);
  avcodec_free_context(&codec);
}

/* DV has no header that says it. */
static void test_interlaced_tape(void **state) {
  (void)state;
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  double seconds = 0;
  write_tape("tape.dv");
  warnings = 0;
  support_ok(context, ern_video_reader_open(context, "tape.dv", &reader));
  for (bool end = false; !end;) support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
  assert_int_equal(warnings, 1);
  if (strstr(warned, "tape.dv: is interlaced") == NULL) fail_msg("%s", warned);
}

static void test_interlaced(void **state) {
  (void)state;
  enum { SIDE = 32 };
  static const uint8_t rgba[4 * SIDE * SIDE];
  ern_video_options options = ern_video_options_default(SIDE, SIDE);
  ern_video_writer *writer = NULL;
  ern_video_reader *reader = NULL;
  options.codec = "ffv1";
  support_ok(context, ern_video_writer_open(context, "rows.mkv", &options, &writer));
  support_ok(context, ern_video_writer_frame(writer, rgba));
  support_ok(context, ern_video_writer_close(&writer));
  copy_pictures("rows.mkv", "fields.mkv", AV_FIELD_TT);
  for (int fields = 0; fields < 2; fields++) {
    warned[0] = 0;
    support_ok(context, ern_video_reader_open(context, fields ? "fields.mkv" : "rows.mkv", &reader));
    ern_video_reader_free(&reader);
    if ((strstr(warned, "fields.mkv: is interlaced") != NULL) != fields) fail_msg("%s", warned);
  }
}

/* A picture whose alpha is not used is one without it; else its reader says that the alpha is lost. */
static void test_transparent(void **state) {
  (void)state;
  enum { SIDE = 16 };
  uint8_t rgba[4 * SIDE * SIDE];
  const ern_image picture = {.width = SIDE, .height = SIDE, .channels = 4, .data = rgba};
  for (int alpha = 0; alpha < 2; alpha++) {
    ern_video_reader *reader = NULL;
    ern_image image = {0};
    double seconds = 0;
    bool end = false;
    memset(rgba, 255, sizeof rgba);
    rgba[4 * SIDE * SIDE - 1] = alpha ? 100 : 255;
    support_ok(context, ern_image_write(context, "glass.png", &picture, 90));
    warned[0] = 0;
    support_ok(context, ern_video_reader_open(context, "glass.png", &reader));
    support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
    assert_int_equal(strstr(warned, "glass.png: has transparent pixels") != NULL, alpha);
    ern_image_free(context, &image);
    ern_video_reader_free(&reader);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_cover_alone),
      cmocka_unit_test(test_display_matrix),
      cmocka_unit_test(test_sound_and_picture_in_step),
      cmocka_unit_test(test_avi_with_b_frames),
      cmocka_unit_test(test_pixel_aspect_changes),
      cmocka_unit_test(test_cut_matroska),
      cmocka_unit_test(test_interlaced),
      cmocka_unit_test(test_cropped),
      cmocka_unit_test(test_interlaced_tape),
      cmocka_unit_test(test_transparent),
      cmocka_unit_test(test_cut_between_packets),
      cmocka_unit_test(test_cut_within_a_packet),
  };
  return cmocka_run_group_tests_name("video_read", tests, set_up, tear_down);
}
