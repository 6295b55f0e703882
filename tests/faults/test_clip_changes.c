/* SPDX-License-Identifier: MIT
 * A clip that changes while it is read: a file of it is cut, emptied, removed, overwritten, or becomes a folder, at
 * each of some calls on the clip. The training ends with a sentence that names a file of the clip, or has read what it
 * needed before and is not touched. With the file as it was it goes on to the model of a training that nothing
 * disturbed, byte for byte.
 *
 *   ERNERF_TEST_CALLS=1      every call, not each of a few (0); 60: 60 of them for each change */
#include <inttypes.h>

#include "../made_clip.h"
#include "journey.h"

#define TRAIN "train %s -o %s.safetensors --iters 6 --rays 32 --levels 2 --seed 5 --save-every 1 --validate-frames 1"
/* frames are read again and again, so that they are read late too */
#define TRAIN_CLIP TRAIN " --set memory=1 --quiet"

static struct journey j;
static ern_context *context;

/* ---- what happens to a file, in the process that reads it ---------------------------------------------------------
 */

static void cut(const char *name) {
  struct stat about;
  if (stat(name, &about) == 0) (void)!truncate(name, about.st_size / 2);
}
static void empty(const char *name) { (void)!truncate(name, 0); }
static void drop(const char *name) { (void)unlink(name); }
static void become_folder(const char *name) {
  (void)unlink(name);
  (void)mkdir(name, 0777);
}
static void overwrite(const char *name) {
  FILE *file = fopen(name, "r+b");
  for (int i = 0; file != NULL && i < 4096; i++) fputc("junk"[i % 4], file);
  if (file != NULL) fclose(file);
}

static const struct {
  const char *what;
  void (*act)(const char *name);
} changes[] = {{"cut", cut}, {"emptied", empty}, {"removed", drop}, {"a folder", become_folder}, {"junk", overwrite}};

/* ---- one training ------------------------------------------------------------------------------------------------ */

static void copy(const char *from, const char *to) {
  size_t count = 0;
  char *bytes = read_file(from, &count);
  support_write(to, bytes, count);
  free(bytes);
}

/* The struck file as it is in the clip that nothing touches, or as it is not there. */
static void restore(void) {
  char original[512];
  assert_non_null(strstr(j.seen->name, "changed_clip/"));
  assert_true(snprintf(original, sizeof original, "whole_clip/%s",
                       strstr(j.seen->name, "changed_clip/") + strlen("changed_clip/")) < (int)sizeof original);
  (void)rmdir(j.seen->name);
  if (journey_there(original))
    copy(original, j.seen->name);
  else
    (void)unlink(j.seen->name);
}

/* Returns whether the training ended over it. */
static bool change_at(size_t at, size_t change) {
  const struct fault fault = {.folder = "changed_clip/",
                              .kinds = 1u << FAULT_OPEN | 1u << FAULT_READ,
                              .at = at,
                              .how = FAULT_ACT,
                              .act = changes[change].act};
  char left[1024];
  clear_run("changed");
  journey_start(&j, &fault, TRAIN_CLIP, "changed_clip", "changed");
  journey_wait(&j);
  if (!atomic_load(&j.seen->struck)) return false; /* it makes a call less or more by the clock */
  if (j.status != 0 && (j.status != 1 || strstr(j.err, "changed_clip/") == NULL))
    fail_msg("call %zu, %s %s: exit status %d: %s", at, j.seen->name, changes[change].what, j.status, j.err);
  if (journey_leftovers(".", "changed", left) != 0) fail_msg("%s is left over", left);
  const bool ended = j.status == 1;
  restore();
  if (ended && journey_newest(context, "changed.run") >= 0)
    journey_ok(&j, TRAIN_CLIP " --resume", "changed_clip", "changed");
  else if (ended)
    journey_ok(&j, TRAIN_CLIP, "changed_clip", "changed");
  expect_same("whole.safetensors", "changed.safetensors");
  return ended;
}

static void test_changes(void **state) {
  (void)state;
  const size_t count = sizeof changes / sizeof *changes;
  const struct fault none = {.folder = "changed_clip/", .kinds = 1u << FAULT_OPEN | 1u << FAULT_READ};
  size_t runs = 0, ended = 0;
  clear_run("changed");
  journey_start(&j, &none, TRAIN_CLIP, "changed_clip", "changed");
  journey_wait(&j);
  assert_int_equal(j.status, 0);
  const size_t calls = atomic_load(&j.seen->calls);
  const size_t all = journey_number("ERNERF_TEST_CALLS", 0), stride = all == 1 ? 1 : calls / (all > 1 ? all : 1) + 1;
  assert_true(calls > 40); /* or the frames were not read through here */
  for (size_t change = 0; change < count; change++)
    for (size_t at = 1 + change * stride / count; at <= calls; at += stride, runs++) ended += change_at(at, change);
  print_message("%zu changes at %zu calls: %zu trainings ended over it, the others had read before\n", runs, calls,
                ended);
  assert_true(ended > runs / 4);
}

static int make_clips(void **state) {
  (void)state;
  static const char *const clips[] = {"whole_clip", "changed_clip"};
  journey_open(&j);
  context = support_context();
  for (int i = 0; i < 2; i++) {
    support_clear(clips[i]);
    journey_ok(&j, "synth %s --size 64 --frames 8 --seed 3 --quiet", clips[i]);
  }
  clear_run("whole");
  journey_ok(&j, TRAIN_CLIP, "whole_clip", "whole");
  return 0;
}

static int close_all(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_changes)};
  return cmocka_run_group_tests(tests, make_clips, close_all);
}
