/* SPDX-License-Identifier: MIT
 * --label: a visible text on the frames, such as a notice that they are synthetic. */
#ifndef ERN_CLI_LABEL_H
#define ERN_CLI_LABEL_H

#include "session/session.h"

enum { LABEL_OPTIONS = 2 };

struct label {
  const char *text; /* NULL: no label */
  double seconds;   /* shown for so long from the first frame on; 0: always */
  /* made */
  int left, top, width, height; /* pixels of the frame that it covers */
  uint8_t *pixels;              /* [height][width][4], RGBA, alpha multiplied in */
};

/* --label, and --set label-time. */
void label_options(struct label *label, struct option options[LABEL_OPTIONS]);
/* EXIT_USAGE after a message, or -1. */
int label_check(const struct label *label, const struct args *args);

/* Draws the label for frames of this size: white letters on a dark ground in the lower left corner; capitals are at
 * least 5 % of the shorter side high. Fails if the text is wider than the frame, no font has its characters, or they
 * are not laid out side by side from left to right. Returns 0, or EXIT_FAILURE after a message. */
int label_make(struct label *label, struct session *session, int width, int height);
/* Blends the label over the frame that is shown at `seconds`. rgba: [height][width][4], alpha not multiplied in. */
void label_put(const struct label *label, double seconds, uint8_t *rgba, int width);
void label_free(struct label *label);

#endif
