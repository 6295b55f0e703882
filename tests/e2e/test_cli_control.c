/* SPDX-License-Identifier: MIT
 * Eyes and pose by the user's hand: by value, by curve, held still, turned. What each must and must not change. */
#include "cli.h"

#include "io/npy.h"

enum { SIZE = 64, FRAMES = 12, PIXEL_BYTES = SIZE * SIZE * 4, WINDOWS = 5, VALUES = WINDOWS * 16 * 29 };

static struct cli cli;

static int make_model(void **state) {
  (void)state;
  static const char *const old[] = {
      "clip",  "m.safetensors",    "m.run",      "open",    "open.safetensors", "open.run",
      "m.pth", "back.safetensors", "unsaid.mp4", "bad.mp4", "bad.safetensors",  "bad.run"};
  for (size_t i = 0; i < sizeof old / sizeof old[0]; i++) support_clear(old[i]);
  cli_run(&cli, "synth clip --size %d --frames %d --seed 3 --quiet", SIZE, FRAMES);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli,
          "train clip -o m.safetensors --iters 40 --rays 256 --levels 6 --seed 7 --lr-net 0.004 --effects "
          "eye,codes,view --quiet");
  cli_expect(&cli, 0, NULL);
  ern_context *context = support_context();
  static float hum[VALUES]; /* the same speech in all frames */
  for (size_t i = 0; i < VALUES; i++) hum[i] = 0.03f;
  support_ok(context, ern_npy_write_f32(context, "hum.npy", hum, 3, (const size_t[]){WINDOWS, 16, 29}));
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
  assert_int_equal(fread(pixels, 1, frames * PIXEL_BYTES + 1, file), frames * PIXEL_BYTES);
  fclose(file);
  return pixels;
}

static void expect_pixels(const char *one, const char *other, size_t frames, bool same) {
  uint8_t *a = raw(one, frames), *b = raw(other, frames);
  if ((memcmp(a, b, frames * PIXEL_BYTES) == 0) != same)
    fail_msg("\"%s\" and \"%s\": the pixels %s", one, other, same ? "differ" : "are the same");
  free(a);
  free(b);
}

static void test_eye_curve(void **state) {
  (void)state;
  ern_context *context = support_context();
  float closed[FRAMES];
  char lines[FRAMES * 2 + 1] = "";
  for (int i = 0; i < FRAMES; i++) {
    closed[i] = 1;
    strcat(lines, "1\n");
  }
  support_ok(context, ern_npy_write_f32(context, "closed.npy", closed, 1, (const size_t[]){FRAMES}));
  support_write_text("closed.txt", lines);
  support_write_text("blink.txt", "0\n0\n0\n0\n0\n0\n1\n0\n");
  expect_pixels("", "--eye clip/au.csv", FRAMES, true);
  expect_pixels("--fix-eye 1 --frames 6:7", "--eye closed.npy --frames 6:7", 1, true);
  expect_pixels("--fix-eye 1 --frames 6:7", "--eye closed.txt --frames 6:7", 1, true);
  expect_pixels("--fix-eye 0 --frames 6:7", "--fix-eye 1 --frames 6:7", 1, false);
  expect_pixels("--fix-eye 1 --frames 6:7", "--eye blink.txt --frames 6:7", 1, true); /* value 6 is frame 6's */
  expect_pixels("--fix-eye 0 --frames 7:8", "--eye blink.txt --frames 7:8", 1, true);
  expect_pixels("--fix-eye 0 --audio hum.npy", "--eye blink.txt --audio hum.npy", WINDOWS, true);
  ern_context_free(&context);
}

static void test_hold(void **state) {
  (void)state;
  uint8_t *moving = raw("--audio hum.npy --fix-eye 0", WINDOWS);
  uint8_t *held = raw("--audio hum.npy --fix-eye 0 --set hold-pose=3", WINDOWS);
  for (size_t k = 0; k < WINDOWS; k++)
    assert_memory_equal(held + k * PIXEL_BYTES, moving + 3 * PIXEL_BYTES, PIXEL_BYTES);
  assert_true(memcmp(moving, moving + 3 * PIXEL_BYTES, PIXEL_BYTES) != 0);
  free(moving);
  free(held);
  expect_pixels("--set hold-pose=0 --frames 4:6", "--set hold-pose=0 --frames 4:6", 2, true);
  expect_pixels("--set hold-pose=5 --frames 5:6", "--frames 5:6", 1, true); /* its own speech and eyes */
  cli_run(&cli, "render m.safetensors --clip clip --set hold-pose=%d -o x.mp4", FRAMES);
  cli_expect(&cli, 2, "--set hold-pose is 12", "expected 0 to 11", NULL);
}

static void test_rotate(void **state) {
  (void)state;
  expect_pixels("--frames 4:6", "--rotate 0,0 --frames 4:6", 2, true);
  expect_pixels("--frames 4:5", "--rotate 20,0 --frames 4:5", 1, false);
  expect_pixels("--rotate 20,0 --frames 4:5", "--rotate -20,0 --frames 4:5", 1, false);
  expect_pixels("--rotate=0,15 --frames 4:5", "--rotate=0,-15 --frames 4:5", 1, false);
  expect_pixels("--set hold-pose=4 --rotate -20,5 --frames 4:5", "--rotate -20,5 --frames 4:5", 1, true);
}

/* A part of a video is that part of the whole, also where a frame depends on those before it. */
static void test_smooth_lips_long(void **state) {
  (void)state;
  uint8_t *all = raw("--smooth-lips", FRAMES), *part = raw("--smooth-lips --frames 6:9", 3);
  assert_memory_equal(part, all + 6 * PIXEL_BYTES, 3 * PIXEL_BYTES);
  free(part);
  part = raw("--smooth-lips --frames 11:", 1);
  assert_memory_equal(part, all + 11 * PIXEL_BYTES, PIXEL_BYTES);
  free(part);
  free(all);
  all = raw("--smooth-lips --fps 50", 2 * FRAMES);
  part = raw("--smooth-lips --fps 50 --frames 13:16", 3);
  assert_memory_equal(part, all + 13 * PIXEL_BYTES, 3 * PIXEL_BYTES);
  free(part);
  free(all);
  json_t *reports[2];
  for (int i = 0; i < 2; i++) {
    cli_run(&cli, "eval m.safetensors clip --split train --smooth-lips %s --json", i == 0 ? "" : "--frames 6:9");
    cli_expect(&cli, 0, NULL);
    reports[i] = cli_json(&cli, NULL);
  }
  for (size_t k = 0; k < 3; k++) {
    const json_t *whole = json_array_get(json_object_get(reports[0], "frames"), 6 + k);
    const json_t *alone = json_array_get(json_object_get(reports[1], "frames"), k);
    assert_true(json_equal(json_object_get(whole, "psnr"), json_object_get(alone, "psnr")));
  }
  json_decref(reports[0]);
  json_decref(reports[1]);
}

/* Windows of another length than those of the training are other speech to the network. */
static void test_window_length(void **state) {
  (void)state;
  static const char refused[] = "the windows of the speech are 8 vectors long, expected 16";
  ern_context *context = support_context();
  static float half[FRAMES * 8 * 29];
  support_ok(context, ern_npy_write_f32(context, "half.npy", half, 3, (const size_t[]){FRAMES, 8, 29}));
  ern_context_free(&context);
  cli_run(&cli, "render m.safetensors --clip clip --audio half.npy -o bad.mp4");
  cli_expect(&cli, 1, "half.npy", refused, NULL);
  cli_run(&cli, "eval m.safetensors clip --audio half.npy");
  cli_expect(&cli, 1, "half.npy", refused, NULL);
  cli_run(&cli, "train clip --audio half.npy --torso --head m.safetensors -o bad.safetensors --iters 1");
  cli_expect(&cli, 1, "the head was trained on windows of 16 vectors of speech, the clip's have 8", NULL);
  cli_run(&cli,
          "train clip --audio half.npy --effects eye,codes,view --from m.safetensors -o bad.safetensors --iters 50");
  cli_expect(&cli, 1, "m.safetensors: window length is 16, this training expects 8", NULL);
  assert_false(cli_there("bad.mp4") || cli_there("bad.safetensors"));
  /* a .pth does not say, nor does what was made of it: taken */
  cli_run(&cli, "convert m.safetensors m.pth");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "convert m.pth back.safetensors");
  cli_expect(&cli, 0, NULL);
  static const char *const unsaid[] = {"m.pth", "back.safetensors"};
  for (int i = 0; i < 2; i++) {
    support_clear("unsaid.mp4");
    cli_run(&cli, "render %s --clip clip --audio half.npy --frames 0:2 -o unsaid.mp4 --quiet --force", unsaid[i]);
    cli_expect(&cli, 0, NULL);
  }
  cli_run(&cli, "info m.safetensors");
  cli_expect_out(&cli, 0, "29 wide, 16 to a window", NULL);
}

static void test_refused(void **state) {
  (void)state;
  static const char *const cases[][3] = {{"0.5\n0.5\n", "has eyes for 2 frames", "expected at least 12"},
                                         {"0.5\n7\n", "line 2 is 7", "0 to 1"},
                                         {"frame, blink\n1, 0\n", "AU45_r is missing", "found: frame, blink"}};
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    support_write_text("bad.csv", cases[i][0]);
    cli_run(&cli, "render m.safetensors --clip clip --eye bad.csv -o bad.mp4");
    cli_expect(&cli, 1, "ernerf render: bad.csv", cases[i][1], cases[i][2], NULL);
  }
  cli_run(&cli, "synth open --size 64 --frames 8 --no-blink --static-camera --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train open -o open.safetensors --iters 1 --rays 64 --levels 4 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render open.safetensors --clip open --eye closed.txt -o bad.mp4");
  cli_expect(&cli, 1, "open.safetensors", "was trained without eye values", "--eye has no effect", NULL);
  assert_false(cli_there("bad.mp4"));
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_eye_curve),     cmocka_unit_test(test_hold),
                                     cmocka_unit_test(test_rotate),        cmocka_unit_test(test_smooth_lips_long),
                                     cmocka_unit_test(test_window_length), cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, make_model, NULL);
}
