/* SPDX-License-Identifier: MIT
 * The metrics of the paper's tables: LMD by files and by a network, AUE by tables, each held against the test's own
 * sums, and files that are refused. */
#include "../made_onnx.h"
#include "cli.h"

#include <math.h>

#include "ernerf/media.h"

static struct cli cli;
enum { SIDE = 64, MOST = 64, POINTS = 68, UNITS = 17 };
static const char *const units[UNITS] = {"AU01_r", "AU02_r", "AU04_r", "AU05_r", "AU06_r", "AU07_r",
                                         "AU09_r", "AU10_r", "AU12_r", "AU14_r", "AU15_r", "AU17_r",
                                         "AU20_r", "AU23_r", "AU25_r", "AU26_r", "AU45_r"};

static size_t frames;  /* that are evaluated */
static long ids[MOST]; /* theirs */

static json_t *evaluate(const char *options) {
  cli_run(&cli, "eval m.safetensors clip %s --json r.json -y --quiet", options);
  cli_expect(&cli, 0, NULL);
  return cli_json(&cli, "r.json");
}

static int train_head(void **state) {
  (void)state;
  cli_shared_clip("long", "clip");
  cli_shared_model("long_head", "m");
  json_t *report = evaluate("");
  const json_t *list = json_object_get(report, "frames"), *row;
  size_t k;
  json_array_foreach((json_t *)list, k, row) ids[frames++] = (long)json_integer_value(json_object_get(row, "id"));
  assert_true(frames >= 5 && frames < MOST);
  json_decref(report);
  return 0;
}

static double number(const json_t *report, const char *metric, const char *name) {
  const json_t *value = json_object_get(json_object_get(json_object_get(report, "metrics"), metric), name);
  if (!json_is_number(value)) fail_msg("metrics.%s.%s is no number", metric, name);
  return json_number_value(value);
}

static void expect_near(double found, double expected, double apart) {
  if (!(fabs(found - expected) <= apart)) fail_msg("%.9g, expected %.9g to %g", found, expected, apart);
}

/* ---- nothing brought --------------------------------------------------------------------------------------------- */

static void test_absent(void **state) {
  (void)state;
  static const char *const metrics[] = {"lmd", "aue", "fid", "sync"};
  json_t *report = evaluate("");
  const json_t *made = json_object_get(report, "metrics"), *needs = json_object_get(made, "not_computed");
  for (size_t i = 0; i < sizeof metrics / sizeof *metrics; i++) {
    assert_true(json_is_null(json_object_get(made, metrics[i])));
    assert_true(json_string_length(json_object_get(needs, metrics[i])) > 10);
  }
  json_decref(report);
  cli_run(&cli, "eval m.safetensors clip");
  cli_expect_out(&cli, 0, "LMD: not computed: needs --landmarks", "AUE: not computed: needs --action-units",
                 "FID: not computed: ", "Sync: not computed: ", NULL);
}

/* ---- LMD --------------------------------------------------------------------------------------------------------- */

static void read_points(const char *folder, long id, double points[POINTS][2]) {
  char path[128];
  snprintf(path, sizeof path, "%s/%ld.lms", folder, id);
  FILE *file = fopen(path, "r");
  assert_non_null(file);
  for (size_t k = 0; k < POINTS; k++) assert_int_equal(fscanf(file, "%lf %lf", &points[k][0], &points[k][1]), 2);
  fclose(file);
}

static void write_points(const char *folder, long id, double points[POINTS][2]) {
  char path[128];
  snprintf(path, sizeof path, "%s/%ld.lms", folder, id);
  FILE *file = fopen(path, "w");
  assert_non_null(file);
  for (size_t k = 0; k < POINTS; k++) fprintf(file, "%.3f %.3f\n", points[k][0], points[k][1]);
  assert_int_equal(fclose(file), 0);
}

/* The definition, written once more: centres first, then the mean of the distances. */
static double distance(double a[POINTS][2], double b[POINTS][2], size_t begin) {
  double at[2][2] = {{0}}, sum = 0;
  for (size_t k = begin; k < POINTS; k++)
    for (size_t c = 0; c < 2; c++) at[0][c] += a[k][c], at[1][c] += b[k][c];
  for (size_t k = begin; k < POINTS; k++) {
    double square = 0;
    for (size_t c = 0; c < 2; c++)
      square += pow(a[k][c] - at[0][c] / (double)(POINTS - begin) - b[k][c] + at[1][c] / (double)(POINTS - begin), 2);
    sum += sqrt(square);
  }
  return sum / (double)(POINTS - begin);
}

static void test_landmark_files(void **state) {
  (void)state;
  double mouth = 0, face = 0, first = 0, a[POINTS][2], b[POINTS][2];
  uint32_t seed = 5;
  support_clear("drawn");
  assert_int_equal(mkdir("drawn", 0777), 0);
  for (size_t i = 0; i < frames; i++) {
    read_points("clip/ori_imgs", ids[i], b);
    for (size_t k = 0; k < POINTS; k++)
      for (size_t c = 0; c < 2; c++) {
        seed = seed * 1664525u + 1013904223u;
        a[k][c] = b[k][c] + 3 + floor(seed / 4294967296.0 * 4000) / 1000; /* the 3 is a shift, which does not count */
      }
    write_points("drawn", ids[i], a);
    mouth += distance(a, b, 48) / (double)frames;
    face += distance(a, b, 0) / (double)frames;
    if (i == 0) first = distance(a, b, 48);
  }
  json_t *report = evaluate("--landmarks drawn --csv t.csv");
  expect_near(number(report, "lmd", "mouth"), mouth, 1e-3); /* of files with 3 digits, as float */
  expect_near(number(report, "lmd", "face"), face, 1e-3);
  expect_near(number(report, "lmd", "frames"), (double)frames, 0);
  expect_near(number(report, "lmd", "left_out"), 0, 0);
  assert_true(number(report, "lmd", "interval95_mouth") > 0);
  json_decref(report);
  size_t bytes = 0;
  char *table = (char *)cli_bytes("t.csv", &bytes), *line = strchr(table, '\n') + 1;
  assert_true(strncmp(table, "frame,split,psnr,ssim,psnr_head,psnr_mouth,ms,lmd_mouth,lmd_face\n", 65) == 0);
  for (int i = 0; i < 7; i++) line = strchr(line, ',') + 1;
  expect_near(strtod(line, NULL), first, 1e-3);
  free(table);
  cli_run(&cli, "eval m.safetensors clip --landmarks drawn");
  cli_expect_out(&cli, 0, "LMD: mouth ", " pixels (", NULL);
  for (size_t i = 0; i < frames; i++) { /* named after the pictures of `render --split val -o drawn/%05d.png` */
    char by_id[64], by_number[64];
    snprintf(by_id, sizeof by_id, "drawn/%ld.lms", ids[i]);
    snprintf(by_number, sizeof by_number, "drawn/%05zu.lms", i);
    assert_int_equal(rename(by_id, by_number), 0);
  }
  report = evaluate("--landmarks drawn");
  expect_near(number(report, "lmd", "mouth"), mouth, 1e-3);
  json_decref(report);
}

/* A point is at its share of a square of 1.25 times the face's longer side, and those of the mouth go to and fro with
 * the mean of red in that square: `gain` of its side for red of 1. */
enum { INPUT = 32 };
static const double gain = 0.3;

static void square_of(double points[POINTS][2], long square[3]) {
  double low[2] = {1e9, 1e9}, high[2] = {-1e9, -1e9};
  for (size_t k = 0; k < 2 * POINTS; k++) {
    low[k % 2] = fmin(low[k % 2], points[k / 2][k % 2]);
    high[k % 2] = fmax(high[k % 2], points[k / 2][k % 2]);
  }
  square[2] = lrint(1.25 * fmax(high[0] - low[0], high[1] - low[1]));
  for (size_t c = 0; c < 2; c++) square[c] = lrint(0.5 * (low[c] + high[c]) - 0.5 * (double)square[2]);
}

static double red_of(const char *path, const long square[3]) {
  ern_context *context = support_context();
  ern_image image = {0};
  double sum = 0;
  support_ok(context, ern_image_read(context, path, 3, &image));
  for (long y = square[1]; y < square[1] + square[2]; y++)
    for (long x = square[0]; x < square[0] + square[2]; x++)
      if (x >= 0 && y >= 0 && x < SIDE && y < SIDE) sum += image.data[3 * (y * SIDE + x)];
  ern_image_free(context, &image);
  ern_context_free(&context);
  return sum / 255 / (double)(square[2] * square[2]);
}

static void make_network(const char *path, size_t count) {
  struct made_message graph = {0};
  float weights[2 * POINTS * 3] = {0}, bias[2 * POINTS] = {0};
  double points[POINTS][2];
  long square[3];
  char picture[64];
  read_points("clip/ori_imgs", ids[0], points);
  square_of(points, square);
  snprintf(picture, sizeof picture, "clip/gt_imgs/%ld.jpg", ids[0]);
  const double red = red_of(picture, square);
  for (size_t k = 0; k < POINTS; k++)
    for (size_t c = 0; c < 2; c++) {
      const double way = k < 48 ? 0 : k % 2 != 0 ? gain : -gain;
      weights[3 * (2 * k + c)] = (float)way;
      bias[2 * k + c] = (float)((points[k][c] - (double)square[c]) / (double)square[2] - way * red);
    }
  made_weight(&graph, "W", (const size_t[]){2 * count, 3, 1, 1, 0}, weights);
  made_weight(&graph, "B", (const size_t[]){2 * count, 0}, bias);
  made_node(&graph, "GlobalAveragePool", "face", "mean", NULL);
  made_node(&graph, "Conv", "mean W B", "wide",
            (const struct made_attribute[]){{"kernel_shape", 2, {1, 1}}, {NULL, 0, {0}}});
  made_node(&graph, "Flatten", "wide", "points", NULL);
  made_value(&graph, 11, "face", (const size_t[]){1, 3, INPUT, INPUT, 0});
  made_value(&graph, 12, "points", (const size_t[]){1, 2 * count, 0});
  made_onnx(path, &graph);
}

static void test_landmark_network(void **state) {
  (void)state;
  double mouth = 0;
  if (!ERN_PREPARE) skip();
  make_network("points.onnx", POINTS);
  json_t *report = evaluate("--landmarks points.onnx");
  assert_int_equal(ids[frames - 1] - ids[0], frames - 1);
  cli_run(&cli,
          "render m.safetensors --clip clip --split all --frames %ld:%ld -o f_%%d.png -y --quiet --set silence-pose=no",
          ids[0], ids[frames - 1] + 1);
  cli_expect(&cli, 0, NULL);
  for (size_t i = 0; i < frames; i++) {
    char path[64];
    double points[POINTS][2];
    long square[3];
    read_points("clip/ori_imgs", ids[i], points);
    square_of(points, square);
    snprintf(path, sizeof path, "f_%ld.png", ids[i]);
    const double drawn = red_of(path, square);
    snprintf(path, sizeof path, "clip/gt_imgs/%ld.jpg", ids[i]);
    mouth += sqrt(2) * gain * (double)square[2] * fabs(drawn - red_of(path, square)) / (double)frames;
  }
  /* 8-bit pictures drawn twice, and an area's mean in whole grey levels of each of INPUT x INPUT: 1 of 255 at most */
  const double rounding = sqrt(2) * gain * SIDE / 255;
  assert_true(mouth > 4 * rounding);
  expect_near(number(report, "lmd", "mouth"), mouth, rounding);
  expect_near(number(report, "lmd", "face") / number(report, "lmd", "mouth"), 20.0 / POINTS, 1e-4);
  json_decref(report);
}

static void refused(const char *options, const char *word, const char *other) {
  cli_run(&cli, "eval m.safetensors clip %s --json none.json --csv none.csv", options);
  cli_expect(&cli, 1, word, other, NULL);
  assert_false(cli_there("none.json"));
  assert_false(cli_there("none.csv"));
}

static void test_landmarks_refused(void **state) {
  (void)state;
  double points[POINTS][2] = {{0}};
  refused("--landmarks nowhere", "nowhere", "expected a folder of ID.lms");
  support_clear("drawn");
  assert_int_equal(mkdir("drawn", 0777), 0);
  refused("--landmarks drawn", "drawn/", ".lms");
  for (size_t i = 0; i < frames; i++) write_points("drawn", ids[i], points);
  char path[64];
  snprintf(path, sizeof path, "drawn/%ld.lms", ids[2]);
  support_write_text(path, "1 2\n3 4\n");
  refused("--landmarks drawn", path, "has 2 landmarks, expected 68");
  support_write_text(path, "1 2\n3 nan\n");
  refused("--landmarks drawn", path, "line 2");
  if (!ERN_PREPARE) return;
  refused("--landmarks nowhere.onnx", "nowhere.onnx", NULL);
  support_write_text("bad.onnx", "no network");
  refused("--landmarks bad.onnx", "bad.onnx", NULL);
  make_network("bad.onnx", 50);
  refused("--landmarks bad.onnx", "bad.onnx", "no output has 68 or 98 points");
}

/* ---- FID --------------------------------------------------------------------------------------------------------- */

/* Features that are the means of the colours in -1..1, each twice. */
static void make_features(const char *path, size_t channels) {
  struct made_message graph = {0};
  static const float weights[6 * 4] = {[0] = 1, [4] = 1, [8] = 1, [9] = 1, [13] = 1, [17] = 1};
  made_weight(&graph, "W", (const size_t[]){6, channels, 1, 1, 0}, weights);
  made_node(&graph, "GlobalAveragePool", "picture", "mean", NULL);
  made_node(&graph, "Conv", "mean W", "features",
            (const struct made_attribute[]){{"kernel_shape", 2, {1, 1}}, {NULL, 0, {0}}});
  made_value(&graph, 11, "picture", (const size_t[]){1, channels, 32, 32, 0});
  made_value(&graph, 12, "features", (const size_t[]){1, 6, 1, 1, 0});
  made_onnx(path, &graph);
}

/* Means of the colours, in -1..1, of a picture that is halved: bilinear between pixels, each counts the same. */
static void colours_of(const char *format, long id, double mean[3]) {
  ern_context *context = support_context();
  ern_image image = {0};
  char path[64];
  snprintf(path, sizeof path, "%s/%ld%s", format, id, format[0] == 'c' ? ".jpg" : ".png");
  support_ok(context, ern_image_read(context, path, 3, &image));
  for (size_t c = 0; c < 3; c++) mean[c] = -1;
  for (size_t i = 0; i < 3 * SIDE * SIDE; i++) mean[i % 3] += image.data[i] / 127.5 / (SIDE * SIDE);
  ern_image_free(context, &image);
  ern_context_free(&context);
}

static void test_frechet_of_frames(void **state) {
  (void)state;
  if (!ERN_VISION) skip();
  make_features("mean.onnx", 3);
  json_t *report = evaluate("--inception mean.onnx");
  support_clear("all");
  assert_int_equal(mkdir("all", 0777), 0);
  cli_run(
      &cli,
      "render m.safetensors --clip clip --split all --frames %ld:%ld -o all/%%d.png -y --quiet --set silence-pose=no",
      ids[0], ids[frames - 1] + 1);
  cli_expect(&cli, 0, NULL);
  /* the means' distance, and how far the roots of the traces are apart: a lower and an upper bound of the rest */
  double mean[2][3] = {{0}}, square[2] = {0, 0}, between = 0, colours[2][MOST][3];
  for (size_t i = 0; i < frames; i++)
    for (size_t t = 0; t < 2; t++) {
      colours_of(t == 0 ? "all" : "clip/gt_imgs", ids[i], colours[t][i]);
      for (size_t c = 0; c < 3; c++) mean[t][c] += colours[t][i][c] / (double)frames;
    }
  for (size_t i = 0; i < frames; i++)
    for (size_t t = 0; t < 2; t++)
      for (size_t c = 0; c < 3; c++) square[t] += 2 * pow(colours[t][i][c] - mean[t][c], 2) / (double)(frames - 1);
  for (size_t c = 0; c < 3; c++) between += 2 * pow(mean[0][c] - mean[1][c], 2);
  const double found = number(report, "fid", "distance"), rounding = 1e-3 * between;
  assert_true(between > 1e-3);
  assert_true(found > between + pow(sqrt(square[0]) - sqrt(square[1]), 2) - rounding);
  assert_true(found < between + square[0] + square[1] + rounding);
  expect_near(number(report, "fid", "features"), 6, 0);
  expect_near(number(report, "fid", "frames"), (double)frames, 0);
  assert_true(json_is_true(json_object_get(json_object_get(json_object_get(report, "metrics"), "fid"), "biased")));
  json_decref(report);
  cli_run(&cli, "eval m.safetensors clip --inception mean.onnx");
  cli_expect_out(&cli, 0, "FID: ", "of 6 features", "biased", NULL);
  make_features("grey.onnx", 4);
  refused("--inception grey.onnx", "[1, 4, 32, 32]", "expected [1, 3, height, width]");
  support_write_text("bad.onnx", "no network");
  refused("--inception bad.onnx", "bad.onnx", NULL);
  refused("--inception mean.onnx --frames 0:1", "1 frame", "expected 2");
}

/* ---- AUE --------------------------------------------------------------------------------------------------------- */

static double intensity(size_t table, size_t row, size_t unit) {
  return (double)((row * 7 + unit * 13 + table * (unit % 5 + 1) * 11) % 51) / 10;
}

/* As OpenFace writes: a blank before each name but the first. `without`: a unit that is left out, UNITS: none. The last
 * `lost` rows have no success. */
static void write_units(const char *path, size_t table, size_t without, size_t rows, size_t lost) {
  FILE *file = fopen(path, "w");
  assert_non_null(file);
  fprintf(file, "frame, timestamp, success");
  for (size_t k = UNITS; k-- > 0;)
    if (k != without) fprintf(file, ", %s", units[k]);
  fprintf(file, ", AU28_c\n");
  for (size_t i = 0; i < rows; i++) {
    fprintf(file, "%zu, %.3f, %d", i + 1, 0.04 * (double)i, i + lost < rows);
    for (size_t k = UNITS; k-- > 0;)
      if (k != without) fprintf(file, ", %.2f", intensity(table, i, k));
    fprintf(file, ", 1.00\n");
  }
  assert_int_equal(fclose(file), 0);
}

/* The mean squared difference of a unit over the first rows. */
static double of_unit(size_t unit, size_t rows) {
  double sum = 0;
  for (size_t i = 0; i < rows; i++) sum += pow(intensity(0, i, unit) - intensity(1, i, unit), 2);
  return sum / (double)rows;
}

static void test_action_units(void **state) {
  (void)state;
  double all = 0, lower = 0;
  const size_t without = 12; /* AU20_r */
  write_units("drawn.csv", 0, UNITS, frames, 2);
  write_units("true.csv", 1, without, frames, 1);
  for (size_t k = 0; k < UNITS; k++) {
    if (k == without) continue;
    all += of_unit(k, frames - 2);
    if (k >= 7 && k < 16) lower += of_unit(k, frames - 2); /* AU10 to AU26 */
  }
  json_t *report = evaluate("--action-units drawn.csv --recorded-action-units true.csv");
  expect_near(number(report, "aue", "all"), all, 1e-5); /* values of 2 digits as float, squared */
  expect_near(number(report, "aue", "lower"), lower, 1e-5);
  expect_near(number(report, "aue", "upper"), all - lower, 1e-5);
  expect_near(number(report, "aue", "units"), UNITS - 1, 0);
  expect_near(number(report, "aue", "frames"), (double)frames - 2, 0);
  expect_near(number(report, "aue", "left_out"), 2, 0);
  json_decref(report);
  cli_run(&cli, "eval m.safetensors clip --action-units drawn.csv --recorded-action-units true.csv");
  cli_expect(&cli, 0, "16 of the 17", "AU20_r", NULL);
  cli_expect_out(&cli, 0, "AUE: ", "2 left out", NULL);
  write_units("true.csv", 0, UNITS, frames, 0);                               /* the same */
  report = evaluate("--action-units drawn.csv --true-action-units true.csv"); /* the old spelling */
  expect_near(number(report, "aue", "all"), 0, 0);
  json_decref(report);
}

static void test_action_units_refused(void **state) {
  (void)state;
  static const char both[] = "--action-units drawn.csv --recorded-action-units true.csv";
  cli_run(&cli, "eval m.safetensors clip --action-units drawn.csv");
  cli_expect(&cli, 2, "--recorded-action-units", NULL);
  write_units("true.csv", 1, UNITS, frames, 0);
  write_units("drawn.csv", 0, UNITS, frames - 1, 0);
  refused(both, "drawn.csv", "expected");
  write_units("drawn.csv", 0, UNITS, frames, frames);
  refused(both, "drawn.csv", "success");
  write_units("drawn.csv", 0, UNITS, frames, 0);
  size_t count = 0;
  uint8_t *bytes = cli_bytes("drawn.csv", &count);
  support_write("drawn.csv", bytes, count - 40); /* torn in the last line */
  refused(both, "drawn.csv", "cells, expected at least");
  free(bytes);
  write_units("drawn.csv", 0, UNITS, frames, 0);
  bytes = cli_bytes("drawn.csv", &count);
  char *cell = strstr((char *)bytes, "1, 0.000, 1, ");
  assert_non_null(cell);
  memcpy(cell + 13, "9.99", 4);
  support_write("drawn.csv", bytes, count);
  refused(both, "AU45_r is 9.99", "0 to 5");
  memcpy(cell + 13, "1.x9", 4);
  support_write("drawn.csv", bytes, count);
  refused(both, "line 2, column AU45_r", "\"1.x9\"");
  free(bytes);
  support_write_text("drawn.csv", "frame, success\n");
  refused(both, "drawn.csv", "rows");
  support_write_text("drawn.csv", "");
  refused(both, "drawn.csv", "empty");
  refused("--action-units nowhere.csv --recorded-action-units true.csv", "nowhere.csv", NULL);
  write_units("drawn.csv", 0, UNITS, frames, 0);
  cli_run(&cli, "eval m.safetensors clip %s --csv true.csv -y", both);
  cli_expect(&cli, 1, "true.csv", "is an input", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_absent),
                                     cmocka_unit_test(test_landmark_files),
                                     cmocka_unit_test(test_landmark_network),
                                     cmocka_unit_test(test_landmarks_refused),
                                     cmocka_unit_test(test_action_units),
                                     cmocka_unit_test(test_frechet_of_frames),
                                     cmocka_unit_test(test_action_units_refused)};
  return cmocka_run_group_tests(tests, train_head, NULL);
}
