/* SPDX-License-Identifier: MIT
 * What `ernerf render` keeps from frame to frame while the camera stands: the pictures are those of a whole computation
 * but for what reuse-rays allows, less is drawn, and what contradicts itself is refused. */
#include "cli.h"

#include "../made_speech.h"
#include "io/npy.h"

enum { SIZE = 48, DRAWN = 64, BYTES = DRAWN * SIZE * SIZE * 4, WIDTH = 29, LENGTH = 16 };
static const int clip_silent[] = {20, 45, 80, 85, 100, 120, MADE_FRAMES}, silent[] = {40, 55, MADE_FRAMES};

static struct cli cli;

static void write_features(ern_context *context, const char *path, const struct made_speech *speech) {
  support_ok(context,
             ern_npy_write_f32(context, path, speech->features.data, 3, (const size_t[]){MADE_FRAMES, LENGTH, WIDTH}));
}

/* A speaker before a camera that stands, and a speech with a silence in frames 40 to 54. */
static int make_model(void **state) {
  (void)state;
  static const char *const old[] = {"clip", "m.safetensors", "m.run"};
  struct made_speech clip, other;
  ern_context *context = support_context();
  for (size_t i = 0; i < sizeof old / sizeof old[0]; i++) support_clear(old[i]);
  cli_run(&cli, "synth clip --size 64 --frames 24 --seed 3 --static-camera --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(remove("clip/aud.wav"), 0); /* of another speech than the one below */
  made_speech(&clip, LENGTH, WIDTH, 3, clip_silent);
  made_speech(&other, LENGTH, WIDTH, 30, silent);
  write_features(context, "clip/aud_ds.npy", &clip);
  write_features(context, "speech.npy", &other);
  cli_run(&cli, "train clip -o m.safetensors --iters 60 --rays 256 --levels 6 --seed 7 --lr-net 0.004 --quiet");
  cli_expect(&cli, 0, NULL);
  free(clip.features.data);
  free(other.features.data);
  ern_context_free(&context);
  return 0;
}

/* The frames as bytes RGBA; the caller frees them. */
static uint8_t *raw(const char *words) {
  uint8_t *pixels = malloc(BYTES + 1);
  assert_non_null(pixels);
  support_clear("raw.bin");
  snprintf(
      cli.line, sizeof cli.line,
      "render m.safetensors --clip clip --audio speech.npy --frames 0:%d --size %dx%d -o - -y --json still.json %s",
      DRAWN, SIZE, SIZE, words);
  cli_start(&cli, "raw.bin", 0);
  cli_wait(&cli);
  cli_expect(&cli, 0, NULL);
  FILE *file = fopen("raw.bin", "rb");
  assert_non_null(file);
  assert_int_equal(fread(pixels, 1, BYTES + 1, file), BYTES);
  fclose(file);
  return pixels;
}

static int most_apart(const uint8_t *a, const uint8_t *b) {
  int most = 0;
  for (size_t i = 0; i < BYTES; i++) most = abs(a[i] - b[i]) > most ? abs(a[i] - b[i]) : most;
  return most;
}

struct report {
  double bound, rays, samples;
};
static struct report report(void) {
  json_t *object = cli_json(&cli, "still.json"), *still = json_object_get(object, "ray_reuse");
  assert_true(json_is_object(still));
  const struct report found = {json_number_value(json_object_get(still, "bound")),
                               json_number_value(json_object_get(still, "rays")),
                               json_number_value(json_object_get(still, "samples"))};
  json_decref(object);
  return found;
}

/* Half a grey level moves a byte by one at most; the share that is printed is the one in the report, and under 1. With
 * and without rest. */
static void test_bound_long(void **state) {
  (void)state;
  static const char *const ways[] = {"--set silence-pose=no", "--set image-scale=0.5 --fix-eye 0.3"};
  for (size_t i = 0; i < sizeof ways / sizeof *ways; i++) {
    char words[128], share[64];
    snprintf(words, sizeof words, "--set reuse-rays=-1 %s", ways[i]);
    uint8_t *whole = raw(words);
    json_t *object = cli_json(&cli, "still.json");
    assert_true(json_is_null(json_object_get(object, "ray_reuse")));
    if (strstr(ways[i], "silence-pose=no") == NULL)
      assert_true(json_integer_value(json_object_get(object, "silent_frames")) > 8);
    json_decref(object);
    uint8_t *kept = raw(ways[i]);
    const struct report found = report();
    assert_true(found.bound == 0.5 && found.rays > 0 && found.rays < 0.95 && found.samples < 0.95);
    snprintf(share, sizeof share, "%.1f %% of rays and %.1f %% of samples", 100 * found.rays, 100 * found.samples);
    cli_expect(&cli, 0, share, NULL);
    if (most_apart(whole, kept) > 1) fail_msg("\"%s\": %d levels off", ways[i], most_apart(whole, kept));
    free(whole);
    free(kept);
  }
}

static void test_other_bounds_long(void **state) {
  (void)state;
  uint8_t *whole = raw("--set reuse-rays=-1"), *none = raw("--set reuse-rays=0");
  const struct report zero = report();
  assert_memory_equal(whole, none, BYTES);
  assert_true(zero.bound == 0);
  uint8_t *half = raw("");
  const struct report usual = report();
  uint8_t *wide = raw("--set reuse-rays=4");
  const struct report few = report();
  assert_true(few.bound == 4);
  assert_true(few.samples <= usual.samples && usual.samples < zero.samples);
  assert_true(most_apart(whole, wide) <= 5 && memcmp(whole, wide, BYTES) != 0);
  free(whole);
  free(none);
  free(half);
  free(wide);
}

/* Few frames are not worth it, and a head that moves has nothing to keep. */
static void test_not_worth_it(void **state) {
  (void)state;
  cli_run(&cli, "render m.safetensors --clip clip --audio speech.npy --frames 0:30 -o few.mp4 -y --json still.json");
  cli_expect(&cli, 0, NULL);
  assert_null(strstr(cli.err, "rendered again"));
  assert_true(report().bound == 0);
}

static void test_words(void **state) {
  (void)state;
  static const char *const wrong[][2] = {{"--set reuse-rays=-2", "a number from -1 to 255"},
                                         {"--reuse-rays 1", "--reuse-rays is --set reuse-rays=VALUE"},
                                         {"--set reuse-rays=nan", "--set reuse-rays"},
                                         {"--hold-fps 25 --set reuse-rays=1", "is not for a budget"}};
  for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
    cli_run(&cli, "render m.safetensors --clip clip -o x.mp4 %s", wrong[i][0]);
    cli_expect(&cli, 2, wrong[i][1], NULL);
    assert_int_not_equal(access("x.mp4", F_OK), 0);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_bound_long), cmocka_unit_test(test_other_bounds_long),
                                     cmocka_unit_test(test_not_worth_it), cmocka_unit_test(test_words)};
  return cmocka_run_group_tests(tests, make_model, NULL);
}
