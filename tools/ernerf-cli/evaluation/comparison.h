/* SPDX-License-Identifier: MIT
 * Writes a video of drawn frames with the recorded frame to their right, and the clip's sound. */
#ifndef ERN_CLI_COMPARISON_H
#define ERN_CLI_COMPARISON_H

#include "evaluation/evaluate.h"

struct comparison {
  struct session *session;
  ern_video_writer *writer; /* NULL: closed */
  ern_sound sound;
  size_t drawn;  /* number of drawn pictures beside the recorded frame */
  uint8_t *rgba; /* [height][(drawn + 1)*width][4] */
};

/* Opens a video at 25 fps for the frames of the evaluation: `drawn` pictures of each beside the recorded frame. If the
 * frame numbers are consecutive, the sound is that of the file `sound` from the first frame on (NULL, or no such file:
 * none). Returns 0, or EXIT_FAILURE after a message, as the next two do. */
int comparison_open(struct comparison *comparison, const struct evaluation *evaluation, size_t drawn, const char *path,
                    const char *sound);
/* Adds frame k. drawn: its pictures from left to right, [height][width][4] each. */
int comparison_add(struct comparison *comparison, const struct evaluation *evaluation, const uint8_t *const *drawn,
                   size_t k);
/* Completes the video and renames it to its path. */
int comparison_finish(struct comparison *comparison);
/* Removes an unfinished video. */
void comparison_close(struct comparison *comparison);

#endif
