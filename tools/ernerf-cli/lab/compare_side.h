/* SPDX-License-Identifier: MIT
 * One side of a comparison: a model, or a video of another system. */
#ifndef ERN_CLI_COMPARE_SIDE_H
#define ERN_CLI_COMPARE_SIDE_H

#include "evaluation/evaluate.h"
#include "session/portrait.h"

struct compare_side {
  struct portrait portrait; /* for a video only model_path, options and source */
  bool video;
  struct evaluation evaluation; /* its rgb and rgba hold the last picture */
  struct measures measures;
  ern_video_reader *reader; /* NULL: not open */
  ern_image picture;        /* last picture read from the video */
  size_t next;              /* number of the reader's next picture */
};

/* Whether the name has the extension of a video, such as .mp4. */
bool compare_side_is_video(const char *path);

/* Takes the options from `asked`. clip: for a video; NULL for a model, which opens its own. A video is read once, to
 * find its size and the number of pictures. Returns 0, or an exit status after a message; call compare_side_close in
 * either case. */
int compare_side_open(struct compare_side *side, struct session *session, const struct args *args,
                      const struct portrait *asked, const char *path, ern_clip *clip);
/* Draws frame k, or reads it from the video. Returns 0, or EXIT_FAILURE after a message. */
int compare_side_draw(struct compare_side *side, size_t k, struct evaluated *evaluated);
void compare_side_close(struct compare_side *side, struct session *session);

/* "head", "head+torso" or "video". */
const char *compare_side_kind(const struct compare_side *side);

#endif
