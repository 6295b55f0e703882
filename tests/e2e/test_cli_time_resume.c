/* SPDX-License-Identifier: MIT
 * `train --time` gone on with: the torso is trained as the head was, and what is in a portrait's way is told before
 * any work. */
#include "cli.h"

#include <math.h>
#include <sys/file.h>
#include <time.h>

static struct cli cli;

#define SMALL "--rays 32 --levels 2 --validate-frames 1 "

static int make_clip(void **state) {
  (void)state;
  support_clear("clip");
  cli_run(&cli, "synth clip --size 64 --frames 22 --quiet");
  cli_expect(&cli, 0, NULL);
  return 0;
}

/* Nothing of the portrait NAME.safetensors. */
static void clear(const char *name) {
  static const char *const parts[] = {".safetensors", ".run", ".head.safetensors", ".head.run"};
  char path[64];
  for (size_t i = 0; i < sizeof parts / sizeof *parts; i++) {
    snprintf(path, sizeof path, "%s%s", name, parts[i]);
    support_clear(path);
  }
}

/* Trains clip with these words, and stops it while it trains the head. */
static void stop_in_head(const char *words) {
  snprintf(cli.line, sizeof cli.line, "train clip " SMALL "%s", words);
  support_clear("cli_err.txt");
  cli_start(&cli, NULL, 0);
  for (int i = 0; i < 3000; i++) {
    cli_read("cli_err.txt", cli.err);
    if (strstr(cli.err, "in all, steps of") != NULL) break;
    nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
  }
  assert_int_equal(kill(cli.pid, SIGINT), 0);
  cli_wait(&cli);
  cli_expect(&cli, 128 + SIGINT, "the state is saved", NULL);
}

/* The metadata "ernerf.state" of a state; the caller owns it. */
static json_t *state_of(const char *path) {
  size_t count = 0;
  uint64_t bytes = 0;
  uint8_t *file = cli_bytes(path, &count);
  assert_true(count > 8);
  for (int i = 7; i >= 0; i--) bytes = bytes << 8 | file[i];
  assert_true(bytes <= count - 8);
  json_t *header = json_loadb((const char *)file + 8, (size_t)bytes, 0, NULL);
  const json_t *text = json_object_get(json_object_get(header, "__metadata__"), "ernerf.state");
  json_t *about = json_loads(json_string_value(text), 0, NULL);
  assert_non_null(about);
  json_decref(header);
  free(file);
  return about;
}

/* A number of a state, or one of its settings; of a flag 1 or 0. */
static double said(const char *path, const char *name) {
  json_t *about = state_of(path);
  const json_t *settings = json_object_get(json_object_get(about, "training"), "settings");
  const json_t *value = json_object_get(about, name), *setting = json_object_get(settings, name);
  const char *text = json_string_value(setting);
  assert_true((value != NULL) != (text != NULL));
  const double number = text == NULL ? json_number_value(value) : strcmp(text, "yes") == 0 ? 1 : strtod(text, NULL);
  json_decref(about);
  return number;
}

static json_t *setting_of(json_t *about, const char *name) {
  return json_object_get(json_object_get(json_object_get(about, "training"), "settings"), name);
}

static void test_torso_as_the_head(void **state) {
  (void)state;
  static const char *const names[] = {"seed", "rays", "data_begin", "data_end", "lr", "ema", "ema_every"};
  static const double values[] = {7, 32, 2, 15, 0.005, 1, 50};
  clear("a");
  stop_in_head(
      "-o a.safetensors --time 60s --seed 7 --data-range 2:15 --lr 0.005 --set ema=yes --set ema-every=50 --set "
      "frames_per_step=3");
  cli_run(&cli, "train clip -o a.safetensors --validate-frames 1 --time 1s --resume");
  cli_expect(&cli, 0, "from 13 frames of 64", "steps of 32 rays, seed 7", "done, a.safetensors", NULL);
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    assert_true(fabs(said("a.head.run/state.safetensors", names[i]) - values[i]) < 1e-6);
    assert_true(fabs(said("a.run/state.safetensors", names[i]) - values[i]) < 1e-6);
  }
  assert_true(said("a.head.run/state.safetensors", "frames_per_step") == 3);
  assert_true(said("a.run/state.safetensors", "frames_per_step") == 1); /* as uninterrupted: it is the head's */
  assert_true(said("a.run/state.safetensors", "torso_random_background") == 1);
  /* a time that is about the same leaves the head of a torso as it is */
  cli_run(&cli, "train clip -o a.safetensors --validate-frames 1 --time 1.3s --resume");
  cli_expect(&cli, 0, "were done before; a.head.safetensors", "done, a.safetensors", NULL);
}

/* What the head is learnt over is kept; random colours cannot be had without parsing. */
static void test_background_of_the_head(void **state) {
  (void)state;
  clear("h");
  cli_run(&cli, "train clip -o h.safetensors --iters 2 --set head-random-background=yes");
  cli_expect(&cli, 1, "clip/parsing: is missing, and --set head-random-background=yes needs it", NULL);
  assert_false(cli_there("h.run"));
  cli_run(&cli, "train clip -o h.safetensors --iters 2 --rays 32 --levels 2 --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_true(said("h.run/state.safetensors", "head_random_background") == 1);
  const char *more = "train clip -o h.safetensors --rays 32 --levels 2 --validate-frames 1 --quiet";
  cli_run(&cli, "%s --iters 2 --set head-random-background=no -y", more);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "%s --iters 3 --resume", more);
  cli_expect(&cli, 0, NULL);
  assert_true(said("h.run/state.safetensors", "head_random_background") == 0);
}

/* Options of the torso wait with the head, and are refused where there is no torso. */
static void test_options_of_the_torso(void **state) {
  (void)state;
  clear("g");
  stop_in_head("-o g.safetensors --time 60s --set torso-gamma=yes --torso-shrink 0.7 --set torso-random-background=no");
  assert_true(said("g.head.run/state.safetensors", "torso_random_background") == 0);
  stop_in_head("-o g.safetensors --time 60s --resume");
  cli_run(&cli, "train clip -o g.safetensors --validate-frames 1 --time 1s --resume");
  cli_expect(&cli, 0, "done, g.safetensors", NULL);
  assert_true(said("g.run/state.safetensors", "torso_gamma") > 0);
  assert_true(said("g.run/state.safetensors", "torso_random_background") == 0);
  cli_run(&cli, "info g.safetensors --json -");
  cli_expect_out(&cli, 0, "\"torso_shrink\": 0.69999", NULL);
  clear("n");
  cli_run(&cli, "train clip -o n.safetensors --time 1s --effects eye --torso-shrink 0.7");
  cli_expect(&cli, 2, "--torso-shrink is about the torso", NULL);
  assert_false(cli_there("n.run") || cli_there("n.head.run"));
  /* a refusal leaves neither folder */
  support_write_text("n.head.safetensors", "mine");
  cli_run(&cli, "train clip -o n.safetensors --time 1s");
  cli_expect(&cli, 1, "n.head.safetensors: is there already", NULL);
  assert_false(cli_there("n.run") || cli_there("n.head.run"));
}

static void test_bf16(void **state) {
  (void)state;
  clear("b");
  cli_run(&cli, "train clip -o b.safetensors " SMALL "--time 0.5s --precision bf16");
  if (strstr(cli.err, "bf16 needs") != NULL) skip();
  cli_expect(&cli, 0, "done, b.safetensors", NULL);
  cli_run(&cli, "train clip -o b.safetensors --time 0.5s --precision bf16 --resume");
  cli_expect(&cli, 0, "were done before; b.safetensors", NULL);
  json_t *head = state_of("b.head.run/state.safetensors"), *torso = state_of("b.run/state.safetensors");
  const char *of_head = json_string_value(setting_of(head, "precision"));
  const char *of_torso = json_string_value(setting_of(torso, "precision"));
  assert_string_equal(of_head, "bf16");
  assert_string_equal(of_torso, "fp32");
  json_decref(head);
  json_decref(torso);
}

/* A time holds as many updates of the average as come: no call is refused for them. */
static void test_average(void **state) {
  (void)state;
  clear("e");
  cli_run(&cli, "train clip -o e.safetensors " SMALL "--time 0.5s --set ema=yes --set ema-every=1000000");
  cli_expect(&cli, 0, "e.head.safetensors: step ", "e.safetensors: step ", "the average has seen 0 updates", NULL);
  cli_run(&cli, "train clip -o e.safetensors --time 0.5s --resume");
  cli_expect(&cli, 0, "the average has seen 0 updates", "were done before; e.safetensors", NULL);
}

/* A portrait that another replaces, stopped before its torso. */
static void test_torso_of_another_head(void **state) {
  (void)state;
  clear("k");
  cli_run(&cli, "train clip -o k.safetensors " SMALL "--time 0.5s --quiet");
  cli_expect(&cli, 0, NULL);
  stop_in_head("-o k.safetensors --time 60s --seed 7 --overwrite");
  const double step = said("k.head.run/state.safetensors", "step");
  cli_run(&cli, "train clip -o k.safetensors --time 60s --resume");
  cli_expect(&cli, 1, "k.safetensors: its torso is trained for another head than that of k.head.safetensors",
             "--overwrite", NULL);
  assert_true(said("k.head.run/state.safetensors", "step") == step);
  assert_true(said("k.run/state.safetensors", "seed") == 0);
  cli_run(&cli, "train clip -o k.safetensors --validate-frames 1 --time 0.5s --resume --overwrite");
  cli_expect(&cli, 0, "done, k.safetensors", NULL);
  assert_true(said("k.run/state.safetensors", "seed") == 7 && said("k.run/state.safetensors", "rays") == 32);
  cli_run(&cli, "train clip -o k.safetensors --time 0.5s --resume");
  cli_expect(&cli, 0, "were done before; k.safetensors", NULL);

  /* the torso's place is held too */
  const int lock = open("k.run/lock", O_RDWR);
  assert_true(lock >= 0 && flock(lock, LOCK_EX | LOCK_NB) == 0);
  cli_run(&cli, "train clip -o k.safetensors " SMALL "--time 0.5s --overwrite");
  cli_expect(&cli, 1, "k.run/lock: another training holds this lock", NULL);
  assert_true(said("k.head.run/state.safetensors", "seed") == 7);
  close(lock);

  support_write_text("k.run/state.safetensors", "damaged");
  support_clear("k.run/state.previous.safetensors");
  support_clear("k.head.safetensors");
  cli_run(&cli, "train clip -o k.safetensors --time 0.5s --resume");
  cli_expect(&cli, 1, "k.run/state.safetensors: ", NULL);
  assert_false(cli_there("k.head.safetensors"));
}

/* A head alone that has replaced a portrait goes on alone. */
static void test_head_of_a_portrait_before(void **state) {
  (void)state;
  clear("m");
  cli_run(&cli, "train clip -o m.safetensors " SMALL "--time 0.5s --quiet");
  cli_expect(&cli, 0, NULL);
  const double step = said("m.head.run/state.safetensors", "step");
  cli_run(&cli, "train clip -o m.safetensors " SMALL "--time 0.5s --overwrite --effects eye,codes,view --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o m.safetensors --validate-frames 1 --time 1s --resume");
  cli_expect(&cli, 0, "seconds was 0.5, going on with 1", "done, m.safetensors", NULL);
  assert_null(strstr(cli.err, "m.head"));
  assert_true(said("m.head.run/state.safetensors", "step") == step);
  cli_run(&cli, "train clip -o m.safetensors --validate-frames 1 --time 2s --resume --effects eye,codes,view,torso");
  cli_expect(&cli, 1, "m.safetensors: its training is that of a head alone", NULL);
}

static void test_torso_has_no_place(void **state) {
  (void)state;
  clear("f");
  assert_int_equal(mkdir("f.run", 0777), 0);
  support_write_text("f.run/measures.csv", "mine");
  cli_run(&cli, "train clip -o f.safetensors " SMALL "--time 0.5s --resume");
  cli_expect(&cli, 1, "f.run/measures.csv: is there already", NULL);
  assert_false(cli_there("f.head.run") || cli_there("f.head.safetensors"));
  clear("f");
  assert_int_equal(symlink("nowhere", "f.run"), 0);
  cli_run(&cli, "train clip -o f.safetensors " SMALL "--time 0.5s --overwrite");
  cli_expect(&cli, 1, "f.run: is a symbolic link", NULL);
  assert_false(cli_there("f.head.run") || cli_there("f.head.safetensors"));
  assert_int_equal(unlink("f.run"), 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_torso_as_the_head),
                                     cmocka_unit_test(test_background_of_the_head),
                                     cmocka_unit_test(test_options_of_the_torso),
                                     cmocka_unit_test(test_bf16),
                                     cmocka_unit_test(test_average),
                                     cmocka_unit_test(test_torso_of_another_head),
                                     cmocka_unit_test(test_head_of_a_portrait_before),
                                     cmocka_unit_test(test_torso_has_no_place)};
  return cmocka_run_group_tests(tests, make_clip, NULL);
}
