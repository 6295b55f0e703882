/* SPDX-License-Identifier: MIT
 * Output of live frames. A separate thread encodes and writes them, so that a slow reader does not delay drawing. */
#ifndef ERN_CLI_LIVE_OUTPUT_H
#define ERN_CLI_LIVE_OUTPUT_H

#include <stdatomic.h>

#include "bounded_queue.h"
#include "ernerf/stream.h"
#include "rate.h"
#include "session/session.h"

enum { LIVE_PICTURES = 8, LIVE_PATIENCE = 30 /* seconds that a server may take */ };

/* A frame in the queue. */
struct live_picture {
  uint8_t *rgba; /* [height][width][4] */
  float *sound;  /* [samples][channels] */
  size_t samples;
  bool repeat;               /* show the last picture again; the others are ignored */
  ern_video_frame *recorded; /* NULL, or a plain frame of which rgba replaces `part` */
  int part[4];               /* x, y, width, height; no width: nothing is replaced */
  double due;                /* when it should be written, by session_seconds */
};

struct live_output {
  /* from the command line */
  const char *url, *format;
  int crf;
  const char *preset, *profile;     /* of x264, set by the verb; NULL: the default */
  const ern_provenance *provenance; /* provenance written into the stream, set by the verb; NULL: none */
  double pixel_aspect;              /* of the frames, width of a pixel over its height, set by the verb; 0: 1 */
  int (*write)(void *user, const void *bytes, size_t count, ern_stream_piece piece); /* set by the verb: takes the
                               stream (ern_stream_options), and `url` is a name for messages; NULL: `url` does */
  void (*sound)(void *user, const float *samples, size_t frames); /* set by the verb: gets the sound of the next
                               picture, before it is written; NULL: nobody does */
  void *write_user;                                               /* of both */
  bool drops; /* when the queue is full, drop frames; else drawing waits */
  /* made */
  struct session *session;
  ern_context *context;
  ern_stream_options options;
  ern_stream_writer *writer;
  struct live_picture pictures[LIVE_PICTURES];
  struct bounded_queue queue;
  pthread_t thread;
  bool serves_http;                     /* HTTP server: serves one reader after another */
  bool connects;                        /* to the server of an address */
  bool completes;                       /* a file: also after a signal it is written to its end */
  atomic_bool running;                  /* the thread runs */
  atomic_bool open;                     /* a reader is connected */
  atomic_bool patient;                  /* each frame that is written moves stop_at */
  _Atomic double stop_at;               /* from this time (session_seconds) on, stop waiting for readers */
  double hurried_until;                 /* the same after a signal; INFINITY: none came. Of the thread */
  atomic_bool given_up;                 /* drawing has failed: the stream gets no proper end, a file is not created */
  double left_out_since, left_out_last; /* when frames were left out, by session_seconds */
  bool told;                            /* of these */
  /* valid after the thread has ended */
  char *error; /* why the writer failed; NULL: it did not */
  bool kept;   /* it failed, and a file was put in place that is cut */
  bool cut;    /* the reader had not received the whole stream in time */
  atomic_ullong written, left_out, readers;
  atomic_uint late[1001]; /* histogram: frames by lateness in milliseconds; the last bin: 1000 or more */
};

/* The path of a file that `url` names, which is created or replaced; NULL: an address, a pipe or a device, which is
 * written to directly. */
const char *live_output_file(const char *url);
/* Opens the stream and starts the thread; for HTTP, the thread waits for a reader and opens the stream. Returns 0, or
 * EXIT_FAILURE after a message, as the others do. */
int live_output_open(struct live_output *output, struct session *session, struct dimensions size, struct rate rate,
                     int sound_rate, int channels);
/* The place for the next frame. NULL: the frame is dropped (no reader, or a slow one), or *failed: the writer has
 * failed, or the stream is `cut`. */
struct live_picture *live_output_next(struct live_output *output, bool *failed);
/* Whether pictures may be recorded frames: not where they are written as RGBA. */
bool live_output_takes_recorded(const struct live_output *output);
void live_output_put(struct live_output *output);
/* Writes the queued frames and ends the stream; soon: within 2 s, else it is left `cut`, as where an address does not
 * take them within LIVE_PATIENCE, or with `patient` one of them. output->error says whether the writer failed. */
void live_output_close(struct live_output *output, bool soon);
/* Abandons the stream. */
void live_output_fail(struct live_output *output);
void live_output_free(struct live_output *output); /* in any state */

/* Seconds of processor time that coding and writing have taken; 0 where that is not known. */
double live_output_seconds(struct live_output *output);
/* Quantile of the lateness: `share` of the frames were written at most so many milliseconds late. */
double live_output_late(const struct live_output *output, double share);

#endif
