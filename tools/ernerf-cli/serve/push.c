/* SPDX-License-Identifier: MIT */
#include "serve/push.h"

#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "ernerf/stream.h"

enum { LOOK_MS = 10, PAUSE_MS = 3000 /* until the next try */ };

static void sleep_ms(int ms) { (void)nanosleep(&(struct timespec){.tv_nsec = 1000000L * ms}, NULL); }

bool push_takes(const char *url) {
  static const char *const schemes[] = {"rtmp://", "rtmps://", "srt://", "udp://"};
  for (size_t i = 0; i < sizeof schemes / sizeof *schemes; i++)
    if (strncmp(url, schemes[i], strlen(schemes[i])) == 0) return url[strlen(schemes[i])] != 0;
  return false;
}

/* A path, a query and a name before @ may be the key of a stream: who watches the state must not learn it. */
static void hide(const char *url, char shown[256]) {
  const char *host = strstr(url, "://") + 3;
  const size_t whole = strcspn(host, "/?#");
  const char *end = host + whole;
  for (const char *at = host; at < end; at++)
    if (*at == '@') host = at + 1;
  snprintf(shown, 256, "%.*s%.*s%s", (int)(strstr(url, "://") + 3 - url), url, (int)(end - host), host,
           *end != 0 ? "/..." : "");
}

static int asks_to_stop(void *user) {
  const struct push *p = user;
  return atomic_load(&p->ends);
}

/* The address is connected once the stream is read for it. */
static ptrdiff_t take(void *user, void *bytes, size_t most) {
  struct push *p = user;
  ptrdiff_t count = 0;
  while (!atomic_load(&p->ends) && (count = p->http->read(p->stream, &p->place, bytes, most)) == 0) sleep_ms(LOOK_MS);
  if (count > 0) atomic_store(&p->connected, true);
  return count > 0 ? count : 0;
}

/* The first failure in a row is warned of, without the address that the message begins with. */
static void note_failure(struct push *p, bool was_connected, ern_status status) {
  char text[PUSH_REASON] = "fell 4 s behind, or the stream has ended";
  if (status != ERN_OK) (void)ern_last_error_copy(p->context, text, sizeof text);
  const size_t own = strlen(p->url);
  const char *reason = strncmp(text, p->url, own) == 0 && text[own] == ':' ? text + own + 2 : text;
  (void)pthread_mutex_lock(&p->mutex);
  p->failures = was_connected ? 1 : p->failures + 1;
  const bool first = p->failures == 1;
  snprintf(p->failed, sizeof p->failed, "%s", reason);
  (void)pthread_mutex_unlock(&p->mutex);
  if (first) session_warn(p->session, "--push %s: %s; it is tried again every %d s", p->shown, reason, PAUSE_MS / 1000);
}

static void *run(void *user) {
  struct push *p = user;
  while (!atomic_load(&p->ends)) {
    p->place = (struct ern_http_place){0};
    const ern_status status = ern_stream_copy(p->context, p->url, take, asks_to_stop, p);
    const bool was_connected = atomic_exchange(&p->connected, false);
    if (atomic_load(&p->ends)) break;
    note_failure(p, was_connected, status);
    for (int ms = 0; ms < PAUSE_MS && !atomic_load(&p->ends); ms += LOOK_MS) sleep_ms(LOOK_MS);
  }
  return NULL;
}

int push_open(struct push *p, struct session *session, const char *url, const struct ern_http_functions *http,
              struct ern_http_stream *stream) {
  p->url = url;
  p->session = session;
  p->http = http;
  p->stream = stream;
  hide(url, p->shown);
  if (ern_context_create(&p->context, NULL) != ERN_OK) return session_fail_with(session, "no memory for --push");
  (void)pthread_mutex_init(&p->mutex, NULL); /* does not fail on Linux */
  p->runs = pthread_create(&p->thread, NULL, run, p) == 0;
  return p->runs ? 0 : session_fail_with(session, "--push %s: cannot start a thread", p->shown);
}

json_t *push_state(struct push *p) {
  const bool connected = atomic_load(&p->connected);
  (void)pthread_mutex_lock(&p->mutex);
  json_t *made = json_pack("{s:s, s:b, s:I, s:s*}", "to", p->shown, "connected", connected, "failures",
                           connected ? (json_int_t)0 : (json_int_t)p->failures, "error",
                           !connected && p->failed[0] != 0 ? p->failed : NULL);
  (void)pthread_mutex_unlock(&p->mutex);
  return made;
}

void push_close(struct push *p) {
  if (p->runs) {
    atomic_store(&p->ends, true);
    (void)pthread_join(p->thread, NULL);
    (void)pthread_mutex_destroy(&p->mutex);
  }
  ern_context_free(&p->context);
  p->runs = false;
}
