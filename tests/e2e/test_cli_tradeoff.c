/* SPDX-License-Identifier: MIT
 * `ernerf tradeoff` on a small made-up clip with a small budget: every file, whole and consistent; and a
 * head that is drawn small. */
#include "cli.h"

#include <math.h>

#include "ernerf/media.h"
#include "io/npy.h"

static struct cli cli;
static const char clip[] = "small";

static int make_model(void **state) {
  (void)state;
  static const char *const old[] = {"m.safetensors", "m.run", "out", "full", "wide", "picture", "small"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  cli_shared_clip("short", clip);
  cli_shared_model("short_head", "m");
  return 0;
}

static double number(const json_t *object, const char *name) {
  const json_t *member = json_object_get(object, name);
  if (!json_is_number(member)) fail_msg("%s is missing or no number", name);
  return json_number_value(member);
}

/* ---- the files --------------------------------------------------------------------------------------------------- */

static void check_point(const json_t *point, size_t turns, size_t frames) {
  static const char *const truths[] = {"exact", "clip"};
  const json_t *ms = json_object_get(point, "ms_per_frame");
  const double median = number(ms, "median");
  assert_true(median > 0 && number(ms, "quartile_1") <= median && number(ms, "quartile_3") >= median);
  assert_int_equal(json_array_size(json_object_get(ms, "turns")), turns);
  assert_true(fabs(number(point, "fps") * median - 1000) < 1e-6);
  assert_true(number(point, "exact_worst_of_255") >= 0 && number(point, "exact_worst_of_255") <= 255);
  for (size_t k = 0; k < 2; k++) {
    const json_t *truth = json_object_get(point, truths[k]);
    assert_int_equal(json_array_size(json_object_get(truth, "psnr_db")), frames);
    assert_true(number(truth, "psnr_db_mean") > 5 && number(truth, "psnr_db_mean") <= 100);
    assert_true(number(truth, "psnr_db_deviation") >= 0);
    assert_non_null(json_string_value(json_object_get(truth, "standing")));
  }
}

/* Returns how many points there are. */
static size_t check_json(void) {
  json_t *file = cli_json(&cli, "out/tradeoff.json");
  const json_t *points = json_object_get(file, "points"), *front = json_object_get(file, "front");
  const json_t *frames = json_object_get(json_object_get(file, "clip"), "frames");
  const size_t turns = (size_t)number(json_object_get(file, "measured"), "turns"), count = json_array_size(points);
  assert_true(turns >= 3 && count >= 2 && json_array_size(frames) == 2);
  for (size_t i = 0; i < count; i++) check_point(json_array_get(points, i), turns, 2);
  assert_string_equal(json_string_value(json_object_get(json_array_get(points, 0), "name")), "default");
  assert_true(json_array_size(front) >= 1);
  double last = 0;
  for (size_t i = 0; i < json_array_size(front); i++) {
    const json_t *point = json_array_get(points, (size_t)json_integer_value(json_array_get(front, i)));
    const double median = number(json_object_get(point, "ms_per_frame"), "median");
    assert_string_equal(json_string_value(json_object_get(json_object_get(point, "exact"), "standing")), "front");
    assert_true(median >= last);
    last = median;
  }
  json_decref(file);
  return count;
}

static void check_csv(size_t points) {
  size_t bytes = 0, lines = 0, commas = 0;
  char *csv = (char *)cli_bytes("out/tradeoff.csv", &bytes);
  assert_int_equal(strncmp(csv, "name,max_steps,", 15), 0);
  for (const char *at = csv; *at != 0; at++) lines += *at == '\n';
  for (const char *at = csv; *at != '\n'; at++) commas += *at == ',';
  assert_int_equal(lines, points + 1);
  assert_int_equal(commas, 22);
  free(csv);
}

static void check_plots(void) {
  static const char *const names[] = {"exact", "clip"};
  ern_context *context = support_context();
  for (size_t k = 0; k < 2; k++) {
    char path[64];
    size_t bytes = 0;
    ern_image image = {0};
    snprintf(path, sizeof path, "out/%s.png", names[k]);
    support_ok(context, ern_image_read(context, path, 3, &image));
    assert_true(image.width > 1000 && image.height > 500);
    ern_image_free(context, &image);
    snprintf(path, sizeof path, "out/%s.svg", names[k]);
    char *svg = (char *)cli_bytes(path, &bytes);
    assert_true(strstr(svg, "<svg") != NULL && strstr(svg, "</svg>") != NULL);
    free(svg);
  }
  ern_context_free(&context);
}

/* Every element that is opened is closed, in the right order; but for those that HTML never closes. */
static void check_nesting(const char *page) {
  static const char *const alone[] = {"!DOCTYPE", "meta", "img", "br"};
  enum { DEEPEST = 32, NAME = 32 };
  char open[DEEPEST][NAME];
  size_t depth = 0;
  for (const char *at = strchr(page, '<'); at != NULL; at = strchr(at + 1, '<')) {
    const bool closes = at[1] == '/';
    char name[NAME];
    bool is_alone = false;
    snprintf(name, sizeof name, "%.*s", (int)strcspn(at + 1 + closes, " >"), at + 1 + closes);
    for (size_t i = 0; i < sizeof alone / sizeof *alone; i++) is_alone |= strcmp(name, alone[i]) == 0;
    if (is_alone) continue;
    if (!closes) {
      assert_true(depth < DEEPEST);
      strcpy(open[depth++], name);
    } else if (depth == 0 || strcmp(open[--depth], name) != 0) {
      fail_msg("</%s> closes nothing, or the wrong thing", name);
    }
  }
  assert_int_equal(depth, 0);
}

/* Nothing that a browser would fetch: pictures are in the page. */
static void check_page(void) {
  static const char *const forbidden[] = {"http:", "https:", "file:", "<script", "<link", "@import", "url("};
  size_t bytes = 0, pictures = 0;
  char *page = (char *)cli_bytes("out/index.html", &bytes);
  check_nesting(page);
  for (size_t i = 0; i < sizeof forbidden / sizeof *forbidden; i++)
    if (strstr(page, forbidden[i]) != NULL) fail_msg("the page has %s", forbidden[i]);
  for (const char *at = strstr(page, "src=\""); at != NULL; at = strstr(at + 1, "src=\"")) {
    pictures++;
    assert_int_equal(strncmp(at, "src=\"data:image/", 16), 0);
  }
  assert_true(pictures >= 2 + 2 + 2 + 4); /* plots; mouth and eyes of clip, exact render and a point with differences */
  assert_non_null(strstr(page, "quartiles"));
  assert_non_null(strstr(page, "</html>\n"));
  free(page);
}

static void test_files(void **state) {
  (void)state;
  cli_run(&cli, "tradeoff m.safetensors '%s' -o out --frames 0:2 --seconds 1 --quiet --json all.json", clip);
  cli_expect_out(&cli, 0, "the front", "ms a frame (quartiles)", "out/index.html", NULL);
  assert_int_equal(cli_count("out"), 7);
  check_csv(check_json());
  check_plots();
  check_page();
  cli_same_bytes("out/tradeoff.json", "all.json");
}

/* ---- what does not work ------------------------------------------------------------------------------------------ */

static void test_bad_input(void **state) {
  (void)state;
  ern_context *context = support_context();
  static float values[33 * 16 * 44];
  cli_run(&cli, "tradeoff m.safetensors '%s'", clip);
  cli_expect(&cli, 2, "-o DIR is missing", NULL);
  cli_run(&cli, "tradeoff m.safetensors '%s' -o out2 --smooth-lips", clip);
  cli_expect(&cli, 2, "--smooth-lips", "depend", NULL);
  cli_run(&cli, "tradeoff m.safetensors '%s' -o out2 --set image-scale=0.1", clip);
  cli_expect(&cli, 2, "--set image-scale", "0.25 to 1", NULL);
  cli_run(&cli, "tradeoff m.safetensors '%s' -o out2 --sharpness 3", clip);
  cli_expect(&cli, 2, "unknown option --sharpness", NULL);
  cli_run(&cli, "tradeoff m.safetensors '%s' -o out2 --frames 0:1", clip);
  cli_expect(&cli, 1, "1 frame", "expected 2 or more", NULL);
  cli_run(&cli, "tradeoff m.safetensors '%s' -o out2 --split train --frames 0:17", clip);
  cli_expect(&cli, 2, "--frames has 17 frames", "16 at most", NULL);
  cli_run(&cli, "tradeoff m.safetensors '%s' -o no/such/out2", clip);
  cli_expect(&cli, 1, "no/such/out2", "cannot be made", NULL);
  cli_run(&cli, "tradeoff m.safetensors '%s' -o m.safetensors", clip);
  cli_expect(&cli, 1, "m.safetensors", "is no folder", NULL);
  cli_run(&cli, "tradeoff none.safetensors '%s' -o out2", clip);
  cli_expect(&cli, 1, "none.safetensors", NULL);
  cli_copy(clip, "wide");
  remove("wide/aud_ds.npy");
  support_ok(context, ern_npy_write_f32(context, "wide/aud_ds.npy", values, 3, (const size_t[]){33, 16, 44}));
  cli_run(&cli, "tradeoff m.safetensors wide -o out2");
  cli_expect(&cli, 1, "aud_ds.npy", "44", "expected 29", NULL);
  assert_false(cli_there("out2"));
  ern_context_free(&context);
}

/* A disk that takes no picture: what was begun is taken away, and nothing half-written stays. */
static void test_full_disk_long(void **state) {
  (void)state;
  cli_run_full(&cli, 3000, "tradeoff m.safetensors '%s' -o full --frames 0:2 --seconds 1 --quiet", clip);
  cli_expect(&cli, 1, "full/", "cannot write", NULL);
  DIR *list = opendir("full");
  for (struct dirent *entry = list != NULL ? readdir(list) : NULL; entry != NULL; entry = readdir(list))
    if (strstr(entry->d_name, ".ernerf-tmp") != NULL) fail_msg("%s was left", entry->d_name);
  if (list != NULL) closedir(list);
}

/* ---- a head that is drawn small ---------------------------------------------------------------------------------- */

static void test_image_scale(void **state) {
  (void)state;
  assert_int_equal(mkdir("picture", 0777), 0);
  cli_run(&cli, "render m.safetensors --clip '%s' --frames 2:3 -o picture/a%%05d.png --quiet", clip);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render m.safetensors --clip '%s' --frames 2:3 --set image-scale=1 -o picture/b%%05d.png --quiet",
          clip);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render m.safetensors --clip '%s' --frames 2:3 --set image-scale=0.5 -o picture/c%%05d.png --quiet",
          clip);
  cli_expect(&cli, 0, NULL);
  cli_same_bytes("picture/a00002.png", "picture/b00002.png");
  ern_context *context = support_context();
  ern_image full = {0}, small = {0};
  support_ok(context, ern_image_read(context, "picture/a00002.png", 3, &full));
  support_ok(context, ern_image_read(context, "picture/c00002.png", 3, &small));
  double sum = 0;
  const int values = 3 * full.width * full.height;
  for (int i = 0; i < values; i++) sum += pow((double)full.data[i] - (double)small.data[i], 2);
  assert_true(sum > 0 && sqrt(sum / values) < 12); /* of 255: another picture, of the same thing */
  ern_image_free(context, &full);
  ern_image_free(context, &small);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_files),
      cmocka_unit_test(test_bad_input),
      cmocka_unit_test(test_full_disk_long),
      cmocka_unit_test(test_image_scale),
  };
  return cmocka_run_group_tests(tests, make_model, NULL);
}
