/* SPDX-License-Identifier: MIT */
#include "dub/recorded_picture.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

enum { PATH_BYTES = 4096 };

struct recorded_picture recorded_picture_of(const char *folder, int width, int height) {
  return (struct recorded_picture){.folder = folder, .width = width, .height = height, .id = -1};
}

static bool name(const struct recorded_picture *picture, int64_t id, char path[PATH_BYTES]) {
  const int length = snprintf(path, PATH_BYTES, "%s/ori_imgs/%" PRId64 ".jpg", picture->folder, id);
  return length >= 0 && length < PATH_BYTES;
}

bool recorded_picture_there(const struct recorded_picture *picture, int64_t id) {
  char path[PATH_BYTES];
  return name(picture, id, path) && access(path, F_OK) == 0;
}

int recorded_picture_read(struct recorded_picture *picture, struct session *session, int64_t id, ern_image *image) {
  char path[PATH_BYTES];
  if (id != picture->id) {
    recorded_picture_free(picture, session);
    if (!name(picture, id, path)) return session_fail_with(session, "%s: the name is too long", picture->folder);
    if (ern_image_read(session->context, path, 3, &picture->image) != ERN_OK) return session_fail(session);
    if (picture->image.width != picture->width || picture->image.height != picture->height)
      return session_fail_with(session, "%s: has %d x %d pixels, expected the %d x %d of the clip", path,
                               picture->image.width, picture->image.height, picture->width, picture->height);
    picture->id = id;
  }
  *image = picture->image;
  return 0;
}

void recorded_picture_free(struct recorded_picture *picture, struct session *session) {
  ern_image_free(session->context, &picture->image);
  picture->id = -1;
}
