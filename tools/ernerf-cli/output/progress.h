/* SPDX-License-Identifier: MIT
 * How far a long work is: one line that is drawn anew on a terminal, plain lines now and then into anything else. */
#ifndef ERN_CLI_PROGRESS_H
#define ERN_CLI_PROGRESS_H

#include "session/session.h"

struct progress {
  struct session *session;
  const char *what, *unit; /* "train", "steps" */
  bool terminal;
  double began, last; /* seconds */
  double rate;        /* units a second where the caller knows; 0: counted here */
  uint64_t last_done;
};

/* Says nothing with --quiet. */
void progress_begin(struct progress *progress, struct session *session, const char *what, const char *unit);
/* `more` follows on the line, such as the loss; "" for none. Call as often as you like. */
void progress_at(struct progress *progress, uint64_t done, uint64_t total, const char *more);
/* Ends the line of a terminal. */
void progress_end(struct progress *progress);

/* "7 s", "3 min 20 s", "5 h 07 min". */
void progress_duration(double seconds, char text[32]);

#endif
