/* SPDX-License-Identifier: MIT
 * Sound of a text, by espeak-ng or by a program of the caller's. */
#ifndef ERN_CLI_LIVE_TTS_H
#define ERN_CLI_LIVE_TTS_H

#include <stdbool.h>
#include <sys/types.h>

#include "option_table.h"

enum { LIVE_TTS_REASON = 2048 };

struct live_tts {
  /* from the command line */
  const char *voice;   /* of espeak-ng */
  const char *program; /* which makes sound of a text in place of espeak-ng; NULL: espeak-ng */
  struct text_list arguments;
  /* between live_tts_begin and live_tts_end */
  char url[4096]; /* of the sound */
  pid_t child;    /* the program; -1: none */
  int file;       /* that `url` names; -1: none */
};

/* Lets the program begin, or espeak-ng make all of the sound. false: reason says why it cannot. live_tts_end in either
 * case. */
bool live_tts_begin(struct live_tts *tts, const char *text, char reason[LIVE_TTS_REASON]);
/* Ends the program, with what it has started, soon unless its sound is `whole`. false: it failed by itself, and
 * reason says how. */
bool live_tts_end(struct live_tts *tts, bool whole, char reason[LIVE_TTS_REASON]);
/* A pipe that no program inherits. */
bool live_tts_pipe(int made[2]);

#endif
