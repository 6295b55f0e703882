/* SPDX-License-Identifier: MIT
 * --watermark: a pattern in the frames that `ernerf detect` detects. */
#ifndef ERN_CLI_WATERMARK_H
#define ERN_CLI_WATERMARK_H

#include "ernerf/media.h"
#include "session/session.h"

enum { WATERMARK_OPTIONS = 1 };

struct watermark {
  const char *key; /* NULL: no watermark */
  ern_watermark *pattern;
};

/* --watermark. */
void watermark_options(struct watermark *watermark, struct option options[WATERMARK_OPTIONS]);
/* EXIT_USAGE after a message, or -1. */
int watermark_check(const struct watermark *watermark, const struct args *args);
/* Creates the pattern for frames of this size. Returns 0, or EXIT_FAILURE after a message. */
int watermark_make(struct watermark *watermark, struct session *session, int width, int height);
/* Adds the pattern to a frame of that size, [height][width][4]. */
int watermark_put(const struct watermark *watermark, struct session *session, uint8_t *rgba);
void watermark_free(struct watermark *watermark);

#endif
