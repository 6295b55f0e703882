/* SPDX-License-Identifier: MIT
 * Ctrl-C, SIGTERM and a second one of either, and a terminal that closes, in the verbs that work for long: what is
 * saved is whole, what is not done has no file under its name, and the next start goes on. */
#include "cli.h"

#include <time.h>

static struct cli cli;

static void rest(long milliseconds) {
  nanosleep(&(struct timespec){.tv_sec = milliseconds / 1000, .tv_nsec = milliseconds % 1000 * 1000000}, NULL);
}

static int make_model(void **state) {
  (void)state;
  static const char *const old[] = {"m.safetensors", "m.run", "t.safetensors", "t.run", "table",         "trade",
                                    "cut.mp4",       "clip",  "h.safetensors", "h.run", "v.safetensors", "v.run"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  cli_run(&cli, "synth clip --size 64 --frames 8 --seed 3 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o m.safetensors --iters 1 --rays 16 --levels 2 --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  return 0;
}

static bool here(const char *sign) {
  if (sign[0] != '"') return cli_there(sign);
  cli_read("cli_err.txt", cli.err);
  return strstr(cli.err, sign + 1) != NULL;
}

/* Starts, waits for a file, or for words on stderr ("\"..."), and sends a signal. */
static void start_and_stop(const char *sign, int signal, const char *format, ...) ERN_PRINTF(3, 4);
static void start_and_stop(const char *sign, int signal, const char *format, ...) {
  va_list values;
  va_start(values, format);
  cli_words(&cli, format, values);
  va_end(values);
  support_clear("cli_err.txt");
  cli_start(&cli, NULL, 0);
  for (int i = 0; !here(sign) && i < 6000; i++) rest(10);
  if (!here(sign)) fail_msg("ernerf %s: %s never came", cli.line, sign);
  assert_int_equal(kill(cli.pid, signal), 0);
}

/* No file below the folder that was being written. */
static void expect_none_begun(const char *folder) {
  DIR *list = opendir(folder);
  assert_non_null(list);
  for (struct dirent *entry = readdir(list); entry != NULL; entry = readdir(list))
    if (strstr(entry->d_name, ".ernerf-tmp") != NULL) fail_msg("%s/%s is left over", folder, entry->d_name);
  closedir(list);
}

/* The first is heard after a step, of seconds here; the second does not wait for it. */
static void test_second(void **state) {
  (void)state;
  start_and_stop("t.run/lock", SIGINT,
                 "train clip -o t.safetensors --rays 262144 --levels 2 --validate-every 0 --threads 1");
  rest(50);
  assert_int_equal(kill(cli.pid, SIGTERM), 0);
  cli_wait(&cli);
  cli_expect(&cli, 128 + SIGTERM, NULL);
  assert_false(cli_there("t.safetensors") || cli_there("t.run/state.safetensors"));
  cli_run(&cli, "train clip -o t.safetensors --iters 1 --rays 16 --levels 2 --validate-frames 1 --resume --quiet");
  cli_expect(&cli, 0, NULL);
  expect_none_begun(".");
  expect_none_begun("t.run");
}

/* Heard at a frame of the validation at the end, which may take long, though no step follows. */
static void test_last_validation(void **state) {
  (void)state;
  start_and_stop("v.run/lock", SIGTERM, "train clip -o v.safetensors --iters 1 --rays 16 --levels 2");
  cli_wait(&cli);
  cli_expect(&cli, 128 + SIGTERM, "stopped after step 1 of 1; the state is saved", NULL);
  assert_true(cli_there("v.run/state.safetensors") && cli_there("v.safetensors"));
  cli_run(&cli, "train clip -o v.safetensors --iters 1 --rays 16 --levels 2 --resume --quiet");
  cli_expect(&cli, 0, NULL);
  expect_none_begun("v.run");
}

/* The second comes while a video is written: it has no file under its name, and the next render of the same name clears
 * what is left. */
static void test_second_of_a_video(void **state) {
  (void)state;
  start_and_stop("\"render: 8 frames", SIGTERM, "render m.safetensors --clip clip --size 256x256 -o cut.mp4");
  rest(20);
  assert_int_equal(kill(cli.pid, SIGINT), 0);
  cli_wait(&cli);
  if (cli.status != 128 + SIGINT && cli.status != 128 + SIGTERM) fail_msg("exit status %d", cli.status);
  assert_false(cli_there("cut.mp4"));
  cli_run(&cli, "render m.safetensors --clip clip --frames 0:1 -o cut.mp4 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_true(cli_there("cut.mp4"));
  expect_none_begun(".");
}

#define LONG_TRAINING "train clip -y -o h.safetensors --iters 100000 --rays 16 --levels 2 --validate-every 0"

/* Said twice, by the system and by the shell. */
static void test_end_of_the_terminal_long(void **state) {
  (void)state;
  signal(SIGHUP, SIG_DFL); /* of this test, and so of the program: it may have been started with nohup itself */
  start_and_stop("\"train  ", SIGHUP, LONG_TRAINING);
  (void)kill(cli.pid, SIGHUP);
  cli_wait(&cli);
  cli_expect(&cli, 128 + SIGHUP, "stopped", NULL);
  assert_true(cli_there("h.run/state.safetensors") && cli_there("h.safetensors"));
  expect_none_begun("h.run");
}

static void test_nohup_long(void **state) {
  (void)state;
  signal(SIGHUP, SIG_IGN);
  start_and_stop("\"train  ", SIGHUP, LONG_TRAINING);
  rest(300);
  assert_int_equal(waitpid(cli.pid, NULL, WNOHANG), 0);
  assert_int_equal(kill(cli.pid, SIGTERM), 0);
  cli_wait(&cli);
  cli_expect(&cli, 128 + SIGTERM, "stopped", NULL);
  signal(SIGHUP, SIG_DFL);
}

static void test_ablate_long(void **state) {
  (void)state;
  start_and_stop("table/trihash-concat.run/lock", SIGINT,
                 "ablate clip -o table --iters 100000 --rays 16 --frames 0:1 --only trihash-concat");
  cli_wait(&cli);
  cli_expect(&cli, 128 + SIGINT, "ernerf ablate: stopped; the state is saved, --resume goes on", NULL);
  assert_true(cli_there("table/trihash-concat.run/state.safetensors"));
  assert_false(cli_there("table/ablation.csv") || cli_there("table/ablation.json") || cli_there("table/ablation.md"));
  expect_none_begun("table");
  expect_none_begun("table/trihash-concat.run");
}

static void test_tradeoff_long(void **state) {
  (void)state;
  start_and_stop("trade", SIGTERM, "tradeoff m.safetensors clip -o trade --frames 0:2 --split train");
  cli_wait(&cli);
  cli_expect(&cli, 128 + SIGTERM, "ernerf tradeoff: stopped, nothing was written", NULL);
  assert_false(cli_there("trade"));
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_second),
                                     cmocka_unit_test(test_last_validation),
                                     cmocka_unit_test(test_second_of_a_video),
                                     cmocka_unit_test(test_end_of_the_terminal_long),
                                     cmocka_unit_test(test_nohup_long),
                                     cmocka_unit_test(test_ablate_long),
                                     cmocka_unit_test(test_tradeoff_long)};
  return cmocka_run_group_tests(tests, make_model, NULL);
}
