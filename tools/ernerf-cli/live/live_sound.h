/* SPDX-License-Identifier: MIT
 * Sources of live sound: a continuous input, and queued files and texts to speak. A separate thread reads them. */
#ifndef ERN_CLI_LIVE_SOUND_H
#define ERN_CLI_LIVE_SOUND_H

#include <pthread.h>
#include <stdatomic.h>

#include "ernerf/live.h"
#include "ernerf/stream.h"
#include "live/live_tts.h"
#include "session/session.h"

enum { LIVE_UTTERANCES = 32 };

/* A file to play, a text to say, or sound that comes through a pipe. */
struct live_utterance {
  unsigned id; /* 1 and up */
  bool speaks; /* a text */
  char *text;  /* or the path of the file; NULL: none */
  struct live_pipe {
    const char *name;   /* of it for messages, a constant; NULL: as it is opened */
    int descriptor;     /* that is read and then closed; 0: none */
    const char *format; /* a constant, FFmpeg's name; NULL: detected */
    int rate, channels; /* where the format has no header */
  } pipe;
};

/* An utterance that was pushed, or is being pushed: its place in the sound of the frames, in samples. */
struct live_mark {
  unsigned id;
  uint64_t begin, end; /* end UINT64_MAX: not known yet */
  bool started;        /* reported */
  bool failed;         /* it gave no sound, or not all of it */
  char *why;           /* NULL: not said */
};

/* What became of an utterance. */
enum live_event { LIVE_NONE, LIVE_STARTED, LIVE_ENDED, LIVE_FAILED };

struct live_sound {
  /* from the command line */
  const char *url, *format; /* url NULL: no input; format NULL: detected */
  int format_rate, format_channels;
  struct live_tts tts; /* sound of texts */
  bool keeps_running;  /* the stream continues with silence after the input has ended */
  /* made */
  struct session *session;
  ern_context *context;
  ern_live *live;
  int rate, channels;
  pthread_t thread;
  pthread_mutex_t mutex;
  pthread_cond_t moved;
  void (*dropped)(void *user, unsigned id); /* set by the verb: told of each utterance that a cancel ends, the oldest
                                               first, with the mutex held, instead of an event; NULL: none is told */
  void *dropped_user;
  bool running, made;
  unsigned current; /* the ID of the utterance that is being read, 0: none. Guarded by the mutex */
  double patience;  /* by session_seconds: when a program has taken too long to make its first sound; 0: never */
  bool stop, skip;  /* end the program; end the current item. Guarded by the mutex */
  struct live_utterance utterance[LIVE_UTTERANCES]; /* those that wait, the oldest first */
  size_t utterance_count;
  unsigned last_id;
  struct live_mark mark[LIVE_UTTERANCES]; /* of utterances that are not heard to their end, the oldest first */
  size_t mark_count;
  char *error;                  /* message of the last input that failed; guarded by the mutex */
  char *why;                    /* the same of the current utterance, which its mark takes over; so guarded too */
  atomic_bool failed;           /* the input of the command line failed */
  atomic_bool input_ended;      /* the input of the command line has been played */
  atomic_ullong samples_pushed; /* number of samples pushed so far */
};

/* Starts the thread, which pushes sound of `rate` and `channels` into `live`. Returns 0, or EXIT_FAILURE after a
 * message. */
int live_sound_start(struct live_sound *sound, struct session *session, ern_live *live, int rate, int channels);
/* If the input of the command line is a regular file, waits until so many samples have been pushed, it has ended, or a
 * signal came. For any other input returns at once. */
void live_sound_await(const struct live_sound *sound, unsigned long long samples);
/* Appends a file, or a text (speaks), to the queue; its ID, 0 if the queue is full. */
unsigned live_sound_say(struct live_sound *sound, bool speaks, const char *text);
/* The same for sound from a pipe, which it closes, also where the queue is full. */
unsigned live_sound_pipe(struct live_sound *sound, const struct live_pipe *pipe);
/* Cancels the current utterance and clears the queue; an input of the command line continues. */
void live_sound_cancel(struct live_sound *sound);
/* What the frames, which have `heard` samples so far, have reached since the last call; *id: of which utterance; *why:
 * of one that failed, NULL: not said; the caller frees it. */
enum live_event live_sound_event(struct live_sound *sound, uint64_t heard, unsigned *id, char **why);
/* The utterance that is heard, 0: none; *waiting: number of those in the queue. */
unsigned live_sound_speaking(struct live_sound *sound, size_t *waiting);
/* Takes the last error message; NULL: none. The caller frees it. */
char *live_sound_take_error(struct live_sound *sound);
void live_sound_stop(struct live_sound *sound); /* in any state */

#endif
