/* SPDX-License-Identifier: MIT
 * A video of drawn frames with the recorded frame to the right of them, and the clip's sound. */
#ifndef ERN_CLI_COMPARISON_H
#define ERN_CLI_COMPARISON_H

#include "evaluation/evaluate.h"

struct comparison {
  struct session *session;
  ern_video_writer *writer; /* NULL: closed */
  ern_sound sound;
  size_t drawn;  /* pictures beside the recorded frame */
  uint8_t *rgba; /* [height][(drawn + 1)*width][4] */
};

/* For the frames of the evaluation, at 25 a second, `drawn` pictures of each beside the recorded frame. Where their
 * numbers follow each other without a gap, the sound is that of the file `sound` (NULL, or not there: none) from the
 * first of them on. Returns 0, or EXIT_FAILURE after a message, as the next two do. */
int comparison_open(struct comparison *comparison, const struct evaluation *evaluation, size_t drawn, const char *path,
                    const char *sound);
/* Adds frame k. drawn: its pictures from left to right, [height][width][4] each. */
int comparison_add(struct comparison *comparison, const struct evaluation *evaluation, const uint8_t *const *drawn,
                   size_t k);
/* Puts the video in its place. */
int comparison_finish(struct comparison *comparison);
/* Removes what was not finished. */
void comparison_close(struct comparison *comparison);

#endif
