/* SPDX-License-Identifier: MIT
 * What can be asked, path by path (openapi.json describes it). */
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "serve/whep.h"

enum { BACKGROUND_BYTES = 8 << 20, KEEP_ALIVE = 15 /* seconds after which a listener gets an empty line */ };

extern const unsigned char ern_serve_text_page[], ern_serve_text_openapi[];
extern const size_t ern_serve_bytes_page, ern_serve_bytes_openapi;

/* ---- pages and figures ------------------------------------------------------------------------------------------- */

static enum MHD_Result send_page(struct request *r) {
  return answer_constant(r, "text/html; charset=utf-8", ern_serve_text_page, ern_serve_bytes_page);
}

static enum MHD_Result send_openapi(struct request *r) {
  return answer_constant(r, "application/json", ern_serve_text_openapi, ern_serve_bytes_openapi);
}

static json_t *describe(const struct ern_http_stream *s) {
  json_t *about = s->state != NULL ? json_loads(s->state, 0, NULL) : NULL;
  if (about == NULL) about = json_object();
  (void)json_object_set_new(about, "id", json_string(s->id));
  (void)json_object_set_new(about, "viewers", json_integer(s->viewers));
  (void)json_object_set_new(about, "viewers_dropped", json_integer((json_int_t)s->dropped));
  (void)json_object_set_new(about, "bytes_sent", json_integer((json_int_t)s->sent));
  return about;
}

static json_t *describe_all(struct ern_http_server *server) {
  json_t *list = json_array();
  serve_lock(server);
  for (const struct ern_http_stream *s = server->streams; s != NULL; s = s->following)
    if (s->state != NULL) (void)json_array_append_new(list, describe(s));
  serve_unlock(server);
  return list;
}

static enum MHD_Result send_state(struct request *r) {
  return answer_json(r, MHD_HTTP_OK, json_pack("{s:o}", "sessions", describe_all(r->server)));
}

static enum MHD_Result send_metrics(struct request *r) {
  json_t *sessions = describe_all(r->server);
  size_t bytes = 0;
  serve_lock(r->server);
  char *text = metrics_text(r->server, sessions, &bytes);
  serve_unlock(r->server);
  json_decref(sessions);
  return answer_text(r, "text/plain; version=0.0.4", text, bytes);
}

/* ---- watching ---------------------------------------------------------------------------------------------------- */

static ssize_t read_stream(void *user, uint64_t position, char *to, size_t most) {
  struct request *r = user;
  struct ern_http_stream *s = r->stream;
  (void)position;
  serve_lock(r->server);
  ssize_t count = broadcast_read(&s->broadcast, &r->viewer, to, most);
  if (count < 0 && !s->broadcast.ended) s->dropped++;
  if (count == 0 && !serve_wait(r, WAITS_PART)) count = -1;
  if (count > 0) s->sent += (uint64_t)count;
  serve_unlock(r->server);
  return count >= 0 ? count : MHD_CONTENT_READER_END_OF_STREAM;
}

static enum MHD_Result watch(struct request *r) {
  serve_lock(r->server);
  const bool fits = r->server->viewers < r->server->options.viewers;
  if (fits) {
    r->watches = true;
    r->server->viewers++;
    r->stream->viewers++;
  }
  serve_unlock(r->server);
  return fits ? answer_stream(r, "video/mp4", read_stream)
              : answer_error(r, MHD_HTTP_SERVICE_UNAVAILABLE, "as many watch as --viewers admits");
}

static ssize_t read_events(void *user, uint64_t position, char *to, size_t most) {
  struct request *r = user;
  static const char empty[] = ":\n\n";
  (void)position;
  serve_lock(r->server);
  ssize_t count = events_read(&r->stream->events, r, to, most);
  if (count == 0 && serve_seconds() > r->spoken + KEEP_ALIVE && most > sizeof empty) {
    memcpy(to, empty, sizeof empty - 1);
    count = sizeof empty - 1;
  }
  if (count > 0) r->spoken = serve_seconds();
  if (count == 0 && (r->stream->removed || !serve_wait(r, WAITS_EVENT))) count = MHD_CONTENT_READER_END_OF_STREAM;
  serve_unlock(r->server);
  return count;
}

/* From the next event on; after a break of the connection from the one after the last. */
static enum MHD_Result listen_to_events(struct request *r) {
  const char *last = MHD_lookup_connection_value(r->connection, MHD_HEADER_KIND, "Last-Event-ID");
  char *end = NULL;
  serve_lock(r->server);
  const uint64_t next = r->stream->events.next;
  r->event = last != NULL ? strtoull(last, &end, 10) + 1 : next;
  if (last == NULL || end == last || *end != 0 || r->event > next) r->event = next;
  r->spoken = 0; /* an empty line says that it listens */
  serve_unlock(r->server);
  return answer_stream(r, "text/event-stream", read_events);
}

/* ---- speaking ---------------------------------------------------------------------------------------------------- */

static const char *query(struct request *r, const char *name) {
  return MHD_lookup_connection_value(r->connection, MHD_GET_ARGUMENT_KIND, name);
}

static bool is_type(struct request *r, const char *beginning) {
  const char *type = MHD_lookup_connection_value(r->connection, MHD_HEADER_KIND, "Content-Type");
  return type != NULL && strncasecmp(type, beginning, strlen(beginning)) == 0;
}

static enum MHD_Result refuse(struct request *r, unsigned status, const char *reason) {
  r->answered = true;
  return answer_error(r, status, reason);
}

/* A number of the query in its range; absent: `usual`. False: it is none. */
static bool take_number(struct request *r, const char *name, int least, int most, int usual, int *value) {
  const char *text = query(r, name);
  char *end = NULL;
  const long read = text != NULL ? strtol(text, &end, 10) : usual;
  *value = (int)read;
  return text == NULL || (end != text && *end == 0 && read >= least && read <= most);
}

/* ?format=s16le&rate=16000&channels=1; without a format the sound says what it is. */
static const char *take_format(struct request *r, struct ern_http_sound *sound) {
  static const char *const known[] = {"s16le", "s16be", "f32le", "mulaw", "alaw"};
  const char *name = query(r, "format");
  for (size_t i = 0; name != NULL && i < sizeof known / sizeof *known; i++)
    if (strcmp(name, known[i]) == 0) sound->format = known[i];
  if (name != NULL && sound->format == NULL) return "format: expected s16le, s16be, f32le, mulaw or alaw";
  if (name == NULL && (query(r, "rate") != NULL || query(r, "channels") != NULL))
    return "rate and channels are about samples without a header: expected a format too";
  if (!take_number(r, "rate", 1000, 384000, 16000, &sound->rate)) return "rate: expected 1000 to 384000";
  if (!take_number(r, "channels", 1, 8, 1, &sound->channels)) return "channels: expected 1 to 8";
  return NULL;
}

static const char gone[] = "the session has ended";

static void queued(struct request *r) {
  serve_lock(r->server);
  serve_tell(r->stream, "queued", r->id, -1, NULL);
  serve_unlock(r->server);
}

/* ?stream=KEY: the body is the next piece of the sound with that key, which goes on in the pipe of those before it;
 * &end=1: it is the last. False: it is the first, or there is no key. *why: it is refused. */
static bool goes_on(struct request *r, const char **why) {
  const char *key = query(r, "stream");
  struct pieces *pieces = &r->stream->pieces;
  *why = key != NULL && (key[0] == 0 || strlen(key) >= ID_BYTES) ? "stream: expected 1 to 63 characters" : NULL;
  if (key == NULL || *why != NULL) return false;
  serve_lock(r->server);
  const bool same = strcmp(pieces->key, key) == 0;
  if (same && pieces->descriptor < 0) *why = "the sound with this key has ended, or was stopped; expected another key";
  if (same && *why == NULL) r->descriptor = fcntl(pieces->descriptor, F_DUPFD_CLOEXEC, 0);
  if (same) r->id = pieces->id;
  if (same) pieces->last = serve_seconds();
  r->last = r->descriptor >= 0 && query(r, "end") != NULL;
  serve_unlock(r->server);
  return same && *why == NULL && r->descriptor >= 0;
}

/* Keeps the pipe of a sound of which more pieces come. */
static void keep_pipe(struct request *r) {
  struct pieces *pieces = &r->stream->pieces;
  const char *key = query(r, "stream");
  if (key == NULL) return;
  serve_lock(r->server);
  serve_end_pieces(r->stream); /* of another key */
  snprintf(pieces->key, sizeof pieces->key, "%s", key);
  pieces->id = r->id;
  pieces->last = serve_seconds();
  pieces->descriptor = fcntl(r->descriptor, F_DUPFD_CLOEXEC, 0);
  r->last = query(r, "end") != NULL;
  serve_unlock(r->server);
}

static enum MHD_Result begin_say(struct request *r) {
  struct ern_http_reply reply = {.status = MHD_HTTP_INTERNAL_SERVER_ERROR};
  struct ern_http_sound sound = {0};
  const char *why = NULL;
  r->most = ERN_HTTP_TEXT;
  if (is_type(r, "text/plain") || is_type(r, "application/json")) return MHD_YES;
  if (!is_type(r, "audio/") && !is_type(r, "application/octet-stream"))
    return refuse(r, MHD_HTTP_UNSUPPORTED_MEDIA_TYPE,
                  "Content-Type: expected text/plain, application/json, audio/... or application/octet-stream");
  if (goes_on(r, &why)) return MHD_YES;
  if (why != NULL) return refuse(r, MHD_HTTP_CONFLICT, why);
  why = take_format(r, &sound);
  if (why != NULL) return refuse(r, MHD_HTTP_BAD_REQUEST, why);
  if (!serve_enter(r->stream)) return refuse(r, MHD_HTTP_GONE, gone);
  int descriptor = -1;
  const unsigned id = r->stream->actions->sound(r->stream->user, &sound, &descriptor, &reply);
  serve_leave(r->stream);
  serve_lock(r->server);
  r->id = id;
  r->descriptor = descriptor;
  serve_unlock(r->server);
  if (r->id == 0) return refuse(r, reply.status, reply.reason);
  keep_pipe(r);
  queued(r);
  return MHD_YES;
}

/* The body as JSON, an object of so many members; NULL: it is none. */
static json_t *body_object(struct request *r, size_t members) {
  json_t *body = r->body != NULL ? json_loadb(r->body, r->count, JSON_REJECT_DUPLICATES, NULL) : NULL;
  if (json_object_size(body) == members) return body;
  json_decref(body);
  return NULL;
}

static enum MHD_Result accepted(struct request *r) {
  return answer_json(
      r, MHD_HTTP_ACCEPTED,
      json_pack("{s:I, s:s, s:b}", "id", (json_int_t)r->id, "session", r->stream->id, "stopped", r->cut));
}

static void say(struct request *r, const char *text, struct ern_http_reply *reply) {
  reply->status = MHD_HTTP_GONE;
  snprintf(reply->reason, sizeof reply->reason, "%s", gone);
  if (!serve_enter(r->stream)) return;
  r->id = r->stream->actions->say(r->stream->user, text, reply);
  serve_leave(r->stream);
  if (r->id > 0) queued(r);
}

static enum MHD_Result end_say(struct request *r) {
  struct ern_http_reply reply = {.status = MHD_HTTP_INTERNAL_SERVER_ERROR};
  if (r->id > 0) return accepted(r);
  json_t *body = is_type(r, "application/json")
                     ? body_object(r, 1)
                     : json_pack("{s:o*}", "text", json_stringn(r->body != NULL ? r->body : "", r->count));
  const char *text = json_string_value(json_object_get(body, "text"));
  const char *reason = NULL;
  if (text == NULL)
    reason = "expected a text of UTF-8, or the object {\"text\": TEXT}";
  else if (text[strspn(text, " \t\r\n")] == 0)
    reason = "the text is empty";
  else if (strlen(text) != json_string_length(json_object_get(body, "text")))
    reason = "the text has a byte of 0";
  else
    say(r, text, &reply);
  json_decref(body);
  if (reason != NULL) return answer_error(r, MHD_HTTP_BAD_REQUEST, reason);
  return r->id > 0 ? accepted(r) : answer_error(r, reply.status, reply.reason);
}

static enum MHD_Result end_stop(struct request *r) {
  if (!serve_enter(r->stream)) return answer_error(r, MHD_HTTP_GONE, gone);
  r->stream->actions->stop(r->stream->user);
  serve_leave(r->stream);
  return answer_json(r, MHD_HTTP_OK, json_pack("{s:b}", "ok", 1));
}

/* ---- lines that the drawing thread answers ----------------------------------------------------------------------- */

static enum MHD_Result pass_answer(struct request *r) {
  static const char error[] = "error: ", busy[] = "busy: ";
  if (strncmp(r->answer, busy, sizeof busy - 1) == 0)
    return answer_error(r, MHD_HTTP_SERVICE_UNAVAILABLE, r->answer + sizeof busy - 1);
  if (strncmp(r->answer, error, sizeof error - 1) == 0)
    return answer_error(r, MHD_HTTP_UNPROCESSABLE_CONTENT, r->answer + sizeof error - 1);
  return answer_json(r, MHD_HTTP_OK, json_pack("{s:b}", "ok", 1));
}

/* Lets the connection stand until a line that was taken is answered. */
static enum MHD_Result await_answer(struct request *r) {
  serve_lock(r->server);
  r->asked = true;
  const bool waits = !r->answered && serve_wait(r, WAITS_ANSWER);
  serve_unlock(r->server);
  if (!waits && !r->answered) return answer_error(r, MHD_HTTP_SERVICE_UNAVAILABLE, "the server stops");
  return waits ? MHD_YES : pass_answer(r);
}

static enum MHD_Result ask(struct request *r, const char *line, void *bytes, size_t count) {
  struct ern_http_reply reply = {.status = MHD_HTTP_INTERNAL_SERVER_ERROR};
  const bool enters = serve_enter(r->stream);
  const bool takes = enters && r->stream->actions->line(r->stream->user, line, bytes, count, r, &reply);
  if (enters) serve_leave(r->stream);
  if (takes) return await_answer(r);
  free(bytes);
  return enters ? answer_error(r, reply.status, reply.reason) : answer_error(r, MHD_HTTP_GONE, gone);
}

static enum MHD_Result begin_text(struct request *r) {
  r->most = ERN_HTTP_TEXT;
  return MHD_YES;
}

static enum MHD_Result end_pose(struct request *r) {
  char line[64] = "";
  if (r->asked) return pass_answer(r);
  json_t *body = body_object(r, 1), *hold = json_object_get(body, "hold"), *eyes = json_object_get(body, "eyes");
  if (json_is_boolean(hold)) snprintf(line, sizeof line, "hold %s", json_is_true(hold) ? "on" : "off");
  if (json_is_null(eyes)) snprintf(line, sizeof line, "eyes clip");
  const double eye = json_is_number(eyes) ? json_number_value(eyes) : -1;
  const int millionths = eye >= 0 && eye <= 1 ? (int)(1e6 * eye + 0.5) : -1;
  if (millionths >= 0) snprintf(line, sizeof line, "eyes %d.%06d", millionths / 1000000, millionths % 1000000);
  json_decref(body);
  if (line[0] == 0)
    return answer_error(
        r, MHD_HTTP_BAD_REQUEST,
        "expected {\"hold\": true or false}, or {\"eyes\": 0 (open) to 1 (closed), or null: the clip's}");
  return ask(r, line, NULL, 0);
}

static enum MHD_Result begin_background(struct request *r) {
  r->most = is_type(r, "image/") ? BACKGROUND_BYTES : ERN_HTTP_TEXT;
  return MHD_YES;
}

static enum MHD_Result end_background(struct request *r) {
  static const char *const choices[] = {"white", "black", "clip"};
  char line[64] = "";
  if (r->asked) return pass_answer(r);
  if (is_type(r, "image/") && r->count > 0) {
    char *bytes = r->body;
    r->body = NULL;
    return ask(r, "background", bytes, r->count);
  }
  json_t *body = body_object(r, 1);
  const char *choice = json_string_value(json_object_get(body, "colour"));
  for (size_t i = 0; choice != NULL && i < sizeof choices / sizeof *choices; i++)
    if (strcmp(choice, choices[i]) == 0) snprintf(line, sizeof line, "background %s", choice);
  json_decref(body);
  if (line[0] == 0)
    return answer_error(r, MHD_HTTP_BAD_REQUEST,
                        "expected {\"colour\": \"white\", \"black\" or \"clip\"}, or a picture as image/...");
  return ask(r, line, NULL, 0);
}

/* ---- sessions -----------------------------------------------------------------------------------------------------
 */

/* {"portrait": ID, "id": ID} */
static enum MHD_Result end_create(struct request *r) {
  const struct ern_http_keeper *keeper = &r->server->options.keeper;
  struct ern_http_reply reply = {.status = MHD_HTTP_BAD_REQUEST};
  if (r->asked) return pass_answer(r);
  json_t *body = body_object(r, 2);
  const char *portrait = json_string_value(json_object_get(body, "portrait"));
  const char *id = json_string_value(json_object_get(body, "id"));
  snprintf(reply.reason, sizeof reply.reason, "expected {\"portrait\": that of a session, \"id\": a new one}");
  const bool takes = portrait != NULL && id != NULL && keeper->create(keeper->user, portrait, id, r, &reply);
  json_decref(body);
  return takes ? await_answer(r) : answer_error(r, reply.status, reply.reason);
}

static enum MHD_Result end_session(struct request *r) {
  const struct ern_http_keeper *keeper = &r->server->options.keeper;
  struct ern_http_reply reply = {0};
  if (r->asked) return pass_answer(r);
  return keeper->end(keeper->user, r->stream->id, r, &reply) ? await_answer(r)
                                                             : answer_error(r, reply.status, reply.reason);
}

/* ---- finding ----------------------------------------------------------------------------------------------------- */

static const struct route routes[] = {
    {"GET", "/", ROLE_ANY, send_page, NULL},
    {"GET", "/openapi.json", ROLE_ANY, send_openapi, NULL},
    {"GET", "/state", ROLE_WATCH, send_state, NULL},
    {"GET", "/metrics", ROLE_WATCH, send_metrics, NULL},
    {"GET", "/v1/sessions", ROLE_WATCH, send_state, NULL},
    {"POST", "/v1/sessions", ROLE_SAY, begin_text, end_create},
    {"DELETE", "/v1/sessions/ID", ROLE_SAY, begin_text, end_session},
    {"GET", "/v1/sessions/ID/stream", ROLE_WATCH, watch, NULL},
    {"POST", "/v1/sessions/ID/whep", ROLE_WATCH, whep_begin, whep_end},
    {"DELETE", "/v1/sessions/ID/whep/KEY", ROLE_WATCH, begin_text, whep_delete},
    {"GET", "/v1/sessions/ID/events", ROLE_WATCH, listen_to_events, NULL},
    {"POST", "/v1/sessions/ID/say", ROLE_SAY, begin_say, end_say},
    {"POST", "/v1/sessions/ID/stop", ROLE_SAY, begin_text, end_stop},
    {"POST", "/v1/sessions/ID/pose", ROLE_SAY, begin_text, end_pose},
    {"POST", "/v1/sessions/ID/background", ROLE_SAY, begin_background, end_background},
};
enum { ROUTES = sizeof routes / sizeof *routes };

/* Whether the url has the path's form; `id`, `key`: the parts that stand for ID and KEY, "" where there is none. */
static bool fits(const char *path, const char *url, char id[ID_BYTES], char key[WHEP_KEY]) {
  const char *place = strstr(path, "/ID");
  id[0] = key[0] = 0;
  if (place == NULL) return strcmp(path, url) == 0;
  const size_t before = (size_t)(place - path) + 1;
  if (strncmp(path, url, before) != 0) return false;
  const size_t bytes = strcspn(url + before, "/");
  const char *rest = place + 3, *given = url + before + bytes, *last = strstr(rest, "/KEY");
  const size_t same = last != NULL ? (size_t)(last - rest) + 1 : strlen(rest) + 1;
  if (bytes == 0 || bytes >= ID_BYTES || strncmp(rest, given, same) != 0) return false;
  if (last != NULL && (strlen(given + same) != WHEP_KEY - 1 || strchr(given + same, '/') != NULL)) return false;
  if (last != NULL) snprintf(key, WHEP_KEY, "%s", given + same);
  snprintf(id, ID_BYTES, "%.*s", (int)bytes, url + before);
  return true;
}

const char *route_find(struct request *r, const char *url, const char *method, unsigned *status) {
  char id[ID_BYTES];
  bool is_path = false;
  for (size_t i = 0; i < ROUTES; i++) {
    if (!fits(routes[i].path, url, id, r->key)) continue;
    is_path = true;
    if (strcmp(routes[i].method, method) != 0) continue;
    r->route = &routes[i];
    if (id[0] == 0) return NULL;
    serve_lock(r->server);
    struct ern_http_stream *s = r->server->streams;
    while (s != NULL && (strcmp(s->id, id) != 0 || s->state == NULL)) s = s->following;
    if (s != NULL) s->users++;
    r->stream = s;
    serve_unlock(r->server);
    *status = MHD_HTTP_NOT_FOUND;
    return s != NULL ? NULL : "there is no such session; GET /state lists them";
  }
  *status = is_path ? MHD_HTTP_METHOD_NOT_ALLOWED : MHD_HTTP_NOT_FOUND;
  return is_path ? "this path has other methods; /openapi.json lists them"
                 : "there is no such path; /openapi.json lists them";
}

void route_methods(const char *url, char *methods, size_t bytes) {
  char id[ID_BYTES], key[WHEP_KEY];
  methods[0] = 0;
  for (size_t i = 0; i < ROUTES; i++) {
    const size_t used = strlen(methods);
    if (fits(routes[i].path, url, id, key))
      snprintf(methods + used, bytes - used, "%s%s", used > 0 ? ", " : "", routes[i].method);
  }
}
