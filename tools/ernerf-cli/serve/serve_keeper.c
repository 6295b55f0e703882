/* SPDX-License-Identifier: MIT */
#include "serve/serve_keeper.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { CONFLICT = 409, BAD_REQUEST = 400, BUSY = 503 };

/* Share of the cores that sessions may need at least; and the cores that coding is thought to take until it is
 * measured. */
static const double most_share = 0.9, usual_coding = 0.1;

bool serve_is_name(const char *name) {
  static const char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789.-_";
  const size_t bytes = strlen(name);
  return bytes > 0 && bytes < SERVE_ID && strspn(name, letters) == bytes && name[0] != '.';
}

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static struct serve_session **place_of(struct serve_keeper *keeper, const char *id) {
  for (size_t k = 0; k < SERVE_SESSIONS; k++)
    if (keeper->sessions[k] != NULL && strcmp(keeper->sessions[k]->id, id) == 0) return &keeper->sessions[k];
  return NULL;
}

static void forget(struct serve_session **place) {
  serve_session_close(*place);
  free(*place);
  *place = NULL;
}

/* held: NULL, or where the message of a failure goes. */
static int open_session(struct serve_keeper *keeper, struct serve_portrait *portrait, const char *id, char *held) {
  size_t k = 0;
  while (k < SERVE_SESSIONS && keeper->sessions[k] != NULL) k++;
  struct serve_session *made = k < SERVE_SESSIONS ? calloc(1, sizeof *made) : NULL;
  struct session session = keeper->live->session;
  session.held = held;
  if (made == NULL)
    return session_fail_with(&session, "no memory for a session, or %d are there or end", SERVE_SESSIONS);
  keeper->sessions[k] = made;
  made->job = *keeper->live;
  made->job.session.held = held;
  if (made->job.session.threads == 0) made->job.session.threads = keeper->threads;
  made->job.portrait.model_path = portrait->path;
  made->job.portrait.lent = portrait->model;
  made->job.portrait.chosen.config = &made->job.portrait.render;
  if (made->job.portrait.source.path == NULL) made->job.portrait.source.path = portrait->clip;
  made->job.rate_control.like = portrait->is_measured ? &portrait->measured : NULL;
  made->measured = portrait->is_measured ? NULL : &portrait->measured;
  if (keeper->until > 0)
    made->job.seconds = fmax(keeper->until - session_seconds(), 1 / rate_value(keeper->live->rate));
  snprintf(made->id, sizeof made->id, "%s", id);
  const int status = serve_session_open(made, keeper->args, keeper->http, keeper->server, keeper->record,
                                        portrait->is_measured ? NULL : &keeper->push);
  if (status != 0) {
    forget(&keeper->sessions[k]);
    return status;
  }
  portrait->is_measured = true;
  return 0;
}

/* MODEL without its ending. */
static bool without_ending(const char *model, char *stem, size_t bytes) {
  const char *dot = strrchr(model, '.'), *slash = strrchr(model, '/');
  const size_t length = dot != NULL && (slash == NULL || dot > slash) ? (size_t)(dot - model) : strlen(model);
  return snprintf(stem, bytes, "%.*s", (int)length, model) < (int)bytes;
}

static int open_portrait(struct serve_keeper *keeper, const char *path) {
  struct session session = keeper->live->session;
  struct serve_portrait *portrait = &keeper->portraits[keeper->portrait_count];
  portrait->path = path;
  if (!without_ending(path, portrait->clip, sizeof portrait->clip))
    return session_fail_with(&session, "%s: the name is too long", path);
  const char *slash = strrchr(portrait->clip, '/'), *stem = slash != NULL ? slash + 1 : portrait->clip;
  const char *name = keeper->name != NULL ? keeper->name : stem;
  if (!serve_is_name(name))
    return session_fail_with(&session, "%s: its name is none for an address, expected --name ID", path);
  if (place_of(keeper, name) != NULL)
    return session_fail_with(&session, "%s: another PORTRAIT has the name %s too", path, name);
  snprintf(portrait->id, sizeof portrait->id, "%s", name);
  if (ern_model_load(&portrait->model, session.context, path) != ERN_OK) return session_fail(&session);
  keeper->portrait_count++;
  return open_session(keeper, portrait, name, NULL);
}

int serve_keeper_open(struct serve_keeper *keeper, const char *const paths[SERVE_PORTRAITS]) {
  const long cores = sysconf(_SC_NPROCESSORS_ONLN);
  size_t count = 1;
  int status = 0;
  keeper->cores = cores > 0 ? (int)cores : 1;
  while (count < SERVE_PORTRAITS && paths[count] != NULL) count++;
  keeper->threads = count > 1 ? (keeper->cores + (int)count - 1) / (int)count : 0;
  for (size_t k = 0; status == 0 && k < count; k++) status = open_portrait(keeper, paths[k]);
  if (keeper->live->seconds > 0) keeper->until = session_seconds() + keeper->live->seconds;
  return status;
}

/* ---- whether the machine is fast enough ---------------------------------------------------------------------------
 */

/* Cores that sessions need at least: their rendering with the fastest settings, and their coding. `portrait` NULL: all
 * that run; else another one of it. */
static double cores_of(const struct serve_keeper *keeper, const struct serve_portrait *portrait, size_t *count) {
  const double rate = rate_value(keeper->live->rate);
  double cores = 0, coding = 0;
  *count = 0;
  for (size_t k = 0; k < SERVE_SESSIONS; k++) {
    struct serve_session *s = keeper->sessions[k];
    if (s == NULL) continue;
    const double seconds = session_seconds() - s->opened, used = serve_session_coding(s);
    if (used < 0) continue;
    cores += rate_control_least(&s->job.rate_control, keeper->cores) * rate / 1000;
    coding += seconds > 2 && used > 0 ? used / seconds : usual_coding;
    (*count)++;
  }
  if (portrait == NULL) return cores + coding;
  return rate_control_least(&portrait->measured, keeper->cores) * rate / 1000 +
         (*count > 0 ? coding / (double)*count : usual_coding);
}

/* ---- wishes ------------------------------------------------------------------------------------------------------ */

static bool take_wish(struct serve_keeper *keeper, const struct serve_wish *wish, struct ern_http_reply *reply) {
  (void)pthread_mutex_lock(&keeper->mutex);
  const bool takes = keeper->wish.token == NULL;
  if (takes) keeper->wish = *wish;
  (void)pthread_mutex_unlock(&keeper->mutex);
  reply->status = BUSY;
  snprintf(reply->reason, sizeof reply->reason, "another session is being made or ended");
  return takes;
}

bool serve_keeper_create(void *user, const char *portrait, const char *id, void *token, struct ern_http_reply *reply) {
  struct serve_wish wish = {.creates = true, .token = token};
  reply->status = BAD_REQUEST;
  snprintf(reply->reason, sizeof reply->reason, "id: expected up to %d letters, digits, ., - and _", SERVE_ID - 1);
  if (!serve_is_name(id)) return false;
  snprintf(reply->reason, sizeof reply->reason, "portrait: expected the name of one that the server was started with");
  if (!serve_is_name(portrait)) return false;
  snprintf(wish.portrait, sizeof wish.portrait, "%s", portrait);
  snprintf(wish.id, sizeof wish.id, "%s", id);
  return take_wish(user, &wish, reply);
}

bool serve_keeper_end(void *user, const char *id, void *token, struct ern_http_reply *reply) {
  struct serve_wish wish = {.token = token};
  snprintf(wish.id, sizeof wish.id, "%s", id);
  return take_wish(user, &wish, reply);
}

static void create(struct serve_keeper *keeper, const struct serve_wish *wish, char answer[SESSION_HELD]) {
  struct serve_portrait *portrait = NULL;
  char held[SESSION_HELD] = "";
  size_t count, other;
  for (size_t k = 0; k < keeper->portrait_count; k++)
    if (strcmp(keeper->portraits[k].id, wish->portrait) == 0) portrait = &keeper->portraits[k];
  if (portrait == NULL || place_of(keeper, wish->id) != NULL) {
    snprintf(answer, SESSION_HELD, "error: %s %s", portrait == NULL ? wish->portrait : wish->id,
             portrait == NULL ? "is no portrait that the server was started with" : "is there already");
    return;
  }
  const double used = cores_of(keeper, NULL, &count), more = cores_of(keeper, portrait, &other);
  if (count >= SERVE_SESSIONS)
    snprintf(answer, SESSION_HELD, "busy: there are %d sessions already, the most that a server has", SERVE_SESSIONS);
  else if (used + more > most_share * keeper->cores)
    snprintf(answer, SESSION_HELD,
             "busy: the machine is too slow for another session: %zu need %.2f of its %d cores at least, and this one "
             "%.2f more, expected %.2f together at most",
             count, used, keeper->cores, more, most_share * keeper->cores);
  else if (open_session(keeper, portrait, wish->id, held) != 0)
    snprintf(answer, SESSION_HELD, "error: %.4000s", held);
}

bool serve_keeper_look(struct serve_keeper *keeper) {
  struct session session = keeper->live->session;
  char answer[SESSION_HELD] = "ok";
  bool any = false;
  (void)pthread_mutex_lock(&keeper->mutex);
  const struct serve_wish wish = keeper->wish;
  (void)pthread_mutex_unlock(&keeper->mutex);
  if (wish.token != NULL) {
    struct serve_session **place = place_of(keeper, wish.id);
    if (wish.creates)
      create(keeper, &wish, answer);
    else if (place != NULL)
      forget(place);
    keeper->stays |= !wish.creates;
    (void)pthread_mutex_lock(&keeper->mutex);
    keeper->wish.token = NULL;
    (void)pthread_mutex_unlock(&keeper->mutex);
    keeper->http->answer(wish.token, answer);
  }
  for (size_t k = 0; k < SERVE_SESSIONS; k++) {
    struct serve_session *s = keeper->sessions[k];
    if (s == NULL) continue;
    any |= !atomic_load(&s->over);
    if (!atomic_load(&s->over) || session_interrupted()) continue;
    if (s->status != 0) session_warn(&session, "%s: the session ends: %s", s->id, s->failed);
    forget(&keeper->sessions[k]);
  }
  return any || (keeper->stays && (keeper->until <= 0 || session_seconds() < keeper->until));
}

void serve_keeper_close(struct serve_keeper *keeper) {
  for (size_t k = 0; k < SERVE_SESSIONS; k++) serve_session_stop(keeper->sessions[k]);
  for (size_t k = 0; k < SERVE_SESSIONS; k++) forget(&keeper->sessions[k]);
  (void)pthread_mutex_lock(&keeper->mutex);
  void *token = keeper->wish.token;
  keeper->wish.token = keeper; /* takes no more */
  (void)pthread_mutex_unlock(&keeper->mutex);
  if (token != NULL) keeper->http->answer(token, "busy: the server stops");
  for (size_t k = 0; k < keeper->portrait_count; k++) ern_model_free(&keeper->portraits[k].model);
}
