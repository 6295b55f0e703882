/* SPDX-License-Identifier: MIT
 * The server: its connections, and what the program calls. */

#include <arpa/inet.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>

#include "core/interface_version.h"
#include "serve/whep.h"

enum {
  LOOK_MS = 100,
  PIECE_PATIENCE = 3 /* seconds until the next piece of a sound must come */,
  MEMORY = 32768 /* bytes of a connection: the longest head */
};

/* ---- waiting ----------------------------------------------------------------------------------------------------- */

/* Ends connections that stand still before or in a request: libmicrohttpd starts its own time anew with each byte. */
static void end_late(struct ern_http_server *server) {
  const double now = serve_seconds();
  for (struct line_held *line = server->lines; line != NULL; line = line->after)
    if (line->since > 0 && now > line->since + server->options.patience) (void)shutdown(line->descriptor, SHUT_RDWR);
}

/* A piece may take as long as the sound before it is heard. */
static bool piece_comes(const struct ern_http_stream *s) {
  for (const struct request *r = s->server->requests; r != NULL; r = r->after)
    if (r->stream == s && r->descriptor >= 0 && r->id == s->pieces.id) return true;
  return false;
}

static void *keep(void *user) {
  struct ern_http_server *server = user;
  while (!atomic_load(&server->stopping)) {
    (void)nanosleep(&(struct timespec){.tv_nsec = LOOK_MS * 1000000}, NULL);
    serve_lock(server);
    end_late(server);
    for (struct ern_http_stream *s = server->streams; s != NULL; s = s->following)
      if (serve_seconds() > s->pieces.last + PIECE_PATIENCE && !piece_comes(s)) serve_end_pieces(s);
    serve_wake(server, NULL, WAITS_PIPE);
    serve_wake(server, NULL, WAITS_EVENT); /* for their empty lines */
    serve_unlock(server);
  }
  return NULL;
}

/* MHD_NotifyConnectionCallback */
static void note_connection(void *user, struct MHD_Connection *connection, void **context,
                            enum MHD_ConnectionNotificationCode code) {
  struct ern_http_server *server = user;
  struct line_held *line = *context;
  if (code == MHD_CONNECTION_NOTIFY_STARTED) {
    const union MHD_ConnectionInfo *info = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CONNECTION_FD);
    *context = line = calloc(1, sizeof *line);
    if (line == NULL || info == NULL) return;
    line->descriptor = info->connect_fd;
    line->since = serve_seconds();
    serve_lock(server);
    line->after = server->lines;
    if (line->after != NULL) line->after->before = line;
    server->lines = line;
    serve_unlock(server);
    return;
  }
  if (line == NULL) return;
  serve_lock(server);
  if (line->before != NULL)
    line->before->after = line->after;
  else if (server->lines == line)
    server->lines = line->after;
  if (line->after != NULL) line->after->before = line->before;
  serve_unlock(server);
  free(line);
  *context = NULL;
}

/* ---- starting and stopping --------------------------------------------------------------------------------------- */

static bool copy_options(struct ern_http_server *server, const struct ern_http_options *options) {
  const char **texts[] = {&server->options.listen,    &server->options.host,        &server->options.origin,
                          &server->options.say_token, &server->options.watch_token, &server->options.stun};
  server->options = *options;
  for (size_t i = 0; i < sizeof texts / sizeof *texts; i++) {
    if (*texts[i] == NULL) continue;
    server->texts[i] = strdup(*texts[i]);
    if (server->texts[i] == NULL) return false;
    *texts[i] = server->texts[i];
  }
  return true;
}

static bool open_daemon(struct ern_http_server *server) {
  const struct ern_http_options *o = &server->options;
  struct sockaddr_in6 six = {.sin6_family = AF_INET6, .sin6_port = htons((uint16_t)o->port)};
  struct sockaddr_in four = {.sin_family = AF_INET, .sin_port = htons((uint16_t)o->port)};
  const bool is_four = inet_pton(AF_INET, o->listen, &four.sin_addr) == 1;
  if (!is_four && inet_pton(AF_INET6, o->listen, &six.sin6_addr) != 1) {
    errno = EADDRNOTAVAIL;
    return false;
  }
  const unsigned flags =
      MHD_USE_INTERNAL_POLLING_THREAD | MHD_USE_EPOLL | MHD_ALLOW_SUSPEND_RESUME | (is_four ? 0 : MHD_USE_IPv6);
  const struct sockaddr *address = is_four ? (const struct sockaddr *)&four : (const struct sockaddr *)&six;
  errno = 0;
  server->daemon = MHD_start_daemon(flags, (uint16_t)o->port, NULL, NULL, request_handle, server, MHD_OPTION_SOCK_ADDR,
                                    address, MHD_OPTION_CONNECTION_LIMIT, o->connections, MHD_OPTION_CONNECTION_TIMEOUT,
                                    (unsigned)(o->patience + 0.5), MHD_OPTION_CONNECTION_MEMORY_LIMIT, (size_t)MEMORY,
                                    MHD_OPTION_NOTIFY_COMPLETED, request_end, server, MHD_OPTION_NOTIFY_CONNECTION,
                                    note_connection, server, MHD_OPTION_END);
  return server->daemon != NULL;
}

static void stop(struct ern_http_server **gone) {
  struct ern_http_server *server = *gone;
  if (server == NULL) return;
  serve_lock(server);
  atomic_store(&server->stopping, true);
  for (enum waits waits = WAITS_PART; waits <= WAITS_PIPE; waits++) serve_wake(server, NULL, waits);
  serve_unlock(server);
  if (server->keeps) (void)pthread_join(server->keeper, NULL);
  whep_close(server);
  if (server->daemon != NULL) MHD_stop_daemon(server->daemon);
  for (size_t i = 0; i < sizeof server->texts / sizeof *server->texts; i++) free(server->texts[i]);
  (void)pthread_mutex_destroy(&server->mutex);
  free(server);
  *gone = NULL;
}

static bool start(const struct ern_http_options *options, struct ern_http_server **server, char *error, size_t bytes) {
  struct ern_http_server *made = calloc(1, sizeof *made);
  *server = NULL;
  if (made != NULL) made->version = ern_http_functions.version;
  if (made != NULL) (void)pthread_mutex_init(&made->mutex, NULL);
  if (made == NULL || !copy_options(made, options)) {
    snprintf(error, bytes, "no memory for a server");
  } else if (!open_daemon(made)) {
    snprintf(error, bytes, "%s: port %d: cannot listen: %s", options->listen, options->port,
             errno != 0 ? strerror(errno) : "libmicrohttpd gives no reason");
  } else if (pthread_create(&made->keeper, NULL, keep, made) != 0) {
    snprintf(error, bytes, "cannot start a thread of the server");
  } else {
    made->keeps = true;
    *server = made;
    return true;
  }
  stop(&made);
  return false;
}

static int port(const struct ern_http_server *server) {
  const union MHD_DaemonInfo *info = MHD_get_daemon_info(server->daemon, MHD_DAEMON_INFO_BIND_PORT);
  return info != NULL ? info->port : 0;
}

/* ---- streams ----------------------------------------------------------------------------------------------------- */

static struct ern_http_stream *add(struct ern_http_server *server, const char *id,
                                   const struct ern_http_actions *actions, void *user) {
  struct ern_http_stream *s = calloc(1, sizeof *s);
  if (s == NULL) return NULL;
  s->server = server;
  snprintf(s->id, sizeof s->id, "%s", id);
  s->actions = actions;
  s->user = user;
  s->users = 1;
  s->pieces.descriptor = -1;
  serve_lock(server);
  struct ern_http_stream **last = &server->streams;
  while (*last != NULL) last = &(*last)->following;
  *last = s;
  serve_unlock(server);
  return s;
}

static void end_stream(struct ern_http_stream **stream) {
  struct ern_http_stream *s = *stream;
  if (s == NULL) return;
  struct ern_http_server *server = s->server;
  serve_lock(server);
  for (struct ern_http_stream **at = &server->streams; *at != NULL; at = &(*at)->following)
    if (*at == s) {
      *at = s->following;
      break;
    }
  s->removed = s->broadcast.ended = true;
  while (s->acts) { /* briefly: no action waits */
    serve_unlock(server);
    (void)nanosleep(&(struct timespec){.tv_nsec = 1000000}, NULL);
    serve_lock(server);
  }
  serve_wake(server, s, WAITS_PART);
  serve_wake(server, s, WAITS_EVENT);
  serve_wake(server, s, WAITS_PIPE);
  serve_end_pieces(s);
  whep_remove(s);
  serve_release(s);
  serve_unlock(server);
  *stream = NULL;
}

static int write_stream(void *stream, const void *bytes, size_t count, ern_stream_piece piece) {
  struct ern_http_stream *s = stream;
  serve_lock(s->server);
  const int failed = broadcast_write(&s->broadcast, bytes, count, piece);
  if (piece != ERN_STREAM_MORE) serve_wake(s->server, s, WAITS_PART);
  serve_unlock(s->server);
  if (failed == 0 && piece != ERN_STREAM_MORE) whep_picture(s, piece);
  return failed;
}

static ptrdiff_t read_stream(struct ern_http_stream *s, struct ern_http_place *place, void *to, size_t most) {
  serve_lock(s->server);
  const ptrdiff_t count = broadcast_read(&s->broadcast, place, to, most);
  serve_unlock(s->server);
  return count;
}

static void tell(struct ern_http_stream *s, const char *word, unsigned id, double seconds, const char *reason) {
  serve_lock(s->server);
  serve_tell(s, word, id, seconds, reason);
  serve_unlock(s->server);
}

static void set_state(struct ern_http_stream *s, const char *json) {
  char *copy = strdup(json);
  serve_lock(s->server);
  free(s->state);
  s->state = copy;
  serve_unlock(s->server);
}

static void answer(void *token, const char *text) {
  struct request *r = token;
  struct ern_http_server *server = r->server;
  serve_lock(server);
  r->answered = true;
  snprintf(r->answer, sizeof r->answer, "%s", text);
  if (r->waits == WAITS_ANSWER) {
    r->waits = WAITS_NOT;
    MHD_resume_connection(r->connection);
  }
  serve_unlock(server);
}

const struct ern_http_functions ern_http_functions = {.version = ERN_INTERFACE_VERSION,
                                                      .start = start,
                                                      .port = port,
                                                      .stop = stop,
                                                      .add = add,
                                                      .remove = end_stream,
                                                      .write = write_stream,
                                                      .read = read_stream,
                                                      .sound = whep_sound,
                                                      .event = tell,
                                                      .state = set_state,
                                                      .answer = answer};
