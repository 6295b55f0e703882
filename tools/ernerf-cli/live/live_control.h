/* SPDX-License-Identifier: MIT
 * Lines that steer a live person, from standard input or a local socket: a thread of its own reads them and hands them
 * over one by one, and the answer goes back where the line came from. */
#ifndef ERN_CLI_LIVE_CONTROL_H
#define ERN_CLI_LIVE_CONTROL_H

#include <pthread.h>

#include "session/session.h"

enum { LIVE_LINE = 4096 };

struct live_control {
  /* from the command line */
  const char *path; /* "-": standard input; a socket's name; NULL: none */
  /* made */
  struct session *session;
  pthread_t thread;
  pthread_mutex_t mutex;
  pthread_cond_t moved;
  bool running, made;
  bool stop;            /* with the mutex, as the next ones */
  bool has_line;        /* `line` waits to be taken, or to be answered */
  bool taken, answered; /* it was */
  char line[LIVE_LINE], answer[LIVE_LINE];
  int listening; /* descriptor of the socket; -1 */
};

/* Makes the socket (a name where there is a file is refused, a socket that nobody listens to is replaced) and starts
 * the thread. Returns 0, or EXIT_FAILURE after a message. */
int live_control_start(struct live_control *control, struct session *session);
/* The next line, without its end; NULL: none waits. It is to be answered before the next one is asked for. */
const char *live_control_line(struct live_control *control);
/* A line, without its end. */
void live_control_answer(struct live_control *control, const char *text);
void live_control_stop(struct live_control *control); /* wherever it stands */

#endif
