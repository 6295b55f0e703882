/* SPDX-License-Identifier: MIT
 * Sync of drawn and true frames by small networks whose distances are known, and networks and frames that are refused.
 */
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
  cli_run(&cli, "synth clip --size 64 --frames 66 --seed 3 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o m.safetensors --iters 6 --rays 256 --levels 4 --quiet");
  cli_expect(&cli, 0, NULL);
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
  cli_run(&cli, "eval m.safetensors clip %s", both);
  cli_expect_out(&cli, 0, "Sync: confidence 0.323, distance 2.828 at 0 frames", "(35 windows)", NULL);
}

/* The mean of blue over five squares, against silence. */
static void test_what_is_seen(void **state) {
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
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_known_distances), cmocka_unit_test(test_what_is_seen),
                                     cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, train_head, NULL);
}
