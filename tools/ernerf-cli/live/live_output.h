/* SPDX-License-Identifier: MIT
 * Where live frames go: a thread of its own encodes and writes them, so that a slow reader does not hold up the person.
 */
#ifndef ERN_CLI_LIVE_OUTPUT_H
#define ERN_CLI_LIVE_OUTPUT_H

#include <stdatomic.h>

#include "bounded_queue.h"
#include "ernerf/stream.h"
#include "session/rate.h"
#include "session/session.h"

enum { LIVE_PICTURES = 8 };

/* A frame on its way. */
struct live_picture {
  uint8_t *rgba; /* [height][width][4] */
  float *sound;  /* [samples][channels] */
  size_t samples;
  bool repeat; /* the last picture again, rgba is not looked at */
  double due;  /* seconds of session_seconds at which it should be there */
};

struct live_output {
  /* from the command line */
  const char *url, *format;
  int crf;
  const ern_provenance *provenance; /* what the stream says of itself, set by the verb; NULL: nothing */
  bool drops;                       /* frames for which a slow reader leaves no room are left out; else drawing waits */
  /* made */
  struct session *session;
  ern_context *context;
  ern_stream_options options;
  ern_stream_writer *writer;
  struct live_picture pictures[LIVE_PICTURES];
  struct bounded_queue queue;
  pthread_t thread;
  bool listens;           /* http, where one reader after another comes */
  atomic_bool running;    /* the thread */
  atomic_bool open;       /* somebody reads */
  _Atomic double stop_at; /* seconds of session_seconds from which on nothing waits for a reader any more */
  atomic_bool given_up;   /* drawing has failed: the stream is not ended, a file is not made */
  /* to be read after the thread has ended */
  char *error; /* why the writer gave up; NULL: it did not */
  bool cut;    /* the reader did not take all of the stream by stop_at */
  atomic_ullong written, left_out, readers;
  atomic_uint late[1001]; /* frames that were written so many milliseconds after they were due, the last one: or more */
};

/* Opens the stream, but http, whose reader is awaited by the thread, and starts the thread. samples: most of a frame.
 * Returns 0, or EXIT_FAILURE after a message, as the others do. */
int live_output_open(struct live_output *output, struct session *session, struct dimensions size, struct rate rate,
                     int sound_rate, int channels);
/* Where to put the next frame; NULL where it is left out (for nobody reads, or too slowly), or where *failed: the
 * writer has given up. */
struct live_picture *live_output_next(struct live_output *output, bool *failed);
void live_output_put(struct live_output *output);
/* Writes what waits and ends the stream; soon: within 2 s, or it stays `cut`. */
int live_output_close(struct live_output *output, bool soon);
/* Gives the stream up, and says why the writer has, where it has. Returns EXIT_FAILURE. */
int live_output_fail(struct live_output *output);
void live_output_free(struct live_output *output); /* wherever it stands */

/* Milliseconds after they were due by which `share` of the frames were written. */
double live_output_late(const struct live_output *output, double share);

#endif
