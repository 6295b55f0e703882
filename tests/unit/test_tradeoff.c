/* SPDX-License-Identifier: MIT
 * Parts of `ernerf tradeoff`: settings in words and JSON, combinations, a front that is read back, bytes and plots;
 * trainings over seeds. */
#include "../support.h"

#include <math.h>

#include "bytes.h"
#include "lab/tradeoff_points.h"
#include "output/plot.h"
#include "output/plot_axis.h"
#include "output/training_report.h"
#include "session/pareto_read.h"
#include "session/settings.h"

static const struct settings base = {
    .max_steps = 16, .transmittance_stop = 0.003f, .image_scale = 1, .backend = "cpu", .isa = "avx2", .threads = 2};

/* ---- settings ---------------------------------------------------------------------------------------------------- */

static void expect_text(struct bytes *bytes, const char *text) {
  assert_false(bytes->failed);
  assert_string_equal(bytes->data, text);
  bytes_free(bytes);
}

static void test_words(void **state) {
  (void)state;
  const struct choice choices[] = {{AXIS_SCALE, 0.5, NULL, NULL},
                                   {AXIS_STEPS, 8, NULL, NULL},
                                   {AXIS_THRESHOLD, 1, NULL, NULL},
                                   {AXIS_UNIT, 0, "cpu", "avx512bf16"}};
  struct settings s = base;
  struct bytes text = {0};
  settings_name(&s, &base, "default", &text);
  expect_text(&text, "default");
  for (size_t i = 0; i < sizeof choices / sizeof *choices; i++) {
    s = settings_with(s, &choices[i]);
    assert_int_equal(settings_changes(&s, &base), i + 1);
  }
  settings_name(&s, &base, "default", &text);
  expect_text(&text, "scale 0.5, 8 samples, threshold 1, avx512bf16");
  settings_options(&s, &base, &text);
  expect_text(&text, " --max-steps 8 --set occupancy-threshold=1 --set image-scale=0.5 --isa avx512bf16");
  const struct choice device = {AXIS_UNIT, 3, "opencl", ""};
  s = settings_with(base, &device);
  assert_int_equal(settings_changes(&s, &base), 1);
  settings_name(&s, &base, "default", &text);
  expect_text(&text, "OpenCL device 3");
  settings_options(&s, NULL, &text);
  expect_text(
      &text,
      " --max-steps 16 --set transmittance-stop=0.003 --set occupancy-threshold=0 --set image-scale=1 --backend opencl "
      "--device 3");
}

static void test_settings_json(void **state) {
  (void)state;
  static const char *const wrong[] = {"{\"max_steps\": 0}",
                                      "{\"max_steps\": 16.5}",
                                      "{\"max_steps\": \"16\"}",
                                      "{\"transmittance_stop\": -1}",
                                      "{\"occupancy_threshold\": 1e7}",
                                      "{\"image_scale\": 0.1}",
                                      "{\"image_scale\": null}",
                                      "{\"backend\": \"gpu\"}",
                                      "{\"isa\": \"\"}",
                                      "{\"isa\": \"a b\"}",
                                      "{\"isa\": \"aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa\"}",
                                      "{\"threads\": -1}",
                                      "{\"device\": 256}",
                                      "{\"isa\": [\"avx2\"]}"};
  struct settings read;
  json_t *object = settings_json(&base);
  assert_null(settings_of_json(&read, object));
  assert_int_equal(settings_changes(&read, &base), 0);
  for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
    json_t *copy = json_deep_copy(object), *change = json_loads(wrong[i], 0, NULL);
    json_object_update(copy, change);
    const char *what = settings_of_json(&read, copy);
    if (what == NULL || strstr(what, json_object_iter_key(json_object_iter(change))) == NULL)
      fail_msg("%s was answered with %s", wrong[i], what != NULL ? what : "nothing");
    json_decref(copy);
    json_decref(change);
  }
  assert_non_null(settings_of_json(&read, NULL));
  json_decref(object);
}

/* ---- combinations ------------------------------------------------------------------------------------------------ */

static void test_combinations(void **state) {
  (void)state;
  /* half the time for an error of 1e-3; a tenth off for nearly nothing; slower and worse; threads */
  const struct effect effects[] = {{{AXIS_SCALE, 0.5, NULL, NULL}, 0.5, 1e-3},
                                   {{AXIS_STOP, 0.03, NULL, NULL}, 0.9, 1e-6},
                                   {{AXIS_STEPS, 4, NULL, NULL}, 1.2, 1e-2},
                                   {{AXIS_THREADS, 1, NULL, NULL}, 0.1, 0}};
  struct settings found[TRADEOFF_POINTS_COMBINATIONS];
  double ms[TRADEOFF_POINTS_COMBINATIONS];
  const size_t count = tradeoff_points_combine(&base, 100, 1e-8, effects, 4, found, ms);
  assert_int_equal(count, 1); /* both good ones together; nothing with what is slower and worse */
  assert_true(fabs(ms[0] - 45) < 1e-9);
  assert_int_equal(found[0].max_steps, 16);
  assert_int_equal(found[0].threads, 2);
  assert_true(found[0].image_scale == 0.5f && found[0].transmittance_stop == 0.03f);
  assert_int_equal(tradeoff_points_combine(&base, 100, 0, effects, 1, found, ms), 0);
  assert_int_equal(tradeoff_points_combine(&base, 100, 0, effects, 0, found, ms), 0);
}

static void test_many_combinations(void **state) {
  (void)state;
  struct effect effects[18];
  for (size_t i = 0; i < 18; i++) {
    const size_t rung = i / 3 + 1;
    effects[i] = (struct effect){{(enum axis)(i % 3), 0.25 + 0.1 * (double)rung, NULL, NULL},
                                 pow(0.8, (double)rung),
                                 pow(10, (double)rung - 8) * (1 + 0.1 * (double)(i % 3))};
    if (effects[i].choice.axis == AXIS_STEPS) effects[i].choice.value = (double)(2 + rung);
  }
  struct settings found[TRADEOFF_POINTS_COMBINATIONS];
  double ms[TRADEOFF_POINTS_COMBINATIONS];
  const size_t count = tradeoff_points_combine(&base, 100, 1e-9, effects, 18, found, ms);
  assert_true(count > 5 && count <= TRADEOFF_POINTS_COMBINATIONS);
  for (size_t i = 0; i < count; i++) {
    assert_true(settings_changes(&found[i], &base) >= 2);
    assert_true(ms[i] > 0 && ms[i] < 100);
    for (size_t k = 0; k < i; k++) assert_true(settings_changes(&found[i], &found[k]) > 0);
  }
}

/* ---- a front that is read back ----------------------------------------------------------------------------------- */

static const char good[] =
    "{'format': 'ernerf.tradeoff', 'version': 1, 'machine': {'cpu': 'some', 'cores': 2},"
    " 'model': {'sha256': '0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef'},"
    " 'clip': {'width': 64, 'height': 48}, 'points': ["
    "{'name': 'default', 'settings': SET, 'ms_per_frame': {'median': 9, 'quartile_1': 8, 'quartile_3': 10},"
    " 'exact': {'psnr_db_mean': 50}, 'clip': {'psnr_db_mean': 30}},"
    "{'name': 'scale 0.5', 'settings': SET, 'ms_per_frame': {'median': 3.5, 'quartile_1': 3.5, 'quartile_3': 4},"
    " 'exact': {'psnr_db_mean': 40.5}, 'clip': {'psnr_db_mean': 29}}], 'front': [1, 0]}";
static const char set[] =
    "{'max_steps': 16, 'transmittance_stop': 0.003, 'occupancy_threshold': 0, 'image_scale': 1, 'backend': 'cpu',"
    " 'isa': 'avx2', 'device': 0, 'threads': 2}";

/* `text` with " for ' and the settings for SET, and the first `from` become `to`. */
static void write_front(const char *text, const char *from, const char *to) {
  static char all[8192], changed[8192];
  char *at = all;
  for (; *text != 0; text++) {
    if (strncmp(text, "SET", 3) == 0) {
      at += sprintf(at, "%s", set);
      text += 2;
    } else {
      *at++ = *text;
    }
  }
  *at = 0;
  const char *found = from != NULL ? strstr(all, from) : NULL;
  assert_true(from == NULL || found != NULL);
  if (found != NULL)
    sprintf(changed, "%.*s%s%s", (int)(found - all), all, to, found + strlen(from));
  else
    strcpy(changed, all);
  for (at = changed; *at != 0; at++)
    if (*at == '\'') *at = '"';
  FILE *file = fopen("front.json", "wb");
  assert_non_null(file);
  assert_true(fwrite(changed, 1, strlen(changed), file) == strlen(changed));
  assert_int_equal(fclose(file), 0);
}

static void test_front_is_read(void **state) {
  (void)state;
  struct session session = {.verb = "test"};
  struct pareto_front front;
  write_front(good, NULL, NULL);
  assert_int_equal(pareto_read(&front, &session, "front.json"), 0);
  assert_int_equal(front.count, 2);
  assert_int_equal(front.width, 64);
  assert_int_equal(front.cores, 2);
  assert_string_equal(front.points[0].name, "scale 0.5");
  assert_true(front.points[0].ms.median == 3.5 && front.points[1].exact_db == 50);
  assert_int_equal(settings_changes(&front.points[1].settings, &base), 0);
  pareto_free(&front);
  pareto_free(&front);
}

static void test_hostile_fronts(void **state) {
  (void)state;
  static const struct {
    const char *from, *to;
  } changes[] = {{"'ernerf.tradeoff'", "'other'"},
                 {"'version': 1", "'version': 2"},
                 {"'version': 1", "'version': 1.5"},
                 {"'cores': 2", "'cores': -1"},
                 {"'cpu': 'some'", "'cpu': 7"},
                 {"0123456789abcdef0", "0123456789abcdeg0"},
                 {"0123456789abcdef0", "0"},
                 {"'width': 64", "'width': 100000"},
                 {"'points': [", "'points': 3, 'others': ["},
                 {"[1, 0]", "[1, 2]"},
                 {"[1, 0]", "[-1]"},
                 {"[1, 0]", "[0.5]"},
                 {"[1, 0]", "[9223372036854775807]"},
                 {"[1, 0]", "[]"},
                 {"[1, 0]", "[1, 0, 0]"},
                 {"[1, 0]", "[0, 1]"},
                 {"[1, 0]", "[1, 0"},
                 {"'quartile_1': 8", "'quartile_1': 9.5"},
                 {"'median': 9", "'median': 0"},
                 {"'median': 9", "'median': 1e400"},
                 {"'psnr_db_mean': 50", "'psnr_db_mean': 1e9"},
                 {"'name': 'default'", "'name': null"},
                 {"'max_steps': 16", "'max_steps': 100000"},
                 {"{'format'", "[{'format'"},
                 {"'front'", "'front': [0], 'front'"}};
  struct session session = {.verb = "test"};
  struct pareto_front front;
  for (size_t i = 0; i < sizeof changes / sizeof *changes; i++) {
    write_front(good, changes[i].from, changes[i].to);
    if (pareto_read(&front, &session, "front.json") == 0) fail_msg("%s was taken", changes[i].to);
    pareto_free(&front);
  }
  assert_int_not_equal(pareto_read(&front, &session, "not_there.json"), 0);
  assert_int_not_equal(pareto_read(&front, &session, "."), 0);
}

/* A member that nobody asks for, of 131,072 values and more: refused before JSON takes memory for each. */
static void test_many_values(void **state) {
  (void)state;
  struct session session = {.verb = "test"};
  struct pareto_front front;
  for (int many = 0; many < 2; many++) {
    write_front(good, NULL, NULL);
    FILE *file = fopen("front.json", "r+b");
    assert_non_null(file);
    assert_int_equal(fseek(file, -1, SEEK_END), 0);
    fputs(",\"more\":[0", file);
    for (int i = 0; i < (many ? 131072 : 130000); i++) fputs(",0", file);
    fputs("]}", file);
    assert_int_equal(fclose(file), 0);
    assert_int_equal(pareto_read(&front, &session, "front.json") != 0, many);
    pareto_free(&front);
  }
}

/* ---- bytes and plots --------------------------------------------------------------------------------------------- */

static void test_bytes(void **state) {
  (void)state;
  struct bytes b = {0};
  bytes_print_html(&b, "<a href=\"x\">&'\xc3\xa4\xff\x01\xe2\x82\xac\xc0\xaf");
  expect_text(&b, "&lt;a href=&quot;x&quot;&gt;&amp;&#39;\xc3\xa4??\xe2\x82\xac??");
  bytes_print_csv(&b, "a, \"b\"");
  expect_text(&b, "\"a, \"\"b\"\"\"");
  bytes_print_csv(&b, "plain");
  expect_text(&b, "plain");
  static const char *const base64[] = {"", "Zg==", "Zm8=", "Zm9v", "Zm9vYg==", "Zm9vYmE=", "Zm9vYmFy"}; /* RFC 4648 */
  for (size_t n = 0; n < sizeof base64 / sizeof *base64; n++) {
    bytes_print(&b, "%s", "");
    bytes_print_base64(&b, "foobar", n);
    expect_text(&b, base64[n]);
  }
  for (int i = 0; i < 5000; i++) bytes_print(&b, "%d ", i);
  assert_int_equal(b.count, strlen(b.data));
  bytes_free(&b);
}

static void test_axes(void **state) {
  (void)state;
  static const double ranges[][2] = {{0, 1},       {3, 3},  {-5, 1000}, {1e-9, 2e-9},
                                     {12.1, 12.2}, {5, 80}, {1, 1e6},   {0.9, 1.1}};
  double ticks[PLOT_MOST_TICKS];
  for (size_t i = 0; i < sizeof ranges / sizeof *ranges; i++)
    for (int log = 0; log < 2; log++) {
      if (log && ranges[i][0] <= 0) continue;
      struct plot_axis axis = plot_axis_around(ranges[i][0], ranges[i][1], log != 0);
      axis.begin = 100, axis.end = 500;
      assert_true(axis.low < ranges[i][0] && axis.high > ranges[i][1]);
      assert_true(fabs(plot_axis_at(&axis, axis.low) - 100) < 1e-6 &&
                  fabs(plot_axis_at(&axis, axis.high) - 500) < 1e-6);
      const size_t count = plot_axis_ticks(&axis, 7, ticks);
      assert_true(count >= 2 && count < PLOT_MOST_TICKS);
      for (size_t k = 0; k < count; k++) {
        assert_true(ticks[k] >= axis.low && ticks[k] <= axis.high);
        if (k > 0) assert_true(ticks[k] > ticks[k - 1]);
      }
    }
}

/* Points that cannot be shown are left out; a plot without any is a frame. */
static void test_plots(void **state) {
  (void)state;
  static const double x[] = {1, 2, 0, 100, NAN}, y[] = {1, INFINITY, 3, 4, 5};
  static const char *const labels[] = {"one", "two", "three", "<four>", NULL};
  const struct plot_series series[] = {{.name = "some",
                                        .x = x,
                                        .y = y,
                                        .x_low = x,
                                        .x_high = x,
                                        .labels = labels,
                                        .count = 5,
                                        .mark = PLOT_DOT,
                                        .line = true},
                                       {.name = "none", .count = 0, .mark = PLOT_RING}};
  struct plot plot = {.title = "t", .x_label = "ms", .y_label = "dB", .x_log = true, .width = 300, .height = 200};
  for (size_t count = 0; count < 3; count++)
    for (enum plot_form form = PLOT_SVG; form <= PLOT_PNG; form++) {
      struct bytes bytes = {0};
      plot.series = series;
      plot.count = count;
      assert_int_equal(plot_draw(&plot, form, &bytes), 0);
      assert_true(bytes.count > 500);
      if (form == PLOT_PNG) assert_memory_equal(bytes.data, "\x89PNG\r\n\x1a\n", 8);
      if (form == PLOT_SVG) assert_non_null(strstr(bytes.data, "</svg>"));
      bytes_free(&bytes);
    }
  plot_end();
}

/* Names of folders in another encoding, as ISO 8859-1, and one that ends within a character. */
static void test_names_of_any_bytes(void **state) {
  (void)state;
  static const double x[] = {1, 2};
  static const char *const labels[] = {
      "stra\xdf"
      "e",
      "\xe2\x82"};
  const struct plot_series series = {
      .name = "\x95\\", .x = x, .y = x, .labels = labels, .count = 2, .mark = PLOT_DOT, .line = true};
  const struct plot plot = {.title =
                                "stra\xdf"
                                "e",
                            .x_label = "s",
                            .y_label = "dB",
                            .width = 400,
                            .height = 300,
                            .series = &series,
                            .count = 1};
  struct bytes bytes = {0};
  char text[6];
  assert_int_equal(plot_draw(&plot, PLOT_SVG, &bytes), 0);
  bytes_free(&bytes);
  assert_int_equal(plot_draw(&plot, PLOT_PNG, &bytes), 0);
  bytes_free(&bytes);
  plot_end();
  bytes_utf8(text, sizeof text, "a\xc3\xa9\xdf\xe2\x82\xac");
  assert_string_equal(text, "a\xc3\xa9?");
}

/* Names that one row has no room for: none begins left of the picture. */
static void test_long_legend(void **state) {
  (void)state;
  enum { CURVES = 12 };
  static const double x[] = {1, 2}, y[] = {3, 4};
  struct plot_series series[CURVES];
  struct bytes bytes = {0};
  size_t glyphs = 0;
  for (size_t k = 0; k < CURVES; k++)
    series[k] = (struct plot_series){.name = "a training", .x = x, .y = y, .count = 2, .mark = PLOT_DOT, .line = true};
  const struct plot plot = {
      .title = "t", .x_label = "s", .y_label = "dB", .width = 400, .height = 300, .series = series, .count = CURVES};
  assert_int_equal(plot_draw(&plot, PLOT_SVG, &bytes), 0);
  for (const char *at = strstr(bytes.data, "<use "); at != NULL; at = strstr(at + 1, "<use ")) {
    const char *place = strstr(at, " x=\"");
    assert_non_null(place);
    const double left = strtod(place + 4, NULL);
    if (!(left >= 0 && left < 400)) fail_msg("a glyph is at %g of 400", left);
    glyphs++;
  }
  assert_true(glyphs > 9 * CURVES);
  bytes_free(&bytes);
  plot_end();
}

/* ---- trainings --------------------------------------------------------------------------------------------------- */

static double member(const json_t *object, const char *name) {
  const json_t *value = json_object_get(object, name);
  return json_is_number(value) ? json_number_value(value) : NAN;
}

/* Two seeds of two points: 0.2 and 0.4 of the mouth's motion at the end; of the other training it is not known. */
static void test_mouth_over_seeds(void **state) {
  (void)state;
  struct session session = {.verb = "test"};
  struct training_study study = {.count = 2, .seeds = 2, .clip = "clip", .base_isa = "ref"};
  for (size_t k = 0; k < 2; k++)
    for (size_t seed = 0; seed < 2; seed++)
      for (size_t i = 0; i < 2; i++) {
        const double mouth = k == 1 ? NAN : i == 0 ? -0.5 : seed == 0 ? 0.2 : 0.4;
        const struct curve_point point = {10 * (i + 1), (double)i + 1, 20 + (double)seed, mouth};
        assert_int_equal(curve_add(&study.kind[k].curve[seed], &session, point), 0);
      }
  const struct training_end end = training_final(&study.kind[0], 2);
  assert_true(fabs(end.psnr.mean - 20.5) < 1e-12 && fabs(end.mouth.mean - 0.3) < 1e-12);
  assert_true(fabs(end.mouth.deviation - sqrt(0.02)) < 1e-12);
  assert_true(isnan(training_final(&study.kind[1], 2).mouth.mean));
  json_t *object = training_json(&study);
  const json_t *trainings = json_object_get(object, "trainings"), *one = json_array_get(trainings, 0);
  const json_t *points = json_array_get(json_object_get(one, "seeds"), 1);
  assert_true(fabs(member(one, "mouth_explained_mean") - 0.3) < 1e-12);
  assert_true(fabs(member(one, "mouth_explained_deviation") - sqrt(0.02)) < 1e-12);
  assert_true(member(json_array_get(points, 0), "mouth_explained") == -0.5);
  assert_true(member(json_array_get(points, 1), "mouth_explained") == 0.4);
  assert_true(json_is_null(json_object_get(json_array_get(trainings, 1), "mouth_explained_mean")));
  json_decref(object);
  training_free(&study);
}

/* A training's own curve has three columns, and says nothing of the mouth. */
static void test_curve_of_a_run(void **state) {
  (void)state;
  struct session session = {.verb = "test"};
  struct curve curve = {0};
  support_write_text("curve.csv", "step,seconds,psnr\n10,1.5,20\n20,3,21\n");
  assert_int_equal(curve_read(&curve, &session, "curve.csv"), 0);
  assert_int_equal(curve.count, 2);
  assert_true(curve.point[1].psnr == 21 && isnan(curve.point[0].mouth) && isnan(curve.point[1].mouth));
  curve_free(&curve);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_words),
      cmocka_unit_test(test_settings_json),
      cmocka_unit_test(test_combinations),
      cmocka_unit_test(test_many_combinations),
      cmocka_unit_test(test_front_is_read),
      cmocka_unit_test(test_hostile_fronts),
      cmocka_unit_test(test_many_values),
      cmocka_unit_test(test_bytes),
      cmocka_unit_test(test_axes),
      cmocka_unit_test(test_plots),
      cmocka_unit_test(test_names_of_any_bytes),
      cmocka_unit_test(test_long_legend),
      cmocka_unit_test(test_mouth_over_seeds),
      cmocka_unit_test(test_curve_of_a_run),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
