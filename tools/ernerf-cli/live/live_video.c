/* SPDX-License-Identifier: MIT */
#include "live/live_video.h"

#include <stdlib.h>
#include <string.h>

#include "dub/turning_path.h"

/* Of the pictures that were read ahead. */
static const size_t most_bytes = (size_t)64 << 20;

int live_video_open(struct live_video *video, struct session *session, const char *clip) {
  video->session = session;
  const int status = recorded_video_open(&video->recorded, session, video->path, clip);
  return status == 0 ? recorded_video_keep(&video->recorded, session) : status;
}

int live_video_keep_poses(struct live_video *video, struct session *session, const struct portrait *portrait,
                          struct frame_source *poses) {
  size_t low, high;
  if (recorded_video_check(session, portrait->source.path, poses) != 0) return EXIT_FAILURE;
  if (frame_source_of_clip(&video->clip_frames, session, portrait->clip, FRAME_SOURCE_ALL) != 0) return EXIT_FAILURE;
  turning_path_ends(portrait->clip, poses->source_frame, 0, poses->count, &low, &high);
  frame_source_keep(poses, low, high + 1);
  return 0;
}

/* ---- the thread -------------------------------------------------------------------------------------------------- */

static void *read_ahead(void *user) {
  struct live_video *video = user;
  struct session *session = &video->reading;
  struct source_frame due;
  const struct frame_source now = {.source_frame = &due, .count = 1, .frame = video->poses->source_frame},
                            *clip = &video->clip_frames;
  for (uint64_t k = 0;; k++) {
    const ern_video_frame *frame = NULL;
    const int slot = queue_wait_for_slot(&video->queue);
    if (slot == QUEUE_CLOSED) return NULL;
    due = frame_source_cycle(video->poses, video->rate, k);
    struct live_recorded *picture = &video->pictures[slot];
    int status = recorded_video_frame(&video->recorded, session, recorded_video_second(&now, 0), &frame);
    if (status == 0 && frame == NULL)
      status =
          session_fail_with(session, "%s: ends before the clip's frame %lld", video->path, (long long)due.pose.img_id);
    if (status == 0)
      picture->place = frame_source_between(clip->source_frame, recorded_video_place(&video->recorded, clip->count), 0);
    if (status == 0)
      status =
          recorded_video_rgb(&video->recorded, session, frame, video->in_place ? video->region : NULL, &picture->rgb);
    ern_video_frame_free(&picture->frame);
    if (status == 0 && ern_video_frame_clone(session->context, frame, &picture->frame) != ERN_OK)
      status = session_fail(session);
    if (status != 0) break;
    queue_push(&video->queue);
  }
  queue_end(&video->queue);
  return NULL;
}

/* The boxes of all poses, grown to even numbers; where there is none, or frames are not coded in place: all. */
static int choose_region(struct live_video *video) {
  const int width = video->recorded.info.width, height = video->recorded.info.height;
  int from[2] = {width, height}, to[2] = {0, 0}, box[4];
  video->in_place = video->in_place && ern_video_frame_is_plain(video->recorded.window[0].frame);
  for (size_t k = 0; video->in_place && k < video->poses->count; k++) {
    if (dubbed_frame_box(&video->dubbed, video->poses, k, width, height, video->recorded.square, box) != ERN_OK)
      return session_fail(video->session);
    for (int c = 0; c < 2 && box[2] > 0; c++) {
      if (box[c] < from[c]) from[c] = box[c] & ~1;
      if (box[c] + box[c + 2] > to[c]) to[c] = (box[c] + box[c + 2] + 1) & ~1;
    }
  }
  const bool any = to[0] > 0;
  memcpy(video->region,
         (const int[4]){any ? from[0] : 0, any ? from[1] : 0, any ? to[0] - from[0] : width,
                        any ? to[1] - from[1] : height},
         sizeof video->region);
  return 0;
}

int live_video_start(struct live_video *video, struct session *session, const struct portrait *portrait,
                     const struct frame_source *poses, struct rate rate, bool in_place) {
  const size_t frame = (size_t)video->recorded.info.width * (size_t)video->recorded.info.height;
  video->in_place = in_place;
  video->poses = poses;
  video->rate = rate;
  if (dubbed_frame_open(&video->dubbed, session, portrait->clip, portrait->source.path, video->recorded.square) != 0 ||
      choose_region(video) != 0)
    return EXIT_FAILURE;
  const size_t places = most_bytes / (3 * frame / 2 + 3 * (size_t)video->region[2] * (size_t)video->region[3]);
  queue_make(&video->queue, places < 4 ? 4 : places < LIVE_VIDEO_PICTURES ? places : LIVE_VIDEO_PICTURES);
  video->reading = *session;
  video->reading.held = video->failed;
  video->running = pthread_create(&video->reader, NULL, read_ahead, video) == 0;
  if (video->running) return 0;
  queue_free(&video->queue);
  return session_fail_with(session, "cannot start a thread that reads %s", video->path);
}

/* ---- the drawing thread ------------------------------------------------------------------------------------------ */

int live_video_show(struct live_video *video, uint64_t number) {
  for (; video->taken <= number; video->taken++) {
    if (video->taken > 0) queue_pop(&video->queue);
    const int slot = queue_wait_for_item(&video->queue);
    if (slot == QUEUE_CLOSED) return session_fail_with(video->session, "%s", video->failed);
    video->shown = &video->pictures[slot];
  }
  return 0;
}

ern_status live_video_draw(struct live_video *video, ern_renderer *renderer, const struct frame_source *frames,
                           size_t k, const ern_frame_input *whole, uint8_t *rgba) {
  int square[4];
  memcpy(square, video->recorded.square, sizeof square);
  for (int c = 0; c < 2; c++) square[c] -= video->region[c];
  return dubbed_frame_draw(&video->dubbed, renderer, frames, k, whole, &video->shown->rgb, square, rgba, NULL);
}

void live_video_colours(const struct live_video *video, const uint8_t *rgba, float *rgb) {
  const int *box = video->dubbed.box;
  const size_t wide = (size_t)box[2], drawn = wide * (size_t)box[3], row = (size_t)video->region[2],
               values = 3 * row * (size_t)video->region[3];
  const uint8_t *corner = rgba + 4 * ((size_t)box[1] * row + (size_t)box[0]);
  for (size_t i = 0; i < values; i++) {
    const size_t at = drawn > 0 ? i / 3 % drawn : 0;
    rgb[i] = drawn > 0 ? (float)corner[4 * (at / wide * row + at % wide) + i % 3] / 255 : 0;
  }
}

int live_video_cut(struct live_video *video, uint8_t *rgba, int part[4], ern_video_frame **recorded) {
  dubbed_frame_cut(&video->dubbed, video->region, rgba, part);
  return ern_video_frame_clone(video->session->context, video->shown->frame, recorded) == ERN_OK
             ? 0
             : session_fail(video->session);
}

void live_video_close(struct live_video *video) {
  if (video->session == NULL) return;
  if (video->running) {
    queue_break(&video->queue);
    (void)pthread_join(video->reader, NULL);
    queue_free(&video->queue);
  }
  for (size_t i = 0; i < LIVE_VIDEO_PICTURES; i++) {
    ern_video_frame_free(&video->pictures[i].frame);
    ern_image_free(video->session->context, &video->pictures[i].rgb);
  }
  frame_source_free(&video->clip_frames);
  dubbed_frame_close(&video->dubbed);
  recorded_video_close(&video->recorded);
}
