/* SPDX-License-Identifier: MIT */
#include "media/live/http_listener.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "core/memory.h"

enum {
  MOST_REQUESTS = 8, /* that are being received; a new one then takes the place of the oldest */
  HEAD_BYTES = 8192,
  HOST_BYTES = 256,
  LOOK_MS = 100,
  HEAD_MS = 5000,     /* to send a request */
  PATIENCE_MS = 30000 /* of a viewer who takes no byte of the stream, so that others are served */
};

struct request {
  int descriptor; /* -1: none */
  size_t count;
  int64_t began; /* milliseconds */
  char head[HEAD_BYTES];
};

struct listener {
  ern_context *context;
  const char *url;
  char host[HOST_BYTES], port[8]; /* of the url; "": any address */
  int descriptor;
  struct request requests[MOST_REQUESTS];
};

static int64_t milliseconds(void) {
  struct timespec now;
  (void)clock_gettime(CLOCK_MONOTONIC, &now);
  return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* ---- the request ------------------------------------------------------------------------------------------------- */

/* Copies the host of "HOST", "HOST:PORT" or "[IPV6]:PORT". Returns what follows it; NULL: it is too long. */
static const char *split_host(const char *from, size_t length, char host[HOST_BYTES]) {
  const bool bracket = length > 0 && from[0] == '[';
  const char *end = memchr(from, bracket ? ']' : ':', length);
  const size_t first = bracket ? 1 : 0, bytes = (end != NULL ? (size_t)(end - from) : length) - first;
  if ((bracket && end == NULL) || bytes >= HOST_BYTES) return NULL;
  snprintf(host, HOST_BYTES, "%.*s", (int)bytes, from + first);
  return end == NULL ? from + length : end + first;
}

/* Copies the value of a header field. Returns how many fields have that name; -1: a value is too long. */
static int find_field(const char *head, const char *name, char value[HOST_BYTES]) {
  const size_t length = strlen(name);
  int count = 0;
  for (const char *line = strchr(head, '\n'); line != NULL; line = strchr(line, '\n')) {
    line++;
    if (strncasecmp(line, name, length) != 0 || line[length] != ':') continue;
    const char *from = line + length + 1 + strspn(line + length + 1, " \t");
    const size_t bytes = strcspn(from, " \t\r\n");
    if (bytes >= HOST_BYTES) return -1;
    snprintf(value, HOST_BYTES, "%.*s", (int)bytes, from);
    count++;
  }
  return count;
}

static bool is_own_host(const struct listener *l, const char *field) {
  char host[HOST_BYTES];
  struct in6_addr address;
  if (split_host(field, strlen(field), host) == NULL || host[0] == 0) return false;
  return inet_pton(AF_INET, host, &address) == 1 || inet_pton(AF_INET6, host, &address) == 1 ||
         strcasecmp(host, "localhost") == 0 || strcasecmp(host, l->host) == 0;
}

/* The status line's rest that a request is refused with; NULL: it is admitted. */
static const char *refusal(const struct listener *l, const char *head) {
  char host[HOST_BYTES], origin[HOST_BYTES];
  if (strncmp(head, "GET ", 4) != 0) return "405 Method Not Allowed";
  if (find_field(head, "Host", host) != 1) return "400 Bad Request";
  if (!is_own_host(l, host)) return "403 Forbidden";
  const int origins = find_field(head, "Origin", origin);
  if (origins == 0) return NULL;
  const bool same = origins == 1 && strncasecmp(origin, "http://", 7) == 0 && strcasecmp(origin + 7, host) == 0;
  return same ? NULL : "403 Forbidden";
}

/* ---- connections ------------------------------------------------------------------------------------------------- */

static void forget(struct request *request) {
  if (request->descriptor >= 0) (void)close(request->descriptor);
  request->descriptor = -1;
}

static void refuse(struct request *request, const char *status) {
  char answer[512];
  const int bytes =
      snprintf(answer, sizeof answer,
               "HTTP/1.1 %s\r\nContent-Type: text/plain\r\nConnection: close\r\n\r\n"
               "%s: expected a GET request, with an IP address, localhost or the name of the server as Host\r\n",
               status, status);
  (void)send(request->descriptor, answer, (size_t)bytes, MSG_NOSIGNAL);
  forget(request);
}

static bool welcome(struct request *request, const char *content_type) {
  char answer[256];
  const int bytes = snprintf(answer, sizeof answer,
                             "HTTP/1.1 200 OK\r\nContent-Type: %s\r\nCache-Control: no-store\r\n"
                             "X-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n",
                             content_type);
  return send(request->descriptor, answer, (size_t)bytes, MSG_NOSIGNAL) == bytes; /* the first bytes: there is space */
}

static void take_connection(struct listener *l) {
  const int made = accept(l->descriptor, NULL, NULL);
  struct request *place = &l->requests[0];
  if (made < 0) return;
  if (fcntl(made, F_SETFD, FD_CLOEXEC) != 0 || fcntl(made, F_SETFL, O_NONBLOCK) != 0) {
    (void)close(made);
    return;
  }
  for (size_t i = 1; i < MOST_REQUESTS && place->descriptor >= 0; i++)
    if (l->requests[i].descriptor < 0 || l->requests[i].began < place->began) place = &l->requests[i];
  forget(place);
  place->descriptor = made;
  place->count = 0;
  place->began = milliseconds();
}

/* Receives more of a request's head. True: it is whole and admitted. */
static bool receive(struct listener *l, struct request *request) {
  char *end = request->head + request->count;
  const ssize_t got = recv(request->descriptor, end, sizeof request->head - 1 - request->count, 0);
  if (got < 0 && (errno == EAGAIN || errno == EINTR)) return false;
  if (got <= 0 || memchr(end, 0, (size_t)got) != NULL) {
    forget(request);
    return false;
  }
  request->count += (size_t)got;
  request->head[request->count] = 0;
  if (strstr(request->head, "\r\n\r\n") == NULL && strstr(request->head, "\n\n") == NULL) {
    if (request->count == sizeof request->head - 1) refuse(request, "431 Request Header Fields Too Large");
    return false;
  }
  const char *status = refusal(l, request->head);
  if (status != NULL) refuse(request, status);
  return status == NULL;
}

/* ---- listening --------------------------------------------------------------------------------------------------- */

static ern_status parse(struct listener *l) {
  static const char scheme[] = "http://";
  const char *from = l->url + sizeof scheme - 1;
  const size_t length = strcspn(from, "/?#");
  const char *rest = split_host(from, length, l->host), *end = from + length;
  const size_t digits = rest != NULL && rest < end && *rest == ':' ? strspn(rest + 1, "0123456789") : 0;
  const bool has_digits = digits > 0 && digits <= 5 && rest + 1 + digits == end;
  const unsigned long port = has_digits ? strtoul(rest + 1, NULL, 10) : 80;
  const bool is_port = port >= 1 && port <= 65535; /* getaddrinfo takes larger ones mod 65536 */
  if (rest == NULL || length == 0 || (rest != end && !has_digits) || !is_port)
    return ern_fail(l->context, ERN_E_ARGUMENT, "%s: has no address to listen at, expected http://HOST:PORT/", l->url);
  snprintf(l->port, sizeof l->port, "%lu", port);
  return ERN_OK;
}

static ern_status start(struct listener *l) {
  const struct addrinfo hints = {
      .ai_family = AF_UNSPEC, .ai_socktype = SOCK_STREAM, .ai_flags = AI_PASSIVE | AI_NUMERICSERV};
  struct addrinfo *list = NULL;
  const int yes = 1, unknown = getaddrinfo(l->host[0] != 0 ? l->host : NULL, l->port, &hints, &list);
  int error = 0;
  if (unknown != 0) return ern_fail(l->context, ERN_E_BUSY, "%s: cannot listen: %s", l->url, gai_strerror(unknown));
  for (const struct addrinfo *at = list; at != NULL && l->descriptor < 0; at = at->ai_next) {
    const int made = socket(at->ai_family, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (made >= 0 && setsockopt(made, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes) == 0 &&
        bind(made, at->ai_addr, at->ai_addrlen) == 0 && listen(made, MOST_REQUESTS) == 0 &&
        fcntl(made, F_SETFL, O_NONBLOCK) == 0) {
      l->descriptor = made;
      break;
    }
    error = errno;
    if (made >= 0) (void)close(made);
  }
  freeaddrinfo(list);
  return l->descriptor >= 0 ? ERN_OK
                            : ern_fail(l->context, ERN_E_BUSY, "%s: cannot listen: %s", l->url, strerror(error));
}

/* Waits for connections and requests, 0.1 s at most. Returns the one that is admitted; NULL: none yet. */
static struct request *look(struct listener *l) {
  struct pollfd polled[1 + MOST_REQUESTS] = {{.fd = l->descriptor, .events = POLLIN}};
  for (size_t i = 0; i < MOST_REQUESTS; i++)
    polled[1 + i] = (struct pollfd){.fd = l->requests[i].descriptor, .events = POLLIN}; /* -1 is ignored */
  if (poll(polled, 1 + MOST_REQUESTS, LOOK_MS) < 0) return NULL;
  for (size_t i = 0; i < MOST_REQUESTS; i++) {
    struct request *request = &l->requests[i];
    if (request->descriptor < 0) continue;
    if (polled[1 + i].revents != 0 && receive(l, request)) return request;
    if (request->descriptor >= 0 && milliseconds() - request->began > HEAD_MS) refuse(request, "408 Request Timeout");
  }
  if (polled[0].revents != 0) take_connection(l);
  return NULL;
}

ern_status ern_http_serve(ern_context *context, const char *url, const char *content_type,
                          struct ern_descriptor_io *made) {
  ern_status status = ERN_OK;
  struct listener *l = NULL;
  ERN_TRY(ERN_NEW(context, 1, &l));
  l->context = context;
  l->url = url;
  l->descriptor = -1;
  for (size_t i = 0; i < MOST_REQUESTS; i++) l->requests[i].descriptor = -1;
  ERN_TRY(parse(l));
  ERN_TRY(start(l));
  for (struct request *request = NULL; request == NULL;) {
    if (made->stop != NULL && made->stop(made->user) != 0)
      ERN_TRY(ern_fail(context, ERN_E_CANCELLED, "%s: stopped before a viewer came", url));
    request = look(l);
    if (request == NULL) continue;
    const int descriptor = request->descriptor;
    if (!welcome(request, content_type)) {
      forget(request);
      request = NULL;
      continue;
    }
    request->descriptor = -1;
    made->patience_ms = PATIENCE_MS;
    ERN_TRY(ern_descriptor_io_take(context, url, descriptor, made));
  }
fail:
  for (size_t i = 0; l != NULL && i < MOST_REQUESTS; i++) forget(&l->requests[i]);
  if (l != NULL && l->descriptor >= 0) (void)close(l->descriptor);
  ern_release(context, l);
  return status;
}
