/* SPDX-License-Identifier: MIT
 * The front that `ernerf tradeoff` left in tradeoff.json: read with suspicion, for verbs that pick a point of it. */
#ifndef ERN_CLI_FRONT_READ_H
#define ERN_CLI_FRONT_READ_H

#include "front.h"
#include "session.h"
#include "settings.h"

enum { FRONT_NAME_BYTES = 128 };

struct front_point {
  char name[FRONT_NAME_BYTES];
  struct settings settings;
  struct spread ms;         /* a frame, milliseconds */
  double exact_db, clip_db; /* mean PSNR */
};

struct front {
  char model_sha256[65]; /* of the model's file */
  char cpu[FRONT_NAME_BYTES];
  int cores, width, height;   /* of the machine; of the pictures */
  struct front_point *points; /* [count >= 1], the fastest first, against the exact render */
  size_t count;
};

/* Returns 0, or EXIT_FAILURE after a message that names file and member. front_free in either case. */
int front_read(struct front *front, struct session *session, const char *path);
void front_free(struct front *front);

#endif
