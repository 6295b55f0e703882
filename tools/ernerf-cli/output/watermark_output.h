/* SPDX-License-Identifier: MIT
 * --watermark: a pattern on the frames that `ernerf detect` finds again. */
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
/* EXIT_USAGE after a sentence, or -1. */
int watermark_check(const struct watermark *watermark, const struct args *args);
/* For frames of that size. Returns 0, or EXIT_FAILURE after a message. */
int watermark_make(struct watermark *watermark, struct session *session, int width, int height);
/* Puts it on a frame of that size, [height][width][4]. */
int watermark_put(const struct watermark *watermark, struct session *session, uint8_t *rgba);
void watermark_free(struct watermark *watermark);

#endif
