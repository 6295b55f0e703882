/* SPDX-License-Identifier: MIT
 * The program on an OpenCL device that is missing, too small, fails or is lost, and with a cache of kernels that is
 * damaged: a message in words and exit status 1, or the same result; nothing half-written in any case. */
#include "../e2e/cli.h"

#include <math.h>

#include "io/file.h"

static struct cli cli;
static char clip[1024];

#define STEPS "--rays 64 --levels 4 --seed 3"
#define DEVICE "--backend opencl"

/* ---- faults: for the programs that are started until `clear` (faults/opencl_faults.c) -----------------------------
 */

static const char *const variables[] = {"OPENCL_LAYERS",         "OCL_ICD_VENDORS",    "ERNERF_FAULT_HIDE",
                                        "ERNERF_FAULT_STRANGER", "ERNERF_FAULT_BUILD", "ERNERF_FAULT_MEMORY",
                                        "ERNERF_FAULT_LAUNCH",   "ERNERF_FAULT_COUNT", "ERNERF_FAULT_FILE",
                                        "ERNERF_FAULT_CODE",     "ERNERF_FAULT_FILL",  "ERNERF_FAULT_LOCAL",
                                        "ERNERF_FAULT_ARGUMENTS"};

static void clear(void) {
  for (size_t i = 0; i < sizeof variables / sizeof variables[0]; i++) unsetenv(variables[i]);
}

static void fault(const char *name, const char *value) {
  char variable[64];
  snprintf(variable, sizeof variable, "ERNERF_FAULT_%s", name);
  assert_int_equal(setenv(variable, value, 1), 0);
  assert_int_equal(setenv("OPENCL_LAYERS", getenv("ERNERF_FAULTS"), 1), 0);
}

/* `name` in the working folder. */
static void place(const char *variable, const char *name) {
  char path[2048], here[1024];
  assert_non_null(getcwd(here, sizeof here));
  snprintf(path, sizeof path, "%s/%s", here, name);
  assert_int_equal(setenv(variable, path, 1), 0);
}

static void forget(const char *name) {
  char path[64];
  snprintf(path, sizeof path, "%s.safetensors", name);
  support_clear(path);
  snprintf(path, sizeof path, "%s.run", name);
  support_clear(path);
}

static bool exists(const char *name, const char *file) {
  char path[128];
  snprintf(path, sizeof path, "%s%s", name, file);
  return cli_there(path);
}

/* No file of `folder` is one that was being written. */
static void nothing_half(const char *folder) {
  DIR *list = opendir(folder);
  for (struct dirent *entry = list != NULL ? readdir(list) : NULL; entry != NULL; entry = readdir(list))
    if (strstr(entry->d_name, ".tmp") != NULL || strstr(entry->d_name, ".part") != NULL)
      fail_msg("%s/%s was left behind", folder, entry->d_name);
  if (list != NULL) closedir(list);
}

/* Trains into `name` on the device and expects the words, exit status 1 and nothing saved. */
static void refuse_training(const char *first, const char *second, const char *third) {
  forget("x");
  cli_run(&cli, "train %s -y -o x.safetensors --iters 2 %s %s", clip, STEPS, DEVICE);
  cli_expect(&cli, 1, "ernerf train: ", "OpenCL", first, second, third, NULL);
  if (exists("x", ".safetensors") || exists("x", ".run/state.safetensors")) fail_msg("a file was left behind");
  nothing_half(".");
}

static void refuse_rendering(const char *first, const char *second) {
  support_clear("x.mp4");
  support_clear("x.json");
  cli_run(&cli, "render m.safetensors --clip %s --frames 0:2 -o x.mp4 %s", clip, DEVICE);
  cli_expect(&cli, 1, "ernerf render: ", "OpenCL", first, second, NULL);
  cli_run(&cli, "eval m.safetensors %s --frames 0:1 --json x.json %s", clip, DEVICE);
  cli_expect(&cli, 1, "ernerf eval: ", "OpenCL", first, second, NULL);
  if (cli_there("x.mp4") || cli_there("x.json")) fail_msg("a file was left behind");
  nothing_half(".");
}

static int make_model(void **state) {
  (void)state;
  const char *source = getenv("ERNERF_SOURCE"), *cache = getenv("XDG_CACHE_HOME");
  char path[2048];
  if (source == NULL || cache == NULL || getenv("ERNERF_FAULTS") == NULL) return 1;
  /* PoCL's own cache stays where it is when ours moves */
  snprintf(path, sizeof path, "%s/pocl/kcache", cache);
  if (setenv("POCL_CACHE_DIR", path, 1) != 0) return 1;
  snprintf(clip, sizeof clip, "%s/data/tiny", source);
  clear();
  forget("m");
  cli_run(&cli, "train %s -o m.safetensors --iters 2 %s --consent agreed --quiet", clip, STEPS);
  cli_expect(&cli, 0, NULL);
  return 0;
}

/* ---- no device --------------------------------------------------------------------------------------------------- */

static void test_no_driver(void **state) {
  (void)state;
  place("OCL_ICD_VENDORS", "nothing");
  support_clear("nothing");
  for (int there = 0; there < 2; there++) { /* a folder that is missing, and one that is empty */
    if (there == 1) assert_int_equal(mkdir("nothing", 0777), 0);
    refuse_training("no driver is installed", "ICD", "--backend cpu");
    refuse_rendering("no driver is installed", "--backend cpu");
    assert_false(exists("x", ".run"));
    cli_run(&cli, "info devices");
    cli_expect_out(&cli, 0, "cpu     0", "backends", NULL);
    cli_expect(&cli, 0, "no driver is installed", NULL);
  }
  clear();
}

static void test_no_device(void **state) {
  (void)state;
  fault("HIDE", "platforms");
  refuse_training("no driver is installed", "ICD", "--backend cpu");
  fault("HIDE", "devices");
  refuse_training("driver", "none of them has a device", "");
  cli_run(&cli, "info devices --json");
  cli_expect(&cli, 0, "none of them has a device", NULL);
  json_t *object = cli_json(&cli, NULL);
  assert_int_equal(json_array_size(json_object_get(object, "devices")), 1);
  json_decref(object);
  clear();
  forget("x");
  cli_run(&cli, "train %s -y -o x.safetensors --iters 2 %s --device 99 %s", clip, STEPS, DEVICE);
  cli_expect(&cli, 1, "found no device 99", "expected 0 to", "ernerf info devices", NULL);
  assert_false(exists("x", ".run"));
}

/* ---- a device that cannot ---------------------------------------------------------------------------------------- */

/* The message holds the end of the log. */
static void test_build(void **state) {
  const char *cache = getenv("XDG_CACHE_HOME");
  char before[1024];
  (void)state;
  snprintf(before, sizeof before, "%s", cache);
  place("XDG_CACHE_HOME", "cache_of_failures");
  support_clear("cache_of_failures");
  fault("BUILD", "300");
  refuse_training("does not build", ".cl: CL_BUILD_PROGRAM_FAILURE", "<source>:300:1: error: it was told to fail");
  refuse_rendering("does not build", "<source>:300:1: error");
  assert_int_equal(cli_count("cache_of_failures/libernerf"), 0);
  clear();
  assert_int_equal(setenv("XDG_CACHE_HOME", before, 1), 0);
}

static void test_no_memory(void **state) {
  (void)state;
  fault("MEMORY", "1000000");
  refuse_training("too little memory: a buffer of ", "bytes is needed", "all memory is 1000000");
  refuse_rendering("too little memory: a buffer of ", "bytes is needed");
  clear();
}

static double number(const json_t *object, const char *field) {
  const json_t *value = json_object_get(object, field);
  if (!json_is_number(value)) fail_msg("the field %s is missing or no number", field);
  return json_number_value(value);
}

/* Half of what a step of so many rays takes: it goes on with fewer, and learns the same. */
static void test_some_memory_long(void **state) {
  json_t *report[2];
  (void)state;
  for (int little = 0; little < 2; little++) {
    if (little == 1) fault("MEMORY", "64000000");
    forget("x");
    cli_run(&cli, "train %s -y -o x.safetensors --iters 2 --rays 8192 --levels 4 --seed 3 %s --json -", clip, DEVICE);
    cli_expect(&cli, 0, little == 1 ? "too little memory for a training step of 8192 rays at once" : "", NULL);
    if (little == 0) assert_null(strstr(cli.err, "at a time"));
    report[little] = cli_json(&cli, NULL);
  }
  clear();
  /* the second step starts from weights that differ by roundings */
  assert_true(fabs(number(report[0], "loss") - number(report[1], "loss")) <= 1e-4 * number(report[0], "loss"));
  assert_true(fabs(number(report[0], "val_psnr") - number(report[1], "val_psnr")) < 0.01);
  json_decref(report[0]);
  json_decref(report[1]);
}

/* A training of the paper's size, 65,536 rays of 512 x 512 and 14 levels, with the limits of an H100: through step 16,
 * the first with a smoothness term. The first steps have 16 samples in each ray, 1,048,576 in all. */
static void test_paper_size_long(void **state) {
  (void)state;
  forget("x");
  support_clear("paper");
  cli_run(&cli, "synth paper --size 512 --frames 11 --quiet");
  cli_expect(&cli, 0, NULL);
  fault("FILL", "2147483648");
  fault("LOCAL", "49152");
  fault("ARGUMENTS", "1024");
  cli_run(&cli, "train paper -o x.safetensors --paper --iters 17 --validate-frames 1 --consent agreed --json - %s",
          DEVICE);
  cli_expect(&cli, 0, NULL);
  assert_null(strstr(cli.err, "at a time"));
  json_t *report = cli_json(&cli, NULL);
  assert_true(number(report, "step") == 17 && isfinite(number(report, "loss")));
  json_decref(report);
  clear();
}

/* ---- a device that is lost --------------------------------------------------------------------------------------- */

static void lose_with_code(const char *code, const char *launch) {
  fault("CODE", code);
  fault("LAUNCH", launch);
  refuse_training("the device is lost", "nothing of this training was saved", "");
  fault("LAUNCH", "3");
  refuse_rendering("the device is lost", "failed: CL_");
  clear();
}

static void test_lost(void **state) {
  (void)state, lose_with_code("-2", "8");
} /* CL_DEVICE_NOT_AVAILABLE, in the first refresh */
static void test_lost_late_long(void **state) { (void)state, lose_with_code("-2", "40"); }
static void test_no_resources_long(void **state) { (void)state, lose_with_code("-5", "40"); } /* CL_OUT_OF_RESOURCES */

/* What an earlier training saved stays as it is. */
static void test_lost_early_long(void **state) {
  (void)state;
  forget("x");
  cli_run(&cli, "train %s -y -o x.safetensors --iters 1 %s --quiet", clip, STEPS);
  cli_expect(&cli, 0, NULL);
  size_t count[2] = {0}, after = 0;
  static const char *const files[] = {"x.safetensors", "x.run/state.safetensors"};
  uint8_t *before[2] = {cli_bytes(files[0], &count[0]), cli_bytes(files[1], &count[1])};
  fault("LAUNCH", "40");
  cli_run(&cli, "train %s -y -o x.safetensors --iters 6 --save-every 2 %s %s", clip, STEPS, DEVICE);
  cli_expect(&cli, 1, "the device is lost", "nothing of this training was saved", NULL);
  for (int i = 0; i < 2; i++) {
    uint8_t *found = cli_bytes(files[i], &after);
    assert_int_equal(after, count[i]);
    assert_memory_equal(found, before[i], after);
    free(found);
    free(before[i]);
  }
  nothing_half("x.run");
  clear();
}

static void copy_file(const char *from, const char *to) {
  size_t count = 0;
  uint8_t *bytes = cli_bytes(from, &count);
  support_write(to, bytes, count);
  free(bytes);
}

/* Lost right after the save of step 2: that state is whole, and goes on here and there. */
static void test_lost_after_save_long(void **state) {
  (void)state;
  forget("x");
  fault("FILE", "x.run/state.safetensors");
  cli_run(&cli, "train %s -y -o x.safetensors --iters 6 --save-every 2 %s %s", clip, STEPS, DEVICE);
  cli_expect(&cli, 1, "the device is lost", "the state of step 2 is whole in x.run", "on any backend", NULL);
  clear();
  nothing_half("x.run");
  nothing_half(".");
  static const char *const files[] = {"x.safetensors", "x.run/state.safetensors"};
  for (int i = 0; i < 2; i++) {
    cli_run(&cli, "info %s --json", files[i]);
    cli_expect(&cli, 0, NULL);
    json_t *info = cli_json(&cli, NULL);
    assert_true(number(info, "step") == 2);
    json_decref(info);
  }
  forget("y");
  assert_int_equal(mkdir("y.run", 0777), 0);
  copy_file(files[1], "y.run/state.safetensors");
  cli_run(&cli, "train %s -o y.safetensors --iters 6 --save-every 2 %s --resume --json -", clip, STEPS);
  cli_expect(&cli, 0, NULL);
  json_t *report = cli_json(&cli, NULL);
  assert_true(number(report, "step") == 6);
  json_decref(report);
  /* on the device the same bytes as in one go */
  cli_run(&cli, "train %s -o x.safetensors --iters 6 --save-every 2 %s --resume --set deterministic=yes %s", clip,
          STEPS, DEVICE);
  cli_expect(&cli, 0, NULL);
  forget("z");
  cli_run(&cli, "train %s -o z.safetensors --iters 6 --save-every 2 %s --set deterministic=yes %s", clip, STEPS,
          DEVICE);
  cli_expect(&cli, 0, NULL);
  cli_same_bytes("x.safetensors", "z.safetensors");
}

/* A state of the CPU goes on on the device. */
static void test_from_cpu_long(void **state) {
  (void)state;
  forget("x");
  cli_run(&cli, "train %s -y -o x.safetensors --iters 2 %s --quiet", clip, STEPS);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train %s -o x.safetensors --iters 4 %s --resume --quiet --json - %s", clip, STEPS, DEVICE);
  cli_expect(&cli, 0, NULL);
  json_t *report = cli_json(&cli, NULL);
  assert_true(number(report, "step") == 4);
  assert_string_equal(json_string_value(json_object_get(report, "backend")), "opencl");
  json_decref(report);
}

/* ---- the cache of kernels ---------------------------------------------------------------------------------------- */

enum { ENTRIES = 64, SUM = 64, HEAD = 2 * SUM /* hex digits of the SHA-256, then of the key, before the binary */ };

/* Draws a frame on a driver that is not known to have a cache of its own, with ours in the folder `cache`; exit status.
 */
static int draw(const char *to) {
  support_clear(to);
  fault("STRANGER", "1");
  cli_run(&cli, "render m.safetensors --clip %s --frames 0:1 -y -o %s --quiet %s", clip, to, DEVICE);
  return cli.status;
}

static size_t list_entries(char paths[ENTRIES][512]) {
  size_t count = 0;
  DIR *list = opendir("cache/libernerf");
  for (struct dirent *entry = list != NULL ? readdir(list) : NULL; entry != NULL; entry = readdir(list)) {
    if (strstr(entry->d_name, ".clbin") == NULL) continue;
    assert_true(count < ENTRIES);
    snprintf(paths[count++], sizeof paths[0], "cache/libernerf/%s", entry->d_name);
  }
  if (list != NULL) closedir(list);
  return count;
}

/* Entry `bytes` [count] with one of the ways to be wrong; returns its new length. */
static size_t damage(uint8_t *bytes, size_t count, size_t way) {
  char sum[SUM + 1];
  switch (way % 5) {
    case 0: return count / 2;
    case 1: bytes[count / 2] ^= 1; return count;
    case 2: return 0;
    case 3: bytes[0] ^= 1; return count;
    default: /* the sum is right, what it is of is no binary of any driver */
      memset(bytes + HEAD, 0x5a, count - HEAD);
      ern_sha256_hex(bytes + SUM, count - SUM, sum);
      memcpy(bytes, sum, SUM);
      return count;
  }
}

/* `info devices` on the driver of `draw`. */
static void expect_kernels_kept(bool kept) {
  fault("STRANGER", "1");
  cli_run(&cli, "info devices --json");
  cli_expect(&cli, 0, NULL);
  if ((strstr(cli.out, "\"kernels_kept\": true") != NULL) != kept)
    fail_msg("kernels_kept, expected %d: %s", kept, cli.out);
}

static void test_cache_long(void **state) {
  static char paths[ENTRIES][512];
  char before[1024];
  (void)state;
  snprintf(before, sizeof before, "%s", getenv("XDG_CACHE_HOME"));
  place("XDG_CACHE_HOME", "cache");
  support_clear("cache");
  expect_kernels_kept(false);
  assert_int_equal(draw("whole%d.png"), 0);
  expect_kernels_kept(true);
  const size_t entries = list_entries(paths);
  assert_true(entries > 0);
  fault("BUILD", "1"); /* from here on the cache is all there is */
  if (draw("again%d.png") != 0) fail_msg("the cache was not used: %s", cli.err);
  cli_same_bytes("whole0.png", "again0.png");
  clear();
  for (size_t way = 0; way < 6; way++) {
    for (size_t i = 0; i < entries; i++) {
      size_t count = 0;
      uint8_t *bytes = cli_bytes(paths[way < 5 ? i : 0], &count); /* 5: the place of another */
      support_write(paths[i], bytes, way < 5 ? damage(bytes, count, way + i) : count);
      free(bytes);
    }
    fault("BUILD", "1");
    assert_int_equal(draw("x%d.png"), 1); /* a damaged entry is not trusted */
    cli_expect(&cli, 1, "does not build", NULL);
    clear();
    assert_int_equal(draw("mended%d.png"), 0);
    cli_same_bytes("whole0.png", "mended0.png");
    fault("BUILD", "1");
    assert_int_equal(draw("mended%d.png"), 0); /* and was built again */
    clear();
  }
  nothing_half("cache/libernerf");
  clear();
  assert_int_equal(setenv("XDG_CACHE_HOME", before, 1), 0);
}

/* PoCL has a cache of its own: nothing is put into ours. */
static void test_driver_with_a_cache_long(void **state) {
  static char paths[ENTRIES][512];
  char before[1024];
  (void)state;
  cli_run(&cli, "info devices --json");
  if (strstr(cli.out, "pocl") == NULL && strstr(cli.out, "PoCL") == NULL) skip();
  snprintf(before, sizeof before, "%s", getenv("XDG_CACHE_HOME"));
  place("XDG_CACHE_HOME", "cache");
  support_clear("cache");
  cli_run(&cli, "render m.safetensors --clip %s --frames 0:1 -y -o own%%d.png --quiet %s", clip, DEVICE);
  cli_expect(&cli, 0, NULL);
  cli_same_bytes("whole0.png", "own0.png");
  assert_int_equal(list_entries(paths), 0);
  assert_int_equal(setenv("XDG_CACHE_HOME", before, 1), 0);
}

/* A folder that cannot be made or written: kernels are built each time. */
static void test_no_cache_long(void **state) {
  char before[1024];
  (void)state;
  snprintf(before, sizeof before, "%s", getenv("XDG_CACHE_HOME"));
  support_clear("file");
  support_write_text("file", "no folder");
  place("XDG_CACHE_HOME", "file");
  assert_int_equal(draw("none%d.png"), 0);
  assert_string_equal(cli.err, "");
  cli_same_bytes("whole0.png", "none0.png");
  support_clear("blocked");
  assert_int_equal(mkdir("blocked", 0777), 0);
  support_write_text("blocked/libernerf", "no folder");
  place("XDG_CACHE_HOME", "blocked");
  assert_int_equal(draw("none%d.png"), 0);
  cli_same_bytes("whole0.png", "none0.png");
  clear();
  assert_int_equal(setenv("XDG_CACHE_HOME", before, 1), 0);
}

/* What the file beside a picture says of a device: no instruction set, and no threads, which it has no use for. */
static void test_provenance_long(void **state) {
  (void)state;
  assert_int_equal(draw("said%d.png"), 0);
  json_t *about = cli_json(&cli, "saidall.png.provenance.json");
  const json_t *settings = json_object_get(about, "settings");
  assert_string_equal(json_string_value(json_object_get(settings, "backend")), "opencl");
  assert_string_equal(json_string_value(json_object_get(settings, "isa")), "");
  assert_int_equal(json_integer_value(json_object_get(settings, "threads")), 0);
  json_decref(about);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_no_driver),
                                     cmocka_unit_test(test_no_device),
                                     cmocka_unit_test(test_build),
                                     cmocka_unit_test(test_no_memory),
                                     cmocka_unit_test(test_some_memory_long),
                                     cmocka_unit_test(test_paper_size_long),
                                     cmocka_unit_test(test_lost),
                                     cmocka_unit_test(test_lost_late_long),
                                     cmocka_unit_test(test_no_resources_long),
                                     cmocka_unit_test(test_lost_early_long),
                                     cmocka_unit_test(test_lost_after_save_long),
                                     cmocka_unit_test(test_from_cpu_long),
                                     cmocka_unit_test(test_cache_long),
                                     cmocka_unit_test(test_driver_with_a_cache_long),
                                     cmocka_unit_test(test_no_cache_long),
                                     cmocka_unit_test(test_provenance_long)};
  return cmocka_run_group_tests(tests, make_model, NULL);
}
