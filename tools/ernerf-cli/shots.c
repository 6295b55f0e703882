/* SPDX-License-Identifier: MIT */
#include "shots.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

enum { AUDIO_WINDOWS = 8 };

static int no_memory(struct session *session, size_t frames) {
  return session_fail_with(session, "no memory for %zu frames", frames);
}

void shots_free(struct shots *shots) {
  free(shots->shot);
  free(shots->rows);
  free(shots->frame);
  free(shots->second);
  *shots = (struct shots){0};
}

static int by_img_id(const void *left, const void *right) {
  const struct shot *a = left, *b = right;
  if (a->pose.img_id != b->pose.img_id) return a->pose.img_id < b->pose.img_id ? -1 : 1;
  if (a->split != b->split) return a->split < b->split ? -1 : 1;
  return a->index < b->index ? -1 : a->index > b->index;
}

/* Numbers the shots and keeps their rows. */
static int number_shots(struct shots *shots, struct session *session) {
  free(shots->rows);
  shots->rows = malloc(shots->count * sizeof *shots->rows);
  if (shots->rows == NULL) return no_memory(session, shots->count);
  shots->row_count = shots->count;
  for (size_t k = 0; k < shots->count; k++) {
    shots->shot[k].number = shots->shot[k].place = k;
    shots->rows[k] = shots->shot[k].pose.aud_id;
  }
  return 0;
}

int shots_of_clip(struct shots *shots, struct session *session, const ern_clip *clip, enum shot_split split) {
  static const char *const names[] = {"train", "val", "all"};
  ern_clip_info info;
  ern_clip_describe(clip, &info);
  *shots = (struct shots){.camera = {.focal = (float)info.focal,
                                     .cx = (float)info.cx,
                                     .cy = (float)info.cy,
                                     .width = info.width,
                                     .height = info.height}};
  const bool wanted[2] = {split != SHOTS_VAL, split != SHOTS_TRAIN};
  const size_t most = info.frames[0] + info.frames[1];
  shots->shot = calloc(most > 0 ? most : 1, sizeof *shots->shot);
  if (shots->shot == NULL) return no_memory(session, most);
  for (int s = 0; s < 2; s++) {
    for (size_t i = 0; wanted[s] && i < info.frames[s]; i++) {
      const ern_clip_frame *frame = ern_clip_frame_at(clip, (ern_split)s, i);
      shots->shot[shots->count++] =
          (struct shot){.pose = frame->pose, .split = (ern_split)s, .index = i, .eye = frame->eye};
    }
  }
  if (shots->count == 0)
    return session_fail_with(session, "split %s of the clip has no frames, expected one or more", names[split]);
  if (split == SHOTS_ALL) qsort(shots->shot, shots->count, sizeof *shots->shot, by_img_id);
  return number_shots(shots, session);
}

int shots_of_poses(struct shots *shots, struct session *session, const char *path) {
  ern_pose_list list = {0};
  *shots = (struct shots){0};
  if (ern_pose_list_load(session->context, path, &list) != ERN_OK) return session_fail(session);
  shots->camera = (ern_camera){.focal = (float)list.focal,
                               .cx = (float)list.cx,
                               .cy = (float)list.cy,
                               .width = list.width,
                               .height = list.height};
  shots->shot = calloc(list.count, sizeof *shots->shot);
  for (size_t i = 0; shots->shot != NULL && i < list.count; i++) shots->shot[i].pose = list.poses[i];
  shots->count = list.count;
  ern_pose_list_free(session->context, &list);
  return shots->shot != NULL ? number_shots(shots, session) : no_memory(session, shots->count);
}

/* ---- changes ----------------------------------------------------------------------------------------------------- */

int shots_smooth_path(struct shots *shots, struct session *session, int window) {
  ern_pose *poses = malloc(shots->count * sizeof *poses);
  if (poses == NULL) return no_memory(session, shots->count);
  for (size_t k = 0; k < shots->count; k++) poses[k] = shots->shot[k].pose;
  const ern_status status = ern_poses_smooth(session->context, poses, shots->count, window);
  for (size_t k = 0; status == ERN_OK && k < shots->count; k++) shots->shot[k].pose = poses[k];
  free(poses);
  return status == ERN_OK ? 0 : session_fail(session);
}

/* The pose brings its frame along: that frame's torso picture, and its refined pose where the model has one. */
void shots_hold_pose(struct shots *shots, size_t frame) {
  const struct shot held = shots->shot[frame];
  for (size_t k = 0; k < shots->count; k++) {
    struct shot *shot = &shots->shot[k];
    shot->pose.img_id = held.pose.img_id;
    memcpy(shot->pose.matrix, held.pose.matrix, sizeof held.pose.matrix);
    shot->split = held.split;
    shot->index = held.index;
  }
}

void shots_turn(struct shots *shots, struct pair degrees) {
  for (size_t k = 0; k < shots->count; k++)
    ern_pose_turn(shots->shot[k].pose.matrix, (double)degrees.first, (double)degrees.second);
}

int shots_smooth_eye(struct shots *shots, struct session *session) {
  float *eyes = malloc(shots->count * sizeof *eyes);
  if (eyes == NULL) return no_memory(session, shots->count);
  for (size_t k = 0; k < shots->count; k++) eyes[k] = shots->shot[k].eye;
  for (size_t k = 0; k < shots->count; k++) {
    const size_t from = k > 0 ? k - 1 : 0, to = k + 1 < shots->count ? k + 2 : shots->count;
    float sum = 0;
    for (size_t j = from; j < to; j++) sum += eyes[j];
    shots->shot[k].eye = sum / (float)(to - from);
  }
  free(eyes);
  return 0;
}

void shots_fix_eye(struct shots *shots, float eye) {
  for (size_t k = 0; k < shots->count; k++) shots->shot[k].eye = eye;
}

int shots_replay(struct shots *shots, struct session *session, size_t windows) {
  struct shot *played = calloc(windows, sizeof *played);
  if (played == NULL) return no_memory(session, windows);
  for (size_t t = 0; t < windows; t++) {
    played[t] = shots->shot[ern_pose_index(t, shots->count)];
    played[t].pose.aud_id = (int64_t)t;
  }
  free(shots->shot);
  shots->shot = played;
  shots->count = windows;
  return number_shots(shots, session);
}

/* Frame k of the output, between `frame`[place] and the next one. */
static struct shot shot_between(const struct shot *frame, struct rate_place at, size_t k) {
  const struct shot *from = &frame[at.place];
  struct shot shot = *from;
  shot.number = k;
  shot.toward = (float)at.toward;
  if (at.toward <= 0) return shot;
  const struct shot *to = from + 1, *nearer = at.toward < 0.5 ? from : to;
  ern_pose_interpolate(shot.pose.matrix, from->pose.matrix, to->pose.matrix, at.toward);
  shot.pose.img_id = nearer->pose.img_id;
  shot.split = nearer->split;
  shot.index = nearer->index;
  shot.eye = from->eye + shot.toward * (to->eye - from->eye);
  return shot;
}

int shots_resample(struct shots *shots, struct session *session, struct rate rate, const ern_features *features) {
  if (rate.numerator == RATE_CLIP * rate.denominator) return 0;
  const size_t count = rate_frames(rate, shots->count);
  const size_t values = (size_t)AUDIO_WINDOWS * (size_t)features->window_length * (size_t)features->width;
  struct shot *made = count > 0 ? calloc(count, sizeof *made) : NULL;
  if (made == NULL) return no_memory(session, count);
  for (size_t k = 0; k < count; k++) made[k] = shot_between(shots->shot, rate_at(rate, k, shots->count), k);
  shots->frame = shots->shot;
  shots->shot = made;
  shots->count = count;
  shots->second = malloc(values * sizeof *shots->second);
  return shots->second != NULL ? 0 : no_memory(session, count);
}

int shots_cut(struct shots *shots, const struct args *args, const struct range *range) {
  const uint64_t end = range->open_end ? shots->count : range->end;
  if (range->begin >= end || end > shots->count)
    return args_refuse(args,
                       "--frames is %" PRIu64 ":%" PRIu64 ", expected A:B with 0 <= A < B <= %zu, the frames there are",
                       range->begin, end, shots->count);
  shots->count = (size_t)(end - range->begin);
  memmove(shots->shot, shots->shot + range->begin, shots->count * sizeof *shots->shot);
  return 0;
}

/* ---- looking ----------------------------------------------------------------------------------------------------- */

const struct shot *shots_before(const struct shots *shots, size_t k) {
  const struct shot *shot = &shots->shot[k];
  return shot->toward > 0 ? &shots->frame[shot->place] : shot;
}

const struct shot *shots_after(const struct shots *shots, size_t k) {
  const struct shot *shot = &shots->shot[k];
  return shot->toward > 0 ? &shots->frame[shot->place + 1] : shot;
}

double shots_seconds(const struct shots *shots, size_t k) {
  const struct shot *shot = &shots->shot[k];
  return ((double)shot->pose.aud_id + (double)shot->toward) / RATE_CLIP;
}

/* Of a frame at 25 a second. */
static void frame_windows(const struct shots *shots, const struct shot *frame, const ern_features *features,
                          ern_audio_pad pad, float *windows) {
  if (pad == ERN_AUDIO_PAD_ZERO)
    ern_audio_windows_of_rows(windows, features, shots->rows, shots->row_count, (int64_t)frame->place);
  else
    ern_audio_windows(windows, features, frame->pose.aud_id, ERN_AUDIO_PAD_EDGE);
}

void shots_windows(const struct shots *shots, size_t k, const ern_features *features, ern_audio_pad pad,
                   float *windows) {
  const float toward = shots->shot[k].toward;
  frame_windows(shots, shots_before(shots, k), features, pad, windows);
  if (toward <= 0) return;
  const size_t values = (size_t)AUDIO_WINDOWS * (size_t)features->window_length * (size_t)features->width;
  frame_windows(shots, shots_after(shots, k), features, pad, shots->second);
  for (size_t i = 0; i < values; i++) windows[i] += toward * (shots->second[i] - windows[i]);
}

ern_camera shots_camera(const struct shots *shots, size_t k, float scale, int width, int height, ern_fit fit) {
  ern_camera camera = shots->camera;
  ern_camera_pose(camera.pose, shots->shot[k].pose.matrix, scale);
  return width == camera.width && height == camera.height ? camera : ern_camera_fitted(&camera, width, height, fit);
}
