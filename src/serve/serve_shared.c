/* SPDX-License-Identifier: MIT */
#include "serve/serve_shared.h"

#include <stdlib.h>
#include <time.h>
#include <unistd.h>

double serve_seconds(void) {
  struct timespec now;
  (void)clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

void serve_lock(struct ern_http_server *server) { (void)pthread_mutex_lock(&server->mutex); }
void serve_unlock(struct ern_http_server *server) { (void)pthread_mutex_unlock(&server->mutex); }

bool serve_wait(struct request *r, enum waits waits) {
  if (atomic_load(&r->server->stopping)) return false;
  r->waits = waits;
  MHD_suspend_connection(r->connection);
  return true;
}

void serve_wake(struct ern_http_server *server, const struct ern_http_stream *stream, enum waits waits) {
  for (struct request *r = server->requests; r != NULL; r = r->after) {
    if (r->waits != waits || (stream != NULL && r->stream != stream)) continue;
    r->waits = WAITS_NOT;
    MHD_resume_connection(r->connection);
  }
}

bool serve_enter(struct ern_http_stream *s) {
  serve_lock(s->server);
  const bool enters = !s->removed;
  s->acts = enters;
  serve_unlock(s->server);
  return enters;
}

void serve_leave(struct ern_http_stream *s) {
  serve_lock(s->server);
  s->acts = false;
  serve_unlock(s->server);
}

void serve_end_pieces(struct ern_http_stream *s) {
  if (s->pieces.descriptor >= 0) (void)close(s->pieces.descriptor);
  s->pieces.descriptor = -1;
}

void serve_release(struct ern_http_stream *s) {
  if (--s->users > 0) return;
  broadcast_free(&s->broadcast);
  events_free(&s->events);
  serve_end_pieces(s);
  free(s->state);
  free(s);
}

void serve_tell(struct ern_http_stream *s, const char *word, unsigned id, double seconds, const char *reason) {
  json_t *why = reason != NULL ? json_string(reason) : NULL; /* left out where it is no UTF-8, as a name of a file */
  json_t *data = json_pack("{s:s, s:I, s:o*, s:o*}", "session", s->id, "id", (json_int_t)id, "seconds",
                           seconds >= 0 ? json_real(seconds) : NULL, "reason", why);
  char *line = data != NULL ? json_dumps(data, JSON_COMPACT | JSON_REAL_PRECISION(9)) : NULL;
  if (line != NULL) {
    events_add(&s->events, word, line);
    serve_wake(s->server, s, WAITS_EVENT);
  }
  free(line);
  json_decref(data);
}
