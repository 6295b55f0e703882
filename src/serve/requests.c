/* SPDX-License-Identifier: MIT
 * A request from its head to its end: its guard, its body, and what it holds. */
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "serve/whep.h"

enum { MOST_THROWN_AWAY = 1 << 20 /* bytes of a body that is too long, before the connection is closed */ };

static struct line_held *line_of(struct MHD_Connection *connection) {
  const union MHD_ConnectionInfo *info = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_SOCKET_CONTEXT);
  return info != NULL ? info->socket_context : NULL;
}

/* From now on (waits), or no longer, the rest of the request must come soon. */
static void set_deadline(struct ern_http_server *server, struct MHD_Connection *connection, bool waits) {
  struct line_held *line = line_of(connection);
  if (line == NULL) return;
  serve_lock(server);
  line->since = waits ? serve_seconds() : 0;
  serve_unlock(server);
}

/* ---- the head ---------------------------------------------------------------------------------------------------- */

static struct request *make(struct ern_http_server *server, struct MHD_Connection *connection) {
  struct request *r = calloc(1, sizeof *r);
  if (r == NULL) return NULL;
  r->server = server;
  r->connection = connection;
  r->descriptor = -1;
  r->spoken = serve_seconds();
  serve_lock(server);
  server->asked++;
  r->after = server->requests;
  if (r->after != NULL) r->after->before = r;
  server->requests = r;
  serve_unlock(server);
  return r;
}

static enum MHD_Result answer_options(struct request *r, const char *url) {
  unsigned status = 0;
  char methods[64];
  const char *why = guard_refusal(r->server, r->connection, ROLE_ANY, false, &status);
  if (why != NULL) return answer_error(r, status, why);
  route_methods(url, methods, sizeof methods);
  return methods[0] != 0 ? answer_methods(r, methods) : answer_error(r, MHD_HTTP_NOT_FOUND, "there is no such path");
}

/* Guards come first, so that nobody learns which sessions there are. */
static enum MHD_Result begin(struct request *r, const char *url, const char *method) {
  unsigned status = 0, guarded = 0;
  if (strcmp(method, MHD_HTTP_METHOD_OPTIONS) == 0) return answer_options(r, url);
  const char *lost = route_find(r, url, method, &status);
  const enum role role = r->route != NULL ? r->route->role : ROLE_WATCH;
  const char *why = guard_refusal(r->server, r->connection, role, strcmp(url, "/") == 0, &guarded);
  if (why != NULL) return answer_error(r, guarded, why);
  if (lost != NULL) return answer_error(r, status, lost);
  if (r->route->begin != NULL) {
    const enum MHD_Result done = r->route->begin(r);
    if (done != MHD_YES || r->route->end == NULL || r->answered) return done;
  }
  const char *length = MHD_lookup_connection_value(r->connection, MHD_HEADER_KIND, "Content-Length");
  if (r->descriptor < 0 && length != NULL && strtoull(length, NULL, 10) > r->most)
    return answer_error(r, MHD_HTTP_CONTENT_TOO_LARGE, "the body is too long");
  return MHD_YES;
}

/* ---- the body ---------------------------------------------------------------------------------------------------- */

static enum MHD_Result keep(struct request *r, const char *bytes, size_t *count) {
  const size_t most = r->most;
  if (r->count + *count > most) { /* it is answered at its end */
    r->thrown += *count;
    *count = 0;
    return r->thrown <= MOST_THROWN_AWAY ? MHD_YES : MHD_NO;
  }
  if (r->count + *count >= r->room) {
    const size_t room = 2 * (r->count + *count) + 256;
    char *more = realloc(r->body, room);
    if (more == NULL) return MHD_NO;
    r->body = more;
    r->room = room;
  }
  memcpy(r->body + r->count, bytes, *count);
  r->count += *count;
  r->body[r->count] = 0;
  *count = 0;
  return MHD_YES;
}

/* Writes sound into its pipe; what does not fit waits until the reader has made room. */
static enum MHD_Result pour(struct request *r, const char *bytes, size_t *count) {
  while (*count > 0 && !r->cut) {
    const ssize_t put = write(r->descriptor, bytes, *count);
    if (put > 0) {
      bytes += put;
      *count -= (size_t)put;
    } else if (errno == EAGAIN) {
      serve_lock(r->server);
      const bool waits = serve_wait(r, WAITS_PIPE);
      serve_unlock(r->server);
      return waits ? MHD_YES : MHD_NO;
    } else if (errno != EINTR) {
      r->cut = true; /* it was stopped */
    }
  }
  *count = 0;
  return MHD_YES;
}

enum MHD_Result request_handle(void *user, struct MHD_Connection *connection, const char *url, const char *method,
                               const char *version, const char *bytes, size_t *count, void **request) {
  struct ern_http_server *server = user;
  struct request *r = *request;
  (void)version;
  if (r == NULL) {
    *request = r = make(server, connection);
    if (r == NULL) return MHD_NO;
    const enum MHD_Result done = begin(r, url, method);
    const bool comes = done == MHD_YES && r->route != NULL && r->route->end != NULL && r->descriptor < 0;
    set_deadline(server, connection, comes);
    return done;
  }
  if (*count > 0) return r->descriptor >= 0 ? pour(r, bytes, count) : keep(r, bytes, count);
  set_deadline(server, connection, false);
  if (r->thrown > 0) return answer_error(r, MHD_HTTP_CONTENT_TOO_LARGE, "the body is too long");
  return r->route != NULL && r->route->end != NULL ? r->route->end(r) : MHD_NO;
}

void request_end(void *user, struct MHD_Connection *connection, void **request, enum MHD_RequestTerminationCode why) {
  struct ern_http_server *server = user;
  struct request *r = *request;
  (void)why;
  *request = NULL;
  if (r == NULL) return;
  set_deadline(server, connection, true);
  serve_lock(server);
  if (r->descriptor >= 0) (void)close(r->descriptor);
  if (r->descriptor >= 0 && r->id == r->stream->pieces.id) {
    r->stream->pieces.last = serve_seconds();
    if (r->last || r->cut) serve_end_pieces(r->stream);
  }
  if (r->before != NULL)
    r->before->after = r->after;
  else
    server->requests = r->after;
  if (r->after != NULL) r->after->before = r->before;
  whep_forget(r);
  if (r->watches) {
    server->viewers--;
    r->stream->viewers--;
  }
  if (r->stream != NULL) serve_release(r->stream);
  serve_unlock(server);
  free(r->body);
  free(r->text);
  free(r);
}
