/* SPDX-License-Identifier: MIT
 * What stands behind a head: a background for the whole video, and the torso picture of each frame of a clip, which a
 * thread of its own reads ahead. */
#ifndef ERN_CLI_BACKGROUND_H
#define ERN_CLI_BACKGROUND_H

#include "bounded_queue.h"
#include "ernerf/media.h"
#include "session/frame_source.h"
#include "session/session.h"

enum { BACKGROUND_TORSOS = 3 };

struct background {
  int width, height; /* of the frames that are drawn */
  ern_fit fit;       /* how pictures of another aspect go into them */
  ern_image image;   /* RGB; data NULL: transparent */
  ern_image resized; /* the torso picture that was scaled last */
  /* the reader's */
  uint8_t *torso[BACKGROUND_TORSOS]; /* [height][width][4] */
  struct bounded_queue queue;
  pthread_t reader;
  bool running, holding; /* holding: the caller looks at the oldest one */
  ern_context *context;
  ern_clip *clip;
  const struct frame_source *frame_source;
  char *error;    /* why the reader gave up; NULL: it did not. To be read after it has ended */
  double seconds; /* that the reader worked */
};

/* The background is `choice`: a file, "white" or "black"; without it (NULL) that of the clip; without a clip (NULL)
 * none. A picture is scaled and placed by ern_fit_box, and its edge pixels go on beside it; where it is
 * transparent the clip's background shows, without a clip black. Returns 0, or EXIT_FAILURE
 * after a message. */
int background_open(struct background *background, struct session *session, const char *choice, const ern_clip *clip,
                    int width, int height, ern_fit fit);
/* Also while it reads. */
void background_free(struct background *background, struct session *session);
/* *rgba = the torso picture of a clip's frame in the size of the frames, NULL where the clip has none. Valid until the
 * next call. Returns as above. */
int background_torso(struct background *background, struct session *session, ern_clip *clip, ern_split split,
                     size_t index, const uint8_t **rgba);
/* Starts to read the torso pictures of the frames, in their order. Until background_free nobody else may ask the clip
 * for pictures. Returns as above. */
int background_read(struct background *background, struct session *session, ern_clip *clip,
                    const struct frame_source *frame_source);
/* *rgba = the torso picture of the next frame in the size of the frames. Valid until the next call. Returns as above.
 */
int background_next_torso(struct background *background, struct session *session, const uint8_t **rgba);
/* Makes a transparent background black. */
int background_fill(struct background *background, struct session *session);

#endif
