/* SPDX-License-Identifier: MIT
 * Control commands of `ernerf live`, one a line, from standard input or a local (Unix) socket. A separate thread reads
 * them and passes them on one by one; the answer goes back to the sender. */
#ifndef ERN_CLI_LIVE_CONTROL_H
#define ERN_CLI_LIVE_CONTROL_H

#include <pthread.h>
#include <sys/stat.h>

#include "session/session.h"

enum { LIVE_LINE = 4096 };

/* Another source of lines than standard input or a socket. All is called on the drawing thread. */
struct live_front {
  const char *(*line)(void *user);              /* as live_control_line; called before each frame */
  void (*answer)(void *user, const char *text); /* as live_control_answer */
  /* word: "started", "ended" or "failed"; why: it failed, NULL: not said */
  void (*event)(void *user, const char *word, unsigned id, const char *why);
  void *user;
};

struct live_control {
  const struct live_front *front; /* set by the verb; NULL: as `path` says */
  /* from the command line */
  const char *path; /* "-": standard input; path of a socket; NULL: none */
  /* made */
  struct session *session;
  pthread_t thread;
  pthread_mutex_t mutex;
  pthread_cond_t moved;
  bool running, made;
  bool stop;            /* guarded by the mutex, as are the next members */
  bool idle;            /* the thread has found nothing to read */
  bool has_line;        /* `line` waits to be taken, or for its answer */
  bool taken, answered; /* the state of `line` */
  char line[LIVE_LINE];
  int client;         /* descriptor that lines are written to; -1: none */
  int listening;      /* descriptor of the listening socket; -1: none */
  struct stat socket; /* its file; all zeros: not made */
};

/* Creates the socket and starts the thread. A path with another file, or with a socket in use, is refused; a stale
 * socket is replaced. Returns 0, or EXIT_FAILURE after a message. */
int live_control_start(struct live_control *control, struct session *session);
/* The next line, without its newline; NULL: none waits, of those that have come in. The caller must answer it before it
 * requests the next one. */
const char *live_control_line(struct live_control *control);
/* text: one line, without its newline. */
void live_control_answer(struct live_control *control, const char *text);
/* Whether anybody may ask. */
bool live_control_hears(const struct live_control *control);
/* Tells the client, if there is one, what became of an utterance (struct live_front). */
void live_control_event(struct live_control *control, const char *word, unsigned id, const char *why);
void live_control_stop(struct live_control *control); /* in any state */

#endif
