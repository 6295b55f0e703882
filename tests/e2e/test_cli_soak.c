/* SPDX-License-Identifier: MIT
 * The stress command for some seconds, head and torso: what it counts, and that it leaves nothing. */
#include "cli.h"

static struct cli cli;

static long long count_of(const json_t *report, const char *field) {
  return json_integer_value(json_object_get(report, field));
}

static void soak(const char *more, const char *seed, bool torso) {
  char left[64];
  snprintf(left, sizeof left, "soaked");
  support_clear(left);
  assert_int_equal(mkdir(left, 0777), 0);
  assert_int_equal(setenv("TMPDIR", left, 1), 0);
  cli_run(&cli, "soak %s/data/tiny --steps 20 --seed %s %s --json -", getenv("ERNERF_SOURCE"), seed, more);
  cli_expect(&cli, 0, "all finite", seed, NULL);
  json_t *report = cli_json(&cli, NULL);
  assert_true(count_of(report, "steps") > 0 && count_of(report, "rounds") > 0 && count_of(report, "frames") > 0);
  assert_int_equal(json_is_true(json_object_get(report, "torso")), torso);
  json_decref(report);
  assert_int_equal(cli_count(left), 0);
}

static void test_head_long(void **state) { (void)state, soak("", "3", false); }
static void test_torso(void **state) { (void)state, soak("--torso", "4", true); }

/* The same seed and round: as many steps in as many rounds, gone on from as often. */
static void test_again_long(void **state) {
  (void)state;
  long long resumes[2] = {-1, -2};
  for (size_t k = 0; k < 2; k++) {
    cli_run(&cli, "soak %s/data/tiny --torso --steps 90 --seed 8 --first 2 --json - --quiet", getenv("ERNERF_SOURCE"));
    cli_expect(&cli, 0, NULL);
    json_t *report = cli_json(&cli, NULL);
    assert_int_equal(count_of(report, "steps"), 90);
    resumes[k] = count_of(report, "resumes") * 1000 + count_of(report, "rounds");
    json_decref(report);
  }
  assert_int_equal(resumes[0], resumes[1]);
}

static void test_refused(void **state) {
  (void)state;
  cli_run(&cli, "soak nowhere");
  cli_expect(&cli, 1, "nowhere", "missing", NULL);
  cli_run(&cli, "soak a b");
  cli_expect(&cli, 2, "\"b\"", NULL);
  assert_int_equal(setenv("TMPDIR", "no/such", 1), 0);
  cli_run(&cli, "soak %s/data/tiny --seconds 1", getenv("ERNERF_SOURCE"));
  cli_expect(&cli, 1, "no/such/ernerf-soak-", "cannot be made", "No such file", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_head_long), cmocka_unit_test(test_torso),
                                     cmocka_unit_test(test_again_long), cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
