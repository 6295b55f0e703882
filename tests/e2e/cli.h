/* SPDX-License-Identifier: MIT
 * Runs the program as a user would, and checks its exit status, its messages and its files. */
#ifndef ERN_TESTS_E2E_CLI_H
#define ERN_TESTS_E2E_CLI_H

#include "../support.h"

#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <signal.h>
#include <stdbool.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

enum { CLI_WORDS = 64, CLI_LINE_BYTES = 4096, CLI_TEXT_BYTES = 1 << 20 };

struct cli {
  pid_t pid;
  int status; /* exit status; 128 + number of a signal that ended it */
  char line[CLI_LINE_BYTES];
  char out[CLI_TEXT_BYTES], err[CLI_TEXT_BYTES]; /* standard output and standard error */
};

#if defined(CLI_EXECUTED)
static inline void cli_begin(int count, char **words) {
  (void)count;
  execv(words[0], words);
  _exit(127);
}
#else
int ernerf_main(int argc, char **argv); /* of tools/ernerf-cli/main.c */

/* Runs the program's code in the forked child, which saves its start, 0.2 s. A file that needs the program itself
 * defines CLI_EXECUTED. */
static inline void cli_begin(int count, char **words) {
  const int status = ernerf_main(count, words);
  fflush(NULL);
  _exit(status); /* not exit(): libraries loaded before the fork would wait there for threads that the child does not
                    have */
}
#endif

/* Standard output goes to cli_out.txt, or to `out` where that is not NULL; files may have at most `file_bytes` bytes
 * (0: any). Words are split at spaces; a word in single quotes may hold some. */
static inline void cli_start(struct cli *cli, const char *out, size_t file_bytes) {
  char *words[CLI_WORDS];
  static char copy[CLI_LINE_BYTES];
  int count = 1;
  words[0] = getenv("ERNERF_BIN");
  if (words[0] == NULL || words[0][0] == 0) fail_msg("ERNERF_BIN is not set: it is the path of the program");
  snprintf(copy, sizeof copy, "%s", cli->line);
  for (char *at = copy; *at != 0;) {
    const char end = *at == '\'' ? '\'' : ' ';
    if (*at == ' ') {
      at++;
      continue;
    }
    assert_true(count < CLI_WORDS - 1);
    words[count++] = end == '\'' ? ++at : at;
    at += strcspn(at, (const char[]){end, 0});
    if (*at != 0) *at++ = 0;
  }
  words[count] = NULL;
  fflush(NULL);
  cli->pid = fork();
  assert_true(cli->pid >= 0);
  if (cli->pid > 0) return;
  const int to = open(out != NULL ? out : "cli_out.txt", O_WRONLY | O_CREAT | (out == NULL ? O_TRUNC : 0), 0644);
  const int err = open("cli_err.txt", O_WRONLY | O_CREAT | O_TRUNC, 0644);
  const struct rlimit limit = {.rlim_cur = file_bytes, .rlim_max = file_bytes};
  if (to < 0 || err < 0 || dup2(to, STDOUT_FILENO) < 0 || dup2(err, STDERR_FILENO) < 0) _exit(126);
  if (file_bytes > 0 && setrlimit(RLIMIT_FSIZE, &limit) != 0) _exit(126);
  cli_begin(count, words);
}

static inline void cli_read(const char *path, char text[CLI_TEXT_BYTES]) {
  FILE *file = fopen(path, "rb");
  text[0] = 0;
  if (file == NULL) return;
  text[fread(text, 1, CLI_TEXT_BYTES - 1, file)] = 0;
  fclose(file);
}

static inline void cli_wait(struct cli *cli) {
  int status = 0;
  assert_int_equal(waitpid(cli->pid, &status, 0), cli->pid);
  cli->status = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  cli_read("cli_out.txt", cli->out);
  cli_read("cli_err.txt", cli->err);
}

static inline void cli_words(struct cli *cli, const char *format, va_list values) {
  const int bytes = vsnprintf(cli->line, sizeof cli->line, format, values);
  assert_true(bytes >= 0 && bytes < (int)sizeof cli->line);
}

static inline void cli_run(struct cli *cli, const char *format, ...) ERN_PRINTF(2, 3);
static inline void cli_run(struct cli *cli, const char *format, ...) {
  va_list values;
  va_start(values, format);
  cli_words(cli, format, values);
  va_end(values);
  cli_start(cli, NULL, 0);
  cli_wait(cli);
}

/* Runs a command line with the file size limit `bytes`, to simulate a full disk. */
static inline void cli_run_full(struct cli *cli, size_t bytes, const char *format, ...) ERN_PRINTF(3, 4);
static inline void cli_run_full(struct cli *cli, size_t bytes, const char *format, ...) {
  va_list values;
  va_start(values, format);
  cli_words(cli, format, values);
  va_end(values);
  cli_start(cli, NULL, bytes);
  cli_wait(cli);
}

static inline void cli_check(const struct cli *cli, int status, const char *text, va_list words) {
  if (cli->status != status)
    fail_msg("ernerf %s\nexit status %d, expected %d\n%s", cli->line, cli->status, status, cli->err);
  for (const char *word = va_arg(words, const char *); word != NULL; word = va_arg(words, const char *))
    if (strstr(text, word) == NULL) fail_msg("ernerf %s\nsaid \"%s\", expected \"%s\" in it", cli->line, text, word);
}

/* Checks the exit status, and that stderr contains each of the texts; the list ends with NULL. */
static inline void cli_expect(const struct cli *cli, int status, ...) {
  va_list words;
  va_start(words, status);
  cli_check(cli, status, cli->err, words);
  va_end(words);
}

/* The same for standard output. */
static inline void cli_expect_out(const struct cli *cli, int status, ...) {
  va_list words;
  va_start(words, status);
  cli_check(cli, status, cli->out, words);
  va_end(words);
}

/* The JSON object in a file, or on standard output (path NULL). The caller owns it. */
static inline json_t *cli_json(const struct cli *cli, const char *path) {
  json_error_t error;
  json_t *object = path != NULL ? json_load_file(path, 0, &error) : json_loads(cli->out, 0, &error);
  if (!json_is_object(object)) fail_msg("ernerf %s: no JSON object: %s", cli->line, error.text);
  return object;
}

static inline bool cli_there(const char *path) { return access(path, F_OK) == 0; }

/* Number of files in a folder; 0 if it does not exist. */
static inline size_t cli_count(const char *folder) {
  DIR *list = opendir(folder);
  size_t count = 0;
  for (struct dirent *entry = list != NULL ? readdir(list) : NULL; entry != NULL; entry = readdir(list))
    count += entry->d_name[0] != '.';
  if (list != NULL) closedir(list);
  return count;
}

/* The copy's files are links to the originals, so that one can be taken away or replaced without touching them. */
static inline void cli_copy(const char *from, const char *to) {
  char source[2048], inside[2048], copy[2048];
  support_clear(to);
  assert_int_equal(mkdir(to, 0777), 0);
  char here[1024] = "";
  if (from[0] != '/') assert_non_null(getcwd(here, sizeof here));
  assert_true(snprintf(source, sizeof source, "%s%s%s", here, here[0] != 0 ? "/" : "", from) < (int)sizeof source);
  DIR *list = opendir(source);
  assert_non_null(list);
  for (struct dirent *entry = readdir(list); entry != NULL; entry = readdir(list)) {
    struct stat about;
    if (entry->d_name[0] == '.') continue;
    assert_true(snprintf(inside, sizeof inside, "%s/%s", source, entry->d_name) < (int)sizeof inside);
    assert_true(snprintf(copy, sizeof copy, "%s/%s", to, entry->d_name) < (int)sizeof copy);
    assert_int_equal(stat(inside, &about), 0);
    if (S_ISDIR(about.st_mode))
      cli_copy(inside, copy);
    else
      assert_int_equal(symlink(inside, copy), 0);
  }
  closedir(list);
}

/* Replaces a file of such a copy. */
static inline void cli_replace(const char *path, const void *bytes, size_t count) {
  remove(path);
  support_write(path, bytes, count);
}

/* Bytes of a file; the caller frees them. */
static inline uint8_t *cli_bytes(const char *path, size_t *count) {
  FILE *file = fopen(path, "rb");
  if (file == NULL) fail_msg("%s: cannot be opened", path);
  assert_int_equal(fseek(file, 0, SEEK_END), 0);
  *count = (size_t)ftell(file);
  rewind(file);
  uint8_t *bytes = malloc(*count + 1);
  assert_non_null(bytes);
  assert_int_equal(fread(bytes, 1, *count, file), *count);
  fclose(file);
  bytes[*count] = 0;
  return bytes;
}

static inline void cli_same_bytes(const char *a, const char *b) {
  size_t first = 0, second = 0;
  uint8_t *left = cli_bytes(a, &first), *right = cli_bytes(b, &second);
  if (first != second || memcmp(left, right, first) != 0) fail_msg("%s and %s differ", a, b);
  free(left);
  free(right);
}

/* ---- what shared_clips.sh has made --------------------------------------------------------------------------------
 */

static inline void cli_shared_path(char path[2048], const char *name) {
  const char *folder = getenv("ERNERF_TEST_CLIPS");
  if (folder == NULL) fail_msg("ERNERF_TEST_CLIPS is not set: it is the folder of e2e/shared_clips");
  assert_true(snprintf(path, 2048, "%s/%s", folder, name) < 2048);
  if (!cli_there(path)) fail_msg("%s is missing: e2e/shared_clips makes it", path);
}

/* A clip of links: "short" (33 frames, 3 of them for validation), "long" (66, 6) or "recorded" (16). */
static inline void cli_shared_clip(const char *name, const char *to) {
  char path[2048];
  cli_shared_path(path, name);
  cli_copy(path, to);
}

/* The shared video, 30 frames of 160 x 160 pixels, as v.mp4, and its clip as truth: both are links. */
static inline void cli_shared_video(void) {
  char path[2048];
  cli_shared_path(path, "person.mp4");
  assert_int_equal(symlink(path, "v.mp4"), 0);
  cli_shared_clip("person", "truth");
}

/* TO.safetensors and TO.run: "short_head" (20 steps of 2 levels) or "long_head" (6 steps of 4 levels) or
 * "recorded_head" (200 steps of 2 levels). A program that
 * goes on with a model may write through links, so these are no links. */
static inline void cli_shared_model(const char *name, const char *to) {
  static const char *const files[] = {".safetensors", ".run/state.safetensors", ".run/log.jsonl", ".run/curve.csv",
                                      ".run/measures.csv"};
  char part[512], path[2048];
  snprintf(part, sizeof part, "%s.run", to);
  support_clear(part);
  assert_int_equal(mkdir(part, 0777), 0);
  for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
    size_t count = 0;
    snprintf(part, sizeof part, "%s%s", name, files[i]);
    cli_shared_path(path, part);
    uint8_t *bytes = cli_bytes(path, &count);
    snprintf(part, sizeof part, "%s%s", to, files[i]);
    support_write(part, bytes, count);
    free(bytes);
  }
}

#endif
