/* SPDX-License-Identifier: MIT
 * What a renderer keeps between the frames of a video: the options, and what came of it. */
#ifndef ERN_CLI_STILLNESS_H
#define ERN_CLI_STILLNESS_H

#include <jansson.h>

#include "portrait.h"

struct stillness {
  /* from the command line */
  float levels; /* most that a pixel may be off, of 255 */
  bool off;
  /* made */
  bool stands; /* the camera stands long enough for rays to be kept */
};

enum { STILLNESS_OPTIONS = 2 };
/* The defaults, and --still --no-still. */
void stillness_options(struct stillness *stillness, struct option options[STILLNESS_OPTIONS]);
/* What does not go together: as args_refuse. */
int stillness_check(const struct args *args);

/* Tells the renderer what to keep while these shots are drawn. Returns 0, or EXIT_FAILURE after a message. */
int stillness_open(struct stillness *stillness, struct portrait *portrait, struct session *session,
                   const struct shots *shots, const ern_features *features);

/* {"bound": of 255, "rays": share rendered anew, "samples": likewise}; null where nothing is kept. */
json_t *stillness_report(const struct stillness *stillness, const struct portrait *portrait);
/* The same in words, beginning with a comma; empty where the camera does not stand. */
void stillness_say(const struct stillness *stillness, const struct portrait *portrait, char *text, size_t room);

#endif
