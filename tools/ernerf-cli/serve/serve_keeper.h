/* SPDX-License-Identifier: MIT
 * The sessions of a server: which there are, further ones that requests ask for, and whether the machine is fast enough
 * for them. */
#ifndef ERN_CLI_SERVE_KEEPER_H
#define ERN_CLI_SERVE_KEEPER_H

#include "serve/serve_session.h"

enum { SERVE_PORTRAITS = 8, SERVE_SESSIONS = 32 };

/* A portrait of the command line, which its sessions share. */
struct serve_portrait {
  const char *path;
  char id[SERVE_ID], clip[4096]; /* its first session; the clip's folder, where no option names it */
  ern_model *model;
  struct rate_control measured; /* the settings and times that its first session found */
  bool is_measured;
};

/* What a request asks for. */
struct serve_wish {
  bool creates;
  char portrait[SERVE_ID], id[SERVE_ID];
  void *token; /* NULL: there is none */
};

struct serve_keeper {
  /* set by the verb */
  const struct live_job *live; /* the options of every session, and the program's own session */
  const struct args *args;
  const struct ern_http_functions *http;
  struct ern_http_server *server;
  const char *name, *record; /* NULL: none */
  struct text_list push;     /* addresses that the first session's stream goes to */
  /* made */
  struct serve_portrait portraits[SERVE_PORTRAITS];
  size_t portrait_count;
  struct serve_session *sessions[SERVE_SESSIONS];
  int cores, threads; /* threads: of a session, where no option says how many */
  double until;       /* by session_seconds: when --duration ends further sessions, and the wait for them; 0: never */
  bool stays;         /* the server stays where no session is left, as a request has ended the last one */
  pthread_mutex_t mutex; /* guards `wish` */
  struct serve_wish wish;
};

/* Whether it is a name for an address: letters, digits, ., - and _, and does not begin with a dot. */
bool serve_is_name(const char *name);

/* Opens the portraits of `paths`, up to the first NULL, with a session each. Returns 0, or EXIT_FAILURE after a
 * message; serve_keeper_close in either case. */
int serve_keeper_open(struct serve_keeper *keeper, const char *const paths[SERVE_PORTRAITS]);
/* Does what a request asks for, and warns of a session that has failed. false: none is left. */
bool serve_keeper_look(struct serve_keeper *keeper);
void serve_keeper_close(struct serve_keeper *keeper);

/* For struct ern_http_keeper, on the server's thread. `user`: the keeper. */
bool serve_keeper_create(void *user, const char *portrait, const char *id, void *token, struct ern_http_reply *reply);
bool serve_keeper_end(void *user, const char *id, void *token, struct ern_http_reply *reply);

#endif
