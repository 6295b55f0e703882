/* SPDX-License-Identifier: MIT
 * Starts the child with posix_spawn, as a program with threads cannot safely fork and continue. The child prints each
 * action before it, so its last line is the action that crashed it. The line "end" means success, whatever the exit
 * status, which another part of the program may have collected (waitpid(-1) in a SIGCHLD handler). */
#define _GNU_SOURCE /* dladdr, pipe2, secure_getenv */
#include "backend_opencl/device/probe.h"

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { PATH_BYTES = 4096, LINE_BYTES = 512, LOOK_MILLISECONDS = 100 };
static const char program[] = "ernerf/ernerf-probe-opencl";

/* ---- the program ------------------------------------------------------------------------------------------------- */

/* In the folder `ernerf` beside this library; for a statically linked program, in lib/ beside its bin/; else in the
 * installation folder. ERNERF_PROBE_OPENCL names another one. */
static bool find_program(char path[PATH_BYTES]) {
  static const char *const ways[] = {"", "../" ERN_LIBRARY_FOLDER "/"};
  static const char anchor = 0;
  const char *named = secure_getenv("ERNERF_PROBE_OPENCL");
  Dl_info self;
  if (named != NULL) return snprintf(path, PATH_BYTES, "%s", named) < PATH_BYTES && access(path, X_OK) == 0;
  const bool known = dladdr(&anchor, &self) != 0 && self.dli_fname != NULL && strchr(self.dli_fname, '/') != NULL;
  for (size_t i = 0; known && i < sizeof ways / sizeof *ways; i++) {
    const int folder = (int)(strrchr(self.dli_fname, '/') + 1 - self.dli_fname);
    const int length = snprintf(path, PATH_BYTES, "%.*s%s%s", folder, self.dli_fname, ways[i], program);
    if (length < PATH_BYTES && access(path, X_OK) == 0) return true;
  }
  return snprintf(path, PATH_BYTES, ERN_LIBRARY_INSTALLED "/%s", program) < PATH_BYTES && access(path, X_OK) == 0;
}

/* Seconds until a child times out: a driver may have to compile, or to wake a device. ERNERF_PROBE_SECONDS overrides
 * it. */
static int timeout_seconds(void) {
  const char *named = getenv("ERNERF_PROBE_SECONDS");
  const long seconds = named != NULL ? strtol(named, NULL, 10) : 0;
  return seconds >= 1 && seconds <= 3600 ? (int)seconds : 60;
}

/* ---- the child --------------------------------------------------------------------------------------------------- */

/* One of the child's two streams: the incomplete line, and the last complete one that was not empty. */
struct stream {
  int descriptor; /* -1: closed */
  size_t length;
  char coming[LINE_BYTES], last[LINE_BYTES];
};

struct child {
  pid_t pid;
  struct stream out, err;
  int status;                   /* of waitpid; -1: not known */
  bool ended, exited, too_long; /* has printed "end"; has exited; has timed out */
  char doing[LINE_BYTES];
  int device; /* the last one that it used; -1: none */
};

static void finish_line(struct stream *s) {
  s->coming[s->length] = 0;
  if (s->length > 0) memcpy(s->last, s->coming, s->length + 1);
  s->length = 0;
}

/* Reads the available bytes; calls `use` for each line. Closes the stream at its end. */
static void take(struct child *child, struct stream *s, void (*use)(struct child *child, const char *line)) {
  char bytes[1024];
  const ssize_t count = read(s->descriptor, bytes, sizeof bytes);
  if (count < 0 && (errno == EINTR || errno == EAGAIN)) return;
  if (count <= 0) {
    finish_line(s); /* the last line may lack a newline */
    close(s->descriptor);
    s->descriptor = -1;
    return;
  }
  for (ssize_t i = 0; i < count; i++) {
    if (bytes[i] != '\n') {
      if (s->length < LINE_BYTES - 1) s->coming[s->length++] = bytes[i] >= ' ' && bytes[i] < 127 ? bytes[i] : '?';
      continue;
    }
    finish_line(s);
    if (use != NULL) use(child, s->last);
  }
}

static void use_line(struct child *child, const char *line) {
  child->ended = strcmp(line, "end") == 0;
  if (strncmp(line, "device ", 7) == 0) child->device = (int)strtol(line + 7, NULL, 10);
  snprintf(child->doing, sizeof child->doing, "%s", line);
}

static double seconds_now(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void look_whether_over(struct child *child, int flags) {
  int status = 0;
  pid_t found = 0;
  do found = waitpid(child->pid, &status, flags);
  while (found < 0 && errno == EINTR);
  if (found == 0) return;
  child->exited = true;
  child->status = found > 0 ? status : -1;
}

/* Reads until the child has printed "end", has exited or has timed out. Does not wait for the end of the streams, as
 * processes that the child started may hold them open. */
static void listen_to(struct child *child) {
  const double began = seconds_now();
  while (!child->ended && !child->too_long) {
    struct pollfd some[2] = {{.fd = child->out.descriptor, .events = POLLIN},
                             {.fd = child->err.descriptor, .events = POLLIN}};
    if (!child->exited) look_whether_over(child, WNOHANG);
    const int ready = poll(some, 2, child->exited ? 0 : LOOK_MILLISECONDS); /* poll ignores a closed one, -1 */
    if (some[0].revents != 0 && ready > 0) take(child, &child->out, use_line);
    if (some[1].revents != 0 && ready > 0) take(child, &child->err, NULL);
    if (child->exited && ready <= 0) break;
    child->too_long = seconds_now() - began > timeout_seconds();
  }
  finish_line(&child->err);
  if (!child->exited) {
    kill(-child->pid, SIGKILL); /* and the processes that it started, such as a compiler */
    look_whether_over(child, 0);
  }
}

/* In a process group of its own, so that a Ctrl-C in the terminal is not taken for a crash of the driver. */
static int start(struct child *child, const char *path, int first, int last, const int out[2], const int err[2]) {
  char from[16], to[16], name[] = "ernerf-probe-opencl";
  char *arguments[] = {name, from, to, NULL};
  posix_spawn_file_actions_t actions;
  posix_spawnattr_t attributes;
  sigset_t all, none;
  snprintf(from, sizeof from, "%d", first);
  snprintf(to, sizeof to, "%d", last);
  sigfillset(&all);
  sigemptyset(&none);
  int error = posix_spawn_file_actions_init(&actions);
  if (error != 0) return error;
  error = posix_spawnattr_init(&attributes);
  if (error == 0) {
    posix_spawnattr_setsigdefault(&attributes, &all);
    posix_spawnattr_setsigmask(&attributes, &none);
    posix_spawnattr_setpgroup(&attributes, 0);
    posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETPGROUP);
    error = posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    if (error == 0) error = posix_spawn_file_actions_adddup2(&actions, out[1], STDOUT_FILENO);
    if (error == 0) error = posix_spawn_file_actions_adddup2(&actions, err[1], STDERR_FILENO);
    if (error == 0) error = posix_spawn(&child->pid, path, &actions, &attributes, arguments, environ);
    posix_spawnattr_destroy(&attributes);
  }
  posix_spawn_file_actions_destroy(&actions);
  return error;
}

/* 0, or errno where the program could not be started. */
static int run(struct child *child, const char *path, int first, int last) {
  int out[2] = {-1, -1}, err[2] = {-1, -1};
  int error = pipe2(out, O_CLOEXEC) == 0 && pipe2(err, O_CLOEXEC) == 0 ? 0 : errno;
  *child = (struct child){.status = -1, .device = -1};
  if (error == 0) error = start(child, path, first, last, out, err);
  if (out[1] >= 0) close(out[1]);
  if (err[1] >= 0) close(err[1]);
  child->out.descriptor = out[0];
  child->err.descriptor = err[0];
  if (error == 0) listen_to(child);
  if (child->out.descriptor >= 0) close(child->out.descriptor);
  if (child->err.descriptor >= 0) close(child->err.descriptor);
  return error;
}

/* ---- what it died of --------------------------------------------------------------------------------------------- */

static void describe_exit(const struct child *child, char text[LINE_BYTES]) {
  static const struct {
    int number;
    const char *name;
  } signals[] = {{SIGABRT, "SIGABRT"}, {SIGSEGV, "SIGSEGV"}, {SIGBUS, "SIGBUS"},
                 {SIGILL, "SIGILL"},   {SIGFPE, "SIGFPE"},   {SIGKILL, "SIGKILL"}};
  if (child->too_long) {
    snprintf(text, LINE_BYTES, "did not answer for %d seconds", timeout_seconds());
  } else if (child->status >= 0 && WIFSIGNALED(child->status)) {
    const int number = WTERMSIG(child->status);
    snprintf(text, LINE_BYTES, "ended by signal %d", number);
    for (size_t i = 0; i < sizeof signals / sizeof *signals; i++)
      if (signals[i].number == number) snprintf(text, LINE_BYTES, "ended by %s", signals[i].name);
  } else if (child->status >= 0 && WIFEXITED(child->status)) {
    snprintf(text, LINE_BYTES, "ended with status %d", WEXITSTATUS(child->status));
  } else {
    snprintf(text, LINE_BYTES, "ended");
  }
}

static ern_status tell_death(ern_context *context, const struct child *child) {
  char how[LINE_BYTES], what[2 * LINE_BYTES];
  const char *message = child->err.last, *name = strchr(child->doing, ' ');
  describe_exit(child, how);
  if (child->device >= 0) {
    name = name != NULL ? strchr(name + 1, ' ') : NULL; /* "device 0 NAME" */
    snprintf(what, sizeof what, "device %d (%s) cannot be used: it was tried", child->device,
             name != NULL ? name + 1 : "");
  } else if (name != NULL) { /* "platform NAME" */
    snprintf(what, sizeof what, "no device can be used: the platform %s was asked for its devices", name + 1);
  } else {
    snprintf(what, sizeof what, "no device can be used: the drivers were loaded");
  }
  return ern_fail(context, ERN_E_DEVICE, "OpenCL: %s in a child process, which %s%s%s%s", what, how,
                  message[0] != 0 ? "; it said: \"" : "", message, message[0] != 0 ? "\"" : "");
}

ern_status ern_cl_probe(ern_context *context, int first, int last, bool *listed, int *dead) {
  char path[PATH_BYTES];
  struct child child;
  *listed = true;
  *dead = last + 1;
  if (!find_program(path)) {
    ern_log(context, ERN_LOG_WARNING,
            "OpenCL: devices are used untried, as the program %s is missing; a driver that fails may end this process",
            program);
    return ERN_OK;
  }
  const int error = run(&child, path, first, last);
  if (error != 0) {
    ern_log(context, ERN_LOG_WARNING, "OpenCL: devices are used untried, as %s cannot be started: error %d", path,
            error);
    return ERN_OK;
  }
  if (child.ended) return ERN_OK;
  *listed = child.device >= 0;
  *dead = child.device;
  return tell_death(context, &child);
}
