/* SPDX-License-Identifier: MIT
 * Sync of drawn and true frames by small networks whose distances are known; the settings of the paper; networks,
 * frames and words that are refused. */
#include "../made_onnx.h"
#include "cli.h"

#include <math.h>

#include "ernerf/media.h"

static struct cli cli;
enum { SIDE = 64, POINTS = 68, SPAN = 5, CROP = 16, WINDOWS = 35 };
static const size_t video[] = {1, 3, SPAN, CROP, CROP, 0}, audio[] = {1, 1, 13, 20, 0};
static const char both[] = "--syncnet-video v.onnx --syncnet-audio a.onnx --split train --frames 0:40";

static int train_head(void **state) {
  (void)state;
  size_t count = 0;
  cli_shared_clip("long", "clip");
  uint8_t *bytes = cli_bytes("clip/aud.wav", &count);
  cli_replace("clip/aud.wav", bytes, count); /* a link leads out of the clip: the sound would not be the clip's own */
  free(bytes);
  cli_shared_model("long_head", "m");
  return 0;
}

/* `width` numbers that are `bias`, the first of them and `weight` times the sum of the first `taken` inputs. */
static void make_embedding(const char *path, const size_t *shape, float weight, size_t taken, size_t width,
                           float bias) {
  struct made_message graph = {0};
  size_t count = 1;
  for (size_t d = 0; shape[d] != 0; d++) count *= shape[d];
  float *weights = calloc(count * width, sizeof *weights), biases[8];
  assert_non_null(weights);
  for (size_t i = 0; i < taken; i++) weights[i * width] = weight;
  for (size_t i = 0; i < width; i++) biases[i] = bias;
  made_weight(&graph, "W", (const size_t[]){count, width, 0}, weights);
  made_weight(&graph, "B", (const size_t[]){1, width, 0}, biases);
  made_node(&graph, "Flatten", "given", "flat", NULL);
  made_node(&graph, "MatMul", "flat W", "wide", NULL);
  made_node(&graph, "Add", "wide B", "embedding", NULL);
  made_value(&graph, 11, "given", shape);
  made_value(&graph, 12, "embedding", (const size_t[]){1, width, 0});
  made_onnx(path, &graph);
  free(weights);
}

static json_t *evaluate(void) {
  cli_run(&cli, "eval m.safetensors clip %s --json r.json -y --quiet", both);
  cli_expect(&cli, 0, NULL);
  return cli_json(&cli, "r.json");
}

static double number(const json_t *report, const char *side, const char *name) {
  const json_t *sync = json_object_get(json_object_get(report, "metrics"), "sync");
  const json_t *value = json_object_get(side != NULL ? json_object_get(sync, side) : sync, name);
  assert_true(json_is_number(value));
  return json_number_value(value);
}

static void expect_near(double found, double expected, double apart) {
  if (!(fabs(found - expected) <= apart)) fail_msg("%.9g, expected %.9g to %g", found, expected, apart);
}

/* Mean of blue over a true frame's square, by docs/evaluation.md without the median over time. */
static double blue_of(long id) {
  ern_context *context = support_context();
  ern_image image = {0};
  double low[2] = {1e9, 1e9}, high[2] = {-1e9, -1e9}, sum = 0, count = 0;
  char path[64];
  snprintf(path, sizeof path, "clip/ori_imgs/%ld.lms", id);
  FILE *file = fopen(path, "r");
  assert_non_null(file);
  for (size_t k = 0; k < 2 * POINTS; k++) {
    double value = 0;
    assert_int_equal(fscanf(file, "%lf", &value), 1);
    low[k % 2] = fmin(low[k % 2], value);
    high[k % 2] = fmax(high[k % 2], value);
  }
  fclose(file);
  low[1] -= 0.25 * (high[1] - low[1]);
  const double half = 0.5 * fmax(high[0] - low[0], high[1] - low[1]), x = 0.5 * (low[0] + high[0]);
  const double y = 0.5 * (low[1] + high[1]);
  snprintf(path, sizeof path, "clip/gt_imgs/%ld.jpg", id);
  support_ok(context, ern_image_read(context, path, 3, &image));
  for (double v = y - half; v < y + 1.8 * half; v += 0.25)
    for (double u = x - 1.4 * half; u < x + 1.4 * half; u += 0.25, count++)
      sum += u >= 0 && v >= 0 && u < SIDE && v < SIDE ? image.data[3 * ((long)v * SIDE + (long)u) + 2] : 110;
  ern_image_free(context, &image);
  ern_context_free(&context);
  return sum / count;
}

static void test_known_distances(void **state) {
  (void)state;
  if (!ERN_VISION) skip();
  make_embedding("v.onnx", video, 0, 0, 2, 3);
  make_embedding("a.onnx", audio, 0, 0, 2, 1);
  json_t *report = evaluate();
  const double there = sqrt(8), gone = sqrt(18); /* (3, 3) from (1, 1); from nothing */
  expect_near(number(report, NULL, "windows"), WINDOWS, 0);
  expect_near(number(report, "drawn", "distance"), there, 1e-5);
  expect_near(number(report, "drawn", "offset"), 0, 0);
  /* the median of the shifts 0 to 15 each way is one of 8 */
  expect_near(number(report, "truth", "confidence"), 8.0 / WINDOWS * (gone - there), 1e-5);
  json_decref(report);
  cli_expect_out(&cli, 0, "Sync: confidence 0.323, distance 2.828 at 0 frames", "(35 windows)", NULL);
}

/* The mean of blue over five squares, against silence. */
static void test_what_is_seen_long(void **state) {
  (void)state;
  if (!ERN_VISION) skip();
  double blue = 0;
  make_embedding("v.onnx", video, 1.0f / (SPAN * CROP * CROP), SPAN * CROP * CROP, 1, 0);
  make_embedding("a.onnx", audio, 0, 0, 1, 0);
  json_t *report = evaluate();
  for (long i = 0; i < WINDOWS; i++)
    for (long k = 0; k < SPAN; k++) blue += blue_of(i + k) / (SPAN * WINDOWS);
  expect_near(number(report, "truth", "distance"), blue, 2); /* grey levels: the square is sampled 16 x 16 times */
  expect_near(number(report, "truth", "confidence"), 0, 1e-9);
  assert_true(fabs(number(report, "drawn", "distance") - blue) > 4); /* the head was hardly trained */
  json_decref(report);
}

/* ---- settings ---------------------------------------------------------------------------------------------------- */

static void expect_setting(const char *options, const char *setting, const char *split) {
  cli_run(&cli, "eval h.safetensors clip %s --frames 0:2 --json r.json -y --quiet", options);
  cli_expect(&cli, 0, NULL);
  json_t *report = cli_json(&cli, "r.json");
  const json_t *found = json_object_get(report, "setting");
  assert_non_null(found);
  if (setting == NULL ? !json_is_null(found) : strcmp(json_string_value(found), setting) != 0)
    fail_msg("%s: the setting is \"%s\"", options, json_is_string(found) ? json_string_value(found) : "null");
  assert_string_equal(json_string_value(json_object_get(report, "split")), split);
  json_decref(report);
}

/* The clip's sound backwards: as long as some frames, from one of them on. */
static void make_sound(const char *path, size_t first, size_t frames) {
  ern_context *context = support_context();
  ern_sound sound = {0};
  support_ok(context, ern_sound_read(context, "clip/aud.wav", &sound));
  for (size_t i = 0, j = sound.frames - 1; i < j; i++, j--) {
    const int16_t value = sound.data[i];
    assert_int_equal(sound.channels, 1);
    sound.data[i] = sound.data[j];
    sound.data[j] = value;
  }
  const size_t begin = first * (size_t)sound.rate / 25;
  sound.frames = frames * (size_t)sound.rate / 25;
  memmove(sound.data, sound.data + begin, sound.frames * sizeof *sound.data);
  support_ok(context, ern_sound_write_wav(context, path, &sound));
  ern_sound_free(context, &sound);
  ern_context_free(&context);
}

/* `other` has the sound of 40 of the 66 frames. */
static void make_other(void) {
  if (cli_there("other")) return;
  cli_run(&cli,
          "train clip -o h.safetensors --iters 6 --rays 256 --levels 4 --asr-model cepstra --validate-frames 1 "
          "--quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(mkdir("other", 0777), 0);
  make_sound("other/aud.wav", 20, 40);
}

static void test_setting_names_long(void **state) {
  (void)state;
  make_other();
  expect_setting("", "reconstruction", "val");
  expect_setting("--setting reconstruction", "reconstruction", "val");
  expect_setting("--split train", NULL, "train");
  expect_setting("--audio other/aud.wav", NULL, "val");
  expect_setting("--setting synchronization --audio other/aud.wav", "synchronization", "all");
  expect_setting("--setting synchronization --audio other/aud.wav --split train", "synchronization", "train");
  cli_run(&cli, "eval h.safetensors clip --setting reconstruction");
  cli_expect_out(&cli, 0, "setting: reconstruction", NULL);
}

/* What compares with true frames is null, an empty field or a line with the reason; what does not is there. */
static void test_synchronization(void **state) {
  (void)state;
  static const char *const gone[] = {"psnr", "ssim", "psnr_head", "psnr_mouth"}, *const reasons[] = {
                                                                                     "psnr",      "ssim",
                                                                                     "psnr_head", "psnr_mouth",
                                                                                     "measures",  "sync.truth",
                                                                                     "lpips",     "lmd",
                                                                                     "aue"};
  char networks[80] = "";
  size_t bytes = 0;
  make_other();
  if (ERN_VISION) {
    make_embedding("v.onnx", video, 0, 0, 2, 3);
    make_embedding("a.onnx", audio, 0, 0, 2, 1);
    snprintf(networks, sizeof networks, "--syncnet-video v.onnx --syncnet-audio a.onnx");
  }
  cli_run(&cli,
          "eval h.safetensors clip --setting synchronization --audio other/aud.wav --json r.json --csv o.csv -y %s",
          networks);
  cli_expect(&cli, 0, "lasts for 40 frames; the 26 frames after that are left out", NULL);
  assert_non_null(strstr(cli.out, "setting: synchronization"));
  assert_non_null(
      strstr(cli.out, "PSNR, SSIM, mouth, sharpness, seam, tremble: not computed: needs frames that were recorded"));
  assert_non_null(strstr(cli.out, "LPIPS: not computed: needs frames that were recorded"));
  json_t *report = cli_json(&cli, "r.json");
  const json_t *metrics = json_object_get(report, "metrics"), *absent = json_object_get(metrics, "not_computed"), *row;
  assert_int_equal(json_integer_value(json_object_get(report, "count")), 40);
  size_t k;
  json_array_foreach(json_object_get(report, "frames"), k, row) {
    assert_int_equal(json_integer_value(json_object_get(row, "id")), k);
    for (size_t i = 0; i < 4; i++) assert_true(json_is_null(json_object_get(row, gone[i])));
    assert_true(json_number_value(json_object_get(row, "ms")) > 0);
  }
  for (size_t i = 0; i < 4; i++) assert_true(json_is_null(json_object_get(report, gone[i])));
  for (size_t i = 0; i < sizeof reasons / sizeof *reasons; i++)
    if (strstr(json_string_value(json_object_get(absent, reasons[i])), "needs frames that were recorded") == NULL)
      fail_msg("no reason why %s is not there", reasons[i]);
  if (ERN_VISION) {
    expect_near(number(report, NULL, "windows"), 35, 0);
    expect_near(number(report, "drawn", "distance"), sqrt(8), 1e-5);
    assert_true(json_is_null(json_object_get(json_object_get(metrics, "sync"), "truth")));
    assert_null(strstr(cli.out, "of the recorded frames"));
  }
  json_decref(report);
  char *csv = (char *)cli_bytes("o.csv", &bytes);
  assert_non_null(strstr(csv, "\n0,train,,,,,"));
  free(csv);
}

/* Sync hears the speech that is given, and no other. */
static void test_other_speech_is_heard_long(void **state) {
  (void)state;
  if (!ERN_VISION) skip();
  make_other();
  make_embedding("v.onnx", video, 0, 0, 1, 0);
  make_embedding("a.onnx", audio, 1.0f / 260, 260, 1, 0); /* the mean of the cepstra */
  double distance[2];
  static const char *const speech[] = {"other/aud.wav", "longer.wav"};
  make_sound("longer.wav", 0, 66);
  for (size_t i = 0; i < 2; i++) {
    cli_run(&cli,
            "eval h.safetensors clip --setting synchronization --audio %s --frames 0:40 --syncnet-video v.onnx "
            "--syncnet-audio a.onnx --json r.json -y --quiet",
            speech[i]);
    cli_expect(&cli, 0, NULL);
    json_t *report = cli_json(&cli, "r.json");
    distance[i] = number(report, "drawn", "distance");
    json_decref(report);
  }
  assert_true(fabs(distance[0] - distance[1]) > 1e-3);
}

static void test_setting_refused(void **state) {
  (void)state;
  static const struct {
    const char *options, *first, *second;
  } wrong[] = {
      {"--setting synchronization", "needs --audio", NULL},
      {"--setting reconstruction --audio other/aud.wav", "--audio", "--setting synchronization"},
      {"--setting reconstruction --split all", "--split is all", "expected val"},
      {"--setting other", "other", "reconstruction"},
      {"--setting synchronization --audio other/aud.wav --sheet s.png", "--sheet", "recorded with the speech"},
      {"--setting synchronization --audio other/aud.wav --refine-poses", "--refine-poses", "recorded with the speech"},
      {"--setting synchronization --audio other/aud.wav --landmarks x", "--landmarks", "recorded with the speech"},
      {"--setting synchronization --audio other/aud.wav --lpips-network x --lpips-heads y", "--lpips-network",
       "recorded with the speech"}};
  make_other();
  for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
    cli_run(&cli, "eval h.safetensors clip %s --json none.json", wrong[i].options);
    cli_expect(&cli, 2, wrong[i].first, wrong[i].second, NULL);
    assert_false(cli_there("none.json"));
  }
  cli_run(&cli, "eval h.safetensors clip --setting synchronization --audio clip/aud.wav --json none.json");
  cli_expect(&cli, 1, "clip/aud.wav", "the clip's own speech", NULL);
  assert_int_equal(link("clip/aud.wav", "linked.wav"), 0);
  cli_run(&cli, "eval h.safetensors clip --setting synchronization --audio linked.wav --json none.json");
  cli_expect(&cli, 1, "linked.wav", "the clip's own speech", NULL);
  cli_run(&cli, "eval h.safetensors clip --setting synchronization --audio other/aud.wav --split val --json none.json");
  cli_expect(&cli, 1, "other/aud.wav: lasts for 40 frames", NULL);
  assert_false(cli_there("none.json"));
}

static void refused(const char *options, const char *word, const char *other) {
  cli_run(&cli, "eval m.safetensors clip %s --json none.json", options);
  cli_expect(&cli, 1, word, other, NULL);
  assert_false(cli_there("none.json"));
}

static void test_refused(void **state) {
  (void)state;
  cli_run(&cli, "eval m.safetensors clip --syncnet-video v.onnx");
  cli_expect(&cli, 2, "--syncnet-audio", NULL);
  if (!ERN_VISION) skip();
  make_embedding("v.onnx", video, 0, 0, 2, 3);
  make_embedding("a.onnx", audio, 0, 0, 1, 1);
  refused("--syncnet-video v.onnx --syncnet-audio a.onnx", "6 frames", "expected 30");
  refused(both, "v.onnx", "expected as many as the other");
  char line[200];
  snprintf(line, sizeof line, "%s --audio clip/aud_ds.npy", both);
  if (cli_there("clip/aud_ds.npy")) refused(line, "aud_ds.npy", "expected a sound");
  make_embedding("a.onnx", video, 0, 0, 2, 3);
  refused(both, "a.onnx", "expected [1, 1, 13, 20]");
  make_embedding("v.onnx", audio, 0, 0, 2, 3);
  refused(both, "v.onnx", "expected [1, 3, 5, side, side]");
  support_write_text("v.onnx", "no network");
  refused(both, "v.onnx", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_known_distances),
                                     cmocka_unit_test(test_what_is_seen_long),
                                     cmocka_unit_test(test_setting_names_long),
                                     cmocka_unit_test(test_synchronization),
                                     cmocka_unit_test(test_other_speech_is_heard_long),
                                     cmocka_unit_test(test_setting_refused),
                                     cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, train_head, NULL);
}
