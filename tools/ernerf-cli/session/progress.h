/* SPDX-License-Identifier: MIT
 * Progress display: on a terminal one line that is redrawn, else plain lines from time to time. */
#ifndef ERN_CLI_PROGRESS_H
#define ERN_CLI_PROGRESS_H

#include "session/session.h"

struct progress {
  struct session *session;
  const char *what, *unit; /* "train", "steps" */
  bool terminal;
  double began, last; /* seconds */
  double rate;        /* units a second if the caller knows; 0: measured here */
  uint64_t last_done;
};

/* Prints nothing with --quiet. */
void progress_begin(struct progress *progress, struct session *session, const char *what, const char *unit);
/* `more`: text at the end of the line, such as the loss; "": none. May be called at any rate. */
void progress_at(struct progress *progress, uint64_t done, uint64_t total, const char *more);
/* Ends the line on a terminal. */
void progress_end(struct progress *progress);

/* "7 s", "3 min 20 s", "5 h 07 min". */
void progress_duration(double seconds, char text[32]);

#endif
