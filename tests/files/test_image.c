/* SPDX-License-Identifier: MIT
 * Pictures: what is written comes back, and what is no picture is refused in words. */
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdbool.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/memory.h"
#include "ernerf/media.h"
#include "io/file.h"
#include "support.h"

static ern_context *context;

static int set_up(void **state) {
  (void)state;
  return ern_context_create(&context, NULL) == ERN_OK ? 0 : -1;
}

static int tear_down(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

static void assert_ok(ern_status status) { support_ok(context, status); }

static ern_image picture(int width, int height, int channels, bool noise) {
  ern_image image = {.width = width, .height = height, .channels = channels};
  const size_t count = (size_t)width * (size_t)height * (size_t)channels;
  assert_ok(ERN_NEW(context, count, &image.data));
  uint32_t seed = 12345;
  for (size_t i = 0; i < count; i++) {
    seed = seed * 1664525u + 1013904223u;
    const size_t pixel = i / (size_t)channels, x = pixel % (size_t)width, y = pixel / (size_t)width;
    const size_t smooth = (x * 3 + y * 2 + (i % (size_t)channels) * 40) / 4;
    image.data[i] = noise ? (uint8_t)(seed >> 24) : (uint8_t)(smooth % 512 < 256 ? smooth % 256 : 255 - smooth % 256);
  }
  return image;
}

static size_t bytes_of(const ern_image *image) {
  return (size_t)image->width * (size_t)image->height * (size_t)image->channels;
}

static double psnr(const ern_image *a, const ern_image *b) {
  double sum = 0;
  for (size_t i = 0; i < bytes_of(a); i++) sum += ((double)a->data[i] - b->data[i]) * ((double)a->data[i] - b->data[i]);
  const double mean = sum / (double)bytes_of(a);
  double decibels = 0; /* 10 log10(255^2/mean), in steps of 0.1 dB: no libm needed */
  for (double left = 255.0 * 255.0 / (mean + 1e-9); left >= 1.0232929922807541; left /= 1.0232929922807541) {
    decibels += 0.1;
  }
  return decibels;
}

static int files_here(void) {
  int count = 0;
  DIR *folder = opendir(".");
  assert_non_null(folder);
  for (const struct dirent *entry = readdir(folder); entry != NULL; entry = readdir(folder)) count++;
  closedir(folder);
  return count;
}

static void test_png_round_trip(void **state) {
  (void)state;
  const int sizes[][2] = {{1, 1}, {3, 5}, {64, 48}, {257, 129}};
  for (size_t i = 0; i < 4; i++) {
    for (int channels = 3; channels <= 4; channels++) {
      ern_image made = picture(sizes[i][0], sizes[i][1], channels, true), read = {0};
      assert_ok(ern_image_write(context, "round.png", &made, 90));
      int width = 0, height = 0;
      assert_ok(ern_image_size(context, "round.png", &width, &height));
      assert_int_equal(width, made.width);
      assert_int_equal(height, made.height);
      assert_ok(ern_image_read(context, "round.png", channels, &read));
      assert_int_equal(read.width, made.width);
      assert_int_equal(read.height, made.height);
      assert_int_equal(read.channels, channels);
      assert_memory_equal(read.data, made.data, bytes_of(&made));
      ern_image_free(context, &made);
      ern_image_free(context, &read);
      assert_null(read.data);
    }
  }
}

/* Every colour under every alpha, 0 included, keeps its bytes. */
static void test_alpha_is_not_multiplied_in(void **state) {
  (void)state;
  ern_image made = picture(256, 256, 4, false), read = {0};
  for (size_t i = 0; i < 256 * 256; i++) {
    made.data[4 * i] = (uint8_t)(i % 256);
    made.data[4 * i + 3] = (uint8_t)(i / 256);
  }
  assert_ok(ern_image_write(context, "alpha.png", &made, 90));
  assert_ok(ern_image_read(context, "alpha.png", 4, &read));
  assert_memory_equal(read.data, made.data, bytes_of(&made));
  ern_image_free(context, &read);
  assert_ok(ern_image_read(context, "alpha.png", 3, &read));
  for (size_t i = 0; i < 256 * 256; i++) assert_memory_equal(read.data + 3 * i, made.data + 4 * i, 3);
  ern_image_free(context, &read);
  ern_image_free(context, &made);
}

/* (200, 100, 50) of alpha 128 in files whose reader multiplies by alpha, or whose format does. The rounding of a
 * product, 0.5, is 1 in the quotient. */
static void test_multiplied_alpha_is_divided(void **state) {
  (void)state;
  static const uint8_t webp[] =
      "RIFF\x1e\0\0\0WEBPVP8L\x11\0\0\0\x2f\x07\xc0\x01\x10\x07\x50\xb2\x22\x57\xa6"
      "\x80\x81\x88\xe8\x7f\0"; /* 8 x 8, lossless */
  static const float rgba[4] = {200.0F / 255 * 128 / 255, 100.0F / 255 * 128 / 255, 50.0F / 255 * 128 / 255,
                                128.0F / 255};
  static const char *const names[] = {"R", "G", "B", "A"}, *const files[] = {"half.webp", "half.exr"};
  static const int expected[4] = {200, 100, 50, 128};
  support_write(files[0], webp, sizeof webp);
  assert_ok(ern_image_write_exr(context, files[1], rgba, 1, 1, 4, names));
  for (int i = 0; i < 2; i++)
    for (int channels = 3; channels <= 4; channels++) {
      ern_image read = {0};
      assert_ok(ern_image_read(context, files[i], channels, &read));
      for (int c = 0; c < channels; c++)
        if (abs(read.data[c] - expected[c]) > 1)
          fail_msg("%s: channel %d is %d, expected %d", files[i], c, read.data[c], expected[c]);
      ern_image_free(context, &read);
    }
}

static void test_missing_channels_are_filled(void **state) {
  (void)state;
  ern_image grey = picture(9, 7, 1, true), colour = picture(9, 7, 3, true), read = {0};
  assert_ok(ern_image_write(context, "grey.png", &grey, 90));
  assert_ok(ern_image_write(context, "colour.png", &colour, 90));
  for (int channels = 3; channels <= 4; channels++) {
    assert_ok(ern_image_read(context, "grey.png", channels, &read));
    for (int i = 0; i < 9 * 7; i++) {
      for (int c = 0; c < channels; c++) assert_int_equal(read.data[i * channels + c], c < 3 ? grey.data[i] : 255);
    }
    ern_image_free(context, &read);
  }
  assert_ok(ern_image_read(context, "colour.png", 4, &read));
  for (size_t i = 0; i < 9 * 7; i++) {
    assert_memory_equal(read.data + 4 * i, colour.data + 3 * i, 3);
    assert_int_equal(read.data[4 * i + 3], 255);
  }
  ern_image_free(context, &read);
  ern_image_free(context, &colour);
  ern_image_free(context, &grey);
}

static void test_jpeg_quality_counts(void **state) {
  (void)state;
  ern_image made = picture(160, 121, 3, false), low = {0}, high = {0}, grey = picture(31, 17, 1, false);
  support_expect(context, ern_image_write(context, "", &made, 20), ERN_E_ARGUMENT, "path", "empty", NULL);
  assert_ok(ern_image_write(context, "low.jpg", &made, 20));
  assert_ok(ern_image_write(context, "high.JPEG", &made, 98));
  assert_ok(ern_image_read(context, "low.jpg", 3, &low));
  assert_ok(ern_image_read(context, "high.JPEG", 3, &high));
  assert_int_equal(high.width, 160);
  assert_int_equal(high.height, 121);
  assert_true(psnr(&made, &high) > 40);
  assert_true(psnr(&made, &low) > 25);
  assert_true(psnr(&made, &high) > psnr(&made, &low) + 3);
  ern_image_free(context, &low);
  assert_ok(ern_image_write(context, "grey.jpg", &grey, 95));
  assert_ok(ern_image_read(context, "grey.jpg", 3, &low));
  for (int i = 0; i < 31 * 17; i++) {
    assert_int_equal(low.data[3 * i], low.data[3 * i + 1]);
    assert_int_equal(low.data[3 * i], low.data[3 * i + 2]);
    assert_in_range(low.data[3 * i] + 8, grey.data[i], grey.data[i] + 16);
  }
  ern_image_free(context, &low);
  ern_image_free(context, &high);
  ern_image_free(context, &grey);
  ern_image_free(context, &made);
}

static void test_same_picture_same_bytes(void **state) {
  (void)state;
  ern_image made = picture(50, 40, 3, true);
  const float depth[6] = {0, 1, 2, 3, 4, 5};
  const char *const name[] = {"Z"};
  uint8_t *first[3], *second;
  size_t counts[3], count;
  const char *const files[] = {"same.png", "same.jpg", "same.exr"};
  for (int pass = 0; pass < 2; pass++) {
    if (pass == 1) sleep(1); /* a time of day in the file would show */
    assert_ok(ern_image_write(context, files[0], &made, 90));
    assert_ok(ern_image_write(context, files[1], &made, 90));
    assert_ok(ern_image_write_exr(context, files[2], depth, 3, 2, 1, name));
    for (int i = 0; i < 3; i++) {
      if (pass == 0) {
        assert_ok(ern_file_read(context, files[i], 1 << 20, &first[i], &counts[i]));
        continue;
      }
      assert_ok(ern_file_read(context, files[i], 1 << 20, &second, &count));
      assert_int_equal(count, counts[i]);
      assert_memory_equal(first[i], second, count);
      ern_release(context, first[i]);
      ern_release(context, second);
    }
  }
  ern_image_free(context, &made);
}

/* Cut anywhere: in the header, in the pixels, before the last marker. */
static void test_cut_short(void **state) {
  (void)state;
  ern_image made = picture(90, 70, 3, true), read = {0};
  const char *const files[] = {"whole.png", "whole.jpg"};
  const char *const cuts[] = {"cut.png", "cut.jpg"};
  for (int i = 0; i < 2; i++) {
    uint8_t *bytes = NULL;
    size_t count = 0;
    assert_ok(ern_image_write(context, files[i], &made, 90));
    assert_ok(ern_file_read(context, files[i], 1 << 20, &bytes, &count));
    const size_t lengths[] = {0, 1, 3, 20, count / 4, count / 2, count * 3 / 4, count - 300, count - 40, count - 20};
    for (size_t j = 0; j < sizeof lengths / sizeof *lengths; j++) {
      support_write(cuts[i], bytes, lengths[j]);
      const ern_status status = ern_image_read(context, cuts[i], 3, &read);
      if (status != ERN_E_FORMAT) {
        fail_msg("%s cut to %zu of %zu: %s", files[i], lengths[j], count, ern_status_name(status));
      }
      assert_null(read.data);
      assert_non_null(strstr(ern_last_error(context), cuts[i]));
    }
    if (i == 1) { /* all but the end marker */
      support_write(cuts[i], bytes, count - 2);
      assert_int_equal(ern_image_read(context, cuts[i], 3, &read), ERN_E_FORMAT);
    }
    ern_release(context, bytes);
  }
  ern_image_free(context, &made);
}

static uint32_t crc32_of(const uint8_t *bytes, size_t count) {
  uint32_t crc = 0xffffffffu;
  for (size_t i = 0; i < count; i++) {
    crc ^= bytes[i];
    for (int bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (crc & 1 ? 0xedb88320u : 0);
  }
  return ~crc;
}

/* A byte other than it was: the checksum tells, and no library prints. */
static void test_damaged_png(void **state) {
  (void)state;
  ern_image made = picture(90, 70, 3, true), read = {0};
  uint8_t *bytes = NULL;
  size_t count = 0;
  struct stat printed;
  assert_ok(ern_image_write(context, "whole.png", &made, 90));
  assert_ok(ern_file_read(context, "whole.png", 1 << 20, &bytes, &count));
  const int before = dup(2), file = open("printed.txt", O_RDWR | O_CREAT | O_TRUNC, 0666);
  assert_int_equal(dup2(file, 2), 2);
  for (size_t at = 16; at < count; at += 97) { /* in IHDR, and in pixels */
    bytes[at] ^= 4;
    support_write("damaged.png", bytes, count);
    bytes[at] ^= 4;
    const ern_status status = ern_image_read(context, "damaged.png", 3, &read);
    if (status != ERN_E_FORMAT && status != ERN_E_SHAPE) fail_msg("byte %zu: %s", at, ern_status_name(status));
    assert_null(read.data);
  }
  dup2(before, 2);
  assert_true(fstat(file, &printed) == 0 && printed.st_size == 0);
  close(before);
  close(file);
  assert_non_null(strstr(ern_last_error(context), "damaged.png: PNG is damaged: the chunk at byte "));
  ern_release(context, bytes);
  ern_image_free(context, &made);
}

/* Writes `to`: the file `from` with that EXIF orientation, in the segment APP1 of a JPEG or the chunk eXIf of a PNG. */
static void add_orientation(const char *from, const char *to, int orientation) {
  uint8_t tiff[] = {'M', 'M', 0, 42, 0, 0, 0, 8, 0, 1, 1, 0x12, 0, 3, 0, 0, 0, 1, 0, (uint8_t)orientation,
                    0,   0,   0, 0,  0, 0};
  static const uint8_t segment[] = {0xff, 0xe1, 0, 8 + sizeof tiff, 'E', 'x', 'i', 'f', 0, 0};
  uint8_t chunk[12 + sizeof tiff] = {0, 0, 0, sizeof tiff, 'e', 'X', 'I', 'f'};
  uint8_t *bytes = NULL;
  size_t count = 0;
  assert_ok(ern_file_read(context, from, 1 << 20, &bytes, &count));
  const bool jpeg = bytes[0] == 0xff;
  const size_t place = jpeg ? 2 : 33; /* after the marker SOI, or signature and IHDR */
  memcpy(chunk + 8, tiff, sizeof tiff);
  const uint32_t crc = crc32_of(chunk + 4, 4 + sizeof tiff);
  for (int k = 0; k < 4; k++) chunk[8 + sizeof tiff + (size_t)k] = (uint8_t)(crc >> (24 - 8 * k));
  FILE *file = fopen(to, "wb");
  assert_non_null(file);
  fwrite(bytes, 1, place, file);
  if (jpeg) fwrite(segment, 1, sizeof segment, file);
  fwrite(jpeg ? tiff : chunk, 1, jpeg ? sizeof tiff : sizeof chunk, file);
  fwrite(bytes + place, 1, count - place, file);
  assert_int_equal(fclose(file), 0);
  ern_release(context, bytes);
}

/* A picture whose quarters are red, green, blue and white, in each orientation of EXIF's definition. */
static void test_orientation(void **state) {
  (void)state;
  enum { WIDE = 32, HIGH = 16 };
  static const uint8_t colours[4][4] = {{255, 0, 0, 255}, {0, 255, 0, 255}, {0, 0, 255, 255}, {255, 255, 255, 255}};
  /* which quarter of the stored ones (left top, right top, left bottom, right bottom) is shown at each place */
  static const int shown[][4] = {{0, 1, 2, 3}, {0, 1, 2, 3}, {1, 0, 3, 2}, {3, 2, 1, 0}, {2, 3, 0, 1},
                                 {0, 2, 1, 3}, {2, 0, 3, 1}, {3, 1, 2, 0}, {1, 3, 0, 2}, {0, 1, 2, 3}};
  ern_image made = picture(WIDE, HIGH, 3, false), read = {0};
  for (int i = 0; i < WIDE * HIGH; i++)
    memcpy(made.data + 3 * i, colours[(i / WIDE >= HIGH / 2) * 2 + (i % WIDE >= WIDE / 2)], 3);
  assert_ok(ern_image_write(context, "lying.png", &made, 100));
  assert_ok(ern_image_write(context, "lying.jpg", &made, 100));
  for (int orientation = 0; orientation <= 9; orientation++) /* 0 and 9 are none */
    for (int k = 0; k < 4; k++) {
      const char *name = k < 2 ? "turned.png" : "turned.jpg";
      const int channels = 3 + k % 2;
      int width = 0, height = 0;
      add_orientation(k < 2 ? "lying.png" : "lying.jpg", name, orientation);
      assert_ok(ern_image_size(context, name, &width, &height));
      assert_ok(ern_image_read(context, name, channels, &read));
      const bool upright = orientation < 5 || orientation > 8;
      assert_int_equal(width, upright ? WIDE : HIGH);
      assert_int_equal(height, upright ? HIGH : WIDE);
      assert_true(read.width == width && read.height == height && read.channels == channels);
      for (int place = 0; place < 4; place++) {
        const int x = place % 2 * (width - 1), y = place / 2 * (height - 1);
        for (int c = 0; c < channels; c++) {
          const int found = read.data[channels * (y * width + x) + c];
          const int expected = colours[shown[orientation][place]][c];
          if (abs(found - expected) > 8)
            fail_msg("%s, orientation %d, corner %d, channel %d: %d, expected %d", name, orientation, place, c, found,
                     expected);
        }
      }
      ern_image_free(context, &read);
    }
  ern_image_free(context, &made);
}

/* A PNG whose header claims 100000 x 100000 and has next to no data. */
static void test_claimed_size_is_refused(void **state) {
  (void)state;
  uint8_t png[] = {0x89, 'P', 'N',  'G',  13, 10, 26, 10, 0, 0, 0,   13,  'I', 'H', 'D',  'R',  0,    1,   0x86, 0xa0,
                   0,    1,   0x86, 0xa0, 8,  2,  0,  0,  0, 0, 0,   0,   0,   0,   0,    0,    1,    'I', 'D',  'A',
                   'T',  0,   0,    0,    0,  0,  0,  0,  0, 0, 'I', 'E', 'N', 'D', 0xae, 0x42, 0x60, 0x82};
  const struct { uint8_t high, middle, low; } sides[] = {{1, 0x86, 0xa0}, {0, 0x20, 1}};
  for (size_t i = 0; i < 2; i++) { /* 100000 and 8193 */
    png[17] = png[21] = sides[i].high;
    png[18] = png[22] = sides[i].middle;
    png[19] = png[23] = sides[i].low;
    const uint32_t crc = crc32_of(png + 12, 17);
    for (int k = 0; k < 4; k++) png[29 + k] = (uint8_t)(crc >> (24 - 8 * k));
    support_write("huge.png", png, sizeof png);
    ern_image read = {0};
    int width = 0, height = 0;
    assert_int_equal(ern_image_read(context, "huge.png", 3, &read), ERN_E_SHAPE);
    assert_non_null(strstr(ern_last_error(context), i == 0 ? "100000" : "8193"));
    assert_null(read.data);
    assert_int_equal(ern_image_size(context, "huge.png", &width, &height), ERN_E_SHAPE);
  }
}

static void test_no_picture(void **state) {
  (void)state;
  ern_image read = {0};
  int width = 1, height = 1;
  support_write("text.png", "this is a text, no picture\n", 27);
  support_write("text.jpg", "this is a text, no picture\n", 27);
  support_write("text.txt", "this is a text, no picture\n", 27);
  mkdir("folder.png", 0777);
  unlink("pipe.png");
  assert_int_equal(mkfifo("pipe.png", 0666), 0);
  assert_int_equal(ern_image_read(context, "text.png", 3, &read), ERN_E_FORMAT);
  assert_int_equal(ern_image_read(context, "text.jpg", 3, &read), ERN_E_FORMAT);
  assert_int_equal(ern_image_read(context, "text.txt", 3, &read), ERN_E_FORMAT);
  assert_int_equal(ern_image_size(context, "text.png", &width, &height), ERN_E_FORMAT);
  assert_int_equal(width, 0);
  assert_int_equal(ern_image_read(context, "nothing.png", 3, &read), ERN_E_MISSING);
  assert_non_null(strstr(ern_last_error(context), "nothing.png"));
  assert_int_equal(ern_image_read(context, "folder.png", 3, &read), ERN_E_IO);
  assert_int_equal(ern_image_read(context, "pipe.png", 3, &read), ERN_E_IO);
  assert_int_equal(ern_image_read(context, "text.png", 2, &read), ERN_E_ARGUMENT);
  assert_null(read.data);
}

/* The content counts, not the name; and names with odd letters are names. */
static void test_odd_names(void **state) {
  (void)state;
  ern_image made = picture(12, 10, 3, true), read = {0};
  const char *const names[] = {"a b.png", "what?x=1.png", "50%d#.png", "wei\xc3\x9f.png", "p?.png"};
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    assert_ok(ern_image_write(context, names[i], &made, 90));
    assert_ok(ern_image_read(context, names[i], 3, &read));
    assert_memory_equal(read.data, made.data, bytes_of(&made));
    ern_image_free(context, &read);
  }
  assert_true(mkdir("a?b.c", 0777) == 0 || errno == EEXIST);
  for (int i = 0; i < 2; i++) {
    const char *name = i == 0 ? "what?x=1.jpg" : "a?b.c/still.jpg";
    assert_ok(ern_image_write(context, name, &made, 100));
    assert_ok(ern_image_read(context, name, 3, &read));
    assert_true(read.width == made.width && read.height == made.height);
    ern_image_free(context, &read);
  }
  assert_int_equal(rename("a b.png", "png.jpg"), 0);
  assert_ok(ern_image_read(context, "png.jpg", 3, &read));
  assert_memory_equal(read.data, made.data, bytes_of(&made));
  ern_image_free(context, &read);
  ern_image_free(context, &made);
}

static void test_exr_round_trip(void **state) {
  (void)state;
  float data[5 * 4 * 5];
  const char *const names[] = {"R", "G", "B", "A", "Z"};
  for (int i = 0; i < 5 * 4; i++) {
    for (int c = 0; c < 5; c++) data[5 * i + c] = c == 3 ? 1.0f : (float)(i * 10 + c) / 200.0f;
  }
  assert_ok(ern_image_write_exr(context, "five.exr", data, 5, 4, 5, names));
  ern_image read = {0};
  assert_ok(ern_image_read(context, "five.exr", 4, &read));
  assert_int_equal(read.width, 5);
  assert_int_equal(read.height, 4);
  for (int i = 0; i < 5 * 4; i++) {
    for (int c = 0; c < 4; c++) {
      const int expected = (int)(data[5 * i + c] * 255.0f + 0.5f);
      assert_int_equal(read.data[4 * i + c], expected > 255 ? 255 : expected);
    }
  }
  ern_image_free(context, &read);
  const char *const twice[] = {"R", "R"};
  assert_int_equal(ern_image_write_exr(context, "twice.exr", data, 5, 4, 2, twice), ERN_E_ARGUMENT);
  assert_int_equal(access("twice.exr", F_OK), -1);
}

static void test_refused_writes_leave_nothing(void **state) {
  (void)state;
  ern_image made = picture(64, 64, 3, true), alpha = picture(4, 4, 4, true);
  const int before = files_here();
  assert_int_equal(ern_image_write(context, "no/such/folder/a.png", &made, 90), ERN_E_MISSING);
  assert_int_equal(ern_image_write(context, "a.gif", &made, 90), ERN_E_ARGUMENT);
  assert_int_equal(ern_image_write(context, "png", &made, 90), ERN_E_ARGUMENT);
  assert_int_equal(ern_image_write(context, "a.jpg", &made, 0), ERN_E_ARGUMENT);
  assert_int_equal(ern_image_write(context, "a.jpg", &made, 101), ERN_E_ARGUMENT);
  assert_int_equal(ern_image_write(context, "a.jpg", &alpha, 90), ERN_E_ARGUMENT);
  ern_image wrong = made;
  wrong.channels = 2;
  assert_int_equal(ern_image_write(context, "a.png", &wrong, 90), ERN_E_ARGUMENT);
  wrong = made;
  wrong.width = ERN_IMAGE_MAX_SIDE + 1;
  assert_int_equal(ern_image_write(context, "a.png", &wrong, 90), ERN_E_SHAPE);
  assert_int_equal(files_here(), before);
  if (geteuid() != 0) { /* root may write anywhere */
    rmdir("locked");
    assert_int_equal(mkdir("locked", 0500), 0);
    assert_int_equal(ern_image_write(context, "locked/a.png", &made, 90), ERN_E_IO);
  }
  ern_image_free(context, &alpha);
  ern_image_free(context, &made);
}

/* A full disk, played by the limit of a file's size: the old file stays, no half one appears. */
static void test_full_disk(void **state) {
  (void)state;
  ern_image made = picture(64, 64, 3, true), read = {0};
  assert_ok(ern_image_write(context, "kept.png", &made, 90));
  const int before = files_here();
  struct rlimit old, small;
  assert_int_equal(getrlimit(RLIMIT_FSIZE, &old), 0);
  small = (struct rlimit){.rlim_cur = 1024, .rlim_max = old.rlim_max};
  assert_int_equal(setrlimit(RLIMIT_FSIZE, &small), 0);
  const ern_status status = ern_image_write(context, "kept.png", &made, 90);
  assert_int_equal(setrlimit(RLIMIT_FSIZE, &old), 0);
  assert_int_equal(status, ERN_E_IO);
  assert_int_equal(files_here(), before);
  assert_ok(ern_image_read(context, "kept.png", 3, &read));
  assert_memory_equal(read.data, made.data, bytes_of(&made));
  ern_image_free(context, &read);
  ern_image_free(context, &made);
}

static void test_resize_is_the_area_average(void **state) {
  (void)state;
  /* 4 x 2 -> 2 x 1: means of 2 x 2 */
  uint8_t four[] = {0, 10, 100, 200, 20, 30, 104, 204};
  const ern_image small = {.width = 4, .height = 2, .channels = 1, .data = four};
  ern_image resized = {0};
  assert_ok(ern_image_resize(context, &small, 2, 1, &resized));
  assert_int_equal(resized.data[0], (0 + 10 + 20 + 30) / 4);
  assert_int_equal(resized.data[1], (100 + 200 + 104 + 204) / 4);
  ern_image_free(context, &resized);
  /* 3 x 1 -> 2 x 1, two channels that differ, RGBA: (a + b/2)/1.5, (b/2 + c)/1.5 */
  uint8_t three[] = {30, 3, 0, 255, 60, 6, 0, 255, 120, 12, 0, 0};
  const ern_image row = {.width = 3, .height = 1, .channels = 4, .data = three};
  assert_ok(ern_image_resize(context, &row, 2, 1, &resized));
  const int expected[] = {40, 4, 0, 255, 100, 10, 0, 85};
  assert_int_equal(resized.channels, 4);
  for (int i = 0; i < 8; i++) assert_int_equal(resized.data[i], expected[i]);
  ern_image_free(context, &resized);
  /* the same size is the same picture */
  assert_ok(ern_image_resize(context, &small, 4, 2, &resized));
  assert_memory_equal(resized.data, four, sizeof four);
  ern_image_free(context, &resized);
  assert_int_equal(ern_image_resize(context, &small, 0, 2, &resized), ERN_E_SHAPE);
  assert_int_equal(ern_image_resize(context, &small, 4, ERN_IMAGE_MAX_SIDE + 1, &resized), ERN_E_SHAPE);
  assert_null(resized.data);
}

static void test_real_pictures(void **state) {
  (void)state;
  char path[1024];
  ern_image background = {0}, torso = {0}, again = {0};
  support_shared("real/presenter/bc.jpg", path);
  assert_ok(ern_image_read(context, path, 3, &background));
  assert_int_equal(background.width, 472);
  assert_int_equal(background.height, 472);
  const uint8_t *middle = background.data + 3 * (236 * 472 + 236);
  assert_true(middle[1] > middle[0] && middle[1] > middle[2]); /* a green screen */
  support_shared("real/presenter/torso_imgs/46.png", path);
  assert_ok(ern_image_read(context, path, 4, &torso));
  size_t clear = 0, solid = 0;
  for (size_t i = 0; i < 472 * 472; i++) {
    clear += torso.data[4 * i + 3] == 0;
    solid += torso.data[4 * i + 3] == 255;
  }
  assert_true(clear > 1000 && solid > 1000);
  assert_ok(ern_image_write(context, "torso.png", &torso, 90));
  assert_ok(ern_image_read(context, "torso.png", 4, &again));
  assert_memory_equal(again.data, torso.data, bytes_of(&torso));
  ern_image_free(context, &again);
  ern_image_free(context, &torso);
  ern_image_free(context, &background);
}

int main(void) {
  signal(SIGXFSZ, SIG_IGN);
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_png_round_trip),
      cmocka_unit_test(test_alpha_is_not_multiplied_in),
      cmocka_unit_test(test_multiplied_alpha_is_divided),
      cmocka_unit_test(test_missing_channels_are_filled),
      cmocka_unit_test(test_jpeg_quality_counts),
      cmocka_unit_test(test_same_picture_same_bytes),
      cmocka_unit_test(test_cut_short),
      cmocka_unit_test(test_damaged_png),
      cmocka_unit_test(test_orientation),
      cmocka_unit_test(test_claimed_size_is_refused),
      cmocka_unit_test(test_no_picture),
      cmocka_unit_test(test_odd_names),
      cmocka_unit_test(test_exr_round_trip),
      cmocka_unit_test(test_refused_writes_leave_nothing),
      cmocka_unit_test(test_full_disk),
      cmocka_unit_test(test_resize_is_the_area_average),
      cmocka_unit_test(test_real_pictures),
  };
  return cmocka_run_group_tests_name("image", tests, set_up, tear_down);
}
