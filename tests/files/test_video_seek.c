/* SPDX-License-Identifier: MIT
 * Videos read from any second on, and written with recorded frames of which a part is replaced. */
#include <math.h>
#include <stdbool.h>

#include "core/memory.h"
#include "ernerf/stream.h"
#include "support.h"

static ern_context *context;

static void *allocate(size_t bytes) {
  void *memory = ern_allocate(context, bytes, 1);
  assert_non_null(memory);
  return memory;
}

/* A moving pattern of soft waves, each channel its own. */
static void draw(uint8_t *rgba, int side, int k) {
  for (int y = 0; y < side; y++) {
    for (int x = 0; x < side; x++, rgba += 4) {
      rgba[0] = (uint8_t)(127.5 + 100 * sin(0.11 * (x + 3 * k)) * cos(0.07 * y));
      rgba[1] = (uint8_t)(127.5 + 100 * sin(0.05 * (y - 2 * k) + 0.03 * x));
      rgba[2] = (uint8_t)(127.5 + 100 * cos(0.06 * (x + y + k)));
      rgba[3] = 255;
    }
  }
}

enum { SEEK_FRAMES = 600, SEEK_SIDE = 32 }; /* three groups of pictures */

static void write_numbered(const char *path) {
  static uint8_t rgba[SEEK_SIDE * SEEK_SIDE * 4];
  const ern_video_options options = ern_video_options_default(SEEK_SIDE, SEEK_SIDE);
  ern_video_writer *writer = NULL;
  support_ok(context, ern_video_writer_open(context, path, &options, &writer));
  for (int k = 0; k < SEEK_FRAMES; k++) {
    draw(rgba, SEEK_SIDE, k);
    support_ok(context, ern_video_writer_frame(writer, rgba));
  }
  support_ok(context, ern_video_writer_close(&writer));
}

/* After a seek the frames are those that are read from the beginning, whichever way it goes. */
static void test_seek(void **state) {
  (void)state;
  static const char *const names[] = {"seek.mp4", "seek.mkv"};
  static const int places[] = {599, 0, 251, 250, 249, 500, 3, 598, 260, 1};
  for (size_t n = 0; n < sizeof names / sizeof *names; n++) {
    ern_video_reader *reader = NULL;
    ern_image image = {0}, *all = allocate(SEEK_FRAMES * sizeof *all);
    double seconds = 0, *times = allocate(SEEK_FRAMES * sizeof *times);
    bool end = false;
    write_numbered(names[n]);
    memset(all, 0, SEEK_FRAMES * sizeof *all);
    support_ok(context, ern_video_reader_open(context, names[n], &reader));
    for (int k = 0; k < SEEK_FRAMES; k++) support_ok(context, ern_video_reader_frame(reader, &all[k], &times[k], &end));
    for (size_t i = 0; i < sizeof places / sizeof *places; i++) {
      const int k = places[i];
      support_ok(context, ern_video_reader_seek(reader, times[k] - (k % 2) * 0.02)); /* of its time, or before it */
      for (int j = k; j < k + 2 && j < SEEK_FRAMES; j++) {
        support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
        assert_true(!end && seconds == times[j]);
        assert_memory_equal(image.data, all[j].data, (size_t)SEEK_SIDE * SEEK_SIDE * 3);
      }
    }
    support_ok(context, ern_video_reader_seek(reader, times[SEEK_FRAMES - 1] + 1));
    support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
    assert_true(end);
    support_ok(context, ern_video_reader_seek(reader, -5));
    support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
    assert_true(!end && seconds == times[0]);
    for (int k = 0; k < SEEK_FRAMES; k++) ern_image_free(context, &all[k]);
    ern_image_free(context, &image);
    ern_video_reader_free(&reader);
    ern_release(context, all);
    ern_release(context, times);
  }
}

/* A frame that is written as it was decoded differs by its coding alone, less than one that went through RGB; its part
 * has the caller's colours. */
/* The same of a stream: the frame, again, and with the part. */
static void check_stream(const ern_video_frame *frame, const int part[4], const uint8_t *rgba,
                         const ern_image *before) {
  ern_stream_options options = ern_stream_options_default(before->width, before->height);
  ern_stream_writer *writer = NULL;
  ern_video_reader *reader = NULL;
  ern_image after = {0};
  double seconds = 0;
  bool end = false;
  const size_t bytes = (size_t)before->width * (size_t)before->height * 3,
               corner = 3 * ((size_t)(part[1] + 10) * (size_t)before->width + (size_t)part[0] + 10);
  options.crf = 0; /* without loss */
  support_ok(context, ern_stream_writer_open(context, "patched.ts", &options, &writer));
  support_ok(context, ern_stream_writer_patch(writer, frame, NULL, NULL, NULL, 0));
  support_ok(context, ern_stream_writer_frame(writer, NULL, NULL, 0));
  support_ok(context, ern_stream_writer_patch(writer, frame, part, rgba, NULL, 0));
  support_ok(context, ern_stream_writer_close(&writer));
  support_ok(context, ern_video_reader_open(context, "patched.ts", &reader));
  for (int k = 0; k < 2; k++) {
    support_ok(context, ern_video_reader_frame(reader, &after, &seconds, &end));
    assert_memory_equal(after.data, before->data, bytes);
  }
  support_ok(context, ern_video_reader_frame(reader, &after, &seconds, &end));
  assert_memory_equal(after.data, before->data, (size_t)(part[1] - 4) * (size_t)before->width * 3);
  for (int c = 0; c < 3; c++) assert_true(abs(after.data[corner + (size_t)c] - rgba[c]) < 3);
  ern_image_free(context, &after);
  ern_video_reader_free(&reader);
}

static void test_patch(void **state) {
  (void)state;
  enum { SIDE = 64 };
  static const int part[4] = {16, 20, 30, 26};
  static uint8_t rgba[SIDE * SIDE * 4], red[30 * 26 * 4];
  ern_video_options options = ern_video_options_default(SIDE, SIDE);
  ern_video_writer *writer = NULL;
  ern_video_reader *readers[2] = {0};
  ern_video_frame *frame = NULL;
  ern_image before = {0}, after = {0}, cut = {0};
  double seconds = 0;
  bool end = false;
  for (size_t i = 0; i < sizeof red; i++) red[i] = i % 4 == 0 ? 200 : 30;
  draw(rgba, SIDE, 0);
  support_ok(context, ern_video_writer_open(context, "plain.mp4", &options, &writer));
  support_ok(context, ern_video_writer_frame(writer, rgba));
  support_ok(context, ern_video_writer_close(&writer));
  support_ok(context, ern_video_reader_open(context, "plain.mp4", &readers[0]));
  support_ok(context, ern_video_reader_decode(readers[0], &frame, &seconds));
  assert_true(ern_video_frame_is_plain(frame));
  support_ok(context, ern_video_reader_rgb(readers[0], frame, NULL, &before));
  support_ok(context, ern_video_reader_rgb(readers[0], frame, part, &cut));
  for (int y = 2; y < part[3] - 2; y++) /* but for the edge the whole frame's; the scaler's weights round by place */
    for (int i = 6; i < 3 * part[2] - 6; i++)
      assert_true(abs(cut.data[3 * y * part[2] + i] - before.data[3 * ((y + part[1]) * SIDE + part[0]) + i]) <= 1);
  options.crf = 0; /* without loss */
  support_ok(context, ern_video_writer_open(context, "patched.mp4", &options, &writer));
  support_ok(context, ern_video_writer_patch(writer, frame, NULL, NULL));
  support_ok(context, ern_video_writer_patch(writer, frame, part, red));
  support_ok(context, ern_video_writer_close(&writer));
  check_stream(frame, part, red, &before);
  ern_video_frame_free(&frame);
  support_ok(context, ern_video_reader_decode(readers[0], &frame, &seconds));
  assert_null(frame);
  support_ok(context, ern_video_reader_open(context, "patched.mp4", &readers[1]));
  support_ok(context, ern_video_reader_frame(readers[1], &after, &seconds, &end));
  assert_memory_equal(after.data, before.data, (size_t)SIDE * SIDE * 3);
  support_ok(context, ern_video_reader_frame(readers[1], &after, &seconds, &end));
  for (int y = 0; y < SIDE; y++)
    for (int x = 0; x < SIDE; x++) {
      const int u = x - part[0], v = y - part[1];
      const uint8_t *is = after.data + 3 * (y * SIDE + x), *was = before.data + 3 * (y * SIDE + x);
      /* the RGB of a pixel is made from colours up to 4 pixels away */
      if (u < -4 || v < -4 || u > part[2] + 3 || v > part[3] + 3) assert_memory_equal(is, was, 3);
      if (u > 3 && v > 3 && u < part[2] - 4 && v < part[3] - 4)
        assert_true(abs(is[0] - 200) < 3 && abs(is[1] - 30) < 3);
    }
  options.codec = "ffv1"; /* of RGB */
  support_ok(context, ern_video_reader_seek(readers[0], 0));
  support_ok(context, ern_video_reader_decode(readers[0], &frame, &seconds));
  support_ok(context, ern_video_writer_open(context, "patched.mkv", &options, &writer));
  assert_int_equal(ern_video_writer_patch(writer, frame, NULL, NULL), ERN_E_UNSUPPORTED);
  ern_video_writer_abandon(&writer);
  ern_video_frame_free(&frame);
  ern_image *const images[] = {&before, &after, &cut};
  for (int i = 0; i < 3; i++) ern_image_free(context, images[i]);
  for (int i = 0; i < 2; i++) ern_video_reader_free(&readers[i]);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_seek), cmocka_unit_test(test_patch)};
  context = support_context();
  const int failed = cmocka_run_group_tests(tests, NULL, NULL);
  ern_context_free(&context);
  return failed;
}
