/* SPDX-License-Identifier: MIT
 * What stands behind a head: a background for the whole video, and the torso picture of each frame of a clip, which a
 * thread of its own reads ahead. */
#ifndef ERN_CLI_BACKDROP_H
#define ERN_CLI_BACKDROP_H

#include "belt.h"
#include "ernerf/media.h"
#include "session.h"
#include "shots.h"

enum { BACKDROP_TORSOS = 3 };

struct backdrop {
  int width, height;    /* of the frames that are drawn */
  ern_fit fit;          /* how pictures of another aspect go into them */
  ern_image background; /* RGB; data NULL: transparent */
  ern_image resized;    /* the torso picture that was scaled last */
  /* the reader's */
  uint8_t *torso[BACKDROP_TORSOS]; /* [height][width][4] */
  struct belt belt;
  pthread_t reader;
  bool running, holding; /* holding: the caller looks at the oldest one */
  ern_context *context;
  ern_clip *clip;
  const struct shots *shots;
  char *trouble;  /* why the reader gave up; NULL: it did not. To be read after it has ended */
  double seconds; /* that the reader worked */
};

/* The background is `choice`: a file, "white" or "black"; without it (NULL) that of the clip; without a clip (NULL)
 * none. A picture is scaled and placed by ern_fit_box, and its edge pixels go on beside it. Returns 0, or EXIT_FAILURE
 * after a message. */
int backdrop_open(struct backdrop *backdrop, struct session *session, const char *choice, const ern_clip *clip,
                  int width, int height, ern_fit fit);
/* Also while it reads. */
void backdrop_free(struct backdrop *backdrop, struct session *session);
/* *rgba = the torso picture of a clip's frame in the size of the frames, NULL where the clip has none. Valid until the
 * next call. Returns as above. */
int backdrop_torso(struct backdrop *backdrop, struct session *session, ern_clip *clip, ern_split split, size_t index,
                   const uint8_t **rgba);
/* Starts to read the torso pictures of the shots, in their order. Until backdrop_free nobody else may ask the clip for
 * pictures. Returns as above. */
int backdrop_read(struct backdrop *backdrop, struct session *session, ern_clip *clip, const struct shots *shots);
/* *rgba = the torso picture of the next shot in the size of the frames. Valid until the next call. Returns as above. */
int backdrop_next_torso(struct backdrop *backdrop, struct session *session, const uint8_t **rgba);
/* Makes a transparent background black. */
int backdrop_fill(struct backdrop *backdrop, struct session *session);

#endif
