/* SPDX-License-Identifier: MIT
 * Makes the clips and models that other end-to-end tests take (cli_shared_clip, cli_shared_model of cli.h), in its own
 * folder. CTest runs it before them: it is their fixture. */
#include "cli.h"

static struct cli cli;

static void make(const char *line) {
  cli_run(&cli, "%s --quiet", line);
  cli_expect(&cli, 0, NULL);
  assert_string_equal(cli.err, "");
}

/* 30 frames to train on and 3 for validation, and a head of them. */
static void test_short(void **state) {
  (void)state;
  make("synth short --size 64 --frames 33 --seed 3");
  make("train short -o short_head.safetensors --iters 20 --rays 256 --levels 2 --validate-frames 1");
  assert_int_equal(cli_count("short/gt_imgs"), 33);
  assert_true(cli_there("short_head.safetensors") && cli_there("short_head.run/state.safetensors"));
}

/* 60 frames to train on and 6 for validation, and a head of them that is hardly trained. */
static void test_long(void **state) {
  (void)state;
  make("synth long --size 64 --frames 66 --seed 3");
  make("train long -o long_head.safetensors --iters 6 --rays 256 --levels 4 --validate-frames 1");
  assert_int_equal(cli_count("long/gt_imgs"), 66);
  assert_true(cli_there("long_head.safetensors") && cli_there("long_head.run/state.safetensors"));
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_short), cmocka_unit_test(test_long)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
