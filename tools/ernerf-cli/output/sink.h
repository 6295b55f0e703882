/* SPDX-License-Identifier: MIT
 * Where frames go: a video, numbered pictures, or standard output, raw or as a stream. A thread of its own converts,
 * encodes and writes them, in order, while the next ones are drawn. */
#ifndef ERN_CLI_SINK_H
#define ERN_CLI_SINK_H

#include "bounded_queue.h"
#include "ernerf/media.h"
#include "ernerf/render.h"
#include "ernerf/stream.h"
#include "output/provenance_output.h"
#include "session/frame_source.h"
#include "session/session.h"

enum sink_kind {
  SINK_VIDEO,  /* NAME.mp4 and others */
  SINK_PNG,    /* NAME%05d.png: RGBA, alpha not multiplied in */
  SINK_JPEG,   /* NAME%05d.jpg: RGB */
  SINK_EXR,    /* NAME%05d.exr: RGBA, alpha multiplied in; depth; attention */
  SINK_RAW,    /* -: RGBA8 on standard output */
  SINK_STREAM, /* - with a form: a stream on standard output */
};

/* Where a frame lies between drawing and writing. */
struct sink_picture {
  uint8_t *rgba;                                /* [height][width][4]; of all but SINK_EXR */
  float *rgb, *alpha, *depth, *attention, *eye; /* of SINK_EXR: [height][width] each, rgb [3] */
  size_t number;                                /* of the frame, for its picture's name */
};

/* One is drawn into while another is written and one waits, so that neither thread stands still for an uneven frame. */
enum { SINK_PICTURES = 3 };

struct sink {
  /* from the command line */
  int crf, codec, preset; /* index of the choices; -1: the default */
  int format;             /* of standard output, index */
  /* made */
  const char *path;
  enum sink_kind kind;
  int width, height;
  ern_video_writer *video;
  ern_stream_writer *stream;
  const ern_sound *sound; /* of the stream, from `first` on, `rate` pictures a second; NULL: silent */
  size_t first, streamed; /* samples; pictures */
  struct rate rate;
  float *samples; /* of a picture */
  struct sink_picture pictures[SINK_PICTURES];
  float *channels;             /* of SINK_EXR, what is written: [height][width][channels] */
  bool has_attention, has_eye; /* channels of SINK_EXR */
  struct bounded_queue queue;  /* pictures on their way to the writer */
  pthread_t writer;
  bool running;
  ern_context *context;
  const ern_provenance *provenance; /* what the output says of itself; NULL: nothing */
  char *error;                      /* of the writer: why it gave up; NULL: it did not. To be read after it has ended */
  double seconds;                   /* that the writer worked */
};

enum { SINK_OPTIONS = 4 };
/* --crf --preset --codec --format. */
void sink_options(struct sink *sink, struct option options[SINK_OPTIONS]);

/* Whether it has no place for alpha; whether it has one for sound. */
bool sink_is_opaque(const struct sink *sink);
bool sink_has_sound(const struct sink *sink);
bool sink_on_stdout(const struct sink *sink);

/* What kind `path` names. Returns -1 to go on, or EXIT_USAGE after a sentence. */
int sink_choose(struct sink *sink, const struct args *args, const char *path);

/* Fails where a file of the output is there already and --overwrite was not given, or cannot be written. A video is
 * asked about without `frame_source`, pictures with it. Returns 0, or EXIT_FAILURE after a message. */
int sink_check(const struct sink *sink, struct session *session, const struct frame_source *frame_source);

/* Makes room, opens the video of `rate` frames a second and starts the writer, with `sound` from `sound_start` seconds
 * on (NULL: silent). model: what it has attention for is written too. provenance must outlive the sink. Returns 0, or
 * EXIT_FAILURE after a message, as the next ones. */
int sink_open(struct sink *sink, struct session *session, int width, int height, struct rate rate,
              const ern_model_info *model, const ern_sound *sound, double sound_start,
              const ern_provenance *provenance);
/* *output = where the renderer has to put the next frame, once one is free. Fails where the writer has failed. */
int sink_next(struct sink *sink, struct session *session, ern_frame_output *output);
/* Hands the picture of the last sink_next to the writer. `number` names its picture. */
void sink_put(struct sink *sink, size_t number);
/* Waits for the last frame and ends the output; a video appears at its place only now. */
int sink_close(struct sink *sink, struct session *session);
/* Frees all, wherever it stands; a video that was not closed is taken away. */
void sink_free(struct sink *sink);

#endif
