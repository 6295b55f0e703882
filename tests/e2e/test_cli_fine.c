/* SPDX-License-Identifier: MIT
 * The fine stage from the command line: after a coarse training, as its last part, and what does not go with it. */
#include "cli.h"

static struct cli cli;

static int make_clip(void **state) {
  (void)state;
  static const char *const old[] = {"clip",  "m.safetensors",      "m.run",      "n.safetensors",
                                    "n.run", "o.safetensors",      "o.run",      "t.safetensors",
                                    "t.run", "t.head.safetensors", "t.head.run", "u.safetensors",
                                    "u.run", "u.head.safetensors", "u.head.run"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  cli_shared_clip("short", "clip");
  return 0;
}

#define HEAD "--rays 600 --levels 2 --seed 5 --validate-every 0 --validate-frames 1 "
#define FINE " --patch-size 16 --set fine-weight=0.3 "

/* A coarse training that goes on as a fine one is the training that was to become one; a resume of that needs no word
 * of it. What is drawn then differs from what a coarse training of as many steps draws. */
static void test_after_and_as_the_last_part(void **state) {
  (void)state;
  cli_run(&cli, "train clip -o m.safetensors " HEAD FINE "--iters 16 --set fine-steps=6");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o n.safetensors " HEAD "--iters 10");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o n.safetensors --resume --stage fine" FINE "--iters 16");
  cli_expect(&cli, 0, NULL);
  cli_same_bytes("m.safetensors", "n.safetensors");
  cli_run(&cli, "train clip -o n.safetensors --resume --iters 18");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o o.safetensors " HEAD "--iters 16");
  cli_expect(&cli, 0, NULL);
  size_t first = 0, second = 0;
  uint8_t *fine = cli_bytes("m.safetensors", &first), *coarse = cli_bytes("o.safetensors", &second);
  assert_true(first != second || memcmp(fine, coarse, first) != 0);
  free(fine);
  free(coarse);
}

static json_t *state_of(const char *path) {
  size_t count = 0;
  uint8_t *bytes = cli_bytes(path, &count);
  uint64_t length = 0;
  json_error_t error;
  memcpy(&length, bytes, sizeof length);
  json_t *header = json_loadb((const char *)bytes + 8, (size_t)length, 0, &error);
  const json_t *text = json_object_get(json_object_get(header, "__metadata__"), "ernerf.state");
  json_t *about = json_loads(json_string_value(text), 0, &error);
  assert_non_null(about);
  json_decref(header);
  free(bytes);
  return about;
}

static void expect_setting(const json_t *training, const char *name, const char *value) {
  const char *found = json_string_value(json_object_get(json_object_get(training, "settings"), name));
  assert_non_null(found);
  assert_string_equal(found, value);
}

/* By the clock the last fifth of the head's steps are fine ones where that is wanted, and else none. */
static void test_by_the_clock_long(void **state) {
  (void)state;
  cli_run(&cli, "train clip -o t.safetensors --time 4s --levels 2 --stage fine --quiet");
  cli_expect(&cli, 0, NULL);
  json_t *about = state_of("t.head.run/state.safetensors"), *training = json_object_get(about, "training");
  const double steps = json_number_value(json_object_get(about, "step"));
  const double from = json_number_value(json_object_get(training, "fine_from"));
  assert_true(from > 0.3 * steps && from < steps);
  json_decref(about);
  cli_run(&cli, "train clip -o u.safetensors --time 2s --levels 2 --quiet");
  cli_expect(&cli, 0, NULL);
  about = state_of("u.head.run/state.safetensors"), training = json_object_get(about, "training");
  assert_null(json_object_get(training, "fine_from"));
  /* what a time is spent on: small steps of one frame, and the average of the weights */
  expect_setting(training, "rays", "512");
  expect_setting(training, "frames_per_step", "1");
  expect_setting(training, "ema_every", "40");
  expect_setting(training, "ema", "yes");
  json_decref(about);
  /* a patch has more rays than such a step, which stays as it is */
  cli_run(&cli, "train clip -o u.safetensors --resume -y --time 4s --stage fine --quiet");
  cli_expect(&cli, 0, NULL);
  about = state_of("u.head.run/state.safetensors"), training = json_object_get(about, "training");
  expect_setting(training, "rays", "512");
  assert_non_null(json_object_get(training, "fine_from"));
  json_decref(about);
}

static void test_refused(void **state) {
  (void)state;
  cli_run(&cli, "train clip -o p.safetensors --time 5s --set fine-steps=9");
  cli_expect(&cli, 2, "--set fine-steps", "--time", NULL);
  cli_run(&cli, "train clip -o p.safetensors --patch-size 16");
  cli_expect(&cli, 2, "--patch-size", "--stage fine", NULL);
  cli_run(&cli, "train clip -o p.safetensors --time 5s --stage coarse --set fine-weight=1");
  cli_expect(&cli, 2, "--set fine-weight", "--stage fine", NULL);
  cli_run(&cli, "train clip -o p.safetensors --stage fine --set fine-steps=3");
  cli_expect(&cli, 2, "--set fine-steps", NULL);
  cli_run(&cli, "train clip -o p.safetensors --torso --head m.safetensors --set fine-steps=3");
  cli_expect(&cli, 2, "--set fine-steps", NULL);
  cli_run(&cli, "train clip -o p.safetensors --set fine-steps=3 --patch-size 24");
  cli_expect(&cli, 1, "patch_size is 24, expected 16, 32, 48 or 64", NULL);
  cli_run(&cli, "train clip -o p.safetensors --iters 5 --set fine-steps=6");
  cli_expect(&cli, 1, "fine_steps is 6", "iters", "5", NULL);
  assert_true(access("p.safetensors", F_OK) != 0);
  cli_run(&cli, "train clip -o n.safetensors --resume --stage coarse --iters 20");
  cli_expect(&cli, 1, "--stage coarse", "since step 10", NULL);
  cli_run(&cli, "train clip -o o.safetensors --resume --patch-size 16 --iters 20");
  cli_expect(&cli, 2, "--patch-size", "--stage fine", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_after_and_as_the_last_part),
                                     cmocka_unit_test(test_by_the_clock_long), cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, make_clip, NULL);
}
