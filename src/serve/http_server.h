/* SPDX-License-Identifier: MIT
 * libernerf-serve: an HTTP server that gives coded streams to many viewers, and passes on what sessions are asked to
 * do. It knows no portraits. The program opens the library for the verb `serve`, and looks up one table of functions.
 */
#ifndef ERN_SERVE_HTTP_SERVER_H
#define ERN_SERVE_HTTP_SERVER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "ernerf/base.h"
#include "ernerf/stream.h"

struct ern_http_server;
struct ern_http_stream; /* of a session: its viewers, events and state */

enum { ERN_HTTP_TEXT = 16384 /* bytes of a text to say, and of any other body that is text */ };

/* Why an action is refused. */
struct ern_http_reply {
  unsigned status; /* of HTTP */
  char reason[1024];
};

/* What the program can be asked for besides; as the actions of a session, `line` for all. false: refused. Else it is
 * answered by `answer` with `token`, once, on any thread. */
struct ern_http_keeper {
  bool (*create)(void *user, const char *portrait, const char *id, void *token, struct ern_http_reply *reply);
  bool (*end)(void *user, const char *id, void *token, struct ern_http_reply *reply);
  void *user;
};

struct ern_http_options {
  const char *listen; /* an IP address */
  int port;           /* 0: any that is free */
  const char *host;   /* a name that requests may have as Host, beside IP addresses and localhost; NULL: none */
  const char *origin; /* of pages, beside those of this server, that may ask; NULL: none */
  const char *say_token, *watch_token; /* NULL: anybody may */
  unsigned connections, viewers;       /* most of each, of all sessions together */
  const char *stun;                    /* of viewers by WebRTC: "stun://HOST:PORT"; NULL: none */
  int first_port, last_port;           /* of UDP, for viewers by WebRTC; 0: those that the system chooses */
  struct ern_http_keeper keeper;
  double patience; /* seconds that a request may take to come, and that a connection may stand still */
};

/* How sound comes that has no header; format NULL: it has one. */
struct ern_http_sound {
  const char *format; /* a constant */
  int rate, channels;
};

/* What a session can be asked for. All is called on the server's thread and must not wait. An ID of 0: refused, as
 * *reply says. */
struct ern_http_actions {
  unsigned (*say)(void *user, const char *text, struct ern_http_reply *reply);
  /* *descriptor: of a pipe that does not block, into which the sound is written, and which the server closes. */
  unsigned (*sound)(void *user, const struct ern_http_sound *sound, int *descriptor, struct ern_http_reply *reply);
  void (*stop)(void *user);
  /* A line as of `live --control`, and bytes that it is about, which are taken over (NULL: none). It is answered by
   * `answer` with `token`, once, on any thread. false: refused, and nothing is taken over. */
  bool (*line)(void *user, const char *line, void *bytes, size_t count, void *token, struct ern_http_reply *reply);
};

/* Where a reader of a stream is; zeros: at its beginning. */
struct ern_http_place {
  bool begun; /* it has, or is getting, the head */
  bool has_head;
  uint64_t part;
  size_t at; /* bytes of the head or part that it has */
};

struct ern_http_functions {
  const char *version; /* ERN_INTERFACE_VERSION */
  /* error: why it could not start. On success the caller owns *server. */
  bool (*start)(const struct ern_http_options *options, struct ern_http_server **server, char *error, size_t bytes);
  int (*port)(const struct ern_http_server *server);
  /* Ends all connections. No line may wait for its answer, and no other call may be under way. */
  void (*stop)(struct ern_http_server **server);
  /* id: letters, digits, ., - and _. NULL without memory. Requests find it once it has a state. */
  struct ern_http_stream *(*add)(struct ern_http_server *server, const char *id, const struct ern_http_actions *actions,
                                 void *user);
  /* Ends the stream for its viewers; no action is called any more. No line may wait for its answer. */
  void (*remove)(struct ern_http_stream **stream);
  /* An ern_stream_options.write, of which `stream` is the user. */
  int (*write)(void *stream, const void *bytes, size_t count, ern_stream_piece piece);
  /* Up to `most` of the next bytes, from the head and the newest key frame on; 0: none yet; -1: the stream has ended,
   * or the reader fell too far behind. Does not wait. */
  ptrdiff_t (*read)(struct ern_http_stream *stream, struct ern_http_place *place, void *to, size_t most);
  /* Samples that belong to the next picture of the stream, before it: [frames], mono, 48000 a second. */
  void (*sound)(struct ern_http_stream *stream, const float *samples, size_t frames);
  /* word: "started", "ended", "interrupted" or "failed"; seconds: in the stream; reason: NULL, or why. */
  void (*event)(struct ern_http_stream *stream, const char *word, unsigned id, double seconds, const char *reason);
  /* json: an object, the figures of the session; its numbers are metrics too. */
  void (*state)(struct ern_http_stream *stream, const char *json);
  /* text: "ok", "error: REASON", or "busy: REASON" where it might be taken later. */
  void (*answer)(void *token, const char *text);
};

extern ERN_API const struct ern_http_functions ern_http_functions;

#endif
