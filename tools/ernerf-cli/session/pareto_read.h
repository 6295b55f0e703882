/* SPDX-License-Identifier: MIT
 * Reads the Pareto front that `ernerf tradeoff` wrote to tradeoff.json, for verbs that choose a point of it. Every
 * member is validated. */
#ifndef ERN_CLI_PARETO_READ_H
#define ERN_CLI_PARETO_READ_H

#include "session/pareto.h"
#include "session/session.h"
#include "session/settings.h"

enum { PARETO_NAME_BYTES = 128 };

struct pareto_point {
  char name[PARETO_NAME_BYTES];
  struct settings settings;
  struct quartiles ms;      /* time of a frame, milliseconds */
  double exact_db, clip_db; /* mean PSNR */
};

struct pareto_front {
  char model_sha256[65]; /* of the model's file */
  char cpu[PARETO_NAME_BYTES];
  int cores, width, height;    /* cores of the machine; size of the pictures in pixels */
  struct pareto_point *points; /* [count >= 1], the fastest first: the front by PSNR against the exact render */
  size_t count;
};

/* Returns 0, or EXIT_FAILURE after a message that names the file and the member. pareto_free in either case. */
int pareto_read(struct pareto_front *front, struct session *session, const char *path);
void pareto_free(struct pareto_front *front);

#endif
