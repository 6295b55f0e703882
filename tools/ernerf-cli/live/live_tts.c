/* SPDX-License-Identifier: MIT */
#include "live/live_tts.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "session/session.h"

/* Seconds that a program may take to end after its last sound, and where its sound is not wanted any more. */
static const double grace = 1, short_grace = 0.1;

extern char **environ;

/* ---- espeak-ng --------------------------------------------------------------------------------------------------- */

/* Lets espeak-ng make a file with sound of a text. */
static bool espeak(struct live_tts *tts, const char *text, char reason[LIVE_TTS_REASON]) {
  char program[] = "espeak-ng", voice_option[] = "-v", file_option[] = "-w", end[] = "--";
  const char *folder = getenv("TMPDIR");
  if (snprintf(tts->url, sizeof tts->url,
               "%s/ernerf-say-"
               "XX"
               "XX"
               "XX",
               folder != NULL ? folder : "/tmp") >= (int)sizeof tts->url) {
    snprintf(reason, LIVE_TTS_REASON, "TMPDIR: the name of the folder is too long");
    return false;
  }
  tts->file = mkstemp(tts->url);
  if (tts->file < 0) {
    snprintf(reason, LIVE_TTS_REASON,
             "%.1500s: cannot make a file for the sound of a text (TMPDIR names its folder): %s", tts->url,
             strerror(errno));
    return false;
  }
  char *voice = strdup(tts->voice), *words = strdup(text);
  pid_t child = -1;
  int state = -1, error = 0;
  if (voice != NULL && words != NULL) {
    char *const arguments[] = {program, voice_option, voice, file_option, tts->url, end, words, NULL};
    error = posix_spawnp(&child, program, NULL, NULL, arguments, environ);
    if (error != 0 || waitpid(child, &state, 0) != child) state = -1;
  }
  free(voice);
  free(words);
  if (state != 0)
    snprintf(reason, LIVE_TTS_REASON, "%s",
             error == ENOENT ? "espeak-ng, which makes sound of a text, is not installed (apt install espeak-ng)"
                             : "espeak-ng made no sound of the text; `espeak-ng --voices` lists what --voice may be");
  return state == 0;
}

/* ---- a program of the caller's ----------------------------------------------------------------------------------- */

bool live_tts_pipe(int made[2]) {
  if (pipe(made) != 0) return false;
  for (int i = 0; i < 2; i++) (void)fcntl(made[i], F_SETFD, FD_CLOEXEC);
  return true;
}

/* Starts the program in a process group of its own, with the two descriptors as its standard input and output. Returns
 * an error number. */
static int start(const struct live_tts *tts, int in, int out, pid_t *child) {
  const struct text_list *list = &tts->arguments;
  char *words[TEXT_LIST + 2] = {strdup(tts->program)};
  posix_spawn_file_actions_t actions;
  posix_spawnattr_t attributes;
  sigset_t signals;
  bool whole = words[0] != NULL;
  int error = ENOMEM;
  for (size_t i = 0; i < list->count; i++) whole = (words[1 + i] = strdup(list->text[i])) != NULL && whole;
  (void)sigemptyset(&signals);
  (void)sigaddset(&signals, SIGPIPE);
  (void)posix_spawn_file_actions_init(&actions);
  (void)posix_spawnattr_init(&attributes);
  (void)posix_spawn_file_actions_adddup2(&actions, in, STDIN_FILENO);
  (void)posix_spawn_file_actions_adddup2(&actions, out, STDOUT_FILENO);
  (void)posix_spawnattr_setsigdefault(&attributes, &signals);
  (void)posix_spawnattr_setpgroup(&attributes, 0);
  (void)posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETPGROUP);
  if (whole) error = posix_spawnp(child, tts->program, &actions, &attributes, words, environ);
  (void)posix_spawnattr_destroy(&attributes);
  (void)posix_spawn_file_actions_destroy(&actions);
  for (size_t i = 0; i < 1 + list->count; i++) free(words[i]);
  return error;
}

/* Waits until the program has ended, and kills it and what it started where it takes longer than `seconds`. Returns
 * its exit status, 128 and more for a signal of others, 0 where it was killed. */
static int await_end(pid_t child, double seconds) {
  const double until = session_seconds() + seconds;
  int state = 0;
  pid_t ended = 0;
  while ((ended = waitpid(child, &state, WNOHANG)) == 0 && session_seconds() < until)
    (void)nanosleep(&(struct timespec){.tv_nsec = 5000000}, NULL);
  (void)kill(-child, SIGKILL);
  if (ended == 0) (void)waitpid(child, &state, 0);
  if (ended == 0) return 0;
  return WIFEXITED(state) ? WEXITSTATUS(state) : 128 + WTERMSIG(state);
}

static bool run(struct live_tts *tts, const char *text, char reason[LIVE_TTS_REASON]) {
  int in[2], out[2] = {-1, -1};
  const size_t bytes = strlen(text);
  int error = 0;
  if (!live_tts_pipe(in)) {
    snprintf(reason, LIVE_TTS_REASON, "--tts: no pipe: %s", strerror(errno));
    return false;
  }
  if (!live_tts_pipe(out))
    error = errno;
  else if (write(in[1], text, bytes) != (ssize_t)bytes) /* into the pipe's buffer, 64 KiB */
    error = EMSGSIZE;
  else
    error = start(tts, in[0], out[1], &tts->child);
  for (int i = 0; i < 2; i++) (void)close(in[i]);
  if (out[1] >= 0) (void)close(out[1]);
  tts->file = out[0];
  if (error == 0) {
    snprintf(tts->url, sizeof tts->url, "/dev/fd/%d", tts->file);
    return true;
  }
  tts->child = -1;
  snprintf(reason, LIVE_TTS_REASON, "--tts %.1500s: cannot be started: %s", tts->program, strerror(error));
  return false;
}

/* ---- the others -------------------------------------------------------------------------------------------------- */

bool live_tts_begin(struct live_tts *tts, const char *text, char reason[LIVE_TTS_REASON]) {
  tts->child = -1;
  tts->file = -1;
  return tts->program != NULL ? run(tts, text, reason) : espeak(tts, text, reason);
}

bool live_tts_end(struct live_tts *tts, bool whole, char reason[LIVE_TTS_REASON]) {
  if (tts->file >= 0 && !whole) (void)close(tts->file); /* so that it ends, if it still writes */
  int state = tts->child > 0 ? await_end(tts->child, whole ? grace : short_grace) : 0;
  if (state == 128 + SIGPIPE && !whole) state = 0;
  if (tts->file >= 0 && whole) (void)close(tts->file);
  if (tts->file >= 0 && tts->program == NULL) (void)unlink(tts->url);
  tts->child = tts->file = -1;
  if (state != 0) snprintf(reason, LIVE_TTS_REASON, "--tts %.1500s: ended with exit status %d", tts->program, state);
  return state == 0;
}
