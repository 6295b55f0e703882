/* SPDX-License-Identifier: MIT
 * Trainings that are killed (SIGKILL): at random moments, and at each call on a file of theirs in turn. Whatever the
 * moment, the next start goes on from a state that is at least as new as any that was whole before, and in the end the
 * model is the same, byte for byte, as that of a training that nothing ended. A comparison that is killed leaves a
 * folder that the next one takes for its own.
 *
 *   ERNERF_TEST_KILLS=1000   kills at random moments (3)
 *   ERNERF_TEST_CALLS=1      every call, not each of a few (0)
 *   ERNERF_TEST_SEED=7       of the moments (1) */
#include <errno.h>
#include <inttypes.h>

#include "../made_clip.h"
#include "journey.h"

enum { STEPS = 24 };
#define TRAIN "train clip -o %s.safetensors --iters 24 --rays 32 --levels 2 --seed 5 --save-every 1 --validate-frames 1"

static struct journey j;
static ern_context *context;

static void wait_seconds(double seconds) {
  const struct timespec time = {.tv_sec = (time_t)seconds,
                                .tv_nsec = (long)(1e9 * (seconds - (double)(time_t)seconds))};
  nanosleep(&time, NULL);
}

static int make_clip(void **state) {
  (void)state;
  journey_open(&j);
  context = support_context();
  support_clear("clip");
  clear_run("whole");
  journey_ok(&j, "synth clip --size 64 --frames 8 --seed 3 --quiet");
  journey_ok(&j, TRAIN " --quiet", "whole");
  return 0;
}

static int close_all(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

/* Each line of the log is whole, and its step is above that of the one before. */
static void expect_log(const char *path) {
  size_t count = 0;
  if (!journey_there(path)) return;
  char *text = read_file(path, &count);
  long long before = 0;
  for (char *line = text; *line != 0;) {
    long long step = 0;
    char *end = strchr(line, '\n');
    if (end == NULL || sscanf(line, "{\"step\": %lld,", &step) != 1 || end[-1] != '}' || step <= before)
      fail_msg("%s: after step %lld comes \"%.60s\"", path, before, line);
    before = step;
    line = end + 1;
  }
  free(text);
}

/* After a kill: the model is not there or whole, and the newest state is not older than `least`; returns its step. */
static int64_t look(const char *name, int64_t least) {
  char model[64], run[64];
  struct ern_tensor_file file = {0};
  snprintf(model, sizeof model, "%s.safetensors", name);
  snprintf(run, sizeof run, "%s.run", name);
  if (journey_there(model)) support_ok(context, ern_safetensors_read(context, model, &file));
  ern_tensor_file_free(context, &file);
  const int64_t newest = journey_newest(context, run);
  if (newest < least)
    fail_msg("%s: the newest state is of step %" PRId64 ", there was one of step %" PRId64, run, newest, least);
  return newest;
}

/* Goes on to the end and compares with the training that nothing ended. */
static void finish(const char *name) {
  char path[64], left[1024];
  journey_ok(&j, TRAIN " --resume --quiet", name);
  snprintf(path, sizeof path, "%s.safetensors", name);
  expect_same("whole.safetensors", path);
  snprintf(path, sizeof path, "%s.run/log.jsonl", name);
  expect_log(path);
  if (journey_leftovers(".", name, left) != 0) fail_msg("%s is left over", left);
}

/* ---- random moments ---------------------------------------------------------------------------------------------- */

static bool ended(void) {
  siginfo_t about = {.si_pid = 0};
  return waitid(P_PID, (id_t)j.pid, &about, WEXITED | WNOHANG | WNOWAIT) == 0 && about.si_pid == j.pid;
}

/* Kills the training once it has made `calls` calls on its files, and a moment later; it may have ended before. */
static void kill_after(size_t calls, double moment) {
  while (atomic_load(&j.seen->calls) < calls && !ended()) wait_seconds(2e-4);
  wait_seconds(moment);
  assert_int_equal(kill(j.pid, SIGKILL), 0);
}

static void test_random_moments(void **state) {
  (void)state;
  const uint32_t kills = journey_number("ERNERF_TEST_KILLS", 3), seed = journey_number("ERNERF_TEST_SEED", 1);
  const struct fault none = {.folder = "killed.", .kinds = (1u << FAULT_KINDS) - 1};
  uint32_t killed = 0, trainings = 0, torn = 0, later = 0;
  int64_t least = -1;
  char left[1024];
  clear_run("killed");
  for (uint32_t k = 0; killed < kills; k++) {
    /* some 190 calls are a save, and before them the start reads what is there */
    const struct ern_random random = ern_random_at(seed, k, 0, ERN_RNG_INIT);
    journey_start(&j, &none, TRAIN " --resume", "killed");
    kill_after(random.word[0] % 700, random.word[1] % 1000 * 1e-5);
    journey_wait(&j);
    killed += j.status == 128 + SIGKILL;
    if (j.status != 128 + SIGKILL && j.status != 0)
      fail_msg("seed %u, kill %u: exit status %d: %s", seed, killed, j.status, j.err);
    const int64_t newest = look("killed", least);
    later += newest > least;
    least = newest;
    torn += journey_leftovers(".", "killed", left) > 0;
    if (j.status != 0 && least < STEPS) continue;
    trainings++;
    finish("killed");
    clear_run("killed");
    least = -1;
  }
  finish("killed");
  print_message(
      "%u kills (seed %u): %u left a file half-written, all were gone on from; %u of them with a newer state "
      "than before, %u trainings came to their end in between\n",
      killed, seed, torn, later, trainings);
}

/* ---- each call on a file ----------------------------------------------------------------------------------------- */

/* From a state of step 22 on, so that a run has two saves and the end. */
static void prepare(const char *from, const char *to) {
  static const char *const names[] = {".safetensors", ".run/state.safetensors", ".run/state.previous.safetensors",
                                      ".run/log.jsonl", ".run/curve.csv"};
  char one[128], other[128];
  clear_run(to);
  snprintf(other, sizeof other, "%s.run", to);
  assert_int_equal(mkdir(other, 0777), 0);
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    size_t count = 0;
    snprintf(one, sizeof one, "%s%s", from, names[i]);
    snprintf(other, sizeof other, "%s%s", to, names[i]);
    if (!journey_there(one)) continue;
    char *bytes = read_file(one, &count);
    support_write(other, bytes, count);
    free(bytes);
  }
}

static void test_each_call(void **state) {
  (void)state;
  const uint32_t seed = journey_number("ERNERF_TEST_SEED", 1), all = journey_number("ERNERF_TEST_CALLS", 0);
  struct fault cut = {.folder = "cut.", .kinds = (1u << FAULT_KINDS) - 1, .how = FAULT_NONE, .error = EIO};
  clear_run("from");
  /* stops by itself once step 22 is saved: the state of step 23 cannot be begun */
  const struct fault stop = {
      .folder = "from.run/state.next", .kinds = 1u << FAULT_OPEN, .at = 23, .how = FAULT_ERROR, .error = EIO};
  journey_start(&j, &stop, TRAIN, "from");
  journey_wait(&j);
  assert_int_equal(j.status, 1);
  assert_int_equal(look("from", 22), 22);
  prepare("from", "cut");
  journey_start(&j, &cut, TRAIN " --resume --quiet", "cut");
  journey_wait(&j);
  assert_int_equal(j.status, 0);
  const size_t calls = atomic_load(&j.seen->calls);
  const size_t stride = all != 0 ? 1 : calls / 4 + 1;
  size_t kills = 0;
  cut.how = FAULT_KILL;
  for (size_t at = 1 + journey_random(seed, 0, (uint32_t)stride); at <= calls; at += stride) {
    cut.at = at;
    prepare("from", "cut");
    journey_start(&j, &cut, TRAIN " --resume --quiet", "cut");
    journey_wait(&j);
    if (j.status != 128 + SIGKILL) continue; /* the number of calls differs a little with the clock */
    look("cut", 22);
    if (kills++ % 4 == 0) finish("cut");
  }
  print_message("killed at %zu of %zu calls on files\n", kills, calls);
  assert_true(kills > 3);
}

/* ---- a comparison ------------------------------------------------------------------------------------------------ */

/* Killed at each of its calls in the folder: the next comparison takes the folder for one of its own. */
static void test_comparison_long(void **state) {
  (void)state;
  static const char line[] =
      "compare whole.safetensors whole.safetensors clip -o compared --split train --frames 0:1 --quiet %s";
  const uint32_t all = journey_number("ERNERF_TEST_CALLS", 0);
  struct fault fault = {.folder = "compared", .kinds = (1u << FAULT_KINDS) - 1, .how = FAULT_NONE, .error = EIO};
  support_clear("compared");
  journey_start(&j, &fault, line, "");
  journey_wait(&j);
  assert_int_equal(j.status, 0);
  const size_t calls = atomic_load(&j.seen->calls), stride = all != 0 ? 1 : calls / 12 + 1;
  size_t kills = 0, between = 0;
  fault.how = FAULT_KILL;
  for (fault.at = 1; fault.at <= calls; fault.at += stride) {
    support_clear("compared");
    journey_start(&j, &fault, line, "");
    journey_wait(&j);
    if (j.status != 128 + SIGKILL) continue;
    kills++;
    const bool named = journey_there("compared/compare.json");
    between += !named && journey_there("compared/compare.mp4.new");
    journey_ok(&j, line, named ? "-y" : "");
    if (journey_there("compared/compare.mp4.new") || journey_there("compared/compare.begun"))
      fail_msg("killed at call %zu: what it left is still there", (size_t)fault.at);
  }
  print_message("killed at %zu of %zu calls on files, %zu of them between the video and the names\n", kills, calls,
                between);
  assert_true(kills > 10 && between > 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_random_moments), cmocka_unit_test(test_each_call),
                                     cmocka_unit_test(test_comparison_long)};
  return cmocka_run_group_tests(tests, make_clip, close_all);
}
