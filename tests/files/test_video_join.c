/* SPDX-License-Identifier: MIT
 * ern_video_join: what of the first segment the joined file has. Its pictures, times and sound: e2e/test_cli_join. Both
 * it and the writer of segments in a program that traps arithmetic errors. */
#define _GNU_SOURCE /* feenableexcept */
#include <fenv.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "core/memory.h"
#include "ernerf/media.h"
#include "io/file.h"
#include "media/ffmpeg.h"
#include "support.h"

enum { SIDE = 32, FRAMES = 5 };

static ern_context *context;

static int set_up(void **state) {
  (void)state;
  context = support_context();
  return 0;
}

static int tear_down(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

static void write_video(const char *path, const ern_video_options *options) {
  static uint8_t rgba[SIDE * SIDE * 4];
  ern_video_writer *writer = NULL;
  unlink(path);
  support_ok(context, ern_video_writer_open(context, path, options, &writer));
  for (int k = 0; k < FRAMES; k++) {
    for (size_t i = 0; i < sizeof rgba; i++) rgba[i] = (uint8_t)(7 * k + (int)(i / 4 % SIDE));
    support_ok(context, ern_video_writer_frame(writer, rgba));
  }
  support_ok(context, ern_video_writer_close(&writer));
}

static unsigned tag_of(const char *path) {
  struct ern_decoder decoder;
  support_ok(context, ern_decoder_open(context, path, AVMEDIA_TYPE_VIDEO, 1, &decoder));
  const unsigned tag = decoder.stream->codecpar->codec_tag;
  ern_decoder_close(&decoder);
  return tag;
}

/* How often `text` is in a file. */
static int times_in(const char *path, const char *text) {
  static unsigned char bytes[1 << 20];
  FILE *file = fopen(path, "rb");
  assert_non_null(file);
  const size_t count = fread(bytes, 1, sizeof bytes, file), length = strlen(text);
  fclose(file);
  int times = 0;
  for (size_t i = 0; i + length <= count; i++) times += memcmp(bytes + i, text, length) == 0;
  return times;
}

/* Gives the box of the pictures a size of 64 bits, as one of 4 GiB has; FFmpeg leaves 8 bytes before it for that. */
static void write_long_size(const char *path) {
  static unsigned char bytes[1 << 20];
  FILE *file = fopen(path, "r+b");
  assert_non_null(file);
  const size_t count = fread(bytes, 1, sizeof bytes, file);
  size_t at = 0;
  while (at + 16 < count && (memcmp(bytes + at,
                                    "\0\0\0\x08"
                                    "free",
                                    8) != 0 ||
                             memcmp(bytes + at + 12, "mdat", 4) != 0))
    at++;
  assert_true(at + 16 < count);
  unsigned char *box = bytes + at, size[4];
  memcpy(size, box + 8, 4);
  memcpy(box, "\0\0\0\x01mdat\0\0\0\0", 12);
  const unsigned longer = (unsigned)(size[0] << 24 | size[1] << 16 | size[2] << 8 | size[3]) + 8;
  for (int i = 0; i < 4; i++) box[12 + i] = (unsigned char)(longer >> (24 - 8 * i));
  rewind(file);
  assert_int_equal(fwrite(bytes, 1, count, file), count);
  fclose(file);
}

/* What a player goes by, and what the file says of itself, are those of the first segment, but for its description. */
static void test_join_keeps_tag_and_provenance(void **state) {
  (void)state;
  const char *const parts[] = {"part.mp4", "part.mp4"};
  ern_provenance made = ern_provenance_default();
  ern_video_options options = ern_video_options_default(SIDE, SIDE);
  made.description = "from 0 s to 1 s";
  options.provenance = &made;
  options.codec = "hevc";
  write_video("part.mp4", &options);
  const int marks = times_in("part.mp4", "AIGC");
  assert_true(marks > 0 && times_in("part.mp4", made.description) == 2);
  for (int k = 0; k < 2; k++) {
    if (k == 1) write_long_size("part.mp4");
    unlink("joined.mp4");
    support_ok(context, ern_video_join(context, "joined.mp4", parts, 2, NULL, 0));
    assert_int_equal(tag_of("joined.mp4"), MKTAG('h', 'v', 'c', '1'));
    assert_int_equal(times_in("joined.mp4", "AIGC"), marks);
    assert_int_equal(times_in("joined.mp4", made.description), 0);
  }
}

static void test_sound_is_checked(void **state) {
  (void)state;
  const char *const parts[] = {"part.mp4"};
  const ern_video_options options = ern_video_options_default(SIDE, SIDE);
  const ern_sound sounds[] = {
      {.rate = 16000, .channels = 1, .frames = 16000}, {.rate = 0, .channels = 1}, {.rate = 16000, .channels = 9}};
  write_video("part.mp4", &options);
  for (size_t i = 0; i < sizeof sounds / sizeof *sounds; i++)
    support_expect(context, ern_video_join(context, "whole.mp4", parts, 1, &sounds[i], 0), ERN_E_ARGUMENT, "whole.mp4",
                   "sound has", NULL);
  assert_int_equal(access("whole.mp4", F_OK), -1);
}

/* Of clicks, the encoder of sound takes logarithms of 0 for what it still holds at the end. */
static void test_host_that_traps(void **state) {
  (void)state;
#if defined __GLIBC__
  static int16_t samples[16000];
  const char *const segments[] = {"traps.mp4"};
  const ern_sound sound = {.rate = 16000, .channels = 1, .frames = 16000, .data = samples};
  ern_video_options options = ern_video_options_default(SIDE, SIDE);
  options.sound = &sound;
  for (int i = 0; i < 16000; i += 1000) samples[i] = 8000;
  feclearexcept(FE_ALL_EXCEPT);
  if (feenableexcept(FE_DIVBYZERO) == -1) skip(); /* processors may have no traps */
  write_video("traps.mp4", &options);
  support_ok(context, ern_video_join(context, "trapped.mp4", segments, 1, &sound, 0));
  const int after = fegetexcept();
  fesetenv(FE_DFL_ENV);
  assert_int_equal(after, FE_DIVBYZERO);
#else
  skip();
#endif
}

/* A list of other files is no segment. */
static void test_lists_are_refused(void **state) {
  (void)state;
  static const char *const segments[] = {"list.mp4"};
  const ern_video_options options = ern_video_options_default(SIDE, SIDE);
  write_video("listed.mp4", &options);
  support_write_text("list.mp4", "ffconcat version 1.0\nfile listed.mp4\n");
  support_expect(context, ern_video_join(context, "of_list.mp4", segments, 1, NULL, 0), ERN_E_FORMAT, "list.mp4",
                 "playlist", NULL);
}

/* The joined file would show the pictures as they are stored. */
static void test_turned(void **state) {
  (void)state;
  const ern_video_options options = ern_video_options_default(SIDE, SIDE);
  const char *const turned[] = {"turned.mp4"};
  uint8_t *bytes = NULL;
  size_t count = 0, at = 0;
  write_video("turned.mp4", &options);
  support_ok(context, ern_file_read(context, "turned.mp4", 1 << 20, &bytes, &count));
  while (at + 80 < count && memcmp(bytes + at, "tkhd", 4) != 0) at++;
  memcpy(bytes + at + 44, "\xff\xff\0\0", 4); /* the first number of the display matrix: -1 */
  support_write("turned.mp4", bytes, count);
  ern_release(context, bytes);
  support_expect(context, ern_video_join(context, "joined.mp4", turned, 1, NULL, 0), ERN_E_FORMAT, "turned.mp4",
                 "turned or mirrored", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_lists_are_refused), cmocka_unit_test(test_join_keeps_tag_and_provenance),
      cmocka_unit_test(test_sound_is_checked), cmocka_unit_test(test_host_that_traps), cmocka_unit_test(test_turned)};
  return cmocka_run_group_tests_name("video_join", tests, set_up, tear_down);
}
