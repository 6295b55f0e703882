/* SPDX-License-Identifier: MIT
 * The recorded pictures of a clip, ori_imgs/ID.jpg: what the camera saw. Those of gt_imgs are put together anew from
 * the person's layers and the still background. */
#ifndef ERN_CLI_RECORDED_PICTURE_H
#define ERN_CLI_RECORDED_PICTURE_H

#include "ernerf/media.h"
#include "session/session.h"

struct recorded_picture {
  const char *folder; /* of the clip; the caller's */
  int width, height;  /* of the clip */
  int64_t id;         /* of the frame in `image`; -1: none */
  ern_image image;    /* RGB */
};

struct recorded_picture recorded_picture_of(const char *folder, int width, int height);
/* Whether the file of a frame is there. */
bool recorded_picture_there(const struct recorded_picture *picture, int64_t id);
/* The picture of a frame, valid until the next call. Returns 0, or EXIT_FAILURE after a message. */
int recorded_picture_read(struct recorded_picture *picture, struct session *session, int64_t id, ern_image *image);
void recorded_picture_free(struct recorded_picture *picture, struct session *session);

#endif
