/* SPDX-License-Identifier: MIT
 * stream.h: what its functions do with bad arguments (base.h, "Arguments"). */
#include "arguments.h"

#include "ernerf/stream.h"

static struct {
  ern_context *context;
  ern_sound_reader *reader;
  ern_stream_writer *writer;
} w;

static const char junk[] = "nowhere/at-all.ts";

CHECK(ern_stream_file) {
  assert_null(ern_stream_file(NULL));
  assert_null(ern_stream_file("udp://127.0.0.1:5000"));
  assert_string_equal(ern_stream_file("file:///a/b.mp4"), "///a/b.mp4");
  assert_string_equal(ern_stream_file("a://b.mp4"), "a://b.mp4"); /* refused where it is opened */
}
CHECK(ern_sound_reader_options_fill) { ern_sound_reader_options_fill(NULL, sizeof(ern_sound_reader_options)); }
CHECK(ern_sound_reader_options_default) { assert_int_equal(ern_sound_reader_options_default().rate, 48000); }
CHECK(ern_sound_reader_is_device) {
  assert_false(ern_sound_reader_is_device(NULL));
  assert_true(ern_sound_reader_is_device("pulse:default"));
  assert_false(ern_sound_reader_is_device("udp://127.0.0.1:5000"));
  assert_false(ern_sound_reader_is_device("a/b:c.wav"));
  assert_false(ern_sound_reader_is_device("file:c.wav"));
}
CHECK(ern_sound_reader_open) {
  ern_sound_reader *reader = (ern_sound_reader *)(void *)&w;
  ern_sound_reader_options options = ern_sound_reader_options_default();
  REFUSED_ALONE(ern_sound_reader_open(NULL, junk, &options, &reader));
  assert_null(reader);
  REFUSED(w.context, "url is NULL", ern_sound_reader_open(w.context, NULL, &options, &reader));
  REFUSED(w.context, "reader is NULL", ern_sound_reader_open(w.context, junk, &options, NULL));
  options.channels = 9;
  REFUSED(w.context, "channels is 9, expected 1 to 8", ern_sound_reader_open(w.context, junk, &options, &reader));
  options = (ern_sound_reader_options){.rate = 48000};
  REFUSED(w.context, "ern_sound_reader_options_default", ern_sound_reader_open(w.context, junk, &options, &reader));
  assert_int_equal(ern_sound_reader_open(w.context, junk, NULL, &reader), ERN_E_MISSING);
}
CHECK(ern_sound_reader_free) {
  ern_sound_reader *none = NULL;
  ern_sound_reader_free(NULL);
  ern_sound_reader_free(&none);
}
CHECK(ern_sound_reader_read) {
  float sample;
  size_t frames = 7;
  REFUSED_ALONE(ern_sound_reader_read(NULL, &sample, 1, &frames));
  assert_int_equal(frames, 0);
  REFUSED(w.context, "samples is NULL", ern_sound_reader_read(w.reader, NULL, 1, &frames));
  REFUSED(w.context, "frames is NULL", ern_sound_reader_read(w.reader, &sample, 1, NULL));
  REFUSED(w.context, "capacity is 0", ern_sound_reader_read(w.reader, &sample, 0, &frames));
}

CHECK(ern_stream_options_fill) { ern_stream_options_fill(NULL, sizeof(ern_stream_options)); }
CHECK(ern_stream_options_default) { assert_int_equal(ern_stream_options_default(3, 4).height, 4); }
CHECK(ern_stream_writer_open) {
  ern_stream_writer *writer = (ern_stream_writer *)(void *)&w;
  ern_stream_options options = ern_stream_options_default(16, 16);
  REFUSED_ALONE(ern_stream_writer_open(NULL, junk, &options, &writer));
  assert_null(writer);
  REFUSED(w.context, "url is NULL", ern_stream_writer_open(w.context, NULL, &options, &writer));
  REFUSED(w.context, "options is NULL", ern_stream_writer_open(w.context, junk, NULL, &writer));
  REFUSED(w.context, "writer is NULL", ern_stream_writer_open(w.context, junk, &options, NULL));
  options.crf = 52;
  REFUSED(w.context, "crf is 52, expected 0 to 51", ern_stream_writer_open(w.context, junk, &options, &writer));
  options = ern_stream_options_default(16, 16);
  options.rate_denominator = 1000000;
  REFUSED(w.context, "rate_denominator is 25/1000000 frames a second, expected 1/100 to 1000",
          ern_stream_writer_open(w.context, junk, &options, &writer));
  options.rate_numerator = 1000000, options.rate_denominator = 1;
  REFUSED(w.context, "1000000/1 frames", ern_stream_writer_open(w.context, junk, &options, &writer));
  options = ern_stream_options_default(16, 16);
  options.sound_rate = 48000;
  REFUSED(w.context, "sound_channels is 0, expected 1 to 8",
          ern_stream_writer_open(w.context, junk, &options, &writer));
  options = ern_stream_options_default(0, 16);
  assert_int_equal(ern_stream_writer_open(w.context, junk, &options, &writer), ERN_E_SHAPE);
  options = ern_stream_options_default(16, 16);
  support_expect(w.context, ern_stream_writer_open(w.context, "a.gif", &options, &writer), ERN_E_UNSUPPORTED,
                 "does not follow from its name", NULL);
  options.pixel_aspect = 0;
  REFUSED(w.context, "pixel_aspect is 0, expected 0.01 to 100",
          ern_stream_writer_open(w.context, "a.ts", &options, &writer));
  options.pixel_aspect = 1;
  options.preset = "slowest";
  REFUSED(w.context, "preset is \"slowest\", expected one of x264's",
          ern_stream_writer_open(w.context, "a.ts", &options, &writer));
  options.preset = NULL;
  options.profile = "extended";
  REFUSED(w.context, "profile is \"extended\", expected baseline, main or high",
          ern_stream_writer_open(w.context, "a.ts", &options, &writer));
  options.profile = "baseline";
  options.crf = 0;
  REFUSED(w.context, "crf is 0, lossless, which H.264 has not in its baseline profile, expected 1 to 51",
          ern_stream_writer_open(w.context, "a.ts", &options, &writer));
  options.crf = ern_stream_options_default(1, 1).crf;
  options.profile = NULL;
  options.format = "theora";
  support_expect(w.context, ern_stream_writer_open(w.context, junk, &options, &writer), ERN_E_UNSUPPORTED,
                 "format is \"theora\"", NULL);
}
CHECK(ern_stream_writer_frame) {
  const uint8_t rgba[16 * 16 * 4] = {0};
  REFUSED_ALONE(ern_stream_writer_frame(NULL, rgba, NULL, 0));
  REFUSED(w.context, "samples is NULL", ern_stream_writer_frame(w.writer, rgba, NULL, 1));
}
CHECK(ern_stream_writer_patch) {
  static const uint8_t rgba[16 * 16 * 4];
  const int odd[4] = {0, 0, 3, 2}, whole[4] = {0, 0, 16, 16};
  const ern_video_options video = ern_video_options_default(16, 16);
  ern_stream_options options = ern_stream_options_default(16, 16);
  ern_video_writer *file = NULL;
  ern_video_reader *reader = NULL;
  ern_video_frame *frame = NULL;
  ern_stream_writer *raw = NULL;
  double seconds;
  support_ok(w.context, ern_video_writer_open(w.context, "plain.mp4", &video, &file));
  support_ok(w.context, ern_video_writer_frame(file, rgba));
  support_ok(w.context, ern_video_writer_close(&file));
  support_ok(w.context, ern_video_reader_open(w.context, "plain.mp4", &reader));
  support_ok(w.context, ern_video_reader_decode(reader, &frame, &seconds));
  REFUSED_ALONE(ern_stream_writer_patch(NULL, frame, NULL, NULL, NULL, 0));
  REFUSED(w.context, "frame is NULL", ern_stream_writer_patch(w.writer, NULL, NULL, NULL, NULL, 0));
  REFUSED(w.context, "rgba is NULL", ern_stream_writer_patch(w.writer, frame, whole, NULL, NULL, 0));
  REFUSED(w.context, "samples is NULL", ern_stream_writer_patch(w.writer, frame, NULL, NULL, NULL, 1));
  assert_int_equal(ern_stream_writer_patch(w.writer, frame, odd, rgba, NULL, 0), ERN_E_SHAPE);
  options.format = "raw";
  support_ok(w.context, ern_stream_writer_open(w.context, "raw.rgba", &options, &raw));
  support_expect(w.context, ern_stream_writer_patch(raw, frame, NULL, NULL, NULL, 0), ERN_E_UNSUPPORTED,
                 "expected the size of the stream, 16 x 16, and a format other than raw", NULL);
  ern_stream_writer_abandon(&raw);
  ern_video_frame_free(&frame);
  ern_video_reader_free(&reader);
}
CHECK(ern_stream_writer_close) {
  ern_stream_writer *none = NULL;
  REFUSED_ALONE(ern_stream_writer_close(NULL));
  REFUSED_ALONE(ern_stream_writer_close(&none));
}
CHECK(ern_stream_writer_abandon) {
  ern_stream_writer *none = NULL;
  ern_stream_writer_abandon(NULL);
  ern_stream_writer_abandon(&none);
}

static ptrdiff_t read_junk(void *user, void *bytes, size_t most) {
  bool *was_read = user;
  if (*was_read) return 0;
  *was_read = true;
  memset(bytes, 7, most);
  return (ptrdiff_t)most;
}
CHECK(ern_stream_copy) {
  bool was_read = false;
  REFUSED_ALONE(ern_stream_copy(NULL, "udp://127.0.0.1:9", read_junk, NULL, &was_read));
  REFUSED(w.context, "url is NULL", ern_stream_copy(w.context, NULL, read_junk, NULL, &was_read));
  REFUSED(w.context, "read is NULL", ern_stream_copy(w.context, "udp://127.0.0.1:9", NULL, NULL, NULL));
  support_expect(w.context, ern_stream_copy(w.context, "udp://127.0.0.1:9", read_junk, NULL, &was_read), ERN_E_FORMAT,
                 "udp://127.0.0.1:9: cannot read the head of the stream", NULL);
  support_expect(w.context, ern_stream_copy(w.context, "a.flv", read_junk, NULL, &was_read), ERN_E_UNSUPPORTED,
                 "a.flv: expected an address", NULL);
  support_expect(w.context, ern_stream_copy(w.context, "concat:a", read_junk, NULL, &was_read), ERN_E_UNSUPPORTED,
                 "begins with \"concat\"", NULL);
}

static const struct arguments_check table[] = {ROW(ern_sound_reader_options_fill),
                                               ROW(ern_sound_reader_options_default),
                                               ROW(ern_stream_file),
                                               ROW(ern_sound_reader_is_device),
                                               ROW(ern_sound_reader_open),
                                               ROW(ern_sound_reader_free),
                                               ROW(ern_sound_reader_read),
                                               ROW(ern_stream_options_fill),
                                               ROW(ern_stream_options_default),
                                               ROW(ern_stream_writer_open),
                                               ROW(ern_stream_writer_frame),
                                               ROW(ern_stream_writer_patch),
                                               ROW(ern_stream_writer_close),
                                               ROW(ern_stream_writer_abandon),
                                               ROW(ern_stream_copy)};
enum { CHECKS = sizeof table / sizeof *table };

static void test_every_function_has_a_check(void **state) {
  (void)state;
  assert_int_equal(arguments_cover("include/ernerf/stream.h", table, CHECKS), CHECKS);
}

static void test_arguments(void **state) {
  (void)state;
  static const int16_t sample[4] = {0};
  const ern_stream_options options = ern_stream_options_default(16, 16);
  ern_sound_reader_options raw = ern_sound_reader_options_default();
  w.context = support_context();
  support_write("raw.s16", sample, sizeof sample);
  raw.format = "s16le";
  support_ok(w.context, ern_sound_reader_open(w.context, "raw.s16", &raw, &w.reader));
  support_ok(w.context, ern_stream_writer_open(w.context, "arguments.ts", &options, &w.writer));
  arguments_run(table, CHECKS);
  ern_sound_reader_free(&w.reader);
  ern_stream_writer_abandon(&w.writer);
  ern_context_free(&w.context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_every_function_has_a_check),
                                     cmocka_unit_test(test_arguments)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
