/* SPDX-License-Identifier: MIT
 * The whole way by the program: train, stop and go on, torso, render to every kind of output, eval. What is written is
 * decoded and looked at. */
#include "cli.h"

#include <math.h>
#include <time.h>

#include "ernerf/media.h"
#include "io/npy.h"
#include "io/safetensors.h"

enum { SIZE = 64, FRAMES = 22, VAL = 2, STEPS = 40, PIXEL_BYTES = SIZE * SIZE * 4 };
#define HEAD_WORDS "--iters 40 --rays 256 --levels 6 --seed 7 --lr-net 0.004 --save-every 2"

static struct cli cli;

static int make_clip(void **state) {
  (void)state;
  static const char *const old[] = {"clip", "head.safetensors", "head.run", "torso.safetensors", "torso.run"};
  for (size_t i = 0; i < sizeof old / sizeof old[0]; i++) support_clear(old[i]);
  cli_run(&cli, "synth clip --size %d --frames %d --seed 3 --quiet", SIZE, FRAMES);
  cli_expect(&cli, 0, NULL);
  return 0;
}

static void rest(long milliseconds) {
  const struct timespec time = {.tv_nsec = milliseconds * 1000000};
  nanosleep(&time, NULL);
}

static double number(const json_t *object, const char *field) {
  const json_t *value = json_object_get(object, field);
  if (!json_is_number(value)) fail_msg("the field %s is missing or no number", field);
  return json_number_value(value);
}

/* ---- training -----------------------------------------------------------------------------------------------------
 */

/* The same tensors, whatever the metadata says (it counts seconds). all: neither file has any
 * that the other lacks; else b may have more. */
static void same_tensors(const char *a, const char *b, bool all) {
  ern_context *context = support_context();
  struct ern_tensor_file left = {0}, right = {0};
  support_ok(context, ern_safetensors_read(context, a, &left));
  support_ok(context, ern_safetensors_read(context, b, &right));
  if (all) assert_int_equal(left.tensor_count, right.tensor_count);
  assert_true(left.tensor_count > 10);
  for (size_t i = 0; i < left.tensor_count; i++) {
    const struct ern_tensor *one = &left.tensors[i], *other = ern_tensor_file_find(&right, one->name);
    if (other == NULL) fail_msg("%s holds no %s", b, one->name);
    assert_int_equal(one->count, other->count);
    if (memcmp(one->data, other->data, one->count * ern_dtype_bytes(one->dtype)) != 0)
      fail_msg("%s differs between %s and %s", one->name, a, b);
  }
  ern_tensor_file_free(context, &left);
  ern_tensor_file_free(context, &right);
  ern_context_free(&context);
}

static void test_head(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_image picture = {0};
  cli_run(&cli, "train clip -o head.safetensors " HEAD_WORDS " --consent agreed --validate-every 20 --json train.json");
  cli_expect(&cli, 0, "a head from 20 frames of 64 x 64", "aud_ds.npy", "au.csv", "head.run", "step 20: PSNR", "40/40",
             "steps/s", "left", "loss", NULL);
  assert_string_equal(cli.out, "");
  json_t *report = cli_json(&cli, "train.json");
  assert_true(number(report, "step") == STEPS && number(report, "val_frames") == VAL);
  assert_true(number(report, "loss") > 0 && number(report, "samples_per_ray") > 1 && number(report, "seconds") > 0);
  assert_true(number(report, "val_psnr") > 15 && number(report, "psnr") > 10);
  assert_string_equal(json_string_value(json_object_get(report, "output")), "head.safetensors");
  json_decref(report);
  static const char *const files[] = {"head.run/state.safetensors", "head.run/log.jsonl", "head.run/curve.csv",
                                      "head.run/val_000020.png", "head.run/val_000040.png"};
  for (size_t i = 0; i < sizeof files / sizeof files[0]; i++)
    if (!cli_there(files[i])) fail_msg("%s is missing", files[i]);
  support_ok(context, ern_image_read(context, files[4], 3, &picture));
  assert_true(picture.width == 5 * SIZE && picture.height == SIZE);
  ern_image_free(context, &picture);
  ern_context_free(&context);
}

/* Stops a training by a signal as soon as it has saved a state; the step is then well before the last. */
static void stop_training(const char *name, int signal) {
  char path[64];
  snprintf(path, sizeof path, "%s.safetensors", name);
  support_clear(path);
  snprintf(path, sizeof path, "%s.run", name);
  support_clear(path);
  snprintf(path, sizeof path, "%s.run/state.safetensors", name);
  snprintf(cli.line, sizeof cli.line, "train clip -o %s.safetensors %s", name, HEAD_WORDS " --consent agreed");
  cli_start(&cli, NULL, 0);
  for (int i = 0; !cli_there(path) && i < 30000; i++) rest(2);
  assert_int_equal(kill(cli.pid, signal), 0);
  cli_wait(&cli);
}

/* Interrupted, or killed outright, and resumed: the same bytes as in one go. */
static void test_resume_long(void **state) {
  (void)state;
  stop_training("stopped", SIGINT);
  cli_expect(&cli, 128 + SIGINT, "ernerf train: stopped after step", "of 40", "--resume", NULL);
  assert_true(cli_there("stopped.safetensors"));
  cli_run(&cli, "train clip -o stopped.safetensors " HEAD_WORDS " --resume");
  cli_expect(&cli, 0, "40/40", NULL);
  cli_same_bytes("head.safetensors", "stopped.safetensors");
  same_tensors("head.run/state.safetensors", "stopped.run/state.safetensors", true);

  stop_training("killed", SIGKILL);
  cli_expect(&cli, 128 + SIGKILL, NULL);
  cli_run(&cli, "train clip -o killed.safetensors " HEAD_WORDS " --resume --threads 1");
  cli_expect(&cli, 0, NULL);
  cli_same_bytes("head.safetensors", "killed.safetensors");
  same_tensors("head.run/state.safetensors", "killed.run/state.safetensors", true);

  cli_run(&cli, "train clip -o killed.safetensors " HEAD_WORDS " --resume --json -"); /* nothing is left to do */
  cli_expect(&cli, 0, "all 40 steps were done before", NULL);
  json_t *report = cli_json(&cli, NULL);
  assert_true(number(report, "step") == STEPS && json_is_null(json_object_get(report, "loss")));
  json_decref(report);
  cli_same_bytes("head.safetensors", "killed.safetensors");
}

static void test_threads_long(void **state) {
  (void)state;
  static const int threads[] = {1, 2, 4};
  char name[64];
  for (size_t i = 0; i < sizeof threads / sizeof threads[0]; i++) {
    cli_run(&cli,
            "train clip -o t%d.safetensors --iters 17 --rays 128 --levels 4 --validate-frames 1 --threads %d --quiet",
            threads[i], threads[i]);
    cli_expect(&cli, 0, NULL);
    assert_string_equal(cli.err, "");
    snprintf(name, sizeof name, "t%d.safetensors", threads[i]);
    cli_same_bytes("t1.safetensors", name);
  }
  cli_run(&cli, "train clip -o other.safetensors --iters 1 --rays 64 --levels 4 --validate-frames 1 --seed 1 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o first.safetensors --iters 1 --rays 64 --levels 4 --validate-frames 1 --seed 2 --quiet");
  cli_expect(&cli, 0, NULL);
  size_t count = 0, same = 0;
  uint8_t *one = cli_bytes("other.safetensors", &count), *two = cli_bytes("first.safetensors", &same);
  assert_true(count != same || memcmp(one, two, count) != 0); /* the seed does something */
  free(one);
  free(two);
}

static void test_average_long(void **state) {
  (void)state;
  support_clear("few.safetensors"), support_clear("few.run");
  cli_run(&cli, "train clip -o few.safetensors --iters 3 --rays 64 --levels 4 --set ema=yes --set ema-every=1");
  cli_expect(&cli, 1, "3 updates", "expected at least 10", "10 steps in all", NULL);
  assert_false(cli_there("few.safetensors") || cli_there("few.run"));
  cli_run(&cli,
          "train clip -o few.safetensors --iters 10 --rays 64 --levels 4 --validate-frames 1 --set ema=yes --set "
          "ema_every=1 "
          "--save-every 4");
  cli_expect(&cli, 0, "few.safetensors: step 8: the weights as they are", NULL);
  cli_run(
      &cli,
      "train clip -o mean.safetensors --iters 11 --rays 64 --levels 4 --validate-frames 1 --set ema-every=1 --quiet");
  cli_expect(&cli, 0, NULL);
  size_t raw = 0, mean = 0;
  uint8_t *before = cli_bytes("mean.safetensors", &raw);
  cli_run(&cli,
          "train clip -o mean.safetensors --iters 11 --rays 64 --levels 4 --set ema-every=1 --resume --set ema=yes");
  cli_expect(&cli, 0, NULL);
  uint8_t *after = cli_bytes("mean.safetensors", &mean);
  assert_int_equal(raw, mean);
  assert_true(memcmp(before, after, raw) != 0);
  free(before);
  free(after);
}

static void test_torso(void **state) {
  (void)state;
  cli_run(
      &cli,
      "train clip --torso --head head.safetensors -o torso.safetensors --iters 20 --rays 512 --set torso-gamma=yes");
  cli_expect(&cli, 0, "the torso for head.safetensors", "20/20", NULL);
  same_tensors("head.safetensors", "torso.safetensors", false); /* the head stays as it is */
  cli_run(&cli, "info torso.safetensors --json");
  json_t *info = cli_json(&cli, NULL);
  assert_string_equal(json_string_value(json_object_get(info, "kind")), "head+torso");
  assert_true(number(info, "head_steps") == STEPS && number(info, "step") == 20);
  assert_true(json_is_true(json_object_get(info, "torso_gamma")));
  json_decref(info);
  cli_run(&cli, "eval torso.safetensors clip --json --quiet");
  cli_expect(&cli, 0, NULL);
  json_t *report = cli_json(&cli, NULL);
  assert_true(number(report, "psnr") > 10);
  assert_true(number(json_object_get(report, "ms_by_stage"), "torso") > 0);
  json_decref(report);
}

/* ---- video --------------------------------------------------------------------------------------------------------
 */

/* Decodes all frames of a video: checks sizes, times at 25 a second, and that there is a picture. Returns their number.
 */
static size_t look_at_video(const char *path, int width, int height, bool sound) {
  ern_context *context = support_context();
  ern_video_reader *reader = NULL;
  ern_video_info info;
  ern_image image = {0};
  double seconds = 0;
  bool end = false;
  size_t count = 0;
  support_ok(context, ern_video_reader_open(context, path, &reader));
  ern_video_reader_info(reader, &info);
  assert_true(info.width == width && info.height == height);
  assert_true(info.rate_numerator == 25 * info.rate_denominator);
  assert_string_equal(info.video_codec, "h264");
  assert_string_equal(info.pixel_format, "yuv420p");
  assert_true(info.has_sound == sound);
  if (sound) assert_string_equal(info.sound_codec, "aac");
  for (;;) {
    support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
    if (end) break;
    int least = 255, most = 0;
    for (size_t i = 0; i < (size_t)width * (size_t)height * 3; i++) {
      least = image.data[i] < least ? image.data[i] : least;
      most = image.data[i] > most ? image.data[i] : most;
    }
    assert_true(most - least > 40);
    if (fabs(seconds - (double)count / 25) > 1e-6) fail_msg("%s: frame %zu is at %g s", path, count, seconds);
    count++;
  }
  if (fabs(info.duration - (double)count / 25) > 0.03) fail_msg("%s: %g s for %zu frames", path, info.duration, count);
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
  ern_context_free(&context);
  return count;
}

/* Raw RGBA8 of what a line draws; the caller frees them. */
static uint8_t *raw(const char *words, size_t frames) {
  size_t count = 0;
  support_clear("raw.rgba");
  snprintf(cli.line, sizeof cli.line, "render %s -o -", words);
  cli_start(&cli, "raw.rgba", 0);
  cli_wait(&cli);
  cli_expect(&cli, 0, NULL);
  uint8_t *bytes = cli_bytes("raw.rgba", &count);
  if (count != frames * PIXEL_BYTES) fail_msg("%s: %zu bytes, expected %zu", words, count, frames * PIXEL_BYTES);
  return bytes;
}

static void test_video(void **state) {
  (void)state;
  cli_run(&cli, "render head.safetensors --clip clip -o all.mp4 --json render.json");
  cli_expect(&cli, 0, "22 frames of 64 x 64", "with sound", "22/22", NULL);
  assert_int_equal(look_at_video("all.mp4", SIZE, SIZE, true), FRAMES);
  json_t *report = cli_json(&cli, "render.json");
  assert_true(number(report, "frames") == FRAMES && number(report, "fps") > 0 && number(report, "seconds") > 0);
  static const char *const stages[] = {"read", "audio", "torso", "head", "output", "encode"};
  for (size_t i = 0; i < sizeof stages / sizeof stages[0]; i++)
    assert_true(number(json_object_get(report, "ms_by_stage"), stages[i]) >= 0);
  assert_true(json_is_true(json_object_get(report, "sound")));
  json_decref(report);

  cli_run(&cli, "render head.safetensors --clip clip --frames 4:12 --size 75x51 -o part.mp4");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(look_at_video("part.mp4", 76, 52, true), 8); /* odd sides are padded */
  cli_run(&cli, "render head.safetensors --clip clip --split val --threads 1 -o val.mp4 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_string_equal(cli.err, "");
  assert_int_equal(look_at_video("val.mp4", SIZE, SIZE, true), VAL);

  /* another speech: its windows set the length, and its sound is that of --wav alone */
  cli_run(&cli, "render head.safetensors --clip clip --split val --audio clip/aud_ds.npy -o speech.mp4");
  cli_expect(&cli, 0, "without sound", NULL);
  assert_int_equal(look_at_video("speech.mp4", SIZE, SIZE, false), FRAMES);
  cli_run(&cli,
          "render head.safetensors --clip clip --audio clip/aud_ds.npy --wav clip/aud.wav --frames 10: -o wav.mp4");
  cli_expect(&cli, 0, "with sound", NULL);
  assert_int_equal(look_at_video("wav.mp4", SIZE, SIZE, true), FRAMES - 10);

  /* no transparency in an mp4: black, and a word about it */
  cli_run(&cli,
          "render torso.safetensors --poses clip/transforms_val.json --aud clip/aud_ds.npy --frames :3 -o black.mp4");
  cli_expect(&cli, 0, "warning", "transparency", "black", NULL);
  assert_int_equal(look_at_video("black.mp4", SIZE, SIZE, false), 3);

  cli_run(&cli, "render head.safetensors --clip clip --frames 4:23 -o bad.mp4");
  cli_expect(&cli, 2, "4:23", "expected", "22", NULL);
  assert_false(cli_there("bad.mp4"));
}

/* A decoded frame is the picture that was drawn, but for what H.264 loses. */
static void test_video_pixels(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  double seconds = 0, difference = 0;
  bool end = false;
  uint8_t *drawn = raw("head.safetensors --clip clip --split val", VAL);
  support_ok(context, ern_video_reader_open(context, "val.mp4", &reader));
  support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
  assert_false(end);
  for (size_t i = 0; i < SIZE * SIZE; i++)
    for (size_t c = 0; c < 3; c++) difference += fabs((double)image.data[3 * i + c] - drawn[4 * i + c]);
  if (difference / (SIZE * SIZE * 3) > 4) fail_msg("the mean difference is %g of 255", difference / (SIZE * SIZE * 3));
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
  ern_context_free(&context);
  free(drawn);
}

/* How alike `part` is to `whole` from sample `at` on: -1 to 1. First channels, same rate. */
static double likeness(const ern_sound *whole, const ern_sound *part, size_t at) {
  double ab = 0, aa = 1e-9, bb = 1e-9;
  for (size_t i = 0; i < part->frames && at + i < whole->frames; i++) {
    const double a = whole->data[(at + i) * (size_t)whole->channels], b = part->data[i * (size_t)part->channels];
    ab += a * b;
    aa += a * a;
    bb += b * b;
  }
  return ab / sqrt(aa * bb);
}

/* The clip's own sound begins at aud_id/25 s of the first frame. */
static void test_sound(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_sound whole = {0}, part = {0};
  support_ok(context, ern_sound_read(context, "clip/aud.wav", &whole));
  support_ok(context, ern_sound_read(context, "part.mp4", &part));
  assert_int_equal(part.rate, whole.rate);
  if (fabs((double)part.frames / part.rate - 8.0 / 25) > 0.1) fail_msg("%zu samples for 8 frames", part.frames);
  size_t best = 0;
  for (size_t at = 0; at + part.frames / 2 < whole.frames; at++)
    if (likeness(&whole, &part, at) > likeness(&whole, &part, best)) best = at;
  if (fabs((double)best / whole.rate - 4.0 / 25) > 0.005)
    fail_msg("the sound begins at %g s", (double)best / whole.rate);
  assert_true(likeness(&whole, &part, best) > 0.8);
  ern_sound_free(context, &whole);
  ern_sound_free(context, &part);
  ern_context_free(&context);
}

/* The largest seed is told as it was given, in the report and in the state, and a resume knows it again. */
static void test_largest_seed_long(void **state) {
  (void)state;
  static const char seed[] = "18446744073709551615";
  size_t bytes = 0;
  support_clear("seed.safetensors");
  support_clear("seed.run");
  cli_run(&cli,
          "train clip -o seed.safetensors --iters 1 --rays 16 --levels 2 --validate-frames 1 --seed %s --quiet --json",
          seed);
  cli_expect(&cli, 0, NULL);
  json_t *report = cli_json(&cli, NULL);
  assert_string_equal(json_string_value(json_object_get(report, "seed")), seed);
  json_decref(report);
  char *text = (char *)cli_bytes("seed.run/state.safetensors", &bytes);
  assert_non_null(strstr(text + 8, "\\\"seed\\\":\\\"18446744073709551615\\\"")); /* 8: the header's length */
  free(text);
  cli_run(&cli, "train clip -o seed.safetensors --iters 2 --rays 16 --levels 2 --seed %s --resume", seed);
  cli_expect(&cli, 0, seed, NULL);
  assert_null(strstr(cli.err, "seed was"));
  cli_run(&cli, "train clip -o seed.safetensors --iters 3 --rays 16 --levels 2 --seed 5 --resume");
  cli_expect(&cli, 0, "seed was 18446744073709551615, going on with 5", NULL);
}

/* Ctrl-C while drawing: no video. */
static void test_stopped_video(void **state) {
  (void)state;
  support_clear("cut.mp4");
  support_clear("cli_err.txt");
  snprintf(cli.line, sizeof cli.line, "render head.safetensors --clip clip --size 384x384 -o cut.mp4");
  cli_start(&cli, NULL, 0);
  for (int i = 0; i < 1000; i++) {
    cli_read("cli_err.txt", cli.err);
    if (strstr(cli.err, "render: 22 frames") != NULL) break;
    rest(20);
  }
  assert_int_equal(kill(cli.pid, SIGTERM), 0);
  cli_wait(&cli);
  cli_expect(&cli, 128 + SIGTERM, "ernerf render: stopped at frame", "of 22", NULL);
  assert_false(cli_there("cut.mp4"));
}

/* ---- pixels -------------------------------------------------------------------------------------------------------
 */

static void expect_pixels(const uint8_t *reference, const char *words, size_t frames, bool same) {
  uint8_t *found = raw(words, frames);
  if ((memcmp(reference, found, frames * PIXEL_BYTES) == 0) != same)
    fail_msg("%s: the pixels %s those without", words, same ? "differ from" : "are");
  free(found);
}

/* Each of the controls moves something, and only where it should. */
static void test_controls_long(void **state) {
  (void)state;
  uint8_t *plain = raw("head.safetensors --clip clip --frames 6:9", 3);
  for (size_t i = 3; i < 3 * PIXEL_BYTES; i += 4) assert_int_equal(plain[i], 255);
  expect_pixels(plain, "head.safetensors --clip clip --frames 6:9 --threads 1 --set memory=1", 3, true);
  expect_pixels(plain, "head.safetensors --clip clip --split train --frames 6:9", 3, true);
  expect_pixels(plain, "head.safetensors --clip clip --frames 6:9 --smooth-path", 3, false);
  expect_pixels(plain, "head.safetensors --clip clip --frames 6:9 --smooth-lips", 3, false);
  expect_pixels(plain, "head.safetensors --clip clip --frames 6:9 --fix-eye 1", 3, false);
  expect_pixels(plain, "head.safetensors --clip clip --frames 6:9 --bg-img white", 3, false);
  expect_pixels(plain, "head.safetensors --clip clip --frames 6:9 --bg-img clip/bc.jpg", 3, true);
  expect_pixels(plain, "head.safetensors --clip clip --frames 6:9 --scale 3.5", 3, false);
  expect_pixels(plain, "head.safetensors --clip clip --frames 6:9 --max-steps 8", 3, false);
  expect_pixels(plain, "head.safetensors --clip clip --frames 6:9 --audio clip/aud_ds.npy", 3,
                true); /* aud_id = frame */
  free(plain);
}

/* Poses go forward and back; with the same speech everywhere a pose draws the same frame. */
static void test_replay(void **state) {
  (void)state;
  enum { WINDOWS = 5, VALUES = WINDOWS * 16 * 29 };
  static float silence[VALUES];
  ern_context *context = support_context();
  for (size_t i = 0; i < VALUES; i++) silence[i] = 0.03f;
  support_ok(context, ern_npy_write_f32(context, "still.npy", silence, 3, (const size_t[]){WINDOWS, 16, 29}));
  ern_context_free(&context);
  uint8_t *frames = raw("torso.safetensors --poses clip/transforms_val.json --audio still.npy", WINDOWS);
  const uint8_t *first = frames, *second = frames + PIXEL_BYTES;
  assert_true(memcmp(first, second, PIXEL_BYTES) != 0);
  assert_memory_equal(first, frames + 2 * PIXEL_BYTES, PIXEL_BYTES);
  assert_memory_equal(second, frames + 3 * PIXEL_BYTES, PIXEL_BYTES);
  assert_memory_equal(first, frames + 4 * PIXEL_BYTES, PIXEL_BYTES);
  bool clear = false;
  for (size_t i = 3; i < PIXEL_BYTES; i += 4) clear |= frames[i] < 255;
  assert_true(clear); /* no background: transparent */
  free(frames);
}

static void test_pictures(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_image image = {0};
  support_clear("out");
  assert_int_equal(mkdir("out", 0777), 0);
  cli_run(&cli, "render head.safetensors --clip clip --frames 4:6 -o out/%%05d.png --quiet");
  cli_expect(&cli, 0, NULL);
  assert_true(cli_count("out") == 3 && cli_there("out/00004.png") && cli_there("out/all.png.provenance.json"));
  support_ok(context, ern_image_read(context, "out/00005.png", 4, &image));
  assert_true(image.width == SIZE && image.height == SIZE);
  uint8_t *pixels = raw("head.safetensors --clip clip --frames 5:6", 1);
  assert_memory_equal(image.data, pixels, PIXEL_BYTES);
  free(pixels);
  ern_image_free(context, &image);

  cli_run(&cli, "render head.safetensors --clip clip --frames 4:5 --size 40x30 -o out/a%%d.exr");
  cli_expect(&cli, 0, "40 x 30", NULL);
  size_t count = 0;
  int width = 0, height = 0;
  support_ok(context, ern_image_size(context, "out/a4.exr", &width, &height));
  assert_true(width == 40 && height == 30);
  uint8_t *bytes = cli_bytes("out/a4.exr", &count);
  static const char *const names[] = {"audio_attention", "eye_attention", "channels"};
  for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
    bool there = false;
    for (size_t k = 0; !there && k + strlen(names[i]) < count && k < 4096; k++)
      there = memcmp(bytes + k, names[i], strlen(names[i])) == 0;
    if (!there) fail_msg("out/a4.exr holds no %s", names[i]);
  }
  free(bytes);
  ern_context_free(&context);
}

/* ---- eval ---------------------------------------------------------------------------------------------------------
 */

static void test_eval(void **state) {
  (void)state;
  cli_run(&cli, "eval head.safetensors clip --json eval.json");
  cli_expect_out(&cli, 0, "PSNR", "SSIM", "mean", "frames a second", "head.safetensors", NULL);
  json_t *report = cli_json(&cli, "eval.json"), *trained = cli_json(&cli, "train.json");
  static const char *const fields[] = {"psnr", "ssim", "psnr_head", "psnr_mouth", "fps", "ms_per_frame"};
  for (size_t i = 0; i < sizeof fields / sizeof fields[0]; i++) assert_true(number(report, fields[i]) > 0);
  static const char *const stages[] = {"audio", "torso", "head", "output"};
  for (size_t i = 0; i < sizeof stages / sizeof stages[0]; i++)
    assert_true(number(json_object_get(report, "ms_by_stage"), stages[i]) >= 0);
  size_t count = 0;
  free(cli_bytes("head.safetensors", &count));
  assert_true(number(report, "model_bytes") == (double)count);
  assert_true(number(report, "param_bytes") < (double)count);
  const json_t *frames = json_object_get(report, "frames");
  assert_int_equal(json_array_size(frames), VAL);
  static const char *const each[] = {"psnr", "ssim", "psnr_head", "psnr_mouth"};
  for (size_t i = 0; i < sizeof each / sizeof each[0]; i++) {
    const double mean = (number(json_array_get(frames, 0), each[i]) + number(json_array_get(frames, 1), each[i])) / VAL;
    assert_true(fabs(mean - number(report, each[i])) < 1e-9);
  }
  assert_true(number(json_array_get(frames, 0), "id") == FRAMES - VAL && number(json_array_get(frames, 0), "ms") > 0);
  /* the training's own validation looked at the same frames */
  assert_true(fabs(number(report, "psnr") - number(trained, "val_psnr")) < 1e-9);
  const double edge = number(report, "psnr");
  json_decref(report);
  json_decref(trained);

  cli_run(&cli, "eval head.safetensors clip --json --split all --frames 2:5");
  report = cli_json(&cli, NULL);
  assert_int_equal(json_array_size(json_object_get(report, "frames")), 3);
  assert_true(number(json_array_get(json_object_get(report, "frames"), 0), "id") == 2);
  json_decref(report);
  cli_run(&cli, "eval head.safetensors clip --json --set audio-pad=zero");
  report = cli_json(&cli, NULL);
  assert_true(number(report, "psnr") != edge);
  json_decref(report);

  cli_copy("clip", "faceless");
  support_clear("faceless/ori_imgs");
  cli_run(&cli, "eval head.safetensors faceless --json");
  report = cli_json(&cli, NULL);
  assert_true(json_is_null(json_object_get(report, "psnr_head")) &&
              json_is_null(json_object_get(report, "psnr_mouth")));
  assert_true(fabs(number(report, "psnr") - edge) < 1e-9);
  json_decref(report);
}

/* PSNR of a head that PyTorch trained, as PyTorch measured it (parity/README.md), in dB to two places. Its edge repeats
 * the nearest window of the split, ours takes the neighbours from the whole file, so the first frames differ a little.
 */
static void test_eval_of_pytorch(void **state) {
  (void)state;
  char model[1024], clip[1024];
  static const struct {
    const char *pad;
    double mean, first, tolerance;
  } known[] = {{"zero", 30.65, 23.94, 0.01}, {"edge", 32.12, 32.73, 0.05}};
  support_shared("parity/head.safetensors", model);
  support_shared("parity/clip", clip);
  for (size_t i = 0; i < sizeof known / sizeof known[0]; i++) {
    cli_run(&cli, "eval '%s' '%s' --json --set audio-pad=%s", model, clip, known[i].pad);
    json_t *report = cli_json(&cli, NULL);
    const double first = number(json_array_get(json_object_get(report, "frames"), 0), "psnr");
    if (fabs(number(report, "psnr") - known[i].mean) > known[i].tolerance ||
        fabs(first - known[i].first) > known[i].tolerance)
      fail_msg("%s: %g dB, the first frame %g dB", known[i].pad, number(report, "psnr"), first);
    json_decref(report);
  }
}

/* A clip without a blink signal makes a model without eyes to move. */
static void test_no_blink_long(void **state) {
  (void)state;
  support_clear("open");
  cli_run(&cli, "synth open --size 64 --frames 8 --no-blink --static-camera --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train open -o open.safetensors --iters 1 --rays 64 --levels 4");
  cli_expect(&cli, 0, "no au.csv", NULL);
  cli_run(&cli, "render open.safetensors --clip open --fix-eye 0.5 -o eye.mp4");
  cli_expect(&cli, 1, "open.safetensors", "--fix-eye", NULL);
  assert_false(cli_there("eye.mp4"));
  cli_run(&cli, "info open.safetensors --json");
  json_t *info = cli_json(&cli, NULL);
  const json_t *effects = json_object_get(info, "effects");
  for (size_t i = 0; i < json_array_size(effects); i++)
    assert_string_not_equal(json_string_value(json_array_get(effects, i)), "eye");
  json_decref(info);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_head),          cmocka_unit_test(test_resume_long),
                                     cmocka_unit_test(test_threads_long),  cmocka_unit_test(test_average_long),
                                     cmocka_unit_test(test_torso),         cmocka_unit_test(test_video),
                                     cmocka_unit_test(test_video_pixels),  cmocka_unit_test(test_sound),
                                     cmocka_unit_test(test_stopped_video), cmocka_unit_test(test_controls_long),
                                     cmocka_unit_test(test_replay),        cmocka_unit_test(test_pictures),
                                     cmocka_unit_test(test_eval),          cmocka_unit_test(test_eval_of_pytorch),
                                     cmocka_unit_test(test_no_blink_long), cmocka_unit_test(test_largest_seed_long)};
  return cmocka_run_group_tests(tests, make_clip, NULL);
}
