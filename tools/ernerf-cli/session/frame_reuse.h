/* SPDX-License-Identifier: MIT
 * Reuse of rays between the frames of a video: the options, and the report of the work saved. */
#ifndef ERN_CLI_FRAME_REUSE_H
#define ERN_CLI_FRAME_REUSE_H

#include <jansson.h>

#include "session/portrait.h"

struct frame_reuse {
  /* from the command line */
  float levels; /* largest error of a pixel, in levels of 255; below 0: no ray is reused */
  /* made */
  bool camera_is_still;    /* the camera is still for enough frames for rays to be reused */
  ern_ray_reuse_work work; /* of all renderers */
};

enum { FRAME_REUSE_OPTIONS = 1 };
/* The default, and --set reuse-rays. */
void frame_reuse_options(struct frame_reuse *frame_reuse, struct option options[FRAME_REUSE_OPTIONS]);

/* Sets up the renderer's ray reuse for these frames. Returns 0, or EXIT_FAILURE after a message. */
int frame_reuse_open(struct frame_reuse *frame_reuse, struct portrait *portrait, struct session *session,
                     const struct frame_source *frame_source, const ern_features *features);

/* Adds the work of a renderer that has drawn its frames. */
void frame_reuse_add(struct frame_reuse *frame_reuse, const ern_renderer *renderer);

/* {"bound": levels of 255, "frames": without keyframes, "rays": share of rays rendered again, "samples": share of
 * samples}; null if nothing is reused. */
json_t *frame_reuse_report(const struct frame_reuse *frame_reuse);
/* The same in words, beginning with a comma; empty if the camera is not still. */
void frame_reuse_say(const struct frame_reuse *frame_reuse, char *text, size_t capacity);

#endif
