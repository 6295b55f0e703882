/* SPDX-License-Identifier: MIT
 * Each call on a file that fails, in turn: opened, read, written, synced, closed, renamed; refused, cut in half, or on
 * a disk that is full from then on. The program says which file it was and ends with status 1, or does without; what
 * was there before is as it was or new and whole, and nothing half-written is left.
 *
 *   ERNERF_TEST_CALLS=1   every call of every way, not a few of some (0); 24: at most 24 of each
 *   ERNERF_TEST_SEED=7    of those that are taken (1) */
#include <errno.h>
#include <inttypes.h>
#include <jansson.h>

#include "../made_clip.h"
#include "journey.h"

enum { WRITES = 1 << FAULT_OPEN | 1 << FAULT_WRITE | 1 << FAULT_SYNC | 1 << FAULT_RENAME | 1 << FAULT_CLOSE };
#define STEPS "train in/clip --rays 32 --seed 5 --save-every 1 --validate-frames 1"
#define TRAIN STEPS " --levels 2"

/* What is done in turn, and where files fail. `outputs` begins empty, or as the journey before left it. */
static const struct way {
  const char *name, *line;
  bool resumes; /* it then goes on without a fault, to the model of one that nothing disturbed */
  bool timed;   /* its files hold seconds, so no two runs write the same */
  bool slow;    /* seconds a run: with every call alone, and then 8 of them at most */
} ways[] = {
    {.name = "resume", .line = TRAIN " -o out/head.safetensors --iters 4 --resume", .resumes = true},
    {.name = "train anew", .line = TRAIN " -y -o out/head.safetensors --iters 2"},
    {.name = "torso", .line = STEPS " --torso --head in/head.safetensors -o out/torso.safetensors --iters 2"},
    {.name = "video", .line = "render in/head.safetensors --clip in/clip -y -o out/talk.mp4 --frames 0:3"},
    {.name = "pictures", .line = "render in/head.safetensors --clip in/clip -y -o out/p%02d.png --frames 0:2"},
    {.name = "exr", .line = "render in/head.safetensors --clip in/clip -o out/p%02d.exr --frames 0:2"},
    {.name = "join", .line = "join in/parts --wav in/clip/aud.wav -y -o out/joined.mp4"},
    {.name = "eval", .line = "eval in/head.safetensors in/clip -y --json out/eval.json"},
    {.name = "compare",
     .line = "compare in/head.safetensors in/head.safetensors in/clip -o out/compared --split train --frames 0:3"},
    {.name = "to pth", .line = "convert -y in/head.safetensors out/head.pth"},
    {.name = "from pth", .line = "convert in/head.pth out/new.safetensors"},
    {.name = "synth", .line = "synth out/made --size 64 --frames 8 --seed 3"},
    {.name = "synth --video", .line = "synth out/shown --size 64 --frames 8 --seed 3 --parsing --video out/shown.mp4"},
    {.name = "info", .line = "info in/head.safetensors --json out/info.json"},
    {.name = "check", .line = "check in/clip --json out/check.json"},
    {.name = "ablate",
     .line = "ablate in/clip -o out/table --iters 1 --rays 16 --frames 0:1 --repeats 3 --only trihash-concat",
     .timed = true,
     .slow = true},
    {.name = "tradeoff",
     .line = "tradeoff in/head.safetensors in/clip -o out/trade --seconds 1 --frames 0:2 --split train",
     .timed = true,
     .slow = true},
    {.name = "tradeoff --training",
     .line = "tradeoff --training in/clip -o out/learnt --seconds 1 --seeds 1 --rays 16 --levels 5",
     .timed = true,
     .slow = true},
    {.name = "soak", .line = "soak in/clip --steps 40 --seed 1 --json out/soak.json", .timed = true}, /* resumes once */
    {.name = "bench", .line = "bench --only peaks --seconds 0.1 --json out/bench.json", .timed = true, .slow = true},
};
enum { WAYS = sizeof ways / sizeof *ways, SLOW_CALLS = 8 };

static struct journey j;
static ern_context *context;
static size_t failing; /* number of the call that fails */
static struct { size_t runs, said, without, unhurt; } tally;

/* ---- folders ----------------------------------------------------------------------------------------------------- */

static bool same_bytes(const char *a, const char *b) {
  size_t a_count = 0, b_count = 0;
  if (!journey_there(a) || !journey_there(b)) return false;
  char *a_bytes = read_file(a, &a_count), *b_bytes = read_file(b, &b_count);
  const bool same = a_count == b_count && memcmp(a_bytes, b_bytes, a_count) == 0;
  free(a_bytes), free(b_bytes);
  return same;
}

static bool ends_with(const char *text, const char *end) {
  const size_t length = strlen(text), tail = strlen(end);
  return length >= tail && strcmp(text + length - tail, end) == 0;
}

/* Calls `visit` for each file below `folder`; returns how many there were. */
static size_t walk(const char *folder, const char *below, void (*visit)(const char *below)) {
  char path[1024], inside[1024];
  size_t count = 0;
  assert_true(snprintf(path, sizeof path, "%s/%s", folder, below) < (int)sizeof path);
  DIR *list = opendir(path);
  assert_non_null(list);
  for (struct dirent *entry = readdir(list); entry != NULL; entry = readdir(list)) {
    struct stat about;
    if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0) continue;
    assert_true(snprintf(inside, sizeof inside, "%s%s%s", below, below[0] != 0 ? "/" : "", entry->d_name) <
                (int)sizeof inside);
    assert_true(snprintf(path, sizeof path, "%s/%s", folder, inside) < (int)sizeof path);
    assert_int_equal(stat(path, &about), 0);
    if (S_ISDIR(about.st_mode))
      count += walk(folder, inside, visit);
    else
      count++, visit(inside);
  }
  closedir(list);
  return count;
}

static const char *copy_from, *copy_to;

/* Files that are only ever replaced are linked: the original then shows whether that holds. */
static void copy_file(const char *below) {
  char from[1024], to[1024];
  snprintf(from, sizeof from, "%s/%s", copy_from, below);
  snprintf(to, sizeof to, "%s/%s", copy_to, below);
  for (char *slash = strchr(to, '/'); slash != NULL; slash = strchr(slash + 1, '/')) {
    *slash = 0;
    assert_true(mkdir(to, 0777) == 0 || errno == EEXIST);
    *slash = '/';
  }
  if (!ends_with(below, ".jsonl") && !ends_with(below, "curve.csv")) {
    assert_int_equal(link(from, to), 0);
    return;
  }
  size_t count = 0;
  char *bytes = read_file(from, &count);
  support_write(to, bytes, count);
  free(bytes);
}

static void copy_folder(const char *from, const char *to) {
  support_clear(to);
  assert_int_equal(mkdir(to, 0777), 0);
  copy_from = from;
  copy_to = to;
  walk(from, "", copy_file);
}

/* ---- what is left ------------------------------------------------------------------------------------------------ */

static const struct way *way;

/* Holds the time of day or the pace of the machine: never the same twice. */
static bool is_timed(const char *below) {
  return strstr(below, "/curve") != NULL || ends_with(below, "lock") || strstr(below, "/val_") != NULL;
}

/* By how a whole file of its kind ends. */
static bool ends_whole(const char *below, const char *path) {
  static const char *const ends[][2] = {
      {".md", "\n"}, {".csv", "\n"}, {".svg", "</svg>\n"}, {".html", "</html>\n"}, {".png", "IEND\xae\x42\x60\x82"}};
  bool whole = false;
  size_t count = 0;
  char *bytes = read_file(path, &count);
  for (size_t i = 0; i < sizeof ends / sizeof *ends; i++) {
    const size_t length = strlen(ends[i][1]);
    whole |= ends_with(below, ends[i][0]) && count > length && memcmp(bytes + count - length, ends[i][1], length) == 0;
  }
  free(bytes);
  return whole;
}

/* What is appended to: the lines of a flush are there, or none of them. */
static bool has_whole_lines(const char *path) {
  size_t count = 0;
  char *bytes = read_file(path, &count);
  const bool whole = count == 0 || bytes[count - 1] == '\n';
  free(bytes);
  return whole;
}

/* A file of out/ is whole: it can be read, or is what it was before (was/) or what it should become (new/). */
static void look_at(const char *below) {
  char path[1024], was[1024], becomes[1024];
  struct ern_tensor_file file = {0};
  snprintf(path, sizeof path, "out/%s", below);
  snprintf(was, sizeof was, "was/%s", below);
  snprintf(becomes, sizeof becomes, "new/%s", below);
  if (strstr(below, ".ernerf-tmp") != NULL) fail_msg("%s: %s is left over\n%s", way->name, path, j.err);
  if (ends_with(below, "/log.jsonl") || ends_with(below, "/curve.csv")) {
    if (!has_whole_lines(path)) fail_msg("%s: %s ends in half a line", way->name, path);
    return;
  }
  if (is_timed(below)) return;
  if (ends_with(below, ".safetensors")) {
    const ern_status status = ern_safetensors_read(context, path, &file);
    if (status != ERN_OK) fail_msg("%s: %s", way->name, ern_last_error(context));
    ern_tensor_file_free(context, &file);
  } else if (ends_with(below, ".json") && !ends_with(below, "transforms_train.json") &&
             !ends_with(below, "transforms_val.json")) {
    json_t *object = json_load_file(path, 0, NULL);
    if (object == NULL) fail_msg("%s: %s is no JSON", way->name, path);
    json_decref(object);
  } else if (way->timed && !journey_there(was)) {
    if (!ends_whole(below, path)) fail_msg("%s: %s is half-written", way->name, path);
  } else if (!same_bytes(path, was) && !same_bytes(path, becomes)) {
    fail_msg("%s: call %zu (%s): exit status %d, and %s is neither as before nor as it should be\n%s", way->name,
             failing, j.seen->name, j.status, path, j.err);
  }
}

/* What the way should make is there. */
static void look_for(const char *below) {
  char path[1024], becomes[1024];
  snprintf(path, sizeof path, "out/%s", below);
  snprintf(becomes, sizeof becomes, "new/%s", below);
  if (is_timed(below)) return;
  if (ends_with(below, "/measures.csv") && strstr(j.err, path) != NULL) return; /* a training goes on without it */
  if (!journey_there(path)) fail_msg("%s: exit status 0, and %s is not there\n%s", way->name, path, j.err);
  if (strstr(below, "state.") == NULL && !ends_with(below, ".jsonl") && !ends_with(below, ".json") && !way->timed &&
      !same_bytes(path, becomes))
    fail_msg("%s: exit status 0, and %s is not what it should be\n%s", way->name, path, j.err);
}

static void one_fault(const struct fault *fault, const char *kind) {
  copy_folder("was", "out");
  failing = fault->at;
  journey_start(&j, fault, "%s --quiet", way->line);
  journey_wait(&j);
  if (!atomic_load(&j.seen->struck)) return; /* there were fewer calls this time */
  tally.runs++;
  if (j.status != 0 && j.status != 1)
    fail_msg("%s: call %zu (%s, %s): exit status %d\n%s", way->name, fault->at, kind, j.seen->name, j.status, j.err);
  if (j.status == 1 && strstr(j.err, "out/") == NULL && strstr(j.err, "in/") == NULL)
    fail_msg("%s: call %zu (%s, %s): \"%s\" names no file", way->name, fault->at, kind, j.seen->name, j.err);
  walk("out", "", look_at);
  if (j.status == 0) walk("new", "", look_for);
  tally.said += j.status == 1;
  tally.without += j.status == 0 && j.err[0] != 0;
  tally.unhurt += j.status == 0 && j.err[0] == 0;
  if (!way->resumes || j.status == 0) return;
  if (journey_newest(context, "out/head.run") < 2) fail_msg("%s: call %zu: the state is lost", way->name, fault->at);
  if (fault->at % 8 != 0) return;
  journey_ok(&j, "%s --quiet", way->line);
  expect_same("out/head.safetensors", "new/head.safetensors");
}

/* ---- tests ------------------------------------------------------------------------------------------------------- */

static int prepare(void **state) {
  (void)state;
  static const char *const old[] = {"in", "out", "was", "new"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  journey_open(&j);
  context = support_context();
  assert_int_equal(setenv("TMPDIR", "out", 1), 0); /* where the soak trains */
  assert_int_equal(mkdir("in", 0777), 0);
  assert_int_equal(mkdir("was", 0777), 0);
  journey_ok(&j, "synth in/clip --size 64 --frames 8 --seed 3 --quiet");
  journey_ok(&j, TRAIN " -o was/head.safetensors --iters 4 --quiet");
  journey_ok(&j, "convert was/head.safetensors in/head.safetensors --quiet");
  journey_ok(&j, "convert was/head.safetensors in/head.pth --quiet");
  assert_int_equal(mkdir("in/parts", 0777), 0);
  for (int k = 0; k < 2; k++)
    journey_ok(&j, "render in/head.safetensors --clip in/clip --frames %d:%d -o in/parts/%d.mp4 --quiet", k, k + 1, k);
  /* at step 2 of 4: the steps after it have no disk */
  clear_run("was/head");
  const struct fault stop = {
      .folder = "head.run/state.next", .kinds = 1u << FAULT_OPEN, .at = 3, .how = FAULT_ERROR, .error = ENOSPC};
  journey_start(&j, &stop, TRAIN " -o was/head.safetensors --iters 4 --quiet");
  journey_wait(&j);
  assert_int_equal(j.status, 1);
  assert_int_equal(journey_newest(context, "was/head.run"), 2);
  support_write_text("was/talk.mp4", "of yesterday");
  support_write_text("was/joined.mp4", "of yesterday");
  support_write_text("was/p00.png", "of yesterday");
  support_write_text("was/eval.json", "{}");
  support_write_text("was/head.pth", "of yesterday");
  return 0;
}

static int close_all(void **state) {
  (void)state;
  ern_context_free(&context);
  print_message(
      "%zu failed calls: %zu times the program said so and ended with status 1, %zu times it said so and did "
      "without, %zu times nothing was hurt\n",
      tally.runs, tally.said, tally.without, tally.unhurt);
  return 0;
}

/* At most `most` calls of each way, or of each other one, or all of them; on files of the folder. */
static void each_call(const char *folder, unsigned kinds, enum fault_how how, int error, const char *kind, size_t most,
                      size_t of) {
  const uint32_t seed = journey_number("ERNERF_TEST_SEED", 1), all = journey_number("ERNERF_TEST_CALLS", 0);
  for (size_t w = all != 0 || of == 1 ? 0 : (seed + (unsigned)how) % of; w < WAYS; w += all != 0 ? 1 : of) {
    struct fault fault = {.folder = folder, .kinds = kinds, .error = error};
    way = &ways[w];
    if (way->slow && all == 0) continue;
    if (all != 0) most = way->slow ? SLOW_CALLS : all > 1 ? all : SIZE_MAX;
    copy_folder("was", "out");
    journey_start(&j, &fault, "%s --quiet", way->line);
    journey_wait(&j);
    if (j.status != 0) fail_msg("%s: exit status %d\n%s", way->name, j.status, j.err);
    const size_t calls = atomic_load(&j.seen->calls), stride = calls <= most ? 1 : calls / most + 1;
    support_clear("new");
    assert_int_equal(rename("out", "new"), 0);
    fault.how = how;
    const size_t before = tally.runs;
    for (fault.at = 1 + journey_random(seed, (uint32_t)w, (uint32_t)stride); fault.at <= calls; fault.at += stride)
      one_fault(&fault, kind);
    if (all != 0) print_message("%s, %s: %zu of %zu calls\n", way->name, kind, tally.runs - before, calls);
  }
}

static void test_refused(void **state) {
  (void)state;
  each_call("out/", (1u << FAULT_KINDS) - 1, FAULT_ERROR, EIO, "EIO", 1, 4);
}

static void test_full(void **state) {
  (void)state;
  each_call("out/", WRITES, FAULT_FULL, ENOSPC, "full disk", 1, 6);
}

static void test_half(void **state) {
  (void)state;
  each_call("out/", 1u << FAULT_WRITE | 1u << FAULT_READ, FAULT_HALF, ENOSPC, "half", 1, 6);
}

static void test_inputs_refused(void **state) {
  (void)state;
  each_call("in/", 1u << FAULT_OPEN | 1u << FAULT_READ | 1u << FAULT_CLOSE, FAULT_ERROR, EIO, "EIO of an input", 1, 6);
}

static void test_inputs_half(void **state) {
  (void)state;
  each_call("in/", 1u << FAULT_READ, FAULT_HALF, EIO, "half of an input", 1, 6);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_refused), cmocka_unit_test(test_full),
                                     cmocka_unit_test(test_half), cmocka_unit_test(test_inputs_refused),
                                     cmocka_unit_test(test_inputs_half)};
  return cmocka_run_group_tests(tests, prepare, close_all);
}
