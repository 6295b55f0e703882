/* SPDX-License-Identifier: MIT
 * Started without standard input, output or errors, as by some schedulers: the next file that is opened has their
 * number, and what is meant for the terminal must not end in it. */
#include "cli.h"

static struct cli cli;

static int shell(const char *line, const char *redirection) {
  char command[CLI_LINE_BYTES];
  assert_true(snprintf(command, sizeof command, "\"$ERNERF_BIN\" %s %s", line, redirection) < (int)sizeof command);
  const int status = system(command);
  assert_true(WIFEXITED(status));
  return WEXITSTATUS(status);
}

static int prepare(void **state) {
  (void)state;
  static const char *const old[] = {"clip", "usual.safetensors", "usual.run"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  cli_run(&cli, "synth clip --size 64 --frames 8 --seed 3 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o usual.safetensors --rays 32 --iters 2 --levels 2 --validate-frames 1");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render usual.safetensors --clip clip -o usual.mp4 --frames 0:2");
  cli_expect(&cli, 0, NULL);
  return 0;
}

static void expect_as_usual(const char *closed) {
  struct stat lock;
  support_clear("closed.safetensors");
  support_clear("closed.run");
  assert_int_equal(shell("train clip -o closed.safetensors --rays 32 --iters 2 --levels 2 --validate-frames 1", closed),
                   0);
  cli_same_bytes("closed.safetensors", "usual.safetensors");
  assert_int_equal(stat("closed.run/lock", &lock), 0);
  assert_int_equal(lock.st_size, 0);
  assert_int_equal(shell("render closed.safetensors --clip clip -o closed.mp4 --frames 0:2 -y", closed), 0);
  cli_same_bytes("closed.mp4", "usual.mp4");
}

static void test_files_are_as_usual(void **state) {
  (void)state;
  expect_as_usual("<&- >&- 2>&-");
}

static void test_one_is_closed_long(void **state) {
  (void)state;
  static const char *const closed[] = {"<&-", ">&-", "2>&-"};
  for (size_t k = 0; k < sizeof closed / sizeof *closed; k++) expect_as_usual(closed[k]);
}

static void test_result_without_an_output(void **state) {
  (void)state;
  assert_int_equal(shell("info usual.safetensors --json -", ">&- 2>said.txt"), 1);
  cli_read("said.txt", cli.err);
  assert_non_null(strstr(cli.err, "standard output"));
  assert_int_equal(shell("info usual.safetensors", "2>&- >said.txt"), 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_files_are_as_usual),
                                     cmocka_unit_test(test_one_is_closed_long),
                                     cmocka_unit_test(test_result_without_an_output)};
  return cmocka_run_group_tests(tests, prepare, NULL);
}
