/* SPDX-License-Identifier: MIT
 * A head and its torso go on to a longer clip, and to a shorter one. */
#include "cli.h"

static struct cli cli;

static int make_clips(void **state) {
  (void)state;
  static const char *const old[] = {"short",         "long",  "a.safetensors", "a.run", "b.safetensors", "b.run",
                                    "p.safetensors", "p.run", "q.safetensors", "q.run", "c.safetensors", "c.run"};
  for (size_t i = 0; i < sizeof old / sizeof old[0]; i++) support_clear(old[i]);
  cli_run(&cli, "synth short --size 64 --frames 12 --seed 3 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "synth long --size 64 --frames 30 --seed 3 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train short -o a.safetensors --iters 20 --rays 128 --levels 4 --effects eye,codes,view,torso --quiet");
  cli_expect(&cli, 0, NULL);
  return 0;
}

static json_int_t codes_of(const char *model) {
  cli_run(&cli, "info %s --json -", model);
  cli_expect(&cli, 0, NULL);
  json_t *object = cli_json(&cli, NULL);
  const json_int_t codes = json_integer_value(json_object_get(object, "codes"));
  json_decref(object);
  return codes;
}

static void test_longer_and_shorter_long(void **state) {
  (void)state;
  const json_int_t few = codes_of("a.safetensors");
  cli_run(&cli, "train long -o b.safetensors --from a.run/state.safetensors --iters 24 --rays 128");
  cli_expect(&cli, 0, "a.run/state.safetensors: has ", "they are kept", "are fresh", NULL);
  const json_int_t many = codes_of("b.safetensors");
  assert_true(many > few);
  cli_run(&cli, "train short --torso --head a.safetensors -o p.safetensors --iters 6 --rays 128 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train long --torso --head b.safetensors --from p.safetensors -o q.safetensors --iters 6 --rays 128");
  cli_expect(&cli, 0, "p.safetensors: has ", "are fresh", NULL);
  assert_int_equal(codes_of("q.safetensors"), many);
  cli_run(&cli, "train short -o c.safetensors --from b.safetensors --iters 4 --rays 128 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(codes_of("c.safetensors"), many); /* no row is in the way */
  cli_run(&cli, "train short -o c.safetensors --from b.safetensors --iters 4 --rays 128 --ind-num %d --overwrite",
          (int)few);
  cli_expect(&cli, 0, "the others dropped", NULL);
  assert_int_equal(codes_of("c.safetensors"), few);
}

/* A training does not go on to a clip that has become shorter, unless it is told which frames of it to take. */
static void test_resume_with_fewer(void **state) {
  (void)state;
  char refused[64];
  support_clear("r.safetensors");
  support_clear("r.run");
  cli_run(&cli, "train long -o r.safetensors --iters 4 --rays 64 --levels 2 --quiet");
  cli_expect(&cli, 0, NULL);
  snprintf(refused, sizeof refused, "short: has %d training frames", (int)codes_of("a.safetensors"));
  cli_run(&cli, "train short -o r.safetensors --resume --iters 6");
  cli_expect(&cli, 1, refused, "r.safetensors", "--data-range", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_longer_and_shorter_long),
                                     cmocka_unit_test(test_resume_with_fewer)};
  return cmocka_run_group_tests(tests, make_clips, NULL);
}
