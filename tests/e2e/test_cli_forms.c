/* SPDX-License-Identifier: MIT
 * Forms of render's output: containers, codecs, pictures and streams, by their frames, which are those of the PNGs, and
 * what does not go together. */
#include "cli.h"

#include <math.h>

#include "ernerf/media.h"

enum { FRAMES = 10, SIDE = 64 };

static struct cli cli;
static ern_context *context;
static uint8_t truth[FRAMES][SIDE * SIDE * 3];

static int make_inputs(void **state) {
  (void)state;
  support_clear("clip");
  cli_shared_clip("short", "clip");
  cli_shared_model("short_head", "m");
  cli_run(&cli, "render m.safetensors --clip clip --frames 0:10 -o p%%02d.png --quiet");
  cli_expect(&cli, 0, NULL);
  if (ern_context_create(&context, NULL) != ERN_OK) return -1;
  for (int k = 0; k < FRAMES; k++) {
    char path[32];
    ern_image image;
    snprintf(path, sizeof path, "p%02d.png", k);
    if (ern_image_read(context, path, 3, &image) != ERN_OK) return -1;
    memcpy(truth[k], image.data, sizeof truth[k]);
    ern_image_free(context, &image);
  }
  return 0;
}

static int free_context(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

static double psnr(const uint8_t *a, const uint8_t *b) {
  double sum = 0;
  for (size_t i = 0; i < sizeof truth[0]; i++) sum += ((double)a[i] - b[i]) * ((double)a[i] - b[i]);
  return sum > 0 ? 10 * log10(255.0 * 255.0 * (double)sizeof truth[0] / sum) : INFINITY;
}

/* The least PSNR of its frames. */
static double check_video(const char *path, const char *codec, const char *sound) {
  ern_video_reader *reader = NULL;
  ern_video_info info;
  ern_image image = {0};
  double least = INFINITY, first = 0, seconds;
  bool end = false;
  int count = 0;
  if (ern_video_reader_open(context, path, &reader) != ERN_OK) fail_msg("%s", ern_last_error(context));
  ern_video_reader_info(reader, &info);
  assert_string_equal(info.video_codec, codec);
  assert_int_equal(info.has_sound, sound != NULL);
  if (sound != NULL) assert_string_equal(info.sound_codec, sound);
  assert_int_equal(info.rate_numerator, 25 * info.rate_denominator);
  for (;; count++) {
    if (ern_video_reader_frame(reader, &image, &seconds, &end) != ERN_OK) fail_msg("%s", ern_last_error(context));
    if (end) break;
    assert_true(count < FRAMES && image.width == SIDE && image.height == SIDE);
    if (count == 0) first = seconds;
    assert_true(fabs(seconds - first - count / 25.0) <= 0.0011); /* matroska counts in milliseconds, rounded twice */
    least = fmin(least, psnr(image.data, truth[count]));
  }
  assert_int_equal(count, FRAMES);
  assert_in_range((int)(1000 * first + 0.5), 0,
                  64); /* matroska: the first packet of AAC, 1024 samples at 16 kHz, stands before it */
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
  return least;
}

/* 30 dB are 8 of 255 steps of error, which half the resolution of colour and a good quality stay under; other colours,
 * or the frame beside it, do not. A GIF has 8 red and green by 4 blue values, up to 16 or 32 steps away before it
 * mixes them. */
static void test_videos(void **state) {
  static const struct {
    const char *options, *path, *codec, *sound;
    double least;
  } rows[] = {{"", "a.mp4", "h264", "aac", 30},
              {"--crf 10 --set preset=slow", "b.MOV", "h264", "aac", 30},
              {"", "c.mkv", "h264", "aac", 30},
              {"", "d.webm", "vp9", "opus", 30},
              {"", "e.GIF", "gif", NULL, 18},
              {"--codec hevc --set preset=ultrafast", "f.mp4", "hevc", "aac", 30},
              {"--codec av1", "g.webm", "av1", "opus", 30},
              {"--codec vp9", "h.mp4", "vp9", "aac", 30},
              {"--codec ffv1", "i.mkv", "ffv1", "aac", INFINITY}};
  (void)state;
  for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
    cli_run(&cli, "render m.safetensors --clip clip --frames 0:10 -o %s %s --quiet", rows[i].path, rows[i].options);
    cli_expect(&cli, 0, NULL);
    const double least = check_video(rows[i].path, rows[i].codec, rows[i].sound);
    if (!(least >= rows[i].least)) fail_msg("%s: %g dB, expected %g", rows[i].path, least, rows[i].least);
  }
}

/* Each file says what made it: a packet of XMP, or a tag of matroska. */
static void test_provenance(void **state) {
  static const char *const paths[] = {"a.mp4", "b.MOV", "c.mkv", "d.webm", "e.GIF"};
  static char bytes[CLI_TEXT_BYTES];
  (void)state;
  for (size_t i = 0; i < sizeof paths / sizeof *paths; i++) {
    bool found = false;
    FILE *file = fopen(paths[i], "rb");
    assert_non_null(file);
    const size_t count = fread(bytes, 1, sizeof bytes - 1, file);
    fclose(file);
    for (size_t at = 0; at < count && !found; at += strlen(bytes + at) + 1)
      found = strstr(bytes + at, "compositeWithTrainedAlgorithmicMedia") != NULL;
    if (!found) fail_msg("%s does not say what made it", paths[i]);
  }
}

static long bytes_of(const char *path) {
  struct stat about;
  assert_int_equal(stat(path, &about), 0);
  return (long)about.st_size;
}

/* A higher crf makes a smaller file, and so does a slower preset, less surely: it makes another one. */
static void test_crf_long(void **state) {
  (void)state;
  cli_run(&cli, "render m.safetensors --clip clip --frames 0:10 -o low.mp4 --crf 40 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render m.safetensors --clip clip --frames 0:10 -o high.mp4 --crf 5 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_true(bytes_of("low.mp4") < bytes_of("high.mp4"));
  cli_run(&cli, "render m.safetensors --clip clip --frames 0:10 -o slow.mp4 --crf 5 --set preset=veryslow --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_not_equal(bytes_of("slow.mp4"), bytes_of("high.mp4"));
}

static void test_pictures(void **state) {
  (void)state;
  cli_run(&cli, "render m.safetensors --clip clip --frames 0:10 -o j%%02d.JPG --quiet");
  cli_expect(&cli, 0, NULL);
  for (int k = 0; k < FRAMES; k++) {
    char path[32];
    ern_image image;
    snprintf(path, sizeof path, "j%02d.JPG", k);
    assert_int_equal(ern_image_read(context, path, 3, &image), ERN_OK);
    assert_true(psnr(image.data, truth[k]) >= 30);
    ern_image_free(context, &image);
  }
}

static void test_streams(void **state) {
  static const struct {
    const char *format, *path, *codec, *sound;
  } rows[] = {{"y4m", "s.y4m", "rawvideo", NULL},
              {"nut", "s.nut", "rawvideo", "pcm_s16le"},
              {"matroska", "s.mkv", "h264", "aac"},
              {"mp4", "s.mp4", "h264", "aac"}};
  (void)state;
  for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
    snprintf(cli.line, sizeof cli.line, "render m.safetensors --clip clip --frames 0:10 -o - --format %s --quiet",
             rows[i].format);
    support_clear(rows[i].path);
    cli_start(&cli, rows[i].path, 0);
    cli_wait(&cli);
    cli_expect(&cli, 0, NULL);
    assert_true(check_video(rows[i].path, rows[i].codec, rows[i].sound) >= 30);
  }
  assert_false(cli_there("-.provenance.json"));
}

/* Each line of stderr is an object; the last one says that all is done. */
static void test_progress(void **state) {
  json_int_t done = 0;
  (void)state;
  cli_run(&cli, "render m.safetensors --clip clip --frames 0:10 -o q.mp4 --quiet --progress json --json");
  cli_expect(&cli, 0, NULL);
  json_decref(cli_json(&cli, NULL));
  for (char *line = strtok(cli.err, "\n"); line != NULL; line = strtok(NULL, "\n")) {
    if (line[0] != '{') continue; /* warnings stay words */
    json_t *object = json_loads(line, 0, NULL);
    assert_non_null(object);
    assert_string_equal(json_string_value(json_object_get(object, "progress")), "render");
    assert_int_equal(json_integer_value(json_object_get(object, "total")), FRAMES);
    assert_true(json_integer_value(json_object_get(object, "done")) > done);
    done = json_integer_value(json_object_get(object, "done"));
    assert_true(json_is_number(json_object_get(object, "seconds")));
    json_decref(object);
  }
  assert_int_equal(done, FRAMES);
}

static void test_refused(void **state) {
  static const struct {
    int status;
    const char *options, *words;
  } rows[] = {{2, "-o x%02d.png --crf 3", "--crf is for a video"},
              {2, "-o x%02d.jpg --codec h264", "--codec is for a video"},
              {2, "-o x.gif --crf 3", "--crf is not for a .gif"},
              {2, "-o x.gif --wav w.wav", "--wav"},
              {2, "-o x.mp4 --format y4m", "--format is what -o - writes"},
              {2, "-o - --format nut --crf 3", "--crf is for a compressed video"},
              {2, "-o x.mkv --codec ffv1 --crf 3", "--crf is for other codecs than ffv1"},
              {2, "-o - --format y4m --set preset=slow", "--set preset is for a video that is written to a file"},
              {2, "-o - --format mp4 --crf 60", "--crf is 60, expected 0 to 51"},
              {2, "-o - --format mp4 --json", "both take standard output"},
              {2, "-o x.mp4 --codec mpeg2", "--codec is \"mpeg2\""},
              {2, "-o x.avi", "expected NAME.mp4, .mov, .mkv, .webm or .gif"},
              {1, "-o x.webm --codec h264", "codec is \"h264\", expected one that webm holds here: vp9, av1"},
              {1, "-o x.mp4 --crf 60", "crf is 60, expected 0 to 51, the range of h264"},
              {1, "-o x.webm --set preset=slow", "vp9 has no presets"}};
  (void)state;
  for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
    cli_run(&cli, "render m.safetensors --clip clip --frames 0:10 --quiet %s", rows[i].options);
    cli_expect(&cli, rows[i].status, rows[i].words, NULL);
    assert_false(cli_there("x.webm") || cli_there("x.mp4") || cli_there("x.gif"));
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_videos),   cmocka_unit_test(test_provenance),
                                     cmocka_unit_test(test_crf_long), cmocka_unit_test(test_pictures),
                                     cmocka_unit_test(test_streams),  cmocka_unit_test(test_progress),
                                     cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, make_inputs, free_context);
}
