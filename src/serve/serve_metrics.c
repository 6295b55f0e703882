/* SPDX-License-Identifier: MIT
 * Figures in Prometheus' text form: those of the server, and every number in the sessions' states. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "serve/serve_shared.h"

/* Figures of a state that only rise. */
static bool rises(const char *name) {
  static const char *const names[] = {"frames",  "drawn",    "repeated", "as_recorded",     "skipped",
                                      "written", "left_out", "seconds",  "viewers_dropped", "bytes_sent"};
  for (size_t i = 0; i < sizeof names / sizeof *names; i++)
    if (strcmp(names[i], name) == 0) return true;
  return false;
}

/* The figures `name` (of the objects `outer` where that is not NULL) of all sessions. */
static void print_figure(FILE *to, const json_t *sessions, const char *outer, const char *name) {
  const bool counts = outer == NULL && rises(name);
  char whole[128];
  size_t i;
  json_t *session;
  snprintf(whole, sizeof whole, "ernerf_session_%s%s%s%s", outer != NULL ? outer : "", outer != NULL ? "_" : "", name,
           counts ? "_total" : "");
  fprintf(to, "# TYPE %s %s\n", whole, counts ? "counter" : "gauge");
  json_array_foreach(sessions, i, session) {
    const json_t *from = outer != NULL ? json_object_get(session, outer) : session;
    const json_t *figure = json_object_get(from, name);
    char *number = json_is_number(figure) ? json_dumps(figure, JSON_ENCODE_ANY | JSON_REAL_PRECISION(9)) : NULL;
    if (number != NULL)
      fprintf(to, "%s{session=\"%s\"} %s\n", whole, json_string_value(json_object_get(session, "id")), number);
    free(number);
  }
}

/* What is a number, or holds some, in any session's state: what is not, such as `speaking` at rest, is null. */
static json_t *figures_of(const json_t *sessions) {
  json_t *figures = json_object(), *session, *value;
  const char *name;
  size_t i;
  json_array_foreach(sessions, i, session) {
    json_object_foreach(session, name, value) {
      if (json_is_number(value) || json_is_object(value)) (void)json_object_set(figures, name, value);
    }
  }
  return figures;
}

char *metrics_text(const struct ern_http_server *server, json_t *sessions, size_t *bytes) {
  char *text = NULL;
  FILE *to = open_memstream(&text, bytes);
  const char *name, *inner;
  json_t *value, *part;
  if (to == NULL) return NULL;
  json_t *figures = figures_of(sessions);
  fprintf(to, "# TYPE ernerf_requests_total counter\nernerf_requests_total %llu\n", (unsigned long long)server->asked);
  fprintf(to, "# TYPE ernerf_requests_refused_total counter\nernerf_requests_refused_total %llu\n",
          (unsigned long long)server->refused);
  fprintf(to, "# TYPE ernerf_viewers gauge\nernerf_viewers %u\n", server->viewers);
  fprintf(to, "# TYPE ernerf_sessions gauge\nernerf_sessions %zu\n", json_array_size(sessions));
  json_object_foreach(figures, name, value) {
    if (json_is_number(value)) print_figure(to, sessions, NULL, name);
    if (!json_is_object(value)) continue;
    json_object_foreach(value, inner, part) if (json_is_number(part)) print_figure(to, sessions, name, inner);
  }
  json_decref(figures);
  if (fclose(to) == 0) return text;
  free(text);
  return NULL;
}
