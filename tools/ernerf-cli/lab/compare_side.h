/* SPDX-License-Identifier: MIT
 * One of the two that are compared: a model, or a video of another system. */
#ifndef ERN_CLI_COMPARE_SIDE_H
#define ERN_CLI_COMPARE_SIDE_H

#include "evaluation/evaluate.h"
#include "session/portrait.h"

struct compare_side {
  struct portrait portrait; /* of a video model_path, options and source alone */
  bool video;
  struct evaluation evaluation; /* what was drawn last is in its rgb and rgba */
  struct measures measures;
  ern_video_reader *reader; /* NULL: not open */
  ern_image picture;        /* of the video, as read last */
  size_t next;              /* number of the picture that the reader gives next */
};

/* Whether the name ends as those of videos do, such as .mp4. */
bool compare_side_is_video(const char *path);

/* Takes the options from `asked`. clip: of a video, NULL of a model, which opens its own. A video is read once, for its
 * size and the number of its pictures. Returns 0, or an exit status after a message; compare_side_close in either case.
 */
int compare_side_open(struct compare_side *side, struct session *session, const struct args *args,
                      const struct portrait *asked, const char *path, ern_clip *clip);
/* Draws frame k, or reads it. Returns 0, or EXIT_FAILURE after a message. */
int compare_side_draw(struct compare_side *side, size_t k, struct evaluated *evaluated);
void compare_side_close(struct compare_side *side, struct session *session);

/* "head", "head+torso" or "video". */
const char *compare_side_kind(const struct compare_side *side);

#endif
