/* SPDX-License-Identifier: MIT
 * The log of events of a session, which listeners read at their own pace. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "serve/serve_shared.h"

void events_add(struct event_log *log, const char *word, const char *data) {
  static const char form[] = "id: %llu\nevent: %s\ndata: %s\n\n";
  const unsigned long long number = log->next;
  const int bytes = snprintf(NULL, 0, form, number, word, data);
  char *text = bytes > 0 ? malloc((size_t)bytes + 1) : NULL, **place = &log->text[number % EVENTS];
  if (text != NULL) snprintf(text, (size_t)bytes + 1, form, number, word, data);
  free(*place);
  *place = text; /* without memory it is left out */
  log->next++;
}

ssize_t events_read(const struct event_log *log, struct request *r, void *to, size_t most) {
  if (r->event + EVENTS < log->next) { /* it was too slow: those in between are lost */
    r->event = log->next - EVENTS;
    r->event_at = 0;
  }
  while (r->event < log->next && log->text[r->event % EVENTS] == NULL) r->event++;
  if (r->event == log->next) return 0;
  const char *rest = log->text[r->event % EVENTS] + r->event_at;
  const size_t left = strlen(rest), count = left < most ? left : most;
  memcpy(to, rest, count);
  r->event_at += count;
  if (count < left) return (ssize_t)count;
  r->event++;
  r->event_at = 0;
  return (ssize_t)count;
}

void events_free(struct event_log *log) {
  for (size_t i = 0; i < EVENTS; i++) free(log->text[i]);
}
