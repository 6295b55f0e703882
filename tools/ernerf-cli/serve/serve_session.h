/* SPDX-License-Identifier: MIT
 * A session of `ernerf serve`: a live portrait whose lines come from the server's requests, and whose frames go to its
 * viewers. It has a thread that draws. */
#ifndef ERN_CLI_SERVE_SESSION_H
#define ERN_CLI_SERVE_SESSION_H

#include "live/live_job.h"
#include "serve/http_server.h"
#include "serve/push.h"
#include "serve/recording.h"

enum { SERVE_ID = 64, SERVE_LINES = 8 };

/* A line that waits for the drawing thread. */
struct serve_line {
  char text[128];
  void *bytes; /* of a picture; NULL: none */
  size_t count;
  void *token;
};

struct serve_session {
  char id[SERVE_ID];
  struct rate_control *measured; /* set by the caller: gets the settings and times that were found; NULL: none */
  double opened;                 /* by session_seconds */
  struct live_job job;
  const struct ern_http_functions *http;
  struct ern_http_stream *stream;
  struct live_front front;
  struct recording recording; /* the writing thread's */
  struct push pushes[TEXT_LIST];
  size_t push_count;
  pthread_t thread;
  pthread_mutex_t mutex; /* guards `lines`, line_count and `ended` */
  struct serve_line lines[SERVE_LINES];
  size_t line_count;
  bool made, running, ended;
  atomic_bool ends;          /* the thread is to end */
  atomic_bool over;          /* the thread is about to return */
  int status;                /* of the thread */
  char failed[SESSION_HELD]; /* its message */
  /* the drawing thread's */
  struct serve_line now; /* that is being answered; token NULL: none */
  char line[4352];       /* its text, or the one with the name of a file for its bytes */
  char file[4096];       /* that file; "": none */
  uint64_t looks;        /* frames so far */
};

/* record: a folder for recordings, or NULL; push: addresses that get the stream, or NULL. Opens the portrait of
 * `session->job`, which is set up as the options say; adds the session to the server, and starts its thread. Returns 0,
 * or EXIT_FAILURE after a message; serve_session_close in either case. */
int serve_session_open(struct serve_session *session, const struct args *args, const struct ern_http_functions *http,
                       struct ern_http_server *server, const char *record, const struct text_list *push);
/* Seconds of processor time that coding has taken; below 0: the session is ending. */
double serve_session_coding(struct serve_session *session);
/* Asks the thread to end; serve_session_close then waits for it. */
void serve_session_stop(struct serve_session *session);
/* Ends the thread and the streams of the viewers. In any state. */
void serve_session_close(struct serve_session *session);

#endif
