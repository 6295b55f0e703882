/* SPDX-License-Identifier: MIT
 * --push: a session's stream to an address too, on a thread of its own. What becomes of it does not touch the viewers.
 */
#ifndef ERN_CLI_SERVE_PUSH_H
#define ERN_CLI_SERVE_PUSH_H

#include <jansson.h>
#include <pthread.h>
#include <stdatomic.h>

#include "serve/http_server.h"
#include "session/session.h"

enum { PUSH_REASON = 512 };

struct push {
  const char *url;
  char shown[256]; /* the address without what may be secret: "rtmp://HOST/..." */
  struct session *session;
  ern_context *context; /* of the thread, for its errors */
  const struct ern_http_functions *http;
  struct ern_http_stream *stream;
  struct ern_http_place place; /* the thread's */
  pthread_t thread;
  bool runs;
  atomic_bool ends, connected;
  pthread_mutex_t mutex;    /* guards the others */
  unsigned failures;        /* in a row */
  char failed[PUSH_REASON]; /* why the last one was; "": none was */
};

/* Whether it is an address that a stream can be pushed to. */
bool push_takes(const char *url);
/* Starts it; `push` is zeroed. Returns 0, or EXIT_FAILURE after a message. */
int push_open(struct push *push, struct session *session, const char *url, const struct ern_http_functions *http,
              struct ern_http_stream *stream);
/* {"to": ADDRESS, "connected": BOOL, "failures": N, "error": REASON or null}; NULL without memory. */
json_t *push_state(struct push *push);
void push_close(struct push *push); /* accepts a zeroed one */

#endif
