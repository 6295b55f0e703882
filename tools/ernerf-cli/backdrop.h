/* SPDX-License-Identifier: MIT
 * What stands behind a head: a background for the whole video, and the torso picture of each frame of a clip. */
#ifndef ERN_CLI_BACKDROP_H
#define ERN_CLI_BACKDROP_H

#include "ernerf/media.h"
#include "session.h"

struct backdrop {
  int width, height;    /* of the frames that are drawn */
  ern_image background; /* RGB; data NULL: transparent */
  ern_image torso;      /* the resized one of the last frame */
};

/* The background is `choice`: a file, "white" or "black"; without it (NULL) that of the clip; without a clip (NULL)
 * none. Returns 0, or EXIT_FAILURE after a message. */
int backdrop_open(struct backdrop *backdrop, struct session *session, const char *choice, const ern_clip *clip,
                  int width, int height);
void backdrop_free(struct backdrop *backdrop, struct session *session);
/* *rgba = the torso picture of a clip's frame in the size of the frames, NULL where the clip has none. Valid until the
 * next call. Returns as above. */
int backdrop_torso(struct backdrop *backdrop, struct session *session, ern_clip *clip, ern_split split, size_t index,
                   const uint8_t **rgba);
/* Makes a transparent background black. */
int backdrop_fill(struct backdrop *backdrop, struct session *session);

#endif
