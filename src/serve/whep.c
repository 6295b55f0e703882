/* SPDX-License-Identifier: MIT */
#include "serve/whep.h"

#include <dlfcn.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/random.h>

#include "serve/fragment.h"
#include "serve/webrtc/webrtc.h"

enum { OFFER_BYTES = 65536, SOUND_RATE = 48000 };

struct whep_viewer {
  struct whep_viewer *following; /* of the stream */
  char key[WHEP_KEY];            /* the end of its address: who knows it may end the viewer */
  struct ern_http_stream *stream;
  struct ern_webrtc_viewer *peer;
  struct request *request; /* waits for the answer; NULL: none */
};

/* ---- the library ------------------------------------------------------------------------------------------------- */

#define TEXT_OF(x) #x
#define SONAME(major) "libernerf-webrtc.so." TEXT_OF(major)

/* ern_webrtc_events.answered */
static void answered(void *user, unsigned status, const char *text) {
  struct whep_viewer *v = user;
  struct ern_http_server *server = v->stream->server;
  serve_lock(server);
  struct request *r = v->request;
  v->request = NULL;
  if (r != NULL) {
    r->whep = NULL;
    r->status = status;
    r->text = strdup(text);
    r->answered = true;
    if (r->waits == WAITS_ANSWER) {
      r->waits = WAITS_NOT;
      MHD_resume_connection(r->connection);
    }
  } else {
    server->webrtc_functions->end(v->peer);
  }
  serve_unlock(server);
}

/* ern_webrtc_events.ended */
static void ended(void *user) {
  struct whep_viewer *v = user;
  struct ern_http_stream *s = v->stream;
  struct ern_http_server *server = s->server;
  serve_lock(server);
  for (struct whep_viewer **at = &s->peers; *at != NULL; at = &(*at)->following)
    if (*at == v) {
      *at = v->following;
      break;
    }
  server->viewers--;
  s->viewers--;
  serve_release(s);
  serve_unlock(server);
  free(v);
}

/* Opens the library when the first viewer offers. On the server's thread. */
static bool open_library(struct ern_http_server *server) {
  static const char name[] = SONAME(ERN_VERSION_MAJOR);
  static const struct ern_webrtc_events events = {answered, ended};
  if (server->webrtc != NULL) return true;
  void *library = dlopen(name, RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE); /* GLib's threads stay */
  const struct ern_webrtc_functions *found = library != NULL ? dlsym(library, "ern_webrtc_functions") : NULL;
  if (found == NULL || strcmp(found->version, server->version) != 0) return false;
  server->webrtc_functions = found;
  server->webrtc = found->open(&events, &(struct ern_webrtc_options){server->options.stun, server->options.first_port,
                                                                     server->options.last_port});
  return server->webrtc != NULL;
}

void whep_remove(struct ern_http_stream *s) {
  if (s->source != NULL) s->server->webrtc_functions->remove(&s->source);
}

void whep_close(struct ern_http_server *server) {
  if (server->webrtc != NULL) server->webrtc_functions->close(&server->webrtc);
}

/* ---- requests ---------------------------------------------------------------------------------------------------- */

static bool make_key(char key[WHEP_KEY]) {
  unsigned char bytes[WHEP_KEY / 2];
  if (getrandom(bytes, sizeof bytes, 0) != (ssize_t)sizeof bytes) return false;
  for (size_t i = 0; i < sizeof bytes; i++) snprintf(key + 2 * i, 3, "%02x", bytes[i]);
  return true;
}

/* Connections that may still come: each is an open file. */
static size_t coming_connections(const struct ern_http_server *server) {
  const union MHD_DaemonInfo *info = MHD_get_daemon_info(server->daemon, MHD_DAEMON_INFO_CURRENT_CONNECTIONS);
  const unsigned most = server->options.connections, now = info != NULL ? info->num_connections : 0;
  return most > now ? most - now : 0;
}

/* Makes the viewer, who then counts. The caller holds the lock. */
static struct whep_viewer *add_viewer(struct request *r) {
  const struct ern_webrtc_functions *functions = r->server->webrtc_functions;
  struct ern_http_stream *s = r->stream;
  const uint8_t *avcc;
  size_t bytes;
  struct whep_viewer *v = calloc(1, sizeof *v);
  if (!fragment_avcc(s->broadcast.head.bytes, s->broadcast.head.count, &avcc, &bytes) || bytes < 4) goto fail;
  if (s->source == NULL) s->source = functions->add(r->server->webrtc);
  if (v == NULL || s->source == NULL || !make_key(v->key)) goto fail;
  v->stream = s;
  v->request = r;
  v->peer = functions->watch(s->source, r->body, avcc, coming_connections(r->server), v);
  if (v->peer == NULL) goto fail;
  v->following = s->peers;
  s->peers = v;
  s->users++;
  s->viewers++;
  r->server->viewers++;
  return v;
fail:
  free(v);
  return NULL;
}

enum MHD_Result whep_begin(struct request *r) {
  static const char type[] = "application/sdp";
  const char *found = MHD_lookup_connection_value(r->connection, MHD_HEADER_KIND, "Content-Type");
  r->most = OFFER_BYTES;
  if (found != NULL && strncasecmp(found, type, sizeof type - 1) == 0) return MHD_YES;
  r->answered = true;
  return answer_error(r, MHD_HTTP_UNSUPPORTED_MEDIA_TYPE, "Content-Type: expected application/sdp");
}

static enum MHD_Result pass_answer(struct request *r) {
  if (r->status == MHD_HTTP_CREATED && r->text != NULL) return answer_created(r, r->answer, r->text);
  return answer_error(r, r->status > 0 ? r->status : MHD_HTTP_SERVICE_UNAVAILABLE,
                      r->text != NULL ? r->text : "the server stops, or has no memory");
}

/* The offer is there; the answer comes from the library's thread. */
enum MHD_Result whep_end(struct request *r) {
  if (r->asked) return pass_answer(r);
  if (r->count == 0 || strlen(r->body) != r->count)
    return answer_error(r, MHD_HTTP_BAD_REQUEST, "expected an offer as SDP, without a byte of 0");
  if (!open_library(r->server))
    return answer_error(r, MHD_HTTP_NOT_IMPLEMENTED,
                        "no WebRTC here: expected libernerf-webrtc beside libernerf-serve, and GStreamer (Debian: "
                        "libernerf-webrtc0)");
  serve_lock(r->server);
  if (r->stream->broadcast.head.count == 0 && !r->stream->removed && serve_wait(r, WAITS_PART)) {
    serve_unlock(r->server);
    return MHD_YES; /* it is asked again when there is a picture, whose profile the answer names */
  }
  const bool fits = r->server->viewers < r->server->options.viewers, removed = r->stream->removed;
  r->whep = fits && !removed ? add_viewer(r) : NULL;
  if (r->whep != NULL) snprintf(r->answer, sizeof r->answer, "whep/%s", r->whep->key);
  r->asked = true;
  const bool waits = r->whep != NULL && serve_wait(r, WAITS_ANSWER);
  serve_unlock(r->server);
  if (waits) return MHD_YES;
  if (!fits) return answer_error(r, MHD_HTTP_SERVICE_UNAVAILABLE, "as many watch as --viewers admits");
  return removed ? answer_error(r, MHD_HTTP_GONE, "the session has ended") : pass_answer(r);
}

void whep_forget(struct request *r) {
  if (r->whep != NULL) r->whep->request = NULL; /* the viewer ends when its answer comes */
  r->whep = NULL;
}

enum MHD_Result whep_delete(struct request *r) {
  serve_lock(r->server);
  const struct whep_viewer *v = r->stream->peers;
  while (v != NULL && strcmp(v->key, r->key) != 0) v = v->following;
  if (v != NULL) r->server->webrtc_functions->end(v->peer);
  serve_unlock(r->server);
  if (v == NULL) return answer_error(r, MHD_HTTP_NOT_FOUND, "there is no such viewer, or it has left");
  return answer_json(r, MHD_HTTP_OK, json_pack("{s:b}", "ok", 1));
}

/* ---- the stream -------------------------------------------------------------------------------------------------- */

void whep_sound(struct ern_http_stream *s, const float *samples, size_t frames) {
  serve_lock(s->server);
  struct ern_webrtc_source *source = s->source;
  s->shown = s->heard;
  s->heard += frames;
  serve_unlock(s->server);
  if (source != NULL) s->server->webrtc_functions->sound(source, samples, frames, (double)s->shown / SOUND_RATE);
}

/* The thread that codes is the only one that changes the broadcast, and the source stays until it has ended. */
void whep_picture(struct ern_http_stream *s, ern_stream_piece piece) {
  const struct broadcast *b = &s->broadcast;
  const struct part *part = &b->parts[(b->next - 1) % BROADCAST_PARTS];
  const uint8_t *avcc, *unit;
  size_t avcc_bytes, bytes;
  serve_lock(s->server);
  struct ern_webrtc_source *source = s->source;
  serve_unlock(s->server);
  if (source == NULL || (piece != ERN_STREAM_KEY && piece != ERN_STREAM_FRAME)) return;
  if (fragment_avcc(b->head.bytes, b->head.count, &avcc, &avcc_bytes) &&
      fragment_picture(part->bytes, part->count, &unit, &bytes))
    s->server->webrtc_functions->picture(source, avcc, avcc_bytes, unit, bytes, piece == ERN_STREAM_KEY,
                                         (double)s->shown / SOUND_RATE);
}
