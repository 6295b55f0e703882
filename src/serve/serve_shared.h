/* SPDX-License-Identifier: MIT
 * What the files of libernerf-serve share: the server, its streams, and a request from its first header to its last
 * byte. One lock guards all of it. It may be held where libmicrohttpd is called to suspend and resume a connection,
 * which takes locks of its own; libmicrohttpd holds none of those where it calls this library. */
#ifndef ERN_SERVE_SHARED_H
#define ERN_SERVE_SHARED_H

#include <jansson.h>
#include <microhttpd.h>
#include <pthread.h>
#include <stdatomic.h>

#include "serve/broadcast.h"
#include "serve/http_server.h"

enum { EVENTS = 256, ID_BYTES = 64, WHEP_KEY = 33 };

/* What was told of utterances, as server-sent events. Event number k is at k % EVENTS. */
struct event_log {
  char *text[EVENTS];
  uint64_t next;
};

/* A sound that comes in several requests, such as that of a page's microphone. */
struct pieces {
  char key[ID_BYTES]; /* that they all have; "": none came yet */
  int descriptor;     /* of its pipe; -1: it has ended */
  unsigned id;        /* its utterance */
  double last;        /* when the last piece came */
};

struct ern_webrtc;
struct ern_webrtc_functions;
struct ern_webrtc_source;
struct whep_viewer;

struct ern_http_stream {
  struct ern_http_server *server;
  struct ern_http_stream *following;
  char id[ID_BYTES];
  const struct ern_http_actions *actions;
  void *user;
  struct broadcast broadcast;
  struct event_log events;
  struct pieces pieces;
  char *state;                      /* JSON */
  unsigned viewers, users;          /* users: requests that hold it */
  uint64_t sent, dropped;           /* bytes to viewers; viewers that were too slow */
  struct whep_viewer *peers;        /* viewers by WebRTC */
  struct ern_webrtc_source *source; /* what they get; NULL: none has come yet */
  uint64_t heard, shown;            /* samples so far; those before the picture that is being coded */
  bool removed, acts;               /* acts: an action is being called, so that its user must stay */
};

/* What a suspended request waits for. */
enum waits { WAITS_NOT, WAITS_PART, WAITS_EVENT, WAITS_ANSWER, WAITS_PIPE };

struct route;

struct request {
  struct ern_http_server *server;
  struct request *before, *after; /* of the server's list */
  struct MHD_Connection *connection;
  const struct route *route;
  struct ern_http_stream *stream; /* NULL: it is about none */
  enum waits waits;
  char *body;                       /* ended by a 0 */
  size_t count, room, most, thrown; /* thrown: bytes beyond `most`, which are not kept */
  int descriptor;                   /* of a pipe; -1: none */
  unsigned id;                      /* of its utterance */
  bool last;                        /* it is the last of several with pieces of one sound */
  bool cut;                         /* the pipe's reader has gone: the rest of the sound is not wanted */
  bool asked, answered;             /* a line: it is passed on; its answer is there */
  char answer[1100];                /* of WHEP: the address of the viewer */
  struct whep_viewer *whep;         /* that is being answered; NULL: none */
  unsigned status;                  /* its answer, of HTTP */
  char *text;                       /* and what it says */
  char key[WHEP_KEY];               /* of the address */
  struct ern_http_place viewer;
  bool watches;    /* it counts among the viewers */
  uint64_t event;  /* the next one to send */
  size_t event_at; /* bytes of it that are sent */
  double spoken;   /* when it was last sent something */
};

/* A connection, by which one that stands still is found. */
struct line_held {
  struct line_held *before, *after;
  int descriptor;
  double since; /* it waits for a request, or the rest of one that is text; 0: for neither */
};

struct ern_http_server {
  struct ern_http_options options;
  char *texts[6]; /* of the options, copied */
  pthread_mutex_t mutex;
  pthread_t keeper;
  bool keeps; /* the thread runs */
  atomic_bool stopping;
  struct MHD_Daemon *daemon;
  struct ern_http_stream *streams;
  struct request *requests;
  struct line_held *lines;
  unsigned viewers;
  const char *version;
  const struct ern_webrtc_functions *webrtc_functions;
  struct ern_webrtc *webrtc; /* NULL: not opened */
  uint64_t asked, refused;   /* requests */
};

double serve_seconds(void); /* of a monotonic clock */
/* Lets the connection stand until serve_wake. The caller holds the lock. False: the server stops, so it must not. */
bool serve_wait(struct request *request, enum waits waits);
/* Wakes the requests that wait for that; stream NULL: of all. The caller holds the lock. */
void serve_wake(struct ern_http_server *server, const struct ern_http_stream *stream, enum waits waits);
void serve_lock(struct ern_http_server *server);
void serve_unlock(struct ern_http_server *server);
/* Before and after an action is called. False: the session has gone. */
bool serve_enter(struct ern_http_stream *stream);
void serve_leave(struct ern_http_stream *stream);
/* The stream is used by one request less. The caller holds the lock. */
void serve_release(struct ern_http_stream *stream);
/* The sound that comes in pieces has ended. The caller holds the lock. */
void serve_end_pieces(struct ern_http_stream *stream);
/* Adds an event, and wakes those who wait for one. The caller holds the lock. */
void serve_tell(struct ern_http_stream *stream, const char *word, unsigned id, double seconds, const char *reason);

/* ---- guard.c: who may ask ---- */

enum role { ROLE_ANY, ROLE_WATCH, ROLE_SAY };

/* Whether the request's Host, Origin and token are such as the options want. *status: else the one to refuse with.
 * Returns NULL, or why not. */
const char *guard_refusal(const struct ern_http_server *server, struct MHD_Connection *connection, enum role role,
                          bool is_page, unsigned *status);
/* The Origin of the request, where it is that of the options; else NULL. */
const char *guard_origin(const struct ern_http_server *server, struct MHD_Connection *connection);

/* ---- events.c ---- */

/* data: one line. */
void events_add(struct event_log *log, const char *word, const char *data);
/* Copies up to `most` bytes of the events from r->event on. Returns their number; 0: none. */
ssize_t events_read(const struct event_log *log, struct request *r, void *to, size_t most);
void events_free(struct event_log *log);

/* ---- serve_metrics.c ---- */

/* sessions: an array of states. The caller frees the text; NULL without memory. The caller holds the lock. */
char *metrics_text(const struct ern_http_server *server, json_t *sessions, size_t *bytes);

/* ---- routes.c: what can be asked ---- */

struct route {
  const char *method, *path; /* path: "/v1/sessions/ID/say"; a part "ID" is a session's, "KEY" at the end a viewer's */
  enum role role;
  /* Called when the head is there. Without `end` it queues a response; with it only to refuse, and sets `answered`. */
  enum MHD_Result (*begin)(struct request *request);
  enum MHD_Result (*end)(struct request *request); /* called when all is there; queues a response, or waits */
};

/* Finds route and stream, which the request then holds; *status: 404 or 405. Returns NULL, or why not. */
const char *route_find(struct request *request, const char *url, const char *method, unsigned *status);
/* The methods of a path, "GET, POST"; "": there is no such path. */
void route_methods(const char *url, char *methods, size_t bytes);

/* ---- answers.c ---- */

/* Queues a response with a JSON object, whose reference is taken; NULL: there was no memory. */
enum MHD_Result answer_json(struct request *request, unsigned status, json_t *object);
/* The same with {"error": REASON}. */
enum MHD_Result answer_error(struct request *request, unsigned status, const char *reason);
/* 201 with the SDP of an answer, which is copied, and where the viewer's address is. */
enum MHD_Result answer_created(struct request *request, const char *location, const char *sdp);
/* bytes: constant. */
enum MHD_Result answer_constant(struct request *request, const char *type, const void *bytes, size_t count);
/* Takes the text; NULL: there was no memory. */
enum MHD_Result answer_text(struct request *request, const char *type, char *text, size_t count);
/* Bytes that `read` hands out (MHD_ContentReaderCallback). */
enum MHD_Result answer_stream(struct request *request, const char *type, MHD_ContentReaderCallback read);
enum MHD_Result answer_methods(struct request *request, const char *methods);

/* requests.c: MHD_AccessHandlerCallback, and MHD_RequestCompletedCallback. */
enum MHD_Result request_handle(void *user, struct MHD_Connection *connection, const char *url, const char *method,
                               const char *version, const char *bytes, size_t *count, void **request);
void request_end(void *user, struct MHD_Connection *connection, void **request, enum MHD_RequestTerminationCode why);

#endif
