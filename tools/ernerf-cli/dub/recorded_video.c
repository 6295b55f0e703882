/* SPDX-License-Identifier: MIT */
#include "dub/recorded_video.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "ernerf/model.h"

/* A frame is taken up to so many seconds before its time, which files round to microseconds or to milliseconds. */
#define EARLY 1e-3

static int fail_record(struct session *session, const char *record, const char *why) {
  return session_fail_with(session, "%s: %s, expected the record of `ernerf prepare`; prepare the clip again", record,
                           why);
}

/* Whether the file has the hash of the record, or, where that has none, its size. */
static int check_same(const struct recorded_video *video, struct session *session, const char *clip, const json_t *root,
                      const json_t *crop) {
  const char *hash = json_string_value(json_object_get(crop, "sha256")), *name = NULL;
  const json_int_t bytes = json_integer_value(json_object_get(json_object_get(root, "source"), "bytes"));
  char found[65];
  struct stat about;
  name = json_string_value(json_object_get(root, "video"));
  if (name == NULL) name = "another video";
  if (hash != NULL) {
    if (ern_file_sha256(session->context, video->path, found) != ERN_OK) return session_fail(session);
    if (strcmp(hash, found) == 0) return 0;
    return session_fail_with(session,
                             "%s: is not the video of %s, which was prepared from %s: found SHA-256 %.12s, "
                             "expected %.12s",
                             video->path, clip, name, found, hash);
  }
  if (stat(video->path, &about) != 0) return session_fail_with(session, "%s: cannot be read", video->path);
  if ((json_int_t)about.st_size == bytes) return 0;
  return session_fail_with(session,
                           "%s: is not the video of %s, which was prepared from %s: found %lld bytes, expected "
                           "%lld",
                           video->path, clip, name, (long long)about.st_size, (long long)bytes);
}

static int read_square(struct recorded_video *video, struct session *session, const char *record, const json_t *crop) {
  static const char *const names[4] = {"x", "y", "width", "side"};
  for (int i = 0; i < 4; i++) {
    const json_t *value = json_object_get(crop, names[i]);
    const double pixels = json_number_value(value);
    if (!json_is_number(value) || !(pixels >= (i < 2 ? 0 : 1)) || pixels > ERN_IMAGE_MAX_SIDE)
      return fail_record(session, record, "\"crop\" has no square");
    video->square[i] = (int)lround(pixels);
  }
  if (video->square[0] + video->square[2] <= video->info.width &&
      video->square[1] + video->square[3] <= video->info.height)
    return 0;
  return session_fail_with(session, "%s: the square ends at %d, %d, but %s has %d x %d pixels", record,
                           video->square[0] + video->square[2], video->square[1] + video->square[3], video->path,
                           video->info.width, video->info.height);
}

/* The frame after `next` becomes `next`. A frame whose time is not later is left out. */
static int advance(struct recorded_video *video, struct session *session) {
  const ern_image reused = video->now;
  bool end = false;
  video->now = video->next;
  video->now_at = video->next_at;
  video->has_now = video->has_next;
  video->next = reused;
  do {
    if (ern_video_reader_frame(video->reader, &video->next, &video->next_at, &end) != ERN_OK)
      return session_fail(session);
  } while (!end && video->has_now && video->next_at <= video->now_at);
  video->has_next = !end;
  return 0;
}

int recorded_video_open(struct recorded_video *video, struct session *session, const char *path, const char *clip) {
  char record[4096];
  json_error_t error;
  int status = 0;
  video->path = path;
  if (snprintf(record, sizeof record, "%s/prepare.json", clip) >= (int)sizeof record)
    return session_fail_with(session, "%s: the name is too long", clip);
  json_t *root = json_load_file(record, JSON_REJECT_DUPLICATES, &error);
  if (root == NULL)
    return session_fail_with(session, "%s: %s; a clip that `ernerf prepare` made of the video is needed", record,
                             error.text);
  const json_t *crop = json_object_get(root, "crop"), *segment = json_object_get(root, "segment");
  const json_t *from = json_object_get(json_is_object(segment) ? segment : json_object_get(root, "source"), "from");
  video->from = json_number_value(from);
  if (!json_is_object(crop) || !json_is_number(from) || !(video->from >= 0) || !(video->from < 1e9))
    status = fail_record(session, record, "has no \"crop\", or no \"from\" of its source");
  if (status == 0 && ern_video_reader_open(session->context, path, &video->reader) != ERN_OK)
    status = session_fail(session);
  /* the file that is open, not one that takes its name later, is the one whose hash is known */
  if (status == 0) status = check_same(video, session, clip, root, crop);
  if (status == 0) {
    ern_video_reader_info(video->reader, &video->info);
    status = read_square(video, session, record, crop);
  }
  json_decref(root);
  if (status == 0) status = advance(video, session);
  if (status == 0 && !video->has_next) status = session_fail_with(session, "%s: has no frame", path);
  video->first = video->next_at;
  return status == 0 ? advance(video, session) : status;
}

int recorded_video_frame(struct recorded_video *video, struct session *session, double seconds,
                         const ern_image **image) {
  const double at = video->first + video->from + seconds + EARLY;
  while (video->has_next && video->next_at <= at)
    if (advance(video, session) != 0) return EXIT_FAILURE;
  const double rate = (double)video->info.rate_numerator / video->info.rate_denominator;
  /* the last frame is shown as long as one of the guessed rate, and up to the end of the clip's frame that shows it */
  const bool past = !video->has_next && at > video->now_at + fmax(1 / rate, 0) + 0.04 + EARLY;
  *image = past ? NULL : &video->now;
  return 0;
}

void recorded_video_close(struct recorded_video *video, struct session *session) {
  ern_video_reader_free(&video->reader);
  ern_image_free(session->context, &video->now);
  ern_image_free(session->context, &video->next);
}
