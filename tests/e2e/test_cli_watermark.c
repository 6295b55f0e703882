/* SPDX-License-Identifier: MIT
 * render and live --watermark, and what detect then says (docs/watermark.md). */
#include <math.h>
#include "cli.h"

static struct cli cli;

static int make_portrait(void **state) {
  (void)state;
  static const char *const old[] = {"clip",       "h.safetensors", "h.run",      "marked.mp4", "plain.mp4",
                                    "plain.json", "small.mp4",     "marked.mkv", "live.mp4",   "exr"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  cli_run(&cli, "synth clip --size 64 --frames 12 --seed 3 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o h.safetensors --iters 3 --rays 32 --levels 2 --validate-every 0 --asr_model cepstra");
  cli_expect(&cli, 0, NULL);
  return 0;
}

#define RENDER \
  "render h.safetensors --clip clip --asr_model cepstra --frames 0:6 --size 160x128 --no-provenance --quiet "

static void test_render(void **state) {
  (void)state;
  cli_run(&cli, RENDER "--watermark 'my key' -o marked.mp4");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, RENDER "-o plain.mp4");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "detect marked.mp4 --watermark 'my key' --json -");
  cli_expect_out(&cli, 0, "\"found\": true", NULL);
  cli_expect(&cli, 0, "is found", NULL);
  cli_run(&cli, "detect marked.mp4 --watermark 'my kez'");
  cli_expect(&cli, 1, "not found", NULL);
  cli_run(&cli, "detect plain.mp4 --watermark 'my key' --json plain.json");
  cli_expect(&cli, 1, "not found", NULL);
  json_t *report = cli_json(&cli, "plain.json");
  assert_true(json_is_false(json_object_get(report, "found")));
  assert_true(json_number_value(json_object_get(report, "false_positive")) > 1e-6);
  json_decref(report);
}

/* Frames at 0, 0.04 ... 0.2 s in windows of 0.1 s: 3, 2, and the last is a rest. The bound is that of two searches. */
static void test_windows(void **state) {
  (void)state;
  cli_run(&cli, "detect marked.mp4 --watermark 'my key' --window 0.1 --json -");
  cli_expect(&cli, 0, "is found", NULL);
  json_t *report = json_loads(cli.out, 0, NULL);
  const json_t *windows = json_object_get(report, "windows");
  assert_int_equal(json_array_size(windows), 2);
  double least = 1;
  for (size_t i = 0; i < 2; i++) {
    const json_t *window = json_array_get(windows, i);
    assert_int_equal(json_integer_value(json_object_get(window, "frames")), 3 - (int)i);
    least = fmin(least, json_number_value(json_object_get(window, "false_positive")));
  }
  const double bound = json_number_value(json_object_get(report, "false_positive"));
  assert_true(fabs(bound - 2 * least) <= 1e-9 * bound);
  json_decref(report);
}

static void test_live(void **state) {
  (void)state;
  cli_run(&cli,
          "live h.safetensors --clip clip --audio clip/aud.wav --as-fast --size 128x128 --watermark 'my key' "
          "--no-provenance --quiet -o live.mp4");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "detect live.mp4 --watermark 'my key'");
  cli_expect(&cli, 0, "is found", NULL);
  cli_run(&cli, "detect live.mp4 --watermark other");
  cli_expect(&cli, 1, "not found", NULL);
}

static void test_refused(void **state) {
  (void)state;
  char key[300];
  memset(key, 'k', 256);
  key[256] = 0;
  cli_run(&cli, "render h.safetensors --clip clip --frames 0:2 --watermark k -o small.mp4");
  cli_expect(&cli, 1, "64 x 64 pixels, expected 128", NULL);
  assert_false(cli_there("small.mp4"));
  cli_run(&cli, RENDER "--watermark %s -o small.mp4", key);
  cli_expect(&cli, 2, "256 bytes, expected 1 to 255", NULL);
  cli_run(&cli, RENDER "--watermark k -o exr/%%05d.exr");
  cli_expect(&cli, 2, "--watermark", NULL);
  cli_run(&cli, "detect marked.mp4 --watermark ''");
  cli_expect(&cli, 2, "expected a value", NULL);
  cli_run(&cli, "detect marked.mp4");
  cli_expect(&cli, 2, "--watermark KEY is missing", NULL);
  cli_run(&cli, "detect none.mp4 --watermark k");
  cli_expect(&cli, 1, "none.mp4", NULL);
  support_write_text("text.mp4", "no video");
  cli_run(&cli, "detect text.mp4 --watermark k --json text.json");
  cli_expect(&cli, 1, "text.mp4", NULL);
  assert_false(cli_there("text.json"));
  cli_run(&cli, "detect --help");
  cli_expect_out(&cli, 0, "0 found, 1 not found or failed", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_render), cmocka_unit_test(test_windows),
                                     cmocka_unit_test(test_live), cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, make_portrait, NULL);
}
