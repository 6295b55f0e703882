/* SPDX-License-Identifier: MIT
 * What is drawn behind a head: one background for the whole video, and for each frame of a clip its torso picture,
 * which separate threads read in advance. */
#ifndef ERN_CLI_BACKGROUND_H
#define ERN_CLI_BACKGROUND_H

#include <pthread.h>

#include "ernerf/media.h"
#include "session/frame_source.h"
#include "session/session.h"

/* BACKGROUND_WAITING: torso pictures beside those that are being read: two are drawn over, one is the next. */
enum { BACKGROUND_READERS = 8, BACKGROUND_WAITING = 3 };

struct background_torso {
  ern_image image; /* RGBA, of the frames' size */
  enum { TORSO_EMPTY, TORSO_READ, TORSO_FAILED } state;
};

struct background {
  int width, height; /* of the frames that are drawn */
  ern_fit fit;       /* how pictures of another aspect ratio are fitted */
  ern_image image;   /* RGB; data NULL: transparent */
  ern_image resized; /* the last scaled torso picture */
  /* the readers' */
  struct background_torso torso[BACKGROUND_READERS + BACKGROUND_WAITING]; /* that of frame k is at k % places */
  size_t places, readers;
  pthread_t reader[BACKGROUND_READERS];
  pthread_mutex_t mutex; /* guards the members below, and `state` */
  pthread_cond_t moved;
  size_t begun, released; /* frames: reading begun, picture no longer in use */
  bool stopped;
  double seconds; /* working time of the readers together */
  /* others' */
  size_t taken; /* frames whose picture the caller has asked for */
  ern_context *context;
  ern_clip *clip;
  const struct frame_source *frame_source;
};

/* The background is `choice`: a file, "white" or "black"; NULL: the clip's; with clip NULL too: none. A picture is
 * scaled and placed by ern_fit_box, and its edge pixels are repeated outside it. The clip's background, or black
 * without a clip, shows through its transparent pixels. Returns 0, or EXIT_FAILURE after a message. */
int background_open(struct background *background, struct session *session, const char *choice, const ern_clip *clip,
                    int width, int height, ern_fit fit);
/* May be called while the threads read. */
void background_free(struct background *background, struct session *session);
/* *rgba = the torso picture of a clip's frame in the size of the frames, NULL where the clip has none. Valid until the
 * next call. Returns as above. */
int background_torso(struct background *background, struct session *session, ern_clip *clip, ern_split split,
                     size_t index, const uint8_t **rgba);
/* Starts the threads that read the frames' torso pictures in advance. Until background_free no other code may read
 * pictures from the clip. Returns as above. */
int background_read(struct background *background, struct session *session, ern_clip *clip,
                    const struct frame_source *frame_source);
/* *rgba = the torso picture of the next frame in the size of the frames; at most once for each frame, by one thread at
 * a time. Returns as above; the error is that of the first frame whose picture cannot be read. */
int background_next_torso(struct background *background, struct session *session, const uint8_t **rgba);
/* Ends the use of the oldest picture of background_next_torso. At most BACKGROUND_WAITING - 1 are in use at a time. */
void background_release_torso(struct background *background);
/* Makes a transparent background black. */
int background_fill(struct background *background, struct session *session);

#endif
