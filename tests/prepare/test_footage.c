/* SPDX-License-Identifier: MIT
 * Videos of several rates at 25 frames a second: which frame stands for which instant. */
#include <libavformat/avformat.h>

#include "ernerf/media.h"
#include "prepare/footage.h"
#include "prepare_test.h"

enum { SIDE = 64, MOST = 110 };

/* Frame k has its number in it: eight stripes, one a bit, white or black. */
static void make_video(ern_context *context, const char *path, int numerator, int denominator, int frames) {
  static uint8_t rgba[4 * SIDE * SIDE];
  ern_video_options options = ern_video_options_default(SIDE, SIDE);
  ern_video_writer *writer = NULL;
  assert_in_range(frames, 1, MOST);
  options.rate_numerator = numerator;
  options.rate_denominator = denominator;
  options.crf = 1;
  remove(path);
  support_ok(context, ern_video_writer_open(context, path, &options, &writer));
  for (int k = 0; k < frames; k++) {
    for (int i = 0; i < SIDE * SIDE; i++) memset(rgba + 4 * i, (k >> (i % SIDE / 8) & 1) != 0 ? 220 : 30, 4);
    support_ok(context, ern_video_writer_frame(writer, rgba));
  }
  support_ok(context, ern_video_writer_close(&writer));
}

static int frame_of(const ern_image *image) {
  int frame = 0;
  assert_true(image->width == SIDE && image->height == SIDE && image->channels == 3);
  for (int bit = 0; bit < 8; bit++) frame |= (image->data[3 * (SIDE / 2 * SIDE + 8 * bit + 4)] > 125) << bit;
  return frame;
}

/* Reads a part to its end; each frame is the video's nearest in time. Returns how many there are. */
static size_t read_part(struct made_job *m, double rate, int frames) {
  struct ern_footage footage;
  const ern_image *image = NULL;
  size_t count = 0;
  support_ok(m->job.context, ern_footage_open(&m->job, &footage));
  const double expected = (double)ern_footage_expected(&footage);
  for (;; count++) {
    support_ok(m->job.context, ern_footage_next(&footage, &image));
    if (image == NULL) break;
    const double at = m->options.from + (double)count / ERN_PREPARE_RATE;
    const int found = frame_of(image);
    assert_in_range(found, 0, frames - 1);
    const double away = fabs(found / rate - at);
    /* past the last frame's time it is still shown; a container's clock may have a step of 1/90000 s and less */
    const bool last = found == frames - 1 && at > found / rate;
    if (away > (last ? 1 : 0.5) / rate + 1e-4)
      fail_msg("at %.3f s of %.3f a second: frame %d, which is shown at %.3f s", at, rate, found, found / rate);
  }
  assert_true(fabs(expected - (double)count) <= 1);
  support_ok(m->job.context, ern_footage_next(&footage, &image));
  assert_null(image); /* and so it stays */
  ern_footage_close(&footage);
  ern_footage_close(&footage);
  return count;
}

static void test_rates(void **state) {
  (void)state;
  static const struct {
    int numerator, denominator, frames;
    size_t expected; /* instants k/25 before the end of the last frame */
  } rates[] = {{24000, 1001, 96, 101}, {25, 1, 100, 100}, {30, 1, 100, 84}, {30000, 1001, 100, 84}, {50, 1, 101, 51},
               {60, 1, 100, 42},       {12, 1, 30, 63},   {5, 1, 10, 50},   {25, 1, 1, 1},          {50, 1, 1, 1}};
  for (size_t i = 0; i < sizeof rates / sizeof *rates; i++) {
    struct made_job m;
    made_job_open(&m, "clip", SIDE, 0);
    make_video(m.job.context, "made.mp4", rates[i].numerator, rates[i].denominator, rates[i].frames);
    const double rate = (double)rates[i].numerator / rates[i].denominator;
    const size_t found = read_part(&m, rate, rates[i].frames);
    if (found != rates[i].expected)
      fail_msg("%d frames of %.3f a second give %zu, expected %zu", rates[i].frames, rate, found, rates[i].expected);
    made_job_close(&m);
  }
}

static void test_parts(void **state) {
  (void)state;
  static const struct {
    double from, to;
    size_t expected;
  } parts[] = {{1, 2, 25}, {0, 0.04, 1}, {0.5, 0, 88}, {3.96, 0, 1},    {0.02, 0.06, 1}, {3.99, 100, 1}, {0, 0.01, 0},
               {4, 0, 0},  {50, 0, 0},   {1e6, 0, 0},  {1.234, 1.5, 7}, {2, 2.001, 0},   {0, 1e8, 100}};
  struct made_job m;
  made_job_open(&m, "clip", SIDE, 0);
  make_video(m.job.context, "made.mp4", 25, 1, 100);
  for (size_t i = 0; i < sizeof parts / sizeof *parts; i++) {
    struct ern_footage footage;
    const ern_image *image = NULL;
    size_t count = 0;
    m.options.from = parts[i].from;
    m.options.to = parts[i].to;
    support_ok(m.job.context, ern_footage_open(&m.job, &footage));
    for (;; count++) {
      support_ok(m.job.context, ern_footage_next(&footage, &image));
      if (image == NULL) break;
      const double at = parts[i].from + (double)count / ERN_PREPARE_RATE;
      const int found = frame_of(image);
      if (fabs(found / 25.0 - at) > (found == 99 ? 0.04 : 0.0201))
        fail_msg("from %g to %g: frame %zu is %d of the video", parts[i].from, parts[i].to, count, found);
    }
    if (count != parts[i].expected)
      fail_msg("from %g to %g: %zu frames, expected %zu", parts[i].from, parts[i].to, count, parts[i].expected);
    ern_footage_close(&footage);
  }
  made_job_close(&m);
}

static void test_no_video(void **state) {
  (void)state;
  struct made_job m;
  struct ern_footage footage;
  made_job_open(&m, "clip", SIDE, 0);
  remove("made.mp4");
  support_expect(m.job.context, ern_footage_open(&m.job, &footage), ERN_E_MISSING, "made.mp4", NULL);
  support_write_text("made.mp4", "no video at all");
  assert_int_not_equal(ern_footage_open(&m.job, &footage), ERN_OK);
  assert_non_null(strstr(ern_last_error(m.job.context), "made.mp4"));
  support_write("made.mp4", "", 0);
  assert_int_not_equal(ern_footage_open(&m.job, &footage), ERN_OK);
  ern_footage_close(&footage);
  ern_footage_close(&(struct ern_footage){0});
  made_job_close(&m);
}

/* The pictures of made.mp4, `times` times one behind the other, each time `apart` seconds after the time before, and
 * one of them `early` seconds before its time. */
static void make_joined(const char *path, int times, double apart, double early) {
  AVFormatContext *from = NULL, *to = NULL;
  AVPacket *packet = av_packet_alloc();
  int64_t written = 0;
  assert_true(packet != NULL && avformat_alloc_output_context2(&to, NULL, "matroska", path) >= 0);
  to->avoid_negative_ts = AVFMT_AVOID_NEG_TS_DISABLED;
  for (int k = 0; k < times; k++) {
    assert_true(avformat_open_input(&from, "made.mp4", NULL, NULL) >= 0);
    if (k == 0) {
      AVStream *stream = avformat_new_stream(to, NULL);
      assert_true(stream != NULL && avcodec_parameters_copy(stream->codecpar, from->streams[0]->codecpar) >= 0);
      stream->codecpar->codec_tag = 0;
      assert_true(avio_open(&to->pb, path, AVIO_FLAG_WRITE) >= 0 && avformat_write_header(to, NULL) >= 0);
    }
    while (av_read_frame(from, packet) >= 0) {
      av_packet_rescale_ts(packet, from->streams[0]->time_base, to->streams[0]->time_base);
      packet->pts += llround(1000 * (k * apart - (written == 25 ? early : 0))); /* the container's clock: 1 ms */
      packet->dts = written++ - 100000;                                         /* must rise, and is not written */
      assert_true(av_write_frame(to, packet) >= 0);
      av_packet_unref(packet);
    }
    avformat_close_input(&from);
  }
  assert_true(av_write_trailer(to) >= 0);
  avio_closep(&to->pb);
  avformat_free_context(to);
  av_packet_free(&packet);
}

/* Of two videos put one behind the other only the first would be seen, and the sound of both would be heard. Pictures
 * whose time has passed are left out, and those after them are shown in time. */
static void test_times_go_back(void **state) {
  (void)state;
  static const struct {
    int times;
    double apart, early;
    size_t expected, left_out; /* 0: refused */
  } cases[] = {{1, 0, 0, 50, 0}, {2, 0, 0, 0, 0}, {1, 0, 0.05, 50, 1}, {2, 1.5, 0, 88, 12}, {2, 0.9, 0, 0, 0}};
  struct made_job m;
  const ern_image *image = NULL;
  made_job_open(&m, "clip", SIDE, 0);
  make_video(m.job.context, "made.mp4", 25, 1, 50);
  m.job.video = "joined.mkv";
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    struct ern_footage footage;
    size_t count = 0, still = 0;
    int before = -1;
    ern_status status = ERN_OK;
    make_joined("joined.mkv", cases[i].times, cases[i].apart, cases[i].early);
    support_ok(m.job.context, ern_footage_open(&m.job, &footage));
    for (;; count++) {
      status = ern_footage_next(&footage, &image);
      if (status != ERN_OK || image == NULL || count == 200) break;
      const int frame = frame_of(image);
      still += frame == before;
      before = frame;
    }
    if (cases[i].expected == 0) {
      support_expect(m.job.context, status, ERN_E_FORMAT, "joined.mkv", "go back", NULL);
    } else {
      support_ok(m.job.context, status);
      assert_int_equal(count, cases[i].expected);
      assert_true(still <= 2);
      assert_int_equal(footage.left_out, cases[i].left_out);
    }
    ern_footage_close(&footage);
  }
  made_job_close(&m);
}

/* A last frame after a gap is shown up to the end of the file, not as long as the gap. */
static void test_last_after_gap(void **state) {
  (void)state;
  struct made_job m;
  struct ern_footage footage;
  const ern_image *image = NULL;
  size_t count = 0;
  made_job_open(&m, "clip", SIDE, 0);
  make_video(m.job.context, "made.mp4", 25, 1, 1);
  make_joined("joined.mkv", 2, 0.4, 0); /* frames at 0 and 0.4 s, each of 0.04 s */
  m.job.video = "joined.mkv";
  support_ok(m.job.context, ern_footage_open(&m.job, &footage));
  for (;; count++) {
    support_ok(m.job.context, ern_footage_next(&footage, &image));
    if (image == NULL) break;
  }
  assert_int_equal(count, 11);
  ern_footage_close(&footage);
  made_job_close(&m);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_rates), cmocka_unit_test(test_parts),
                                     cmocka_unit_test(test_no_video), cmocka_unit_test(test_times_go_back),
                                     cmocka_unit_test(test_last_after_gap)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
