/* SPDX-License-Identifier: MIT
 * What the program loads before it needs it: the libraries of pictures, video and sound come with the first file of
 * media, and not with the help, a model or a refusal. The dynamic loader tells (LD_DEBUG=files). */
#define CLI_EXECUTED /* the loader of the program is what this tests */
#include "cli.h"

static struct cli cli;

/* Of the libraries in the loader's words, how many have one of `names` in theirs. */
static size_t count_loaded(const char *trace, const char *const *names) {
  size_t found = 0;
  char line[4096];
  FILE *file = fopen(trace, "r");
  assert_non_null(file);
  while (fgets(line, sizeof line, file) != NULL)
    for (const char *const *name = names; *name != NULL; name++)
      found += strstr(line, "calling init: ") != NULL && strstr(line, *name) != NULL;
  fclose(file);
  return found;
}

/* Runs `line` and says how many libraries of media it loaded, of all that it loaded. */
static size_t loads(int status, const char *line, size_t *all) {
  static const char *const media[] = {"libavcodec.",    "libavformat.", "libavutil.", "libOpenImageIO.",
                                      "libopencv_core", "media-impl",   NULL};
  static const char *const every[] = {".so", NULL};
  char trace[64];
  assert_int_equal(setenv("LD_DEBUG", "files", 1), 0);
  assert_int_equal(setenv("LD_DEBUG_OUTPUT", "trace", 1), 0);
  cli_run(&cli, "%s", line);
  assert_int_equal(unsetenv("LD_DEBUG"), 0);
  assert_int_equal(unsetenv("LD_DEBUG_OUTPUT"), 0);
  cli_expect(&cli, status, NULL);
  snprintf(trace, sizeof trace, "trace.%d", (int)cli.pid);
  const size_t found = count_loaded(trace, media);
  *all = count_loaded(trace, every);
  assert_int_equal(remove(trace), 0);
  return found;
}

static void refuse_media(int status, const char *line) {
  size_t all = 0;
  const size_t found = loads(status, line, &all);
  if (found > 0) fail_msg("ernerf %s loads %zu libraries of media", line, found);
  assert_in_range(all, 3, 60);
}

static void test_help(void **state) {
  static const char *const verbs[] = {"prepare",  "train", "render",  "live",     "eval",  "compare",
                                      "check",    "info",  "convert", "features", "synth", "bench",
                                      "tradeoff", "soak",  "ablate",  "join",     "detect"};
  char line[64];
  (void)state;
  refuse_media(0, "--version");
  refuse_media(0, "--help");
  for (size_t i = 0; i < sizeof verbs / sizeof *verbs; i++) {
    snprintf(line, sizeof line, "%s --help", verbs[i]);
    refuse_media(0, line);
  }
}

static void test_before_an_input(void **state) {
  (void)state;
  refuse_media(2, "render");
  refuse_media(1, "render none.safetensors --clip none -o out.mp4");
  refuse_media(1, "info none.safetensors");
}

/* What has no picture, video or sound in it, and what has. */
static void test_files(void **state) {
  size_t all = 0;
  char line[4096];
  (void)state;
  snprintf(line, sizeof line, "train '%s/data/tiny' -o m.safetensors --iters 1 --rays 16 --levels 2 --quiet",
           getenv("ERNERF_SOURCE"));
  assert_true(loads(0, line, &all) > 0);
  refuse_media(0, "info m.safetensors");
  refuse_media(0, "convert m.safetensors m.pth --quiet");
  snprintf(line, sizeof line, "info '%s/data/tiny/transforms_val.json'", getenv("ERNERF_SOURCE"));
  refuse_media(0, line);
  snprintf(line, sizeof line, "check '%s/data/tiny'", getenv("ERNERF_SOURCE"));
  assert_true(loads(0, line, &all) > 0);
}

static void copy(const char *from, const char *to) {
  size_t count = 0;
  uint8_t *bytes = cli_bytes(from, &count);
  support_write(to, bytes, count);
  assert_int_equal(chmod(to, 0755), 0);
  free(bytes);
}

/* A program that has lost one of the libraries that it loads: bin/ernerf and lib/ of it in the folder `to`. */
static void install_without(const char *lost, const char *to) {
  static const char *const parts[] = {"", "-media", "-media-impl", "-prepare", "-vision", "-perceptual", "-mpi"};
  char folder[512], from[4096], path[1024];
  const char *program = getenv("ERNERF_BIN"), *slash = strrchr(program, '/');
  assert_int_equal(mkdir(to, 0755), 0);
  snprintf(folder, sizeof folder, "%s/bin", to);
  assert_int_equal(mkdir(folder, 0755), 0);
  snprintf(folder, sizeof folder, "%s/lib", to);
  assert_int_equal(mkdir(folder, 0755), 0);
  for (size_t i = 0; i < sizeof parts / sizeof *parts; i++) {
    snprintf(from, sizeof from, "%.*s/../lib/libernerf%s.so.%d", (int)(slash - program), program, parts[i],
             ERN_VERSION_MAJOR);
    snprintf(path, sizeof path, "%s/libernerf%s.so.%d", folder, parts[i], ERN_VERSION_MAJOR);
    if (strcmp(parts[i], lost) != 0 && cli_there(from)) copy(from, path);
  }
  snprintf(path, sizeof path, "%s/bin/ernerf", to);
  copy(program, path);
  assert_int_equal(setenv("ERNERF_BIN", path, 1), 0);
}

/* Without the library of media a verb that needs it ends with a message, and leaves no output. The model is that of
 * test_files. */
static void test_without_media(void **state) {
  static const char *const lines[] = {"check clip",
                                      "train clip -o x.safetensors --iters 1",
                                      "train clip --torso --head m.safetensors -o x.safetensors --iters 1",
                                      "render m.safetensors --clip clip -o x.mp4",
                                      "render m.safetensors --clip clip --audio clip/aud.wav -o x.mp4",
                                      "render m.safetensors --clip clip --audio clip/aud.wav -o -",
                                      "live m.safetensors --clip clip --duration 1 -o x.mp4",
                                      "live m.safetensors --clip clip --audio clip/aud.wav -o x.mp4",
                                      "live m.safetensors --clip clip --control - -o http://127.0.0.1:1/",
                                      "eval m.safetensors clip",
                                      "compare m.safetensors m.safetensors clip -o x",
                                      "features clip/aud.wav -o x.npy",
                                      "features clip/aud.wav --speech-model x.onnx -o x.npy",
                                      "detect x.mp4 --watermark key",
                                      "synth x --size 64 --frames 8",
                                      "bench m.safetensors clip",
                                      "tradeoff m.safetensors clip -o x",
                                      "soak clip --steps 1",
                                      "ablate clip -o x --iters 1"};
  const char *program = getenv("ERNERF_BIN");
  char kept[2048], path[2048];
  (void)state;
  snprintf(kept, sizeof kept, "%s", program);
  snprintf(path, sizeof path, "%s/data/tiny", getenv("ERNERF_SOURCE"));
  cli_copy(path, "clip");
  install_without("-media-impl", "bare");
  for (size_t i = 0; i < sizeof lines / sizeof *lines; i++) {
    cli_run(&cli, "%s", lines[i]);
    cli_expect(&cli, 1, "libernerf-media-impl.so", "cannot be loaded", NULL);
    assert_false(cli_there("x.mp4") || cli_there("x.npy") || cli_there("x.safetensors"));
  }
  assert_int_equal(setenv("ERNERF_BIN", kept, 1), 0);
}

static void run_limited(const char *line, rlim_t kib) {
  struct rlimit before, now;
  assert_int_equal(getrlimit(RLIMIT_AS, &before), 0);
  now = before;
  now.rlim_cur = kib * 1024;
  assert_int_equal(setrlimit(RLIMIT_AS, &now), 0);
  cli_run(&cli, "%s", line);
  assert_int_equal(setrlimit(RLIMIT_AS, &before), 0);
  if (cli.status > 1 || (cli.status == 1 && strstr(cli.err, "ernerf ") == NULL))
    fail_msg("%s with %zu KiB: exit status %d: %s", line, (size_t)kib, cli.status, cli.err);
  support_clear("x.mp4");
  support_clear("x.npy");
  support_clear("x");
}

/* Libraries that allocate, or start threads, while they are loaded end the process where they cannot. bench has
 * threads of its own by then. */
static void test_little_memory(void **state) {
  (void)state;
  run_limited("check clip", 400000);
  run_limited("live m.safetensors --clip clip --duration 1 -o x.mp4", 400000);
  /* enough for one library that is loaded by itself, not for all */
  for (rlim_t kib = 80000; kib <= 120000; kib += 10000) run_limited("check clip", kib);
}

static void test_little_memory_long(void **state) {
  static const char *const lines[] = {"check clip",
                                      "render m.safetensors --clip clip -o x.mp4",
                                      "live m.safetensors --clip clip --duration 1 -o x.mp4",
                                      "detect x.mp4 --watermark key",
                                      "synth x --size 64 --frames 8",
                                      "features clip/aud.wav -o x.npy"};
  (void)state;
  for (rlim_t kib = 350000; kib <= 450000; kib += 50000)
    for (size_t i = 0; i < sizeof lines / sizeof *lines; i++) run_limited(lines[i], kib);
  for (rlim_t kib = 700000; kib <= 900000; kib += 100000)
    run_limited("bench m.safetensors clip --only frame --seconds 0 --rays 256 --quiet", kib);
}

/* A program inherits from the one that starts it that SIGCHLD is ignored: waitpid then knows no exit status. */
static void test_little_memory_without_children(void **state) {
  const struct rlimit little = {400u << 20, 400u << 20};
  int how = 0;
  (void)state;
  fflush(NULL);
  const pid_t child = fork();
  assert_true(child >= 0);
  if (child == 0) {
    (void)signal(SIGCHLD, SIG_IGN);
    if (freopen("check.err", "w", stderr) != NULL && setrlimit(RLIMIT_AS, &little) == 0)
      (void)execl(getenv("ERNERF_BIN"), "ernerf", "check", "clip", (char *)NULL);
    _exit(126);
  }
  assert_int_equal(waitpid(child, &how, 0), child);
  if (!WIFEXITED(how) || WEXITSTATUS(how) != 1) fail_msg("check ended with %x, expected exit status 1", (unsigned)how);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_help),
                                     cmocka_unit_test(test_before_an_input),
                                     cmocka_unit_test(test_files),
                                     cmocka_unit_test(test_without_media),
                                     cmocka_unit_test(test_little_memory),
                                     cmocka_unit_test(test_little_memory_long),
                                     cmocka_unit_test(test_little_memory_without_children)};
#if !ERN_SHARED
  puts("the libraries are static");
  return 0;
#endif
  return cmocka_run_group_tests(tests, NULL, NULL);
}
