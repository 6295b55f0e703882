/* SPDX-License-Identifier: MIT
 * `ernerf ablate`: its tables on a small budget, going on after a stop, its refusals. Which row wins is not checked. */
#include "cli.h"

#include <math.h>

static struct cli cli;

static const char clip[] = "clip"; /* smaller than data/tiny, whose collisions test_tables_long looks at */

static int make_clip(void **state) {
  (void)state;
  support_clear("clip");
  cli_run(&cli, "synth clip --size 64 --frames 24 --seed 5 --quiet");
  cli_expect(&cli, 0, NULL);
  return 0;
}

static double number(const json_t *object, const char *key) {
  const json_t *value = json_object_get(object, key);
  if (!json_is_number(value)) fail_msg("%s is no number", key);
  return json_number_value(value);
}

static void check_figure(const json_t *row, const char *key, double least, double most, size_t seeds) {
  const json_t *figure = json_object_get(row, key);
  const double mean = number(figure, "mean");
  if (!(mean > least && mean < most)) fail_msg("%s is %g, expected %g to %g", key, mean, least, most);
  assert_int_equal(json_array_size(json_object_get(figure, "seeds")), seeds);
}

static void check_row(const json_t *row, size_t seeds) {
  const json_t *ms = json_object_get(row, "ms_per_frame");
  check_figure(row, "psnr", 5, 60, seeds);
  check_figure(row, "ssim", 0, 1, seeds);
  check_figure(row, "psnr_mouth", 1, 60, seeds);
  check_figure(row, "training_seconds", 0, 1e6, seeds);
  assert_true(number(ms, "quartile_1") > 0 && number(ms, "quartile_1") <= number(ms, "median"));
  assert_true(number(ms, "median") <= number(ms, "quartile_3"));
  assert_true(number(row, "sample_flops") > 1000 && number(row, "parameters") > 1000);
  assert_true(number(row, "model_bytes") > 4 * number(row, "parameters"));
}

/* The paper's claim, which holds for any head: planes collide less than the volume, and frontal most of them. */
static void check_collisions(const json_t *table) {
  const double volume = number(json_object_get(table, "volume"), "collisions"),
               frontal = number(json_object_get(table, "frontal_xz"), "collisions"),
               xy = number(json_object_get(table, "side_xy"), "collisions"),
               yz = number(json_object_get(table, "side_yz"), "collisions");
  assert_true(number(table, "points") > 0);
  assert_true(volume > frontal + xy + yz);
  assert_true(frontal >= xy && frontal >= yz && xy >= 0 && yz >= 0);
}

static void test_tables_long(void **state) {
  (void)state;
  cli_run(&cli,
          "ablate %s/data/tiny -o tables --iters 4 --rays 64 --frames 0:2 --repeats 3 --threads 2 --only "
          "trihash-channel,trihash-concat,hash3d-channel --json --quiet",
          getenv("ERNERF_SOURCE"));
  cli_expect(&cli, 0, NULL);
  json_t *object = cli_json(&cli, NULL);
  const json_t *rows = json_object_get(object, "rows");
  assert_int_equal(json_array_size(rows), 3);
  assert_int_equal(number(object, "frames"), 2);
  assert_string_equal(json_string_value(json_object_get(json_array_get(rows, 0), "name")), "hash3d-channel");
  for (size_t i = 0; i < 3; i++) check_row(json_array_get(rows, i), 1);
  assert_false(json_is_true(json_object_get(json_array_get(rows, 1), "fused"))); /* trihash-concat */
  check_collisions(json_object_get(object, "collisions"));
  json_decref(object);

  char text[CLI_TEXT_BYTES];
  cli_read("tables/ablation.md", text);
  assert_non_null(strstr(text, "| trihash | channel |"));
  assert_non_null(strstr(text, "| paper | 835186 |"));
  cli_read("tables/ablation.csv", text);
  size_t lines = 0;
  for (const char *at = text; *at != 0; at++) lines += *at == '\n';
  assert_int_equal(lines, 4);
  assert_int_equal(access("tables/ablation.json", R_OK), 0);
  assert_int_equal(access("tables/hash3d-channel.safetensors", R_OK), 0);
  cli_run(&cli, "info tables/hash3d-channel.safetensors");
  cli_expect_out(&cli, 0, "hash3d", NULL);
}

static void ablate_again(const char *folder, const char *more, double *psnr, double *seconds, double *lr_net) {
  cli_run(&cli,
          "ablate %s -o %s --iters 2 --rays 32 --seeds 2 --frames 0:1 --repeats 3 --only trihash-channel %s --json "
          "--quiet",
          clip, folder, more);
  cli_expect(&cli, 0, NULL);
  json_t *object = cli_json(&cli, NULL);
  const json_t *row = json_array_get(json_object_get(object, "rows"), 0);
  check_row(row, 2);
  *psnr = number(json_object_get(row, "psnr"), "mean");
  *seconds = number(json_object_get(row, "training_seconds"), "mean");
  *lr_net = number(object, "lr_net");
  json_decref(object);
}

/* All trainings are done: a second call evaluates them again and finds the same, also in the seconds behind them.
 * Another rate is another training. */
static void test_resume_long(void **state) {
  (void)state;
  double psnr[3], seconds[3], lr_net[3];
  ablate_again("again", "--lr-net 0.004", &psnr[0], &seconds[0], &lr_net[0]);
  ablate_again("again", "--lr-net 0.004 --resume", &psnr[1], &seconds[1], &lr_net[1]);
  ablate_again("slower", "", &psnr[2], &seconds[2], &lr_net[2]);
  assert_true(psnr[0] == psnr[1] && seconds[0] == seconds[1] && psnr[2] != psnr[0]);
  assert_true((float)lr_net[0] == 0.004f && lr_net[1] == lr_net[0] && (float)lr_net[2] == 0.001f);
  assert_int_equal(access("again/trihash-channel-s0.safetensors", R_OK), 0);
  assert_int_equal(access("again/trihash-channel-s1.safetensors", R_OK), 0);
}

static const char ablate_row[] = "ablate %s -o %s --iters 2 --rays 32 --frames 0:1 --repeats 3 --only %s --quiet %s";

/* --resume replaces tables only where they are those of these rows. */
static void test_resume_keeps_tables(void **state) {
  (void)state;
  cli_run(&cli, ablate_row, clip, "rows", "trihash-channel", "");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, ablate_row, clip, "rows", "hash3d-channel", "--resume");
  cli_expect(&cli, 1, "rows/ablation.json", "holds the row trihash-channel", "--overwrite", NULL);
  static const struct {
    const char *more, *words;
  } others[] = {{"--resume --seeds 2", "has seeds 1, expected 2"},
                {"--resume --frames 0:2", "has frames 1, expected 2"},
                {"--resume --rays 16", "has rays 32, expected 16"},
                {"--resume --lr-net 0.01", "has lr_net 0.001, expected 0.01"},
                {"--resume --seed 5", "has seed 0, expected 5"}};
  for (size_t i = 0; i < sizeof others / sizeof *others; i++) {
    cli_run(&cli, "ablate %s -o rows --iters 2 --repeats 3 --only trihash-channel --quiet %s%s%s", clip,
            strstr(others[i].more, "rays") == NULL ? "--rays 32 " : "",
            strstr(others[i].more, "frames") == NULL ? "--frames 0:1 " : "", others[i].more);
    cli_expect(&cli, 1, others[i].words, NULL);
  }
}

/* Nor where the folder holds other files, or a link in a table's place. */
static void test_resume_keeps_other_files_long(void **state) {
  (void)state;
  cli_run(&cli, ablate_row, clip, "rows", "hash3d-channel,trihash-channel", "--resume");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(mkdir("notes", 0777), 0);
  support_write_text("notes/ablation.md", "mine");
  cli_run(&cli, ablate_row, clip, "notes", "trihash-channel", "--resume");
  cli_expect(&cli, 1, "notes: ", "no tables of an earlier ablation", "--overwrite", NULL);
  cli_run(&cli, ablate_row, clip, "notes", "trihash-channel", "--resume --overwrite");
  cli_expect(&cli, 0, NULL);
  /* a table that leads elsewhere, and a report into a row's state */
  assert_int_equal(system("rm rows/ablation.md && printf mine > mine.md && ln -s ../mine.md rows/ablation.md"), 0);
  cli_run(&cli, ablate_row, clip, "rows", "hash3d-channel,trihash-channel", "--resume");
  cli_expect(&cli, 1, "rows/ablation.md", "no regular file", NULL);
  assert_int_equal(system("printf mine | cmp - mine.md"), 0);
  assert_int_equal(symlink("rows/trihash-channel.run/state.safetensors", "link.json"), 0);
  cli_run(&cli, ablate_row, clip, "rows", "trihash-channel", "--json link.json -y");
  cli_expect(&cli, 1, "link.json", "is in rows", NULL);
}

static void test_refusals(void **state) {
  (void)state;
  cli_run(&cli, "ablate %s", clip);
  cli_expect(&cli, 2, "-o DIR is missing", NULL);
  cli_run(&cli, "ablate %s -o x --only trihash-channel,cubes", clip);
  cli_expect(&cli, 2, "there is no row \"cubes\"", NULL);
  cli_run(&cli, "ablate %s -o x --seeds 0", clip);
  cli_expect(&cli, 2, "--seeds", NULL);
  cli_run(&cli, "ablate %s -o x --frames 40:50", clip);
  cli_expect(&cli, 2, "--frames", NULL);
  cli_run(&cli, "ablate nothing -o x");
  cli_expect(&cli, 1, "nothing", NULL);
  FILE *file = fopen("a_file", "w");
  assert_non_null(file);
  fclose(file);
  cli_run(&cli, "ablate %s -o a_file --iters 1 --rays 1", clip);
  cli_expect(&cli, 1, "a_file: is no folder", NULL);
  cli_run(&cli, "ablate %s -o missing/deeper --iters 1 --rays 1", clip);
  cli_expect(&cli, 1, "missing/deeper: cannot be made", NULL);
  assert_int_not_equal(access("x", F_OK), 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_tables_long), cmocka_unit_test(test_resume_long),
                                     cmocka_unit_test(test_resume_keeps_tables),
                                     cmocka_unit_test(test_resume_keeps_other_files_long),
                                     cmocka_unit_test(test_refusals)};
  return cmocka_run_group_tests(tests, make_clip, NULL);
}
