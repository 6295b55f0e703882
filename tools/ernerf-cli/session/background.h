/* SPDX-License-Identifier: MIT
 * What is drawn behind a head: one background for the whole video, and for each frame of a clip its torso picture,
 * which a separate thread reads in advance. */
#ifndef ERN_CLI_BACKGROUND_H
#define ERN_CLI_BACKGROUND_H

#include "bounded_queue.h"
#include "ernerf/media.h"
#include "session/frame_source.h"
#include "session/session.h"

enum { BACKGROUND_TORSOS = 3 };

struct background {
  int width, height; /* of the frames that are drawn */
  ern_fit fit;       /* how pictures of another aspect ratio are fitted */
  ern_image image;   /* RGB; data NULL: transparent */
  ern_image resized; /* the last scaled torso picture */
  /* the reader thread's */
  uint8_t *torso[BACKGROUND_TORSOS]; /* [height][width][4] */
  struct bounded_queue queue;
  pthread_t reader;
  bool running, holding; /* holding: the caller uses the oldest picture */
  ern_context *context;
  ern_clip *clip;
  const struct frame_source *frame_source;
  char *error;    /* why the reader failed; NULL: it did not. Read it after the thread has ended */
  double seconds; /* working time of the reader */
};

/* The background is `choice`: a file, "white" or "black"; NULL: the clip's; with clip NULL too: none. A picture is
 * scaled and placed by ern_fit_box, and its edge pixels are repeated outside it. The clip's background, or black
 * without a clip, shows through its transparent pixels. Returns 0, or EXIT_FAILURE after a message. */
int background_open(struct background *background, struct session *session, const char *choice, const ern_clip *clip,
                    int width, int height, ern_fit fit);
/* May be called while the thread reads. */
void background_free(struct background *background, struct session *session);
/* *rgba = the torso picture of a clip's frame in the size of the frames, NULL where the clip has none. Valid until the
 * next call. Returns as above. */
int background_torso(struct background *background, struct session *session, ern_clip *clip, ern_split split,
                     size_t index, const uint8_t **rgba);
/* Starts the thread that reads the frames' torso pictures in order. Until background_free no other code may read
 * pictures from the clip. Returns as above. */
int background_read(struct background *background, struct session *session, ern_clip *clip,
                    const struct frame_source *frame_source);
/* *rgba = the torso picture of the next frame in the size of the frames. Valid until the next call. Returns as above.
 */
int background_next_torso(struct background *background, struct session *session, const uint8_t **rgba);
/* Makes a transparent background black. */
int background_fill(struct background *background, struct session *session);

#endif
