/* SPDX-License-Identifier: MIT
 * What a renderer keeps between the frames of a video: the options, and what came of it. */
#ifndef ERN_CLI_FRAME_REUSE_H
#define ERN_CLI_FRAME_REUSE_H

#include <jansson.h>

#include "session/portrait.h"

struct frame_reuse {
  /* from the command line */
  float levels; /* most that a pixel may be off, of 255 */
  bool off;
  /* made */
  bool stands; /* the camera stands long enough for rays to be kept */
};

enum { FRAME_REUSE_OPTIONS = 2 };
/* The defaults, and --reuse-rays --no-reuse-rays. */
void frame_reuse_options(struct frame_reuse *frame_reuse, struct option options[FRAME_REUSE_OPTIONS]);
/* What does not go together: as args_refuse. */
int frame_reuse_check(const struct args *args);

/* Tells the renderer what to keep while these frames are drawn. Returns 0, or EXIT_FAILURE after a message. */
int frame_reuse_open(struct frame_reuse *frame_reuse, struct portrait *portrait, struct session *session,
                     const struct frame_source *frame_source, const ern_features *features);

/* {"bound": of 255, "rays": share rendered anew, "samples": likewise}; null where nothing is kept. */
json_t *frame_reuse_report(const struct frame_reuse *frame_reuse, const struct portrait *portrait);
/* The same in words, beginning with a comma; empty where the camera does not stand. */
void frame_reuse_say(const struct frame_reuse *frame_reuse, const struct portrait *portrait, char *text,
                     size_t capacity);

#endif
