/* SPDX-License-Identifier: MIT
 * Where live sound comes from: an input that goes on, and what is to be said; a thread of its own reads it. */
#ifndef ERN_CLI_LIVE_SOUND_H
#define ERN_CLI_LIVE_SOUND_H

#include <pthread.h>
#include <stdatomic.h>

#include "ernerf/live.h"
#include "ernerf/stream.h"
#include "session/session.h"

enum { LIVE_UTTERANCES = 32 };

struct live_sound {
  /* from the command line */
  const char *url, *format; /* NULL: no input, as it is; found out */
  int format_rate, format_channels;
  const char *voice; /* espeak-ng's */
  bool stays;        /* the person goes on resting when the input has ended */
  /* made */
  struct session *session;
  ern_context *context;
  ern_live *live;
  int rate, channels;
  pthread_t thread;
  pthread_mutex_t mutex;
  pthread_cond_t moved;
  bool running, made;
  bool stop, skip;                  /* the program ends; what is played now ends. With the mutex */
  char *utterance[LIVE_UTTERANCES]; /* files to play ("f...") and texts to say ("t..."), the oldest first */
  size_t utterance_count;
  char *error;         /* the last input that failed, in words; with the mutex */
  atomic_bool failed;  /* the input of the command line did */
  atomic_bool over;    /* it has been played */
  atomic_ullong heard; /* samples */
};

/* Starts the thread, which pushes sound of `rate` and `channels` into the session. Returns 0, or EXIT_FAILURE after a
 * message. */
int live_sound_start(struct live_sound *sound, struct session *session, ern_live *live, int rate, int channels);
/* A regular file of the command line: returns when so many samples have been pushed, it is over, or a signal came. Any
 * other input: at once. */
void live_sound_await(const struct live_sound *sound, unsigned long long samples);
/* After what waits: a file, or a text (speaks); false where too much waits. */
bool live_sound_say(struct live_sound *sound, bool speaks, const char *text);
/* What is said and what waits is dropped; an input of the command line goes on after it. */
void live_sound_cancel(struct live_sound *sound);
/* The last thing that went wrong, once; NULL: nothing. The caller frees it. */
char *live_sound_take_error(struct live_sound *sound);
void live_sound_stop(struct live_sound *sound); /* wherever it stands */

#endif
