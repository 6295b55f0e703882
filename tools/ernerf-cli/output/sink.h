/* SPDX-License-Identifier: MIT
 * Output of frames: a video, numbered pictures, or standard output, raw or as a stream. A separate thread converts,
 * encodes and writes them in order while the next ones are drawn. */
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
  SINK_STREAM, /* - with --format: a stream on standard output */
};

/* The buffers of a frame between drawing and writing. */
struct sink_picture {
  uint8_t *rgba;                                /* [height][width][4]; for all kinds but SINK_EXR */
  float *rgb, *alpha, *depth, *attention, *eye; /* for SINK_EXR: [height][width] each, rgb [height][width][3] */
  size_t number;                                /* of the frame, for its picture's name */
  ern_video_frame *recorded;                    /* NULL, or a frame of which rgba replaces `part` */
  int part[4];                                  /* x, y, width, height; no width: nothing is replaced */
};

/* Two are drawn while another is written and a fourth waits, so that frames of uneven cost stall no thread. */
enum { SINK_PICTURES = 4 };

struct sink {
  /* from the command line */
  int crf, codec, preset; /* indices into their choices; -1: the default */
  int format;             /* of standard output, index into its choices */
  /* made */
  const char *path;
  enum sink_kind kind;
  int width, height;
  double pixel_aspect; /* of a video: width of a pixel over its height; 0: 1 */
  ern_video_writer *video;
  ern_stream_writer *stream;
  const ern_sound *sound; /* of the stream, from `first` on, `rate` pictures a second; NULL: silent */
  size_t first, streamed; /* samples; pictures */
  struct rate rate;
  float *samples; /* scratch: the sound of one picture */
  struct sink_picture pictures[SINK_PICTURES];
  float *channels;             /* for SINK_EXR, the data to write: [height][width][channels] */
  bool has_attention, has_eye; /* channels of SINK_EXR */
  struct bounded_queue queue;  /* pictures on their way to the writer */
  size_t begun;                /* calls of sink_next */
  pthread_t writer;
  bool running;
  ern_context *context;
  const ern_provenance *provenance; /* record that is written into the output; NULL: none */
  char *claim_name;                 /* of the lock of numbered pictures; NULL: there is none */
  int claim;                        /* its descriptor */
  char *error;                      /* why the writer failed; NULL: it did not. Read it after the thread has ended */
  double seconds;                   /* working time of the writer */
};

enum { SINK_OPTIONS = 4 };
/* --crf --preset --codec --format. */
void sink_options(struct sink *sink, struct option options[SINK_OPTIONS]);

/* After sink_choose, where no option of coding is given: other values than the defaults for h264, which make files of
 * about the same size and PSNR in less time. */
void sink_code_fast(struct sink *sink);

/* Whether the output has no alpha; whether it can hold sound. */
bool sink_is_opaque(const struct sink *sink);
bool sink_has_sound(const struct sink *sink);
bool sink_on_stdout(const struct sink *sink);

/* Derives the kind from `path`. Returns -1 to continue, or EXIT_USAGE after a message. */
int sink_choose(struct sink *sink, const struct args *args, const char *path);

/* Fails if a file of the output exists without --overwrite, or cannot be written. With frame_source NULL checks a
 * video, otherwise the numbered pictures, which it locks up to sink_free. Returns 0, or EXIT_FAILURE after a message.
 */
int sink_check(struct sink *sink, struct session *session, const struct frame_source *frame_source);

/* Allocates the buffers, opens the video of `rate` frames a second and starts the writer, with `sound` from
 * `sound_start` seconds on (NULL: silent). model: the attention maps that it has are written too. provenance must
 * outlive the sink. Returns 0, or EXIT_FAILURE after a message, as the next ones. */
int sink_open(struct sink *sink, struct session *session, int width, int height, struct rate rate,
              const ern_model_info *model, const ern_sound *sound, double sound_start,
              const ern_provenance *provenance);
/* Waits for a free place and sets *output to its buffers for the renderer. Fails if the writer has failed. At most
 * SINK_PICTURES - 1 pictures may be drawn at a time, each by a thread of its own; one thread at a time calls this. */
int sink_next(struct sink *sink, struct session *session, ern_frame_output *output);
/* Hands the picture of the oldest sink_next to the writer. `number` names its picture. One thread at a time. */
void sink_put(struct sink *sink, size_t number);
/* Whether sink_put_patched may be called: the output is a video of yuv420p. */
bool sink_takes_recorded(const struct sink *sink);
/* As sink_put of a video, but the frame is `recorded`, a plain one, where the part (x, y, width, height; no width:
 * nothing) is replaced: rgba of sink_next has [height][width][4]. Keeps a reference to the frame. */
int sink_put_patched(struct sink *sink, struct session *session, const ern_video_frame *recorded, const int part[4]);
/* Waits for the last frame and completes the output; only then does a video appear under its path. */
int sink_close(struct sink *sink, struct session *session);
/* Frees everything, in any state; an unfinished video is removed. */
void sink_free(struct sink *sink);

#endif
