/* SPDX-License-Identifier: MIT
 * What `train --consent` is told, what a rendered file and the file beside it say (docs/provenance.md); what detect
 * finds of a watermark. */
#include <math.h>
#include "cli.h"

#include "ernerf/model.h"

#define SMALL "--iters 3 --rays 32 --levels 2 --validate-every 0 --validate-frames 1 "

static struct cli cli;

static int make_clip(void **state) {
  (void)state;
  static const char *const old[] = {
      "clip",          "other", "out",           "h.safetensors", "h.run", "t.safetensors",        "t.run",
      "f.safetensors", "f.run", "n.safetensors", "n.run",         "v.mp4", "v.mp4.provenance.json"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  cli_run(&cli, "synth clip --size 64 --frames 8 --seed 3 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "synth other --size 64 --frames 8 --seed 4 --quiet");
  cli_expect(&cli, 0, NULL);
  return 0;
}

static void expect_consent(const char *model, const char *text) {
  cli_run(&cli, "info %s --json -", model);
  cli_expect(&cli, 0, NULL);
  json_t *about = json_loads(cli.out, 0, NULL);
  assert_string_equal(json_string_value(json_object_get(about, "consent")), text);
  json_decref(about);
}

/* A torso has its head's, a resumed training keeps its own, a model of another person is not given it. */
static void test_consent(void **state) {
  (void)state;
  support_write_text("agreed.txt", "agreed on Monday\n\n");
  cli_run(&cli, "train clip -o h.safetensors " SMALL "--consent agreed.txt");
  cli_expect(&cli, 0, NULL);
  expect_consent("h.safetensors", "agreed on Monday");
  cli_run(&cli, "train clip -o h.safetensors --iters 5 --resume");
  cli_expect(&cli, 0, NULL);
  expect_consent("h.safetensors", "agreed on Monday");
  cli_run(&cli, "train clip --torso --head h.safetensors -o t.safetensors --iters 3 --rays 32 --validate-frames 1");
  cli_expect(&cli, 0, NULL);
  expect_consent("t.safetensors", "agreed on Monday");
  cli_run(&cli, "train clip --from h.safetensors -o f.safetensors " SMALL "--iters 9");
  cli_expect(&cli, 0, NULL);
  expect_consent("f.safetensors", "agreed on Monday");
  cli_run(&cli, "train other --from h.safetensors -o n.safetensors " SMALL "--iters 9");
  cli_expect(&cli, 0, NULL);
  expect_consent("n.safetensors", "");
  cli_run(&cli, "train clip -o h.safetensors --iters 6 --resume --consent 'withdrawn \033[31m'");
  cli_expect(&cli, 0, NULL);
  expect_consent("h.safetensors", "withdrawn \033[31m");
  cli_run(&cli, "info h.safetensors");
  cli_expect_out(&cli, 0, "withdrawn  [31m", NULL); /* nothing that a terminal would obey */
}

static void test_consent_refused(void **state) {
  (void)state;
  static char text[1100];
  memset(text, 'a', sizeof text - 1);
  support_write_text("long.txt", text);
  support_write_text("empty.txt", "\n");
  support_write_text("odd.txt", "\xff\xfe");
  static const char *const files[] = {"long.txt", "empty.txt", "odd.txt", "agreed.tx", "clip"};
  static const char *const words[] = {"1023", "is empty", "UTF-8", "agreed.tx: there is no such file",
                                      "clip: is no regular file"};
  for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
    cli_run(&cli, "train clip -o r.safetensors " SMALL "--consent %s", files[i]);
    cli_expect(&cli, 1, words[i], NULL);
    assert_false(cli_there("r.safetensors"));
  }
}

static const char *member(const json_t *object, const char *name) {
  return json_string_value(json_object_get(object, name));
}

static void test_video(void **state) {
  (void)state;
  char hex[65];
  ern_context *context = support_context();
  cli_run(&cli, "render t.safetensors --clip clip --frames 2:5 -o v.mp4 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_string_equal(cli.err, "");
  json_t *about = cli_json(&cli, "v.mp4.provenance.json");
  assert_string_equal(member(about, "made_by"), "ernerf");
  assert_string_equal(member(about, "digital_source_type"), "compositeWithTrainedAlgorithmicMedia");
  assert_string_equal(member(about, "output"), "v.mp4");
  assert_string_equal(member(about, "consent"), "agreed on Monday");
  assert_int_equal(json_integer_value(json_object_get(about, "first_frame")), 2);
  assert_int_equal(json_integer_value(json_object_get(about, "frames")), 3);
  assert_int_equal(json_integer_value(json_object_get(json_object_get(about, "settings"), "max_steps")), 16);
  support_ok(context, ern_file_sha256(context, "t.safetensors", hex));
  assert_string_equal(member(json_object_get(about, "model"), "sha256"), hex);
  assert_string_equal(member(json_object_get(about, "model"), "file"), "t.safetensors");
  assert_int_equal(strlen(member(json_object_get(about, "speech"), "sha256")), 64);
  json_decref(about);
  ern_context_free(&context);
}

/* A file of ours that was left is replaced, one of the user's never; without the option neither is made. */
static void test_file_beside(void **state) {
  (void)state;
  support_clear("v.mp4");
  cli_run(&cli, "render n.safetensors --clip other --frames 0:2 --bg-img white -o v.mp4 --quiet");
  cli_expect(&cli, 0, "does not say that the person has agreed", NULL);
  json_t *about = cli_json(&cli, "v.mp4.provenance.json");
  assert_string_equal(member(about, "digital_source_type"), "compositeWithTrainedAlgorithmicMedia"); /* its torso */
  json_decref(about);
  support_clear("v.mp4");
  cli_run(&cli, "render t.safetensors --clip clip --torso model --frames 0:2 --bg-img white -o v.mp4 --quiet");
  cli_expect(&cli, 0, NULL);
  about = cli_json(&cli, "v.mp4.provenance.json");
  assert_string_equal(member(about, "digital_source_type"), "trainedAlgorithmicMedia");
  json_decref(about);
  support_clear("v.mp4");
  support_write_text("v.mp4.provenance.json", "{\"mine\": 1}");
  cli_run(&cli, "render t.safetensors --clip clip --frames 0:2 -o v.mp4");
  cli_expect(&cli, 1, "v.mp4.provenance.json: is there already", NULL);
  assert_false(cli_there("v.mp4"));
  cli_run(&cli, "render t.safetensors --clip clip --frames 0:2 -o v.mp4 --no-provenance");
  cli_expect(&cli, 0, NULL);
  about = cli_json(&cli, "v.mp4.provenance.json");
  assert_int_equal(json_integer_value(json_object_get(about, "mine")), 1);
  json_decref(about);
  cli_run(&cli, "render t.safetensors --clip clip --frames 0:2 -o v.mp4 -y");
  cli_expect(&cli, 0, NULL);
  about = cli_json(&cli, "v.mp4.provenance.json");
  assert_string_equal(member(about, "made_by"), "ernerf");
  json_decref(about);
}

/* A '%' in the name of a video or of its folder is no number of a picture. A name to which the ending of the file
 * beside the video cannot be added is refused before the video is made. */
static void test_file_beside_odd_names(void **state) {
  (void)state;
  support_clear("100%");
  assert_int_equal(mkdir("100%", 0777), 0);
  cli_run(&cli, "render t.safetensors --clip clip --frames 0:1 -o 100%%/%%d.mp4 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_true(cli_there("100%/%d.mp4") && cli_there("100%/%d.mp4.provenance.json"));
  cli_run(&cli, "render t.safetensors --clip clip --frames 0:1 -o 100%%/%0240d.mp4 --quiet", 0);
  cli_expect(&cli, 1, ".mp4.provenance.json: cannot write: File name too long", NULL);
  assert_int_equal(cli_count("100%"), 2);
}

/* The first frame of the raw output of a render; the caller frees it. */
static uint8_t *first_frame(const char *words, size_t frame) {
  enum { BYTES = 64 * 64 * 4 };
  uint8_t *pixels = malloc(BYTES);
  assert_non_null(pixels);
  support_clear("raw.bin");
  snprintf(cli.line, sizeof cli.line, "render t.safetensors --clip clip --frames 0:4 --quiet -o - %s", words);
  cli_start(&cli, "raw.bin", 0);
  cli_wait(&cli);
  cli_expect(&cli, 0, NULL);
  FILE *file = fopen("raw.bin", "rb");
  assert_non_null(file);
  assert_int_equal(fseek(file, (long)(frame * BYTES), SEEK_SET), 0);
  assert_int_equal(fread(pixels, 1, BYTES, file), BYTES);
  fclose(file);
  return pixels;
}

/* Letters of 5 % of 64 pixels and more in the lower left corner, for as long as asked; nothing else changes. */
static void test_label(void **state) {
  (void)state;
  uint8_t *plain = first_frame("", 0), *said = first_frame("--label AI", 0);
  int top = 64, bottom = -1, left = 64, right = -1, white = 0;
  for (int i = 0; i < 64 * 64; i++) {
    if (memcmp(plain + 4 * i, said + 4 * i, 4) == 0) continue;
    top = i / 64 < top ? i / 64 : top;
    bottom = i / 64 > bottom ? i / 64 : bottom;
    left = i % 64 < left ? i % 64 : left;
    right = i % 64 > right ? i % 64 : right;
    white += said[4 * i] > 200 && said[4 * i + 1] > 200 && said[4 * i + 2] > 200;
  }
  assert_true(top > 40 && bottom - top + 1 >= 4 + 2 && left < 8 && right < 40);
  assert_true(white >= 4);
  free(plain), free(said);
  uint8_t *now = first_frame("--label AI --set label-time=0.08s", 1),
          *then = first_frame("--label AI --set label-time=0.08s", 2);
  uint8_t *second = first_frame("", 1), *third = first_frame("", 2);
  assert_true(memcmp(now, second, 64 * 64 * 4) != 0);
  assert_memory_equal(then, third, 64 * 64 * 4);
  free(now), free(then), free(second), free(third);
  cli_run(&cli, "render t.safetensors --clip clip --frames 0:2 --label 'this is far too long for it' -o w.mp4");
  cli_expect(&cli, 1, "--label", "the frames have 64 x 64", NULL);
  assert_false(cli_there("w.mp4"));
  /* a private letter, which no font has; "Ä" is in any */
  cli_run(&cli, "render t.safetensors --clip clip --frames 0:2 --size 33x17 --label 'made by AI' -o w.mp4");
  cli_expect(&cli, 1, "--label", "the frames have 33 x 17", NULL); /* letters of a pixel would fit, and not be read */
  cli_run(&cli, "render t.safetensors --clip clip --frames 0:2 --label '\xc3\x84\xf4\x8f\xbf\xbd' -o w.mp4");
  cli_expect(&cli, 1, "--label", "U+10FFFD (\xf4\x8f\xbf\xbd)", "fonts-unifont", NULL);
  cli_run(&cli, "render t.safetensors --clip clip --frames 0:2 --label 'A\nI' -o w.mp4");
  cli_expect(&cli, 1, "--label: has U+000A", NULL);
  cli_run(&cli, "render t.safetensors --clip clip --frames 0:2 --label 'A\xd8\xb3' -o w.mp4");
  cli_expect(&cli, 1, "--label: has U+0633", "from left to right", NULL);
  assert_false(cli_there("w.mp4"));
  cli_run(&cli, "render t.safetensors --clip clip --frames 0:2 --set label-time=2s -o w.mp4");
  cli_expect(&cli, 2, "--set label-time is about --label", NULL);
  cli_run(&cli, "render --help");
  cli_expect_out(&cli, 0, "--label TEXT", NULL);
}

/* ---- the watermark (docs/watermark.md) --------------------------------------------------------------------------- */

static int make_speaking_head(void **state) {
  (void)state;
  static const char *const old[] = {"w.safetensors", "w.run",     "marked.mp4", "plain.mp4", "plain.json",
                                    "small.mp4",     "text.json", "live.mp4",   "exr"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  cli_run(&cli, "train clip -o w.safetensors " SMALL "--asr-model cepstra");
  cli_expect(&cli, 0, NULL);
  return 0;
}

#define RENDER \
  "render w.safetensors --clip clip --asr-model cepstra --frames 0:6 --size 160x128 --no-provenance --quiet "

static void test_watermark(void **state) {
  (void)state;
  cli_run(&cli, RENDER "--watermark 'my key' -o marked.mp4");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, RENDER "-o plain.mp4");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "detect marked.mp4 --watermark 'my key' --json -");
  cli_expect_out(&cli, 0, "\"found\": true", NULL);
  cli_run(&cli, "detect marked.mp4 --watermark 'my kez'");
  cli_expect_out(&cli, 1, "not found", NULL);
  cli_run(&cli, "detect plain.mp4 --watermark 'my key' --json plain.json");
  cli_expect_out(&cli, 1, "not found", NULL);
  json_t *report = cli_json(&cli, "plain.json");
  assert_true(json_is_false(json_object_get(report, "found")));
  assert_true(json_number_value(json_object_get(report, "false_positive")) > 1e-6);
  json_decref(report);
}

/* Frames at 0, 0.04 ... 0.2 s in windows of 0.1 s: 3, 2, and the last is a rest. The bound is that of two searches. */
static void test_watermark_windows(void **state) {
  (void)state;
  cli_run(&cli, "detect marked.mp4 --watermark 'my key' --window 0.1 --json -");
  cli_expect_out(&cli, 0, "\"found\": true", NULL);
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

static void test_watermark_live_long(void **state) {
  (void)state;
  cli_run(&cli,
          "live w.safetensors --clip clip --audio clip/aud.wav --as-fast --size 128x128 --watermark 'my key' "
          "--no-provenance --quiet -o live.mp4");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "detect live.mp4 --watermark 'my key' --quiet");
  cli_expect_out(&cli, 0, "is found", NULL);
  cli_run(&cli, "detect live.mp4 --watermark other");
  cli_expect_out(&cli, 1, "not found", NULL);
}

static void test_watermark_refused(void **state) {
  (void)state;
  char key[300];
  memset(key, 'k', 256);
  key[256] = 0;
  cli_run(&cli, "render w.safetensors --clip clip --frames 0:2 --watermark k -o small.mp4");
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
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_consent),     cmocka_unit_test(test_consent_refused),       cmocka_unit_test(test_video),
      cmocka_unit_test(test_file_beside), cmocka_unit_test(test_file_beside_odd_names), cmocka_unit_test(test_label)};
  const struct CMUnitTest watermark[] = {cmocka_unit_test(test_watermark), cmocka_unit_test(test_watermark_windows),
                                         cmocka_unit_test(test_watermark_live_long),
                                         cmocka_unit_test(test_watermark_refused)};
  const int failed = cmocka_run_group_tests(tests, make_clip, NULL);
  return failed + cmocka_run_group_tests(watermark, make_speaking_head, NULL);
}
