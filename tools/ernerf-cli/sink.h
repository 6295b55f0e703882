/* SPDX-License-Identifier: MIT
 * Where frames go: a video, numbered pictures, or raw pixels on standard output. */
#ifndef ERN_CLI_SINK_H
#define ERN_CLI_SINK_H

#include "ernerf/media.h"
#include "ernerf/render.h"
#include "session.h"

enum sink_kind {
  SINK_VIDEO, /* NAME.mp4 */
  SINK_PNG,   /* NAME%05d.png: RGBA, alpha not multiplied in */
  SINK_EXR,   /* NAME%05d.exr: RGBA, alpha multiplied in; depth; attention */
  SINK_RAW    /* -: RGBA8 on standard output */
};

struct sink {
  const char *path;
  enum sink_kind kind;
  int width, height;
  ern_video_writer *video;
  uint8_t *rgba; /* [height][width][4]; of all but SINK_EXR */
  /* of SINK_EXR: [height][width] each, rgb [3]; and what is written, [height][width][channels] */
  float *rgb, *alpha, *depth, *attention, *eye, *channels;
  bool has_eye;
};

/* What kind `path` names. Returns -1 to go on, or EXIT_USAGE after a sentence. */
int sink_choose(struct sink *sink, const struct args *args, const char *path);

/* Makes room and opens the video, with `sound` from `sound_start` seconds on (NULL: silent). has_eye: the attention of
 * the eye is written too. Returns 0, or EXIT_FAILURE after a message, as the next two. */
int sink_open(struct sink *sink, struct session *session, int width, int height, bool has_eye, const ern_sound *sound,
              double sound_start);
/* Where the renderer has to put a frame for sink_put. */
ern_frame_output sink_room(const struct sink *sink);
/* Writes the frame that is in the room. `number` names its picture. */
int sink_put(struct sink *sink, struct session *session, size_t number);
/* Ends the output; a video appears at its place only now. */
int sink_close(struct sink *sink, struct session *session);
/* Frees all; a video that was not closed is taken away. */
void sink_free(struct sink *sink);

#endif
