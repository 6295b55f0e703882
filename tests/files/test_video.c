/* SPDX-License-Identifier: MIT
 * Videos: what is written is decoded again and compared, picture by picture and sample by sample. */
#include <dirent.h>
#include <math.h>
#include <signal.h>
#include <stdbool.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/memory.h"
#include "ernerf/media.h"
#include "io/file.h"
#include "media/ffmpeg.h"
#include "support.h"

static const double pi = 3.14159265358979323846;
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

static void *allocate(size_t bytes) {
  void *memory = ern_allocate(context, bytes, 1);
  assert_non_null(memory);
  return memory;
}

/* A moving pattern of soft waves, each channel its own; alpha is noise, which must not matter. */
static void draw(uint8_t *rgba, int width, int height, int k) {
  for (int y = 0; y < height; y++) {
    for (int x = 0; x < width; x++, rgba += 4) {
      rgba[0] = (uint8_t)(127.5 + 100 * sin(0.11 * (x + 3 * k)) * cos(0.07 * y));
      rgba[1] = (uint8_t)(127.5 + 100 * sin(0.05 * (y - 2 * k) + 0.03 * x));
      rgba[2] = (uint8_t)(127.5 + 100 * cos(0.06 * (x + y + k)));
      rgba[3] = (uint8_t)(x * 31 + y * 17 + k);
    }
  }
}

/* Two tones under a slow, irregular envelope: no shift of a few ms looks like another. */
static ern_sound tones(int rate, int channels, double seconds) {
  const size_t frames = (size_t)(seconds * rate + 0.5);
  ern_sound sound = {.rate = rate, .channels = channels, .frames = frames};
  sound.data = allocate(frames * (size_t)channels * 2 + 1);
  for (size_t i = 0; i < frames; i++) {
    const double t = (double)i / rate, envelope = 0.5 + 0.3 * sin(2 * pi * 3.1 * t) + 0.2 * sin(2 * pi * 7.7 * t + 1);
    for (int c = 0; c < channels; c++) {
      const double tone = sin(2 * pi * (310 + 90 * c) * t) + 0.6 * sin(2 * pi * (1170 + 130 * c) * t);
      sound.data[i * (size_t)channels + (size_t)c] = (int16_t)lrint(9000 * envelope * tone);
    }
  }
  return sound;
}

static int files_in(const char *path) {
  int count = 0;
  DIR *folder = opendir(path);
  assert_non_null(folder);
  for (const struct dirent *entry = readdir(folder); entry != NULL; entry = readdir(folder)) count++;
  closedir(folder);
  return count;
}

static void write_video(const char *path, const ern_video_options *options, int frames) {
  ern_video_writer *writer = NULL;
  uint8_t *rgba = allocate((size_t)options->width * (size_t)options->height * 4);
  support_ok(context, ern_video_writer_open(context, path, options, &writer));
  for (int k = 0; k < frames; k++) {
    draw(rgba, options->width, options->height, k);
    support_ok(context, ern_video_writer_frame(writer, rgba));
  }
  support_ok(context, ern_video_writer_close(&writer));
  assert_null(writer);
  ern_release(context, rgba);
}

/* Decodes `path`, checks count and times exactly, and returns the lowest PSNR of a frame in dB. */
static double compare_video(const char *path, const ern_video_options *options, int frames, ern_video_info *info) {
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  double seconds = -1, lowest = 1e9;
  bool end = false;
  const int width = options->width, height = options->height;
  uint8_t *rgba = allocate((size_t)width * (size_t)height * 4);
  support_ok(context, ern_video_reader_open(context, path, &reader));
  ern_video_reader_info(reader, info);
  assert_int_equal(info->width, width + width % 2);
  assert_int_equal(info->height, height + height % 2);
  for (int k = 0;; k++) {
    const uint8_t *before = image.data;
    support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
    if (end) {
      assert_int_equal(k, frames);
      break;
    }
    if (k > 0) assert_ptr_equal(image.data, before); /* the buffer is used again */
    const double expected = (double)k * options->rate_denominator / options->rate_numerator;
    assert_true(fabs(seconds - expected) < 1e-12 * (1 + expected));
    draw(rgba, width, height, k);
    double sum = 0;
    for (int y = 0; y < image.height; y++) { /* padding is the last row and column again */
      for (int x = 0; x < image.width; x++) {
        const int from_x = x < width ? x : width - 1, from_y = y < height ? y : height - 1;
        const uint8_t *from = rgba + 4 * (from_y * width + from_x), *to = image.data + 3 * (y * image.width + x);
        for (int c = 0; c < 3; c++) sum += (from[c] - to[c]) * (from[c] - to[c]);
      }
    }
    const double psnr = 10 * log10(255.0 * 255.0 / (sum / (3.0 * image.width * image.height) + 1e-9));
    if (psnr < lowest) lowest = psnr;
  }
  support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end)); /* the end stays the end */
  assert_true(end);
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
  assert_null(reader);
  ern_release(context, rgba);
  return lowest;
}

/* Time of the first sample of the sound, as a player sees it. */
static double start_of_sound(const char *path) {
  struct ern_decoder decoder;
  bool end = false;
  support_ok(context, ern_decoder_open(context, path, AVMEDIA_TYPE_AUDIO, 1, &decoder));
  support_ok(context, ern_decoder_next(&decoder, &end));
  assert_false(end);
  const double start = (double)decoder.frame->best_effort_timestamp * av_q2d(decoder.stream->time_base);
  ern_decoder_close(&decoder);
  return start;
}

static double at(const ern_sound *sound, double seconds, int channel) {
  const double place = seconds * sound->rate, low = floor(place), part = place - low;
  if (low < 0 || low + 1 >= (double)sound->frames) return 0;
  const int16_t *data = sound->data + (size_t)low * (size_t)sound->channels + channel;
  return (1 - part) * data[0] + part * data[sound->channels];
}

/* The shift in ms that matches `heard` best to `made` from `start` seconds on, and that match's correlation. */
static double shift_of(const ern_sound *made, double start, const ern_sound *heard, int channel, double *correlation) {
  double best = -2, best_shift = 0;
  const double length = (double)heard->frames / heard->rate;
  for (double shift = -30; shift <= 30; shift += 0.125) {
    double ab = 0, aa = 0, bb = 0;
    for (double t = 0.04; t < length - 0.04; t += 1.0 / 8000) {
      const double a = at(made, start + t, channel), b = at(heard, t + shift / 1000, channel);
      ab += a * b;
      aa += a * a;
      bb += b * b;
    }
    const double match = ab / (sqrt(aa * bb) + 1e-9);
    if (match > best) {
      best = match;
      best_shift = shift;
    }
  }
  *correlation = best;
  return best_shift;
}

static void check_sound(const char *path, const ern_sound *made, double start, double length) {
  ern_sound heard = {0};
  support_ok(context, ern_sound_read(context, path, &heard));
  assert_int_equal(heard.channels, made->channels);
  const double found = (double)heard.frames / heard.rate;
  if (fabs(found - length) > 1.01 / heard.rate) fail_msg("%s: sound of %.6f s, expected %.6f", path, found, length);
  assert_true(fabs(start_of_sound(path)) < 1e-9);
  /* the channel for low tones, in FFmpeg's usual order of that many channels: AAC keeps nothing else of it */
  const int low_tones = made->channels == 3 ? 2 : made->channels >= 6 ? 3 : -1;
  for (int c = 0; c < made->channels; c++) {
    if (c == low_tones) continue;
    double correlation = 0;
    const double shift = shift_of(made, start, &heard, c, &correlation);
    if (fabs(shift) > 0.2) fail_msg("%s: channel %d is %g ms late", path, c, shift);
    if (correlation < 0.98) fail_msg("%s: channel %d correlates by %g", path, c, correlation);
  }
  ern_sound_free(context, &heard);
}

static void test_odd_size_and_sound(void **state) {
  (void)state;
  ern_sound sound = tones(16000, 1, 5);
  ern_video_options options = ern_video_options_default(161, 119);
  assert_int_equal(options.rate_numerator, 25);
  assert_int_equal(options.rate_denominator, 1);
  assert_int_equal(options.crf, 15);
  assert_null(options.sound);
  options.sound = &sound;
  write_video("odd.mp4", &options, 60);
  ern_video_info info;
  const double psnr = compare_video("odd.mp4", &options, 60, &info);
  if (psnr < 36) fail_msg("a frame has %.2f dB", psnr);
  assert_true(fabs(info.duration - 60 / 25.0) < 1e-3);
  assert_int_equal(info.rate_numerator, 25);
  assert_int_equal(info.rate_denominator, 1);
  assert_string_equal(info.video_codec, "h264");
  assert_string_equal(info.pixel_format, "yuv420p");
  assert_string_equal(info.sound_codec, "aac");
  assert_true(info.has_sound);
  assert_int_equal(info.sound_rate, 16000);
  assert_int_equal(info.sound_channels, 1);
  check_sound("odd.mp4", &sound, 0, 60 / 25.0);
  ern_sound_free(context, &sound);
}

static void test_sounds_long(void **state) {
  (void)state;
  const struct {
    int rate, channels, kept_rate;
    double seconds, start, length; /* pictures: 1 s */
  } cases[] = {{48000, 2, 48000, 3, 0.5, 1},    {44100, 1, 44100, 0.6, 0, 0.6},  {44100, 2, 44100, 1.3, 0.777, 0.523},
               {10000, 1, 11025, 2, 0.2, 1},    {192000, 2, 96000, 1.5, 0.1, 1}, {48000, 6, 48000, 2, 0, 1},
               {16000, 7, 16000, 2, 0, 1},      {22050, 1, 22050, 2, 0.0123, 1}, {16000, 3, 16000, 2, 1.0 / 3, 1},
               {16000, 8, 16000, 0.05, 0, 0.05}};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    ern_sound sound = tones(cases[i].rate, cases[i].channels, cases[i].seconds);
    ern_video_options options = ern_video_options_default(64, 48);
    ern_video_info info;
    options.sound = &sound;
    options.sound_start = cases[i].start;
    write_video("sound.mp4", &options, 25);
    assert_true(compare_video("sound.mp4", &options, 25, &info) > 30);
    assert_true(info.has_sound);
    assert_int_equal(info.sound_rate, cases[i].kept_rate);
    assert_int_equal(info.sound_channels, cases[i].channels);
    assert_true(fabs(info.duration - 1) < 2e-3);
    const bool same_rate = cases[i].kept_rate == cases[i].rate;
    if (cases[i].length > 0.1) {
      check_sound("sound.mp4", &sound, cases[i].start, same_rate || cases[i].length == 1 ? cases[i].length : 0);
    }
    ern_sound_free(context, &sound);
  }
}

static void test_silent(void **state) {
  (void)state;
  ern_video_options options = ern_video_options_default(64, 64);
  ern_video_info info;
  ern_sound unread = {0}, sound = tones(16000, 1, 1);
  write_video("silent.mp4", &options, 3);
  assert_true(compare_video("silent.mp4", &options, 3, &info) > 30);
  assert_false(info.has_sound);
  support_expect(context, ern_sound_read(context, "silent.mp4", &unread), ERN_E_FORMAT, "silent.mp4", "no sound", NULL);
  options.sound = &sound; /* nothing of it is left at 1 s */
  options.sound_start = 1;
  write_video("late.mp4", &options, 3);
  assert_true(compare_video("late.mp4", &options, 3, &info) > 30);
  assert_false(info.has_sound);
  ern_sound_free(context, &sound);
}

static void test_sizes_and_rates(void **state) {
  (void)state;
  const struct {
    int width, height, numerator, denominator, frames;
  } cases[] = {{1, 1, 25, 1, 2},       {2, 3, 50, 2, 4},    {33, 17, 30000, 1001, 40}, {450, 450, 25, 1, 3},
               {62, 34, 1000, 33, 12}, {16, 16, 1, 2, 3},   {18, 20, 240, 1, 5},       {48, 40, 999983, 39979, 30},
               {16, 16, 1, 100, 3},    {16, 16, 1000, 1, 9}};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    ern_video_options options = ern_video_options_default(cases[i].width, cases[i].height);
    ern_video_info info;
    options.rate_numerator = cases[i].numerator;
    options.rate_denominator = cases[i].denominator;
    write_video("size.mp4", &options, cases[i].frames);
    assert_true(compare_video("size.mp4", &options, cases[i].frames, &info) > 30);
    const double duration = (double)cases[i].frames * cases[i].denominator / cases[i].numerator;
    if (fabs(info.duration - duration) > 2e-3) fail_msg("case %zu: %g s, expected %g", i, info.duration, duration);
  }
}

static void test_pixel_aspect(void **state) {
  (void)state;
  static const char *const paths[] = {"wide.mp4", "wide.mov", "wide.mkv", "wide.webm"};
  for (size_t i = 0; i < sizeof paths / sizeof *paths; i++) {
    ern_video_options options = ern_video_options_default(48, 32);
    ern_video_info info;
    options.pixel_aspect = 64.0 / 45;
    write_video(paths[i], &options, 2);
    (void)compare_video(paths[i], &options, 2, &info);
    if (fabs(info.pixel_aspect - 64.0 / 45) > 0.02) fail_msg("%s: %g", paths[i], info.pixel_aspect);
  }
}

/* Times in a gif are in 1/100 s: more frames would have equal times. */
static void test_gif_has_100_frames_a_second_at_most(void **state) {
  (void)state;
  ern_video_options options = ern_video_options_default(16, 16);
  ern_video_writer *writer = NULL;
  options.rate_numerator = 101;
  support_expect(context, ern_video_writer_open(context, "fast.gif", &options, &writer), ERN_E_ARGUMENT, "fast.gif",
                 "101 frames a second", "100", NULL);
  assert_int_equal(access("fast.gif", F_OK), -1);
  options.rate_numerator = 100;
  write_video("fast.gif", &options, 9);
}

/* Opus has layouts of 1 to 8 channels, of which FFmpeg's usual one of 3 and of 4 is none. */
static void test_webm_has_each_number_of_channels(void **state) {
  (void)state;
  for (int channels = 1; channels <= 8; channels++) {
    ern_sound sound = tones(16000, channels, 0.4), kept = {0};
    ern_video_options options = ern_video_options_default(16, 16);
    options.sound = &sound;
    write_video("sound.webm", &options, 10);
    support_ok(context, ern_sound_read(context, "sound.webm", &kept));
    assert_int_equal(kept.channels, channels);
    ern_sound_free(context, &sound);
    ern_sound_free(context, &kept);
  }
}

/* Saturated colours come back as themselves only where both sides use the BT.709 matrix and limited range. */
static void test_colours(void **state) {
  (void)state;
  static const uint8_t colours[][3] = {{255, 0, 0}, {0, 255, 0},   {0, 0, 255},    {255, 255, 255},
                                       {0, 0, 0},   {255, 255, 0}, {128, 128, 128}};
  /* Y'CbCr of BT.709, limited range: 16 + 219 Y, 128 + 224 Cb, 128 + 224 Cr, rounded by hand */
  static const uint8_t expected[][3] = {{63, 102, 240}, {173, 42, 26},  {32, 240, 118}, {235, 128, 128},
                                        {16, 128, 128}, {219, 16, 138}, {126, 128, 128}};
  ern_video_options options = ern_video_options_default(64, 64);
  options.crf = 1;
  for (size_t i = 0; i < sizeof colours / sizeof *colours; i++) {
    ern_video_writer *writer = NULL;
    ern_video_reader *reader = NULL;
    uint8_t *rgba = allocate(64 * 64 * 4);
    for (size_t k = 0; k < 64 * 64; k++) memcpy(rgba + 4 * k, colours[i], 3);
    support_ok(context, ern_video_writer_open(context, "colour.mp4", &options, &writer));
    support_ok(context, ern_video_writer_frame(writer, rgba));
    support_ok(context, ern_video_writer_close(&writer));
    ern_image image = {0};
    double seconds = 0;
    bool end = false;
    support_ok(context, ern_video_reader_open(context, "colour.mp4", &reader));
    support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
    for (size_t k = 0; k < 64 * 64; k++) {
      for (int c = 0; c < 3; c++) assert_true(abs(image.data[3 * k + (size_t)c] - colours[i][c]) <= 3);
    }
    ern_video_reader_free(&reader);
    struct ern_decoder decoder;
    support_ok(context, ern_decoder_open(context, "colour.mp4", AVMEDIA_TYPE_VIDEO, 1, &decoder));
    support_ok(context, ern_decoder_next(&decoder, &end));
    assert_int_equal(decoder.frame->colorspace, AVCOL_SPC_BT709);
    assert_int_equal(decoder.frame->color_primaries, AVCOL_PRI_BT709);
    assert_int_equal(decoder.frame->color_trc, AVCOL_TRC_BT709);
    assert_int_equal(decoder.frame->color_range, AVCOL_RANGE_MPEG);
    for (int p = 0; p < 3; p++) {
      const int side = p == 0 ? 64 : 32;
      const uint8_t found = decoder.frame->data[p][side / 2 * decoder.frame->linesize[p] + side / 2];
      if (abs(found - expected[i][p]) > 1)
        fail_msg("colour %zu, plane %d: %d, expected %d", i, p, found, expected[i][p]);
    }
    ern_decoder_close(&decoder);
    ern_image_free(context, &image);
    ern_release(context, rgba);
  }
}

static void test_quality_counts(void **state) {
  (void)state;
  ern_video_options options = ern_video_options_default(128, 128);
  ern_video_info info;
  struct stat good, bad;
  options.crf = 10;
  write_video("good.mp4", &options, 20);
  const double high = compare_video("good.mp4", &options, 20, &info);
  options.crf = 45;
  write_video("bad.mp4", &options, 20);
  const double low = compare_video("bad.mp4", &options, 20, &info);
  assert_true(high > low + 3);
  assert_int_equal(stat("good.mp4", &good), 0);
  assert_int_equal(stat("bad.mp4", &bad), 0);
  assert_true(good.st_size > 2 * bad.st_size);
}

static void test_nothing_is_left_behind(void **state) {
  (void)state;
  ern_video_options options = ern_video_options_default(64, 64);
  ern_video_writer *writer = NULL;
  uint8_t *rgba = allocate(64 * 64 * 4);
  mkdir("place", 0777);
  mkdir("place/folder.mp4", 0777);
  unlink("place/a.mp4");
  const int before = files_in("place");
  support_ok(context, ern_video_writer_open(context, "place/a.mp4", &options, &writer));
  for (int k = 0; k < 70; k++) support_ok(context, ern_video_writer_frame(writer, rgba));
  assert_int_equal(access("place/a.mp4", F_OK), -1); /* not seen before its time */
  ern_video_writer_abandon(&writer);
  assert_null(writer);
  ern_video_writer_abandon(&writer);
  ern_video_writer_abandon(NULL);
  assert_int_equal(files_in("place"), before);
  support_ok(context, ern_video_writer_open(context, "place/a.mp4", &options, &writer));
  support_expect(context, ern_video_writer_close(&writer), ERN_E_STATE, "a.mp4", "0 frames", NULL);
  assert_null(writer);
  assert_int_equal(files_in("place"), before);
  support_expect(context, ern_video_writer_open(context, "place/no/a.mp4", &options, &writer), ERN_E_MISSING, "a.mp4",
                 NULL);
  support_expect(context, ern_video_writer_open(context, "place/folder.mp4", &options, &writer), ERN_E_IO, "folder",
                 NULL);
  assert_null(writer);
  ern_video_options wrong = options;
  wrong.width = 0;
  assert_int_equal(ern_video_writer_open(context, "place/a.mp4", &wrong, &writer), ERN_E_SHAPE);
  wrong = options;
  for (int denominator = -1; denominator <= 0; denominator++) {
    wrong.rate_denominator = denominator;
    assert_int_equal(ern_video_writer_open(context, "place/a.mp4", &wrong, &writer), ERN_E_ARGUMENT);
  }
  wrong.rate_numerator = 2001, wrong.rate_denominator = 2;
  assert_int_equal(ern_video_writer_open(context, "place/a.mp4", &wrong, &writer), ERN_E_ARGUMENT);
  wrong = options;
  wrong.crf = 52;
  assert_int_equal(ern_video_writer_open(context, "place/a.mp4", &wrong, &writer), ERN_E_ARGUMENT);
  wrong = options;
  wrong.sound_start = NAN;
  assert_int_equal(ern_video_writer_open(context, "place/a.mp4", &wrong, &writer), ERN_E_ARGUMENT);
  assert_int_equal(files_in("place"), before);
  ern_release(context, rgba);
}

/* A full disk at whatever byte: an error from a frame or from close, the file of before untouched, nothing else. */
/* Memory that has been used before looks different each time; nothing of it may reach the file. */
static void dirty_heap(unsigned seed) {
  enum { BLOCKS = 64 };
  void *blocks[BLOCKS];
  for (unsigned i = 0; i < BLOCKS; i++) {
    const size_t bytes = 1000 + (size_t)(seed * 7919 + i * 104729) % 300000;
    blocks[i] = malloc(bytes);
    assert_non_null(blocks[i]);
    memset(blocks[i], (int)(seed * 37 + i * 11), bytes);
  }
  for (unsigned i = 0; i < BLOCKS; i++) free(blocks[i]);
}

static void test_same_bytes(void **state) {
  (void)state;
  const ern_video_options options = ern_video_options_default(96, 96);
  uint8_t *first = NULL, *again = NULL;
  size_t count = 0, count_again = 0;
  write_video("first.mp4", &options, 60);
  support_ok(context, ern_file_read(context, "first.mp4", 1 << 24, &first, &count));
  for (unsigned run = 1; run <= 8; run++) {
    dirty_heap(run);
    write_video("again.mp4", &options, 60);
    support_ok(context, ern_file_read(context, "again.mp4", 1 << 24, &again, &count_again));
    if (count != count_again || memcmp(first, again, count) != 0) fail_msg("run %u: other bytes", run);
    ern_release(context, again);
  }
  ern_release(context, first);
}

static void test_full_disk(void **state) {
  (void)state;
  ern_sound sound = tones(16000, 1, 4);
  ern_video_options options = ern_video_options_default(96, 96);
  options.sound = &sound;
  ern_video_info info;
  uint8_t *rgba = allocate(96 * 96 * 4);
  mkdir("full", 0777);
  write_video("full/a.mp4", &options, 5);
  struct stat about;
  write_video("whole.mp4", &options, 90);
  assert_int_equal(stat("whole.mp4", &about), 0);
  const int before = files_in("full");
  const off_t size = about.st_size;
  const off_t limits[] = {0, 20, 3000, size / 2, size - 4000, size - 1};
  struct rlimit old;
  assert_int_equal(getrlimit(RLIMIT_FSIZE, &old), 0);
  for (size_t i = 0; i < sizeof limits / sizeof *limits; i++) {
    const struct rlimit small = {.rlim_cur = (rlim_t)limits[i], .rlim_max = old.rlim_max};
    ern_video_writer *writer = NULL;
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &small), 0);
    ern_status status = ern_video_writer_open(context, "full/a.mp4", &options, &writer);
    for (int k = 0; k < 90 && status == ERN_OK; k++) {
      draw(rgba, 96, 96, k);
      status = ern_video_writer_frame(writer, rgba);
    }
    const ern_status closed = writer != NULL ? ern_video_writer_close(&writer) : status;
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &old), 0);
    if (closed != ERN_E_IO) fail_msg("limit %ld of %ld: %s", (long)limits[i], (long)size, ern_status_name(closed));
    if (status != ERN_OK) assert_int_equal(status, ERN_E_IO);
    assert_non_null(strstr(ern_last_error(context), "full/a.mp4"));
    assert_non_null(strstr(ern_last_error(context), "File too large"));
    assert_int_equal(files_in("full"), before);
  }
  assert_true(compare_video("full/a.mp4", &options, 5, &info) > 30);
  ern_release(context, rgba);
  ern_sound_free(context, &sound);
}

static void test_cut_short_and_no_video(void **state) {
  (void)state;
  ern_video_options options = ern_video_options_default(96, 96);
  ern_video_reader *reader = NULL;
  uint8_t *bytes = NULL;
  size_t count = 0;
  write_video("cut_from.mp4", &options, 50);
  support_ok(context, ern_file_read(context, "cut_from.mp4", 1 << 24, &bytes, &count));
  const size_t lengths[] = {0, 10, 500}; /* test_cut_within_a_packet has others */
  for (size_t i = 0; i < sizeof lengths / sizeof *lengths; i++) {
    support_write("cut.mp4", bytes, lengths[i]);
    ern_status status = ern_video_reader_open(context, "cut.mp4", &reader);
    ern_image image = {0};
    double seconds = 0;
    bool end = false;
    while (status == ERN_OK && !end) status = ern_video_reader_frame(reader, &image, &seconds, &end);
    if (status != ERN_E_FORMAT) fail_msg("cut to %zu of %zu: %s", lengths[i], count, ern_status_name(status));
    ern_image_free(context, &image);
    ern_video_reader_free(&reader);
  }
  ern_release(context, bytes);
  ern_image image = {0};
  support_expect(context, ern_image_read(context, "cut_from.mp4", 3, &image), ERN_E_FORMAT, "cut_from.mp4", NULL);
  write_video("place:of 50%d?.mp4", &options, 2); /* a name, no address */
  ern_video_info info;
  assert_true(compare_video("place:of 50%d?.mp4", &options, 2, &info) > 30);
  support_write_text("text.mp4", "no video here, only these words\n");
  support_expect(context, ern_video_reader_open(context, "text.mp4", &reader), ERN_E_FORMAT, "text.mp4", NULL);
  support_expect(context, ern_video_reader_open(context, "nothing.mp4", &reader), ERN_E_MISSING, "nothing.mp4", NULL);
  ern_sound sound = tones(16000, 1, 0.2);
  support_ok(context, ern_sound_write_wav(context, "only.wav", &sound));
  support_expect(context, ern_video_reader_open(context, "only.wav", &reader), ERN_E_FORMAT, "no video", NULL);
  assert_null(reader);
  ern_sound_free(context, &sound);
}

/* The real presenter's frames and sound, in and out again. */
static void test_real_clip(void **state) {
  (void)state;
  char path[1024], name[64];
  ern_sound sound = {0};
  ern_video_writer *writer = NULL;
  ern_video_options options = ern_video_options_default(472, 472);
  support_shared("real/presenter/aud.wav", path);
  support_ok(context, ern_sound_read(context, path, &sound));
  options.sound = &sound;
  options.sound_start = 1.5;
  support_ok(context, ern_video_writer_open(context, "real.mp4", &options, &writer));
  for (int k = 0; k < 30; k++) {
    ern_image image = {0};
    snprintf(name, sizeof name, "real/presenter/gt_imgs/%d.jpg", k);
    support_shared(name, path);
    support_ok(context, ern_image_read(context, path, 4, &image));
    support_ok(context, ern_video_writer_frame(writer, image.data));
    ern_image_free(context, &image);
  }
  support_ok(context, ern_video_writer_close(&writer));
  check_sound("real.mp4", &sound, 1.5, 30 / 25.0);
  ern_video_reader *reader = NULL;
  support_ok(context, ern_video_reader_open(context, "real.mp4", &reader));
  ern_image shown = {0};
  for (int k = 0; k < 30; k++) {
    ern_image image = {0};
    double seconds = 0, sum = 0;
    bool end = true;
    support_ok(context, ern_video_reader_frame(reader, &shown, &seconds, &end));
    assert_false(end);
    snprintf(name, sizeof name, "real/presenter/gt_imgs/%d.jpg", k);
    support_shared(name, path);
    support_ok(context, ern_image_read(context, path, 3, &image));
    for (size_t i = 0; i < 472 * 472 * 3; i++) sum += (image.data[i] - shown.data[i]) * (image.data[i] - shown.data[i]);
    const double psnr = 10 * log10(255.0 * 255.0 / (sum / (472 * 472 * 3)));
    if (psnr < 34) fail_msg("frame %d has %.2f dB", k, psnr);
    ern_image_free(context, &image);
  }
  ern_image_free(context, &shown);
  ern_video_reader_free(&reader);
  ern_sound_free(context, &sound);
}

int main(void) {
  signal(SIGXFSZ, SIG_IGN);
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_odd_size_and_sound),
      cmocka_unit_test(test_sounds_long),
      cmocka_unit_test(test_silent),
      cmocka_unit_test(test_sizes_and_rates),
      cmocka_unit_test(test_pixel_aspect),
      cmocka_unit_test(test_gif_has_100_frames_a_second_at_most),
      cmocka_unit_test(test_webm_has_each_number_of_channels),
      cmocka_unit_test(test_colours),
      cmocka_unit_test(test_quality_counts),
      cmocka_unit_test(test_nothing_is_left_behind),
      cmocka_unit_test(test_same_bytes),
      cmocka_unit_test(test_full_disk),
      cmocka_unit_test(test_cut_short_and_no_video),
      cmocka_unit_test(test_real_clip),
  };
  return cmocka_run_group_tests_name("video", tests, set_up, tear_down);
}
