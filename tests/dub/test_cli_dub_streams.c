/* SPDX-License-Identifier: MIT
 * `ernerf dub` and `live --video` of videos whose streams cannot all become a part of the output: further sound and
 * subtitles, pictures that change their size. */
#include <libavcodec/bsf.h>
#include <libavformat/avformat.h>

#include "dub/recorded_clip.h"
#include "ernerf/stream.h"

enum { SIDE = 96, RECORDED = 16, FRAMES = 8 };

static struct cli cli;

static void write_record(const char *hash, double from) { recorded_clip_write(hash, from, 0, SIDE, RECORDED); }

static int make_all(void **state) {
  (void)state;
  recorded_clip_take(true);
  return 0;
}

/* FRAMES grey frames of side x side pixels as a stream with its header in the pictures' packets. */
static void write_stream(const char *path, int side) {
  static uint8_t rgba[SIDE * SIDE * 4];
  ern_context *context = support_context();
  const ern_stream_options options = ern_stream_options_default(side, side);
  ern_stream_writer *writer = NULL;
  memset(rgba, 128, sizeof rgba);
  support_ok(context, ern_stream_writer_open(context, path, &options, &writer));
  for (int k = 0; k < FRAMES; k++) support_ok(context, ern_stream_writer_frame(writer, rgba, NULL, 0));
  support_ok(context, ern_stream_writer_close(&writer));
  ern_context_free(&context);
}

/* The pictures of both streams, one after the other, in one Matroska file. change: FFmpeg's filter for the second's. */
static void append_streams(const char *const from[2], const char *change, const char *to) {
  AVFormatContext *in = NULL, *out = NULL;
  AVBSFContext *filter = NULL;
  AVPacket *packet = av_packet_alloc();
  int64_t pictures = 0;
  assert_true(packet != NULL && avformat_alloc_output_context2(&out, NULL, "matroska", to) >= 0);
  for (int i = 0; i < 2; i++) {
    assert_true(avformat_open_input(&in, from[i], NULL, NULL) >= 0 && avformat_find_stream_info(in, NULL) >= 0);
    if (i == 0) {
      AVStream *stream = avformat_new_stream(out, NULL);
      assert_true(stream != NULL && avcodec_parameters_copy(stream->codecpar, in->streams[0]->codecpar) >= 0);
      stream->codecpar->codec_tag = 0;
      assert_true(avio_open(&out->pb, to, AVIO_FLAG_WRITE) >= 0 && avformat_write_header(out, NULL) >= 0);
    }
    assert_true(av_bsf_list_parse_str(i == 1 ? change : "null", &filter) >= 0);
    assert_true(avcodec_parameters_copy(filter->par_in, in->streams[0]->codecpar) >= 0 && av_bsf_init(filter) >= 0);
    while (av_read_frame(in, packet) >= 0) {
      assert_true(av_bsf_send_packet(filter, packet) >= 0 && av_bsf_receive_packet(filter, packet) >= 0);
      packet->pts = packet->dts = 40 * pictures++; /* the container's clock: 1 ms */
      packet->duration = 40;
      assert_true(av_interleaved_write_frame(out, packet) >= 0);
      av_packet_unref(packet);
    }
    av_bsf_free(&filter);
    avformat_close_input(&in);
  }
  assert_true(av_write_trailer(out) >= 0);
  avio_closep(&out->pb);
  avformat_free_context(out);
  av_packet_free(&packet);
}

/* Copies clip.mp4 with its sound twice, with subtitles, and with a second track of pictures, as Matroska. */
static void copy_with_more(const char *to) {
  AVFormatContext *in = NULL, *out = NULL;
  AVPacket *packet = av_packet_alloc();
  assert_true(packet != NULL && avformat_open_input(&in, "clip.mp4", NULL, NULL) >= 0);
  assert_true(avformat_alloc_output_context2(&out, NULL, "matroska", to) >= 0);
  for (unsigned i = 0; i < 5; i++) { /* pictures, sound, sound, subtitles, pictures */
    AVStream *stream = avformat_new_stream(out, NULL);
    assert_non_null(stream);
    stream->codecpar->codec_type = AVMEDIA_TYPE_SUBTITLE;
    stream->codecpar->codec_id = AV_CODEC_ID_SUBRIP;
    if (i != 3) assert_true(avcodec_parameters_copy(stream->codecpar, in->streams[i == 1 || i == 2]->codecpar) >= 0);
    stream->codecpar->codec_tag = 0;
  }
  assert_true(avio_open(&out->pb, to, AVIO_FLAG_WRITE) >= 0 && avformat_write_header(out, NULL) >= 0);
  while (av_read_frame(in, packet) >= 0) {
    const int i = packet->stream_index;
    av_packet_rescale_ts(packet, in->streams[i]->time_base, out->streams[i]->time_base);
    assert_true(av_interleaved_write_frame(out, packet) >= 0);
    av_packet_unref(packet);
  }
  assert_true(av_write_trailer(out) >= 0);
  avio_closep(&out->pb);
  avformat_free_context(out);
  avformat_close_input(&in);
  av_packet_free(&packet);
}

/* Streams of the video that the output lacks are named. */
static void test_other_streams(void **state) {
  (void)state;
  ern_context *context = support_context();
  char hash[65];
  copy_with_more("more.mkv");
  support_ok(context, ern_file_sha256(context, "more.mkv", hash));
  write_record(hash, 0);
  cli_run(&cli, "dub h.safetensors more.mkv --clip clip --audio clip/aud.wav -o more.mp4 -y --frames 0:1");
  cli_expect(&cli, 0,
             "warning: more.mkv: stream 2 (audio, aac), stream 3 (subtitle, subrip), stream 4 (video, h264): not in "
             "the output",
             NULL);
#if ERN_PREPARE
  cli_run(&cli, "prepare more.mkv -o prepared --only face"); /* too short */
  cli_expect(&cli, 1, "more.mkv: has other pictures too", "stream 4 (video, h264), which are not read", NULL);
#endif
  write_record(NULL, 0);
  cli_run(&cli, "dub h.safetensors clip.mp4 --clip clip --audio clip/aud.wav -o more.mp4 -y --frames 0:1");
  cli_expect(&cli, 0, NULL);
  assert_null(strstr(cli.err, "not in the output"));
  ern_context_free(&context);
}

/* A video whose pictures become smaller: the message says where. */
static void test_other_size(void **state) {
  (void)state;
  ern_context *context = support_context();
  char hash[65];
  write_stream("large.ts", SIDE);
  write_stream("small.ts", SIDE / 2);
  append_streams((const char *const[]){"large.ts", "small.ts"}, "null", "sizes.mkv");
  support_ok(context, ern_file_sha256(context, "sizes.mkv", hash));
  write_record(hash, 0.2); /* most of the clip is in the second stream */
  cli_run(&cli, "dub h.safetensors sizes.mkv --clip clip --audio clip/aud.wav -o no.mp4");
  cli_expect(&cli, 1, "sizes.mkv: its picture at 0.32 s has 48 x 48 pixels, expected 96 x 96", NULL);
  cli_run(&cli, "live h.safetensors --clip clip --video sizes.mkv --audio clip/aud.wav --as-fast -o no.mp4");
  cli_expect(&cli, 1, "sizes.mkv: its picture at 0.32 s has 48 x 48 pixels, expected 96 x 96", NULL);
  assert_false(cli_there("no.mp4"));
  ern_context_free(&context);
}

/* Grey of frame k, at a corner. */
static int grey_of(const char *path, int k) {
  ern_context *context = support_context();
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  double seconds = 0;
  bool end = false;
  support_ok(context, ern_video_reader_open(context, path, &reader));
  for (int i = 0; i <= k; i++) support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
  assert_false(end);
  const int grey = image.data[0];
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
  ern_context_free(&context);
  return grey;
}

/* A video that turns to full range, so that its frames are no longer coded as they were decoded: the output has one
 * range, and their colours. */
static void test_other_range(void **state) {
  (void)state;
  ern_context *context = support_context();
  char hash[65];
  write_stream("limited.ts", SIDE);
  append_streams((const char *const[]){"limited.ts", "limited.ts"}, "h264_metadata=video_full_range_flag=1",
                 "ranges.mkv");
  support_ok(context, ern_file_sha256(context, "ranges.mkv", hash));
  write_record(hash, 0);
  cli_run(&cli, "dub h.safetensors ranges.mkv --clip clip --audio clip/aud.wav -o ranges.mp4 -y");
  cli_expect(&cli, 0, NULL);
  const int before = grey_of("ranges.mkv", FRAMES - 1), after = grey_of("ranges.mkv", FRAMES);
  assert_true(before - after > 1); /* 126 of 16 to 235 is 128, of 0 to 255 it is 126 */
  assert_in_range(grey_of("ranges.mp4", FRAMES - 1), before - 1, before + 1);
  assert_in_range(grey_of("ranges.mp4", FRAMES), after - 1, after + 1);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_other_streams), cmocka_unit_test(test_other_size),
                                     cmocka_unit_test(test_other_range)};
  return cmocka_run_group_tests(tests, make_all, NULL);
}
