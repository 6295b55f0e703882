/* SPDX-License-Identifier: MIT */
#include "dub/recorded_video.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ernerf/model.h"

/* Seconds by which a time may differ from a frame's, as files round these to microseconds or to milliseconds. */
#define EARLY 1e-3

static int fail_record(struct session *session, const char *record, const char *why) {
  return session_fail_with(session, "%s: %s, expected the record of `ernerf prepare`; prepare the clip again", record,
                           why);
}

/* Whether the file has the hash of the record. */
static int check_same(const struct recorded_video *video, struct session *session, const char *record, const char *clip,
                      const json_t *root, const json_t *crop) {
  const char *hash = json_string_value(json_object_get(crop, "sha256")), *name = NULL;
  char found[65];
  name = json_string_value(json_object_get(root, "video"));
  if (hash == NULL) return fail_record(session, record, "\"crop\" has no \"sha256\"");
  if (ern_file_sha256(session->context, video->path, found) != ERN_OK) return session_fail(session);
  if (strcmp(hash, found) == 0) return 0;
  return session_fail_with(
      session, "%s: is not the video of %s, which was prepared from %s: found SHA-256 %.12s, expected %.12s",
      video->path, clip, name != NULL ? name : "another video", found, hash);
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

static void drop(struct recorded_video *video, size_t frames) {
  for (size_t i = 0; i < frames; i++) ern_video_frame_free(&video->window[i].frame);
  video->count -= frames;
  memmove(video->window, video->window + frames, video->count * sizeof *video->window);
}

/* Decodes the next frame into the window. A frame whose time is not later than the last one's is left out. */
static int advance(struct recorded_video *video, struct session *session) {
  struct recorded_frame next = {0};
  for (;;) {
    if (ern_video_reader_decode(video->reader, &next.frame, &next.at) != ERN_OK) return session_fail(session);
    if (next.frame == NULL || video->count == 0 || next.at > video->window[video->count - 1].at) break;
    ern_video_frame_free(&next.frame);
  }
  video->ended = next.frame == NULL;
  if (video->ended) return 0;
  if (video->count == video->places) drop(video, 1);
  video->window[video->count++] = next;
  return 0;
}

static double rate_of(const struct recorded_video *video) {
  return (double)video->info.rate_numerator / video->info.rate_denominator;
}

/* The window begins before `at`: as many frames of the guessed rate as it has places for, more where frames last
 * longer. */
static int go_back(struct recorded_video *video, struct session *session, double at) {
  const double rate = rate_of(video);
  double span = (double)(video->places - 2) / (rate >= 1 ? rate : 1), from;
  do {
    from = fmax(at - span, video->first);
    span *= 2;
    drop(video, video->count);
    if (ern_video_reader_seek(video->reader, from) != ERN_OK) return session_fail(session);
    if (advance(video, session) != 0) return EXIT_FAILURE;
  } while (from > video->first && (video->count == 0 || video->window[0].at > at));
  return video->count > 0 ? 0 : session_fail_with(session, "%s: cannot be read once more", video->path);
}

static int keep(struct recorded_video *video, struct session *session, size_t places) {
  struct recorded_frame *window = realloc(video->window, places * sizeof *window);
  if (window == NULL) return session_fail_with(session, "%s: no memory for %zu frames", video->path, places);
  video->window = window;
  video->places = places;
  return 0;
}

int recorded_video_keep(struct recorded_video *video, struct session *session) {
  const size_t frame = (size_t)video->info.width * (size_t)video->info.height * 3 / 2 + 1;
  const size_t places = ((size_t)384 << 20) / frame;
  return keep(video, session, places < 8 ? 8 : places > 128 ? 128 : places);
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
  if (status == 0) status = check_same(video, session, record, clip, root, crop);
  if (status == 0) {
    ern_video_reader_info(video->reader, &video->info);
    status = read_square(video, session, record, crop);
  }
  json_decref(root);
  if (status == 0) status = keep(video, session, 2);
  if (status == 0) status = advance(video, session);
  if (status == 0 && video->ended) status = session_fail_with(session, "%s: has no frame", path);
  if (status == 0) video->first = video->window[0].at;
  return status;
}

/* Seconds for which the video's last frame is shown: as long as the one before it, as `prepare` does at most, and one
 * of the mean rate at least. */
static double last_shown(const struct recorded_video *video) {
  const struct recorded_frame *last = &video->window[video->count - 1];
  const double before = video->count > 1 ? fmin(last->at - last[-1].at, 0.5) : 0;
  return fmax(1 / rate_of(video), before);
}

int recorded_video_frame(struct recorded_video *video, struct session *session, double seconds,
                         const ern_video_frame **frame) {
  const double at = video->first + (video->from + seconds);
  const struct recorded_frame *window = video->window;
  if (window[0].at > at + EARLY && go_back(video, session, at + EARLY) != 0) return EXIT_FAILURE;
  while (!video->ended && window[video->count - 1].at <= at)
    if (advance(video, session) != 0) return EXIT_FAILURE;
  size_t shown = 0; /* the nearest one, the later one of two, as in the clip */
  while (shown + 1 < video->count && fabs(window[shown + 1].at - at) <= fabs(window[shown].at - at)) shown++;
  const bool past = video->ended && at > window[video->count - 1].at + last_shown(video) + 0.04 + EARLY;
  *frame = past ? NULL : window[shown].frame;
  video->shown = window[shown].at;
  return 0;
}

/* Number of the frame, of a video of constant rate, that is nearest to the time of the clip's frame k, the later of
 * two: the one that the clip shows. */
static double frame_of_clip(const struct recorded_video *video, double k) {
  return floor((video->from + k / RATE_CLIP) * rate_of(video) + 0.5 + 1e-6);
}

/* Whether the frames near the shown one lie where the video's rate has them, but for the rounding of their times. */
static bool is_steady(const struct recorded_video *video, double frame) {
  const double rate = rate_of(video);
  const struct recorded_frame *last = &video->window[video->count - 1];
  return rate >= 1 && fabs((video->shown - video->first) * rate - frame) < 0.1 &&
         (video->count < 2 || fabs((last->at - last[-1].at) * rate - 1) < 0.1);
}

struct rate_place recorded_video_place(const struct recorded_video *video, size_t count) {
  const double since = video->shown - video->first, frame = round(since * rate_of(video));
  double at = (since - video->from) * RATE_CLIP;
  if (is_steady(video, frame)) {
    double k = floor(at);
    while (frame_of_clip(video, k) > frame) k--;
    while (frame_of_clip(video, k + 1) <= frame) k++;
    const double before = frame_of_clip(video, k), after = frame_of_clip(video, k + 1);
    at = k + (frame - before) / (after - before);
  }
  at = fmin(fmax(at, 0), (double)count - 1);
  return (struct rate_place){(size_t)at, at - floor(at)};
}

int recorded_video_check(struct session *session, const char *clip, const struct frame_source *frames) {
  for (size_t k = 0; k < frames->count; k++) {
    const int64_t id = frames->source_frame[k].pose.img_id;
    if (id != (int64_t)k)
      return session_fail_with(session,
                               "%s: transforms_train.json and transforms_val.json: frame %zu has img_id %" PRId64
                               ", expected %zu, each frame of the video once",
                               clip, k, id, k);
  }
  return 0;
}

double recorded_video_second(const struct frame_source *frames, size_t k) {
  const double from = (double)frame_source_before(frames, k)->pose.img_id,
               to = (double)frame_source_after(frames, k)->pose.img_id;
  return (from + (double)frames->source_frame[k].toward * (to - from)) / RATE_CLIP;
}

int recorded_video_rgb(struct recorded_video *video, struct session *session, const ern_video_frame *frame,
                       const int part[4], ern_image *image) {
  return ern_video_reader_rgb(video->reader, frame, part, image) == ERN_OK ? 0 : session_fail(session);
}

void recorded_video_close(struct recorded_video *video) {
  if (video->window != NULL) drop(video, video->count);
  free(video->window);
  ern_video_reader_free(&video->reader);
}
