/* SPDX-License-Identifier: MIT
 * `ernerf render --fps`: frames, their times, what is between two frames of the clip, and the sound. */
#include "cli.h"

#include <math.h>

#include "ernerf/media.h"
#include "io/npy.h"

enum { SIZE = 64, FRAMES = 12, PIXEL_BYTES = SIZE * SIZE * 4, WINDOWS = 16, VALUES = WINDOWS * 16 * 29 };

static struct cli cli;
static ern_context *context;

static int make_model(void **state) {
  (void)state;
  static const char *const old[] = {"clip", "m.safetensors", "m.run", "out", "v.mp4", "w.mp4"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  context = support_context();
  cli_run(&cli, "synth clip --size %d --frames %d --seed 3 --quiet", SIZE, FRAMES);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli,
          "train clip -o m.safetensors --iters 60 --rays 256 --levels 4 --seed 7 --lr-net 0.004 --validate-frames 1 "
          "--effects "
          "eye,codes,view --quiet");
  cli_expect(&cli, 0, NULL);
  static float hum[VALUES]; /* the same speech in all frames */
  for (size_t i = 0; i < VALUES; i++) hum[i] = 0.03f;
  support_ok(context, ern_npy_write_f32(context, "hum.npy", hum, 3, (const size_t[]){WINDOWS, 16, 29}));
  return 0;
}

static int drop_context(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

/* Frames of a raw output; the caller frees them. */
static uint8_t *raw(const char *words, size_t frames) {
  uint8_t *pixels = malloc(frames * PIXEL_BYTES + 1);
  assert_non_null(pixels);
  support_clear("raw.bin");
  snprintf(cli.line, sizeof cli.line, "render m.safetensors --clip clip %s -o - --quiet", words);
  cli_start(&cli, "raw.bin", 0);
  cli_wait(&cli);
  cli_expect(&cli, 0, NULL);
  FILE *file = fopen("raw.bin", "rb");
  assert_non_null(file);
  const size_t found = fread(pixels, 1, frames * PIXEL_BYTES + 1, file);
  fclose(file);
  if (found != frames * PIXEL_BYTES)
    fail_msg("%s: %zu bytes of pictures, expected %zu", words, found, frames * PIXEL_BYTES);
  return pixels;
}

static bool same(const uint8_t *a, size_t i, const uint8_t *b, size_t j) {
  return memcmp(a + i * PIXEL_BYTES, b + j * PIXEL_BYTES, PIXEL_BYTES) == 0;
}

/* Where nothing lies yet. */
static void clear_outputs(void) {
  support_clear("v.mp4");
  support_clear("v.json");
  support_clear("w.mp4");
}

/* Mean of the squared differences of two frames. */
static double apart(const uint8_t *a, size_t i, const uint8_t *b, size_t j) {
  double sum = 0;
  for (size_t k = 0; k < PIXEL_BYTES; k++) {
    const double d = (double)a[i * PIXEL_BYTES + k] - (double)b[j * PIXEL_BYTES + k];
    sum += d * d;
  }
  return sum / PIXEL_BYTES;
}

/* Frame k at k / rate seconds, as many as cover the clip, and the rate in the container and in --json. */
static void test_times(void **state) {
  (void)state;
  static const struct {
    const char *words, *rate;
    int numerator, denominator;
    size_t frames;
  } cases[] = {{"", "25", 25, 1, 12},
               {"--fps 25", "25", 25, 1, 12},
               {"--fps 50", "50", 50, 1, 24},
               {"--fps 29.97", "30000/1001", 30000, 1001, 15},
               {"--fps 24000/1001", "24000/1001", 24000, 1001, 12},
               {"--fps 1", "1", 1, 1, 1}};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    ern_video_reader *reader = NULL;
    ern_video_info info;
    ern_image image = {0};
    double seconds = 0;
    bool end = false;
    size_t count = 0;
    clear_outputs();
    cli_run(&cli, "render m.safetensors --clip clip %s -o v.mp4 --json v.json", cases[i].words);
    cli_expect(&cli, 0, "a second", NULL);
    support_ok(context, ern_video_reader_open(context, "v.mp4", &reader));
    ern_video_reader_info(reader, &info);
    assert_int_equal(info.rate_numerator, cases[i].numerator);
    assert_int_equal(info.rate_denominator, cases[i].denominator);
    for (support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end)); !end; count++) {
      const double expected = (double)count * cases[i].denominator / cases[i].numerator;
      if (fabs(seconds - expected) > 1e-9)
        fail_msg("%s: frame %zu is shown at %.9f s, expected %.9f", cases[i].words, count, seconds, expected);
      support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
    }
    assert_int_equal(count, cases[i].frames);
    ern_image_free(context, &image);
    ern_video_reader_free(&reader);
    json_t *report = cli_json(&cli, "v.json");
    assert_string_equal(json_string_value(json_object_get(report, "rate")), cases[i].rate);
    assert_int_equal(json_integer_value(json_object_get(report, "frames")), cases[i].frames);
    json_decref(report);
  }
}

/* At 50 every second frame is one at 25, and those between are between: nearer to both than these are to each other. */
static void test_between(void **state) {
  (void)state;
  uint8_t *plain = raw("", FRAMES), *same_rate = raw("--fps 25", FRAMES), *fast = raw("--fps 50", 2 * FRAMES);
  assert_memory_equal(plain, same_rate, FRAMES * PIXEL_BYTES);
  double halves = 0, wholes = 0;
  for (size_t k = 0; k < FRAMES; k++) {
    if (!same(plain, k, fast, 2 * k)) fail_msg("frame %zu at 50 a second is not frame %zu at 25", 2 * k, k);
    if (k + 1 == FRAMES) continue;
    assert_false(same(fast, 2 * k, fast, 2 * k + 1) || same(fast, 2 * k + 1, fast, 2 * k + 2));
    halves += fmax(apart(fast, 2 * k, fast, 2 * k + 1), apart(fast, 2 * k + 1, fast, 2 * k + 2));
    wholes += apart(fast, 2 * k, fast, 2 * k + 2);
  }
  assert_true(halves < wholes);
  assert_true(same(fast, 2 * FRAMES - 2, fast, 2 * FRAMES - 1)); /* past the last frame all stands still */
  free(same_rate);
  free(fast);
  uint8_t *slow = raw("--fps 12.5", FRAMES / 2);
  for (size_t k = 0; k < FRAMES / 2; k++) assert_true(same(slow, k, plain, 2 * k));
  free(slow);
  free(plain);
}

/* Frames and numbers of pictures count the output's. */
static void test_frames(void **state) {
  (void)state;
  uint8_t *all = raw("--fps 50 --set audio-pad=zero", 2 * FRAMES),
          *part = raw("--fps 50 --set audio-pad=zero --frames 5:9", 4);
  for (size_t k = 0; k < 4; k++) assert_true(same(part, k, all, 5 + k));
  free(all);
  free(part);
  assert_int_equal(mkdir("out", 0777), 0);
  cli_run(&cli, "render m.safetensors --clip clip --fps 50 --frames 22:24 -o out/%%d.png --quiet");
  cli_expect(&cli, 0, NULL);
  assert_true(cli_there("out/22.png") && cli_there("out/23.png") && cli_count("out") == 3);
  cli_run(&cli, "render m.safetensors --clip clip --fps 30 --frames 0:16 -o out/%%d.png --quiet");
  cli_expect(&cli, 2, "--frames is 0:16", "<= 15", NULL);
}

/* Poses go forward and back: a third of the way between the last two is the same place on the way back. Thirds, as the
 * torso picture of a half is that of the later frame. */
static void test_turn(void **state) {
  (void)state;
  uint8_t *all = raw("--audio hum.npy --fix-eye 0 --fps 75", 3 * WINDOWS);
  const size_t turn = 3 * (FRAMES - 1);
  for (size_t k = 1; k <= 6; k++) { /* slerp from either end rounds differently: far less than a step */
    const double step = apart(all, turn - k, all, turn - k + 1), there_and_back = apart(all, turn - k, all, turn + k);
    if (!(there_and_back < 0.01 * step))
      fail_msg("%zu frames from the turn: %g apart, a step is %g", k, there_and_back, step);
  }
  assert_false(same(all, turn, all, turn + 1));
  free(all);
}

/* Held heads stand at any rate, and a curve of the eyes is interpolated. */
static void test_control(void **state) {
  (void)state;
  support_write_text("blink.txt", "0\n1\n0\n0\n0\n0\n0\n0\n0\n0\n0\n0\n0\n0\n0\n0\n");
  static const char curve[] =
      "--audio hum.npy --set hold-pose=2 --set reuse-rays=-1 --fps 100 --eye blink.txt --frames 0:6";
  static const char value[] =
      "--audio hum.npy --set hold-pose=2 --set reuse-rays=-1 --fps 100 --frames 0:6 --fix-eye %s";
  static const char *const eyes[] = {"0", "0.25", "0.5", "0.75", "1", "0.75"};
  uint8_t *blink = raw(curve, 6);
  for (size_t k = 0; k < 6; k++) {
    char words[256];
    snprintf(words, sizeof words, value, eyes[k]);
    uint8_t *fixed = raw(words, 6);
    if (!same(blink, k, fixed, 0)) fail_msg("frame %zu is not one with eyes of %s", k, eyes[k]);
    assert_true(same(fixed, 0, fixed, 5));
    free(fixed);
  }
  assert_false(same(blink, 0, blink, 2));
  free(blink);
  support_write_text("short.txt", "0\n1\n");
  clear_outputs();
  cli_run(&cli, "render m.safetensors --clip clip --fps 50 --frames 0:4 --eye short.txt -o v.mp4");
  cli_expect(&cli, 1, "short.txt: has eyes for 2 frames, expected at least 3", "at 25 a second", NULL);
  free(raw("--fps 50 --frames 0:3 --eye short.txt", 3));
}

/* What is heard of the file, one channel; the caller frees it. */
static ern_sound sound_of(const char *words) {
  ern_sound sound = {0};
  clear_outputs();
  cli_run(&cli, "render m.safetensors --clip clip %s -o w.mp4 --quiet", words);
  cli_expect(&cli, 0, NULL);
  support_ok(context, ern_sound_read(context, "w.mp4", &sound));
  return sound;
}

/* The same sound at any rate, from the time of the first frame on. */
static void test_sound(void **state) {
  (void)state;
  ern_sound plain = sound_of(""), fast = sound_of("--fps 60"), part = sound_of("--fps 50 --frames 5:24"), truth = {0};
  support_ok(context, ern_sound_read(context, "clip/aud.wav", &truth));
  assert_int_equal(plain.rate, fast.rate);
  assert_int_equal(plain.rate, truth.rate);
  const double rate = plain.rate;
  assert_true(fabs((double)plain.frames / rate - FRAMES / 25.0) < 2 / rate);
  assert_int_equal(fast.frames, plain.frames);
  /* frame 60 / 60 begins its packets elsewhere than 25 / 25 would: the same to what AAC loses */
  double off = 0, power = 0;
  for (size_t i = 0; i < plain.frames; i++) {
    off += pow((double)plain.data[i] - (double)fast.data[i], 2);
    power += pow((double)plain.data[i], 2);
  }
  assert_true(off < 0.05 * power);
  assert_true(fabs((double)part.frames / rate - 19 / 50.0) < 2 / rate);
  /* 5 / 50 s into the sound, to a millisecond: no other place fits as well */
  const long expected = lrint(0.1 * rate);
  long best = -1;
  double least = INFINITY;
  for (long lag = 0; lag < lrint(0.2 * rate); lag += lrint(rate / 1000)) {
    double sum = 0;
    for (size_t i = 0; i < part.frames / 2; i++)
      sum += pow((double)part.data[i] - (double)truth.data[(size_t)lag + i], 2);
    if (sum < least) {
      least = sum;
      best = lag;
    }
  }
  assert_int_equal(best, expected);
  ern_sound_free(context, &plain);
  ern_sound_free(context, &fast);
  ern_sound_free(context, &part);
  ern_sound_free(context, &truth);
}

static void test_words(void **state) {
  (void)state;
  static const char *const bad[] = {"0.5", "241", "30/0", "fast", "-25", "25/1/1"};
  for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
    cli_run(&cli, "render m.safetensors --clip clip --fps=%s -o bad.mp4", bad[i]);
    cli_expect(&cli, 2, "--fps is \"", "expected frames a second from 1 to 240", NULL);
  }
  assert_false(cli_there("bad.mp4"));
  clear_outputs();
  cli_run(&cli, "render m.safetensors --clip clip --fps 30 --hold-fps 0.1 -o v.mp4 --json v.json");
  cli_expect(&cli, 0, "15 frames of 64 x 64, 30 a second", "measures the cost of the settings briefly", NULL);
  json_t *report = cli_json(&cli, "v.json");
  assert_true(json_is_object(json_object_get(report, "rate_control")));
  json_decref(report);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_times),   cmocka_unit_test(test_between),
                                     cmocka_unit_test(test_frames),  cmocka_unit_test(test_turn),
                                     cmocka_unit_test(test_control), cmocka_unit_test(test_sound),
                                     cmocka_unit_test(test_words)};
  return cmocka_run_group_tests(tests, make_model, drop_context);
}
