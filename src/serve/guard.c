/* SPDX-License-Identifier: MIT
 * Who may ask: Host, Origin and tokens of a request. */
#include <arpa/inet.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "serve/serve_shared.h"

enum { HOST_BYTES = 256 };

static const char *header(struct MHD_Connection *connection, const char *name) {
  return MHD_lookup_connection_value(connection, MHD_HEADER_KIND, name);
}

struct counted {
  const char *name;
  unsigned count;
};

static enum MHD_Result count_field(void *user, enum MHD_ValueKind kind, const char *name, const char *value) {
  struct counted *counted = user;
  (void)kind;
  (void)value;
  counted->count += strcasecmp(name, counted->name) == 0;
  return MHD_YES;
}

static unsigned count_of(struct MHD_Connection *connection, const char *name) {
  struct counted counted = {.name = name};
  (void)MHD_get_connection_values(connection, MHD_HEADER_KIND, count_field, &counted);
  return counted.count;
}

/* Whether the host of "HOST", "HOST:PORT" or "[IPV6]:PORT" is an IP address, localhost or the options' name: the names
 * of other pages' servers that lead here are none of them. */
static bool is_own_host(const struct ern_http_server *server, const char *field) {
  char host[HOST_BYTES];
  struct in6_addr address;
  const bool bracket = field[0] == '[';
  const char *end = strchr(field, bracket ? ']' : ':');
  const size_t bytes = end != NULL ? (size_t)(end - field) : strlen(field);
  const char *port = end != NULL ? end + bracket : ""; /* ":80" */
  if (bytes >= HOST_BYTES || (bracket && end == NULL)) return false;
  if (port[0] != 0 && (port[0] != ':' || port[1 + strspn(port + 1, "0123456789")] != 0)) return false;
  snprintf(host, sizeof host, "%.*s", (int)(bytes - bracket), field + bracket);
  return inet_pton(AF_INET, host, &address) == 1 || inet_pton(AF_INET6, host, &address) == 1 ||
         strcasecmp(host, "localhost") == 0 ||
         (server->options.host != NULL && strcasecmp(host, server->options.host) == 0);
}

const char *guard_origin(const struct ern_http_server *server, struct MHD_Connection *connection) {
  const char *origin = header(connection, "Origin"), *allowed = server->options.origin;
  return origin != NULL && allowed != NULL && strcasecmp(origin, allowed) == 0 ? origin : NULL;
}

static bool is_own_origin(const char *origin, const char *host) {
  const char *rest = strncasecmp(origin, "http://", 7) == 0    ? origin + 7
                     : strncasecmp(origin, "https://", 8) == 0 ? origin + 8 /* through a proxy */
                                                               : NULL;
  return rest != NULL && strcasecmp(rest, host) == 0;
}

/* Takes as long for any two texts of these lengths. */
static bool is_same(const char *one, const char *other) {
  const size_t bytes = strlen(one), wanted = strlen(other);
  unsigned char apart = bytes != wanted;
  for (size_t i = 0; i < bytes; i++) apart |= (unsigned char)(one[i] ^ other[i % (wanted > 0 ? wanted : 1)]);
  return apart == 0;
}

/* The token of "Authorization: Bearer TOKEN", else of the query, for what cannot send headers. */
static const char *token_of(struct MHD_Connection *connection) {
  static const char bearer[] = "Bearer ";
  const char *field = header(connection, "Authorization");
  if (field != NULL) return strncasecmp(field, bearer, sizeof bearer - 1) == 0 ? field + sizeof bearer - 1 : "";
  return MHD_lookup_connection_value(connection, MHD_GET_ARGUMENT_KIND, "token");
}

static const char *token_refusal(const struct ern_http_server *server, struct MHD_Connection *connection,
                                 enum role role) {
  const struct ern_http_options *o = &server->options;
  const char *token = token_of(connection);
  const bool says = o->say_token == NULL || (token != NULL && is_same(token, o->say_token));
  const bool watches = o->watch_token == NULL || (token != NULL && is_same(token, o->watch_token));
  if (role == ROLE_SAY && !says) return "a token is needed to let it speak: Authorization: Bearer TOKEN";
  if (role == ROLE_WATCH && !watches && (o->say_token == NULL || !says))
    return "a token is needed to watch: Authorization: Bearer TOKEN, or ?token=TOKEN";
  return NULL;
}

const char *guard_refusal(const struct ern_http_server *server, struct MHD_Connection *connection, enum role role,
                          bool is_page, unsigned *status) {
  const char *host = header(connection, "Host"), *origin = header(connection, "Origin");
  const char *site = header(connection, "Sec-Fetch-Site");
  *status = MHD_HTTP_BAD_REQUEST;
  if (host == NULL || count_of(connection, "Host") != 1) return "expected one field Host";
  if (count_of(connection, "Origin") > 1) return "expected one field Origin at most";
  *status = MHD_HTTP_FORBIDDEN;
  if (!is_own_host(server, host))
    return "Host is the name of another server, expected an IP address, localhost or --host";
  const bool allowed = guard_origin(server, connection) != NULL;
  if (origin != NULL && !allowed && !is_own_origin(origin, host))
    return "Origin is another page's, expected this server's or that of --allow-origin";
  if (site != NULL && !is_page && !allowed && strcasecmp(site, "same-origin") != 0 && strcasecmp(site, "none") != 0)
    return "a page of another origin asks, expected one of this server or of --allow-origin";
  *status = MHD_HTTP_UNAUTHORIZED;
  return token_refusal(server, connection, role);
}
