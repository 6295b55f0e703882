/* SPDX-License-Identifier: MIT */
#include "live/live_control.h"

#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

enum { LOOK_MS = 100, HANDOVER_MS = 20 /* wait for the thread, which may be between two lines */ };

/* Returns false where the program ends. */
static bool set_idle(struct live_control *control, bool idle) {
  (void)pthread_mutex_lock(&control->mutex);
  const bool stop = control->stop;
  control->idle = idle;
  if (idle) (void)pthread_cond_broadcast(&control->moved);
  (void)pthread_mutex_unlock(&control->mutex);
  return !stop;
}

/* Waits until the descriptor is readable; false: the program ends. */
static bool await_input(struct live_control *control, int descriptor) {
  for (int wait = 0; set_idle(control, wait > 0); wait = LOOK_MS) {
    struct pollfd look = {.fd = descriptor, .events = POLLIN};
    const int ready = poll(&look, 1, wait);
    if (ready > 0) return set_idle(control, false);
    if (ready < 0 && errno != EINTR) return false;
  }
  return false;
}

/* Writes a line. A peer that has disconnected does not end the stream. The caller holds the lock. */
static void tell(struct live_control *control, const char *text) {
  char line[LIVE_LINE];
  snprintf(line, sizeof line, "%.*s\n", LIVE_LINE - 2, text);
  if (control->listening < 0)
    (void)fputs(line, stderr);
  else if (control->client >= 0)
    (void)send(control->client, line, strlen(line), MSG_NOSIGNAL | MSG_DONTWAIT);
}

/* Writes a line that is no answer to the client, if there is one. */
static void tell_client(struct live_control *control, const char *text) {
  (void)pthread_mutex_lock(&control->mutex);
  tell(control, text);
  (void)pthread_mutex_unlock(&control->mutex);
}

/* Passes a line to the main thread and waits until it has answered; false: the program ends. */
static bool exchange(struct live_control *control, const char *line) {
  (void)pthread_mutex_lock(&control->mutex);
  snprintf(control->line, sizeof control->line, "%s", line);
  control->has_line = true;
  control->taken = control->answered = false;
  (void)pthread_cond_broadcast(&control->moved);
  while (!control->answered && !control->stop) (void)pthread_cond_wait(&control->moved, &control->mutex);
  const bool answered = control->answered;
  control->has_line = false;
  (void)pthread_mutex_unlock(&control->mutex);
  return answered;
}

/* Reads lines until the end of the input. Of a line that is too long, only the first LIVE_LINE - 1 bytes are kept, and
 * it is refused. */
static void read_lines(struct live_control *control, int descriptor) {
  char line[LIVE_LINE], piece[512];
  size_t length = 0;
  bool too_long = false, has_zero = false;
  while (await_input(control, descriptor)) {
    const ssize_t got = read(descriptor, piece, sizeof piece);
    if (got <= 0 && !(got < 0 && errno == EINTR)) return;
    for (ssize_t i = 0; i < got; i++) {
      if (piece[i] != '\n') {
        if (length + 1 < sizeof line) line[length++] = piece[i];
        too_long |= length + 1 == sizeof line;
        has_zero |= piece[i] == 0;
        continue;
      }
      if (length > 0 && line[length - 1] == '\r') length--;
      line[length] = 0;
      length = 0;
      if (too_long) {
        char refusal[64];
        snprintf(refusal, sizeof refusal, "error: the line is longer than %d bytes", LIVE_LINE - 2);
        tell_client(control, refusal);
      } else if (has_zero) {
        tell_client(control, "error: the line has a byte of 0");
      } else if (line[0] != 0 && !exchange(control, line)) {
        return;
      }
      too_long = has_zero = false;
    }
  }
}

static void set_client(struct live_control *control, int client) {
  (void)pthread_mutex_lock(&control->mutex);
  control->client = client;
  (void)pthread_mutex_unlock(&control->mutex);
}

static void *read_control(void *user) {
  struct live_control *control = user;
  if (control->listening < 0) read_lines(control, STDIN_FILENO);
  while (control->listening >= 0 && await_input(control, control->listening)) {
    const int client = accept(control->listening, NULL, NULL);
    if (client < 0) continue;
    set_client(control, client);
    read_lines(control, client);
    set_client(control, -1);
    (void)close(client);
  }
  (void)set_idle(control, true);
  return NULL;
}

/* ---- the others -------------------------------------------------------------------------------------------------- */

/* Removes the socket of a killed process at `name`. Any other file there, also a socket of another type (connect:
 * EPROTOTYPE) and one whose owner does not answer, is refused. */
static int remove_stale(const struct live_control *control, const struct sockaddr_un *name) {
  struct session *session = control->session;
  struct stat there;
  if (lstat(control->path, &there) != 0) return 0;
  if (!S_ISSOCK(there.st_mode))
    return session_fail_with(session, "--control %s: is there already and is no socket, expected a new name",
                             control->path);
  const int probe = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (probe < 0) return session_fail_with(session, "--control: %s", strerror(errno));
  const bool answers = connect(probe, (const struct sockaddr *)name, sizeof *name) == 0;
  const int error = answers ? 0 : errno;
  (void)close(probe);
  if (answers || error == EAGAIN)
    return session_fail_with(session, "--control %s: another program listens there", control->path);
  if (error != ECONNREFUSED)
    return session_fail_with(session,
                             "--control %s: a socket that this program did not make is there (%s), expected "
                             "a new name",
                             control->path, strerror(error));
  if (unlink(control->path) != 0 && errno != ENOENT)
    return session_fail_with(session, "--control %s: a stale socket cannot be removed: %s", control->path,
                             strerror(errno));
  return 0;
}

static int open_socket(struct live_control *control) {
  struct session *session = control->session;
  struct sockaddr_un address = {.sun_family = AF_UNIX};
  if (strlen(control->path) >= sizeof address.sun_path)
    return session_fail_with(session, "--control %s: the name has %zu bytes, expected %zu at most", control->path,
                             strlen(control->path), sizeof address.sun_path - 1);
  memcpy(address.sun_path, control->path, strlen(control->path) + 1);
  if (remove_stale(control, &address) != 0) return EXIT_FAILURE;
  control->listening = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (control->listening < 0) return session_fail_with(session, "--control: %s", strerror(errno));
  if (bind(control->listening, (const struct sockaddr *)&address, sizeof address) != 0 ||
      lstat(control->path, &control->socket) != 0 || listen(control->listening, 4) != 0)
    return session_fail_with(session, "--control %s: %s", control->path, strerror(errno));
  return 0;
}

int live_control_start(struct live_control *control, struct session *session) {
  control->session = session;
  control->listening = control->client = -1;
  if (control->path == NULL) return 0;
  (void)pthread_mutex_init(&control->mutex, NULL); /* neither fails on Linux */
  (void)pthread_cond_init(&control->moved, NULL);
  control->made = true;
  if (strcmp(control->path, "-") != 0 && open_socket(control) != 0) return EXIT_FAILURE;
  if (pthread_create(&control->thread, NULL, read_control, control) != 0)
    return session_fail_with(session, "cannot start a thread that reads --control");
  control->running = true;
  return 0;
}

const char *live_control_line(struct live_control *control) {
  if (control->front != NULL) return control->front->line(control->front->user);
  if (!control->running) return NULL;
  struct timespec until;
  (void)clock_gettime(CLOCK_REALTIME, &until);
  until.tv_nsec += 1000000L * HANDOVER_MS;
  until.tv_sec += until.tv_nsec / 1000000000;
  until.tv_nsec %= 1000000000;
  (void)pthread_mutex_lock(&control->mutex);
  for (int error = 0; !(control->has_line && !control->taken) && !control->idle && error == 0;)
    error = pthread_cond_timedwait(&control->moved, &control->mutex, &until);
  const bool waits = control->has_line && !control->taken;
  control->taken = control->taken || waits;
  (void)pthread_mutex_unlock(&control->mutex);
  return waits ? control->line : NULL;
}

void live_control_answer(struct live_control *control, const char *text) {
  if (control->front != NULL) {
    control->front->answer(control->front->user, text);
    return;
  }
  (void)pthread_mutex_lock(&control->mutex);
  tell(control, text);
  control->answered = true;
  (void)pthread_cond_broadcast(&control->moved);
  (void)pthread_mutex_unlock(&control->mutex);
}

bool live_control_hears(const struct live_control *control) { return control->path != NULL || control->front != NULL; }

void live_control_event(struct live_control *control, const char *word, unsigned id, const char *why) {
  char text[64];
  if (control->front != NULL) {
    control->front->event(control->front->user, word, id, why);
    return;
  }
  snprintf(text, sizeof text, "%s %u", word, id);
  tell_client(control, text);
}

void live_control_stop(struct live_control *control) {
  if (control->running) {
    (void)pthread_mutex_lock(&control->mutex);
    control->stop = true;
    (void)pthread_cond_broadcast(&control->moved);
    (void)pthread_mutex_unlock(&control->mutex);
    (void)pthread_join(control->thread, NULL);
    control->running = false;
  }
  if (!control->made) return;
  if (control->listening >= 0) {
    struct stat there;
    (void)close(control->listening);
    if (lstat(control->path, &there) == 0 && there.st_ino == control->socket.st_ino &&
        there.st_dev == control->socket.st_dev && S_ISSOCK(control->socket.st_mode))
      (void)unlink(control->path);
  }
  (void)pthread_mutex_destroy(&control->mutex);
  (void)pthread_cond_destroy(&control->moved);
  control->made = false;
}
