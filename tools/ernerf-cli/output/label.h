/* SPDX-License-Identifier: MIT
 * --label: words on the frames that say what they are. */
#ifndef ERN_CLI_LABEL_H
#define ERN_CLI_LABEL_H

#include "session/session.h"

enum { LABEL_OPTIONS = 2 };

struct label {
  const char *text; /* NULL: no label */
  double seconds;   /* from the first frame on; 0: throughout */
  /* made */
  int left, top, width, height; /* pixels of the frame that it covers */
  uint8_t *pixels;              /* [height][width][4], RGBA, alpha multiplied in */
};

/* --label --label-time. */
void label_options(struct label *label, struct option options[LABEL_OPTIONS]);
/* EXIT_USAGE after a sentence, or -1. */
int label_check(const struct label *label, const struct args *args);

/* Draws it for frames of that size: white letters on a dark ground in the lower left corner, whose capitals are 5 % of
 * the shorter side or more. Fails where the text is wider than the frame, or no font has it. Returns 0, or EXIT_FAILURE
 * after a message. */
int label_make(struct label *label, struct session *session, int width, int height);
/* Puts it over the frame that is shown at `seconds`. rgba: [height][width][4], alpha not multiplied in. */
void label_put(const struct label *label, double seconds, uint8_t *rgba, int width);
void label_free(struct label *label);

#endif
