/* SPDX-License-Identifier: MIT
 * Runs the program's code in a forked child of the test, which avoids the start-up cost of a thousand runs, and injects
 * a fault. Then checks the results: exit status, messages, files. */
#ifndef ERN_TESTS_JOURNEY_H
#define ERN_TESTS_JOURNEY_H

#include "../support.h"

#include <fcntl.h>
#include <signal.h>
#include <stdbool.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "core/rng.h"
#include "file_faults.h"
#include "io/safetensors.h"

int ernerf_main(int argc, char **argv); /* of tools/ernerf-cli/main.c */

enum { JOURNEY_WORDS = 64, JOURNEY_SECONDS = 120, JOURNEY_TEXT = 1 << 14 };

struct journey {
  pid_t pid;
  int status; /* exit status; 128 + number of a signal that ended it */
  char line[1024], err[JOURNEY_TEXT];
  struct fault_seen *seen;
};

static inline void journey_open(struct journey *j) {
  const int file = open("journey_seen.bin", O_RDWR | O_CREAT | O_TRUNC, 0644);
  assert_true(file >= 0 && ftruncate(file, sizeof *j->seen) == 0);
  *j = (struct journey){.seen = mmap(NULL, sizeof *j->seen, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0)};
  assert_true(j->seen != MAP_FAILED);
  close(file);
}

static inline void journey_child(struct journey *j, const struct fault *fault) {
  char *words[JOURNEY_WORDS] = {"ernerf"};
  int count = 1;
  const int err = open("journey_err.txt", O_WRONLY | O_CREAT | O_TRUNC, 0644),
            out = open("journey_out.txt", O_WRONLY | O_CREAT | O_TRUNC, 0644);
  if (err < 0 || out < 0 || dup2(err, STDERR_FILENO) < 0 || dup2(out, STDOUT_FILENO) < 0) _exit(126);
  for (char *word = strtok(j->line, " "); word != NULL && count < JOURNEY_WORDS - 1; word = strtok(NULL, " "))
    words[count++] = word;
  alarm(JOURNEY_SECONDS); /* SIGALRM ends a run that hangs */
  faults_set(fault, j->seen);
  const int status = ernerf_main(count, words);
  faults_set(NULL, NULL);
  fflush(NULL);
  _exit(status); /* not exit(): libraries loaded before the fork would wait there for threads that the child does not
                    have */
}

/* Starts a command line; `fault` NULL: nothing fails. */
static inline void journey_start(struct journey *j, const struct fault *fault, const char *format, ...)
    ERN_PRINTF(3, 4);
static inline void journey_start(struct journey *j, const struct fault *fault, const char *format, ...) {
  va_list values;
  va_start(values, format);
  assert_true(vsnprintf(j->line, sizeof j->line, format, values) < (int)sizeof j->line);
  va_end(values);
  fflush(NULL);
  j->pid = fork();
  assert_true(j->pid >= 0);
  if (j->pid == 0) journey_child(j, fault);
}

static inline void journey_wait(struct journey *j) {
  int status = 0;
  assert_int_equal(waitpid(j->pid, &status, 0), j->pid);
  j->status = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  FILE *file = fopen("journey_err.txt", "rb");
  assert_non_null(file);
  j->err[fread(j->err, 1, sizeof j->err - 1, file)] = 0;
  fclose(file);
}

/* Runs a command line that must succeed. */
static inline void journey_ok(struct journey *j, const char *format, ...) ERN_PRINTF(2, 3);
static inline void journey_ok(struct journey *j, const char *format, ...) {
  char line[sizeof j->line];
  va_list values;
  va_start(values, format);
  assert_true(vsnprintf(line, sizeof line, format, values) < (int)sizeof line);
  va_end(values);
  journey_start(j, NULL, "%s", line);
  journey_wait(j);
  if (j->status != 0) fail_msg("ernerf %s\nexit status %d\n%s", j->line, j->status, j->err);
}

static inline bool journey_there(const char *path) { return access(path, F_OK) == 0; }

/* ---- results ----------------------------------------------------------------------------------------------------- */

/* Step of a state file; -1: missing or incomplete. */
static inline int64_t journey_step_of(ern_context *context, const char *path) {
  struct ern_tensor_file file = {0};
  long long step = -1;
  if (journey_there(path) && ern_safetensors_read(context, path, &file) == ERN_OK) {
    const char *text = ern_tensor_file_metadata(&file, "ernerf.state"),
               *at = text != NULL ? strstr(text, "\"step\":") : NULL;
    if (at == NULL || sscanf(at, "\"step\":%lld", &step) != 1) step = -1;
  }
  ern_tensor_file_free(context, &file);
  return step;
}

/* The newest complete step in a run folder; -1: none. */
static inline int64_t journey_newest(ern_context *context, const char *run) {
  static const char *const names[] = {"state.next.safetensors", "state.safetensors", "state.previous.safetensors"};
  int64_t newest = -1;
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    char path[1024];
    snprintf(path, sizeof path, "%s/%s", run, names[i]);
    const int64_t step = journey_step_of(context, path);
    newest = step > newest ? step : newest;
  }
  return newest;
}

/* Number of unfinished temporary files below `folder` whose paths contain `part`; first: one of them. */
static inline size_t journey_leftovers(const char *folder, const char *part, char first[1024]) {
  DIR *list = opendir(folder);
  size_t count = 0;
  for (struct dirent *entry = list != NULL ? readdir(list) : NULL; entry != NULL; entry = readdir(list)) {
    char inside[1024];
    struct stat about;
    if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0) continue;
    assert_true(snprintf(inside, sizeof inside, "%s/%s", folder, entry->d_name) < (int)sizeof inside);
    if (lstat(inside, &about) == 0 && S_ISDIR(about.st_mode)) count += journey_leftovers(inside, part, first);
    if (strstr(entry->d_name, ".ernerf-tmp") == NULL || strstr(inside, part) == NULL) continue;
    if (count++ == 0) memcpy(first, inside, sizeof inside);
  }
  if (list != NULL) closedir(list);
  return count;
}

/* A random integer in [0, most), a function of seed and count. */
static inline uint32_t journey_random(uint32_t seed, uint32_t count, uint32_t most) {
  return most > 0 ? ern_random_at(seed, count, 0, ERN_RNG_INIT).word[0] % most : 0;
}

static inline uint32_t journey_number(const char *name, uint32_t otherwise) {
  const char *value = getenv(name);
  return value != NULL && value[0] != 0 ? (uint32_t)strtoul(value, NULL, 10) : otherwise;
}

#endif
