/* SPDX-License-Identifier: MIT
 * `train --time`: a head and its torso by the clock, gone on with, and what does not go with it; `--paper`. */
#include "cli.h"

static struct cli cli;

#define TIMED "train clip -o p.safetensors --rays 32 --levels 2 --validate-frames 1 "

static int make_clips(void **state) {
  (void)state;
  static const char *const old[] = {"clip",       "alone",         "p.safetensors", "p.run", "p.head.safetensors",
                                    "p.head.run", "h.safetensors", "h.run"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  cli_run(&cli, "synth clip --size 64 --frames 22 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_copy("clip", "alone");
  support_clear("alone/torso_imgs");
  return 0;
}

/* A number of the object that --json prints of a training. */
static double number_of(const char *name) {
  json_t *object = cli_json(&cli, NULL);
  const double value = json_number_value(json_object_get(object, name));
  json_decref(object);
  return value;
}

static bool has_torso(const char *model) {
  cli_run(&cli, "info %s --json -", model);
  cli_expect(&cli, 0, NULL);
  json_t *object = cli_json(&cli, NULL);
  const bool has = strcmp(json_string_value(json_object_get(object, "kind")), "head+torso") == 0;
  json_decref(object);
  return has;
}

static void test_head_and_torso_long(void **state) {
  (void)state;
  cli_run(&cli, TIMED " --time 6s");
  cli_expect(&cli, 0, "5 s in all", "a preview", "writes p.head.safetensors", "1 s in all",
             "the torso for p.head.safetensors", "done, p.safetensors", NULL);
  assert_false(has_torso("p.head.safetensors"));
  assert_true(has_torso("p.safetensors"));
  cli_run(&cli, TIMED " --time 6s");
  cli_expect(&cli, 1, "p.safetensors: is there already", "--resume", "--overwrite", NULL);
  support_clear("p.safetensors");
  cli_run(&cli, TIMED " --time 6s");
  cli_expect(&cli, 1, "p.run/", ": is there already", NULL);

  /* all of it is done; what was removed comes back from the state */
  cli_run(&cli, "train clip -o p.safetensors --time 6s --resume --json -");
  cli_expect(&cli, 0, "were done before; p.head.safetensors", "were done before; p.safetensors", NULL);
  const double steps = number_of("step");
  assert_true(steps > 1);
  assert_true(has_torso("p.safetensors"));
  cli_run(&cli, "train clip -o p.safetensors --time 12s --resume");
  cli_expect(&cli, 1, "p.safetensors: its torso is trained for a head of --time 6 s", NULL);
}

static void test_head_alone(void **state) {
  (void)state;
  cli_run(&cli, "train alone -o h.safetensors --rays 32 --levels 2 --validate-frames 1 --time 1s --json -");
  cli_expect(&cli, 0, "1 s in all", "done, h.safetensors", NULL);
  assert_true(number_of("step") >= 1 && number_of("seconds") > 0); /* how many, the load of the machine decides */
  assert_int_not_equal(access("h.head.safetensors", F_OK), 0);
  /* a resume without --time keeps the time */
  cli_run(&cli, "train alone -o h.safetensors --resume");
  cli_expect(&cli, 0, "steps were done before", NULL);
}

/* A head that was stopped goes on, with more time than it had, and its torso follows. */
static void test_stopped_head_long(void **state) {
  (void)state;
  support_clear("s.safetensors"), support_clear("s.run"), support_clear("s.head.safetensors"),
      support_clear("s.head.run");
  cli_run(&cli, "train clip -o s.head.safetensors --rays 32 --levels 2 --validate-frames 1 --iters 5 --quiet");
  cli_expect(&cli, 0, NULL);
  /* what is no training's is not replaced, and that is said before any work */
  support_write_text("s.safetensors", "mine");
  cli_run(&cli, "train clip -o s.safetensors --time 2s --resume");
  cli_expect(&cli, 1, "s.safetensors: is there, and no training of it can go on", NULL);
  support_clear("s.safetensors");
  cli_run(&cli, "train clip -o s.safetensors --resume");
  cli_expect(&cli, 1, "s.safetensors: has no saved state, but its head s.head.safetensors has one", NULL);
  cli_run(&cli, "train clip -o s.safetensors --validate-frames 1 --time 2s --resume --json -");
  cli_expect(&cli, 0, "seconds was 0, going on with 1.66", "done, s.head.safetensors", "done, s.safetensors", NULL);
  assert_true(has_torso("s.safetensors"));
}

static void test_refused(void **state) {
  (void)state;
  static const struct {
    const char *options, *words;
  } cases[] = {{"--time 5x", "90s, 10m or 1.5h"},
               {"--time 0", "90s, 10m or 1.5h"},
               {"--time 1e3", "90s, 10m or 1.5h"},
               {"--time s", "90s, 10m or 1.5h"},
               {"--time 0.05s", "from 0.1s to 1000000000s"},
               {"--time 99999999m", "from 0.1s to 1000000000s"},
               {"--time 1.2.3", "90s, 10m or 1.5h"},
               {"--time 10m --iters 5", "--iters counts steps"},
               {"--time 10m --save-every 5", "--save-every counts steps"},
               {"--time 10m --paper", "--time and --paper"},
               {"--torso --head p.head.safetensors --set refine-poses=yes", "--set refine-poses is about the head"}};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    cli_run(&cli, "train clip -o n.safetensors %s", cases[i].options);
    cli_expect(&cli, 2, cases[i].words, NULL);
  }
  assert_int_not_equal(access("n.run", F_OK), 0);
}

/* The published schedule is that of these options. */
static void test_paper_long(void **state) {
  (void)state;
  support_clear("paper.safetensors"), support_clear("paper.run");
  support_clear("same.safetensors"), support_clear("same.run");
  cli_run(
      &cli,
      "train clip -o paper.safetensors --paper --iters 40 --rays 64 --levels 2 --seed 3 --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli,
          "train clip -o same.safetensors --iters 40 --rays 64 --levels 2 --seed 3 --validate-frames 1 --quiet "
          "--set refresh-every=16 --set ray-sampling=uniform --set voice-fade=no");
  cli_expect(&cli, 0, NULL);
  cli_same_bytes("paper.safetensors", "same.safetensors");
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_head_and_torso_long), cmocka_unit_test(test_head_alone),
                                     cmocka_unit_test(test_stopped_head_long), cmocka_unit_test(test_refused),
                                     cmocka_unit_test(test_paper_long)};
  return cmocka_run_group_tests(tests, make_clips, NULL);
}
