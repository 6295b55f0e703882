/* SPDX-License-Identifier: MIT */
#include "session/frame_source.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

enum { AUDIO_WINDOWS = 8 };

static int no_memory(struct session *session, size_t frames) {
  return session_fail_with(session, "no memory for %zu frames", frames);
}

void frame_source_free(struct frame_source *frame_source) {
  free(frame_source->source_frame);
  free(frame_source->rows);
  free(frame_source->frame);
  free(frame_source->second);
  free(frame_source->trained);
  *frame_source = (struct frame_source){0};
}

static int by_img_id(const void *left, const void *right) {
  const struct source_frame *a = left, *b = right;
  if (a->pose.img_id != b->pose.img_id) return a->pose.img_id < b->pose.img_id ? -1 : 1;
  if (a->split != b->split) return a->split < b->split ? -1 : 1;
  return a->index < b->index ? -1 : a->index > b->index;
}

/* Numbers the frames and stores their rows. */
static int number_frames(struct frame_source *frame_source, struct session *session) {
  free(frame_source->rows);
  frame_source->rows = malloc(frame_source->count * sizeof *frame_source->rows);
  if (frame_source->rows == NULL) return no_memory(session, frame_source->count);
  frame_source->row_count = frame_source->count;
  for (size_t k = 0; k < frame_source->count; k++) {
    frame_source->source_frame[k].number = frame_source->source_frame[k].place = k;
    frame_source->rows[k] = frame_source->source_frame[k].pose.aud_id;
  }
  return 0;
}

bool frame_source_refines(const ern_model_info *model, const ern_clip_info *clip) {
  const bool known = model->clip[0] != 0 && clip->identity[0] != 0;
  return model->cameras > 0 && (!known || strcmp(model->clip, clip->identity) == 0);
}

void frame_source_refine(const struct frame_source *frame_source, const ern_model *model,
                         const struct source_frame *frame, float pose[16]) {
  if (frame_source->trained != NULL && frame->split == ERN_SPLIT_TRAIN)
    ern_model_refine(model, frame->index, pose);
  else
    ern_model_refine_unseen(model, frame_source->trained, frame_source->trained_count, frame->pose.img_id, pose);
}

int frame_source_of_clip(struct frame_source *frame_source, struct session *session, const ern_clip *clip,
                         enum frame_source_split split) {
  static const char *const names[] = {"train", "val", "all"};
  ern_clip_info info;
  ern_clip_describe(clip, &info);
  *frame_source = (struct frame_source){.camera = {.focal = (float)info.focal,
                                                   .cx = (float)info.cx,
                                                   .cy = (float)info.cy,
                                                   .width = info.width,
                                                   .height = info.height},
                                        .has_motion = info.has_torso_motion};
  const bool wanted[2] = {split != FRAME_SOURCE_VAL, split != FRAME_SOURCE_TRAIN};
  const size_t most = info.frames[0] + info.frames[1];
  frame_source->source_frame = calloc(most > 0 ? most : 1, sizeof *frame_source->source_frame);
  frame_source->trained_count = info.frames[ERN_SPLIT_TRAIN];
  frame_source->trained = calloc(most > 0 ? most : 1, sizeof *frame_source->trained);
  if (frame_source->source_frame == NULL || frame_source->trained == NULL) return no_memory(session, most);
  for (size_t i = 0; i < frame_source->trained_count; i++)
    frame_source->trained[i] = ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, i)->pose.img_id;
  for (int s = 0; s < 2; s++) {
    for (size_t i = 0; wanted[s] && i < info.frames[s]; i++) {
      const ern_clip_frame *frame = ern_clip_frame_at(clip, (ern_split)s, i);
      struct source_frame *to = &frame_source->source_frame[frame_source->count++];
      *to = (struct source_frame){.pose = frame->pose, .split = (ern_split)s, .index = i, .eye = frame->eye};
      memcpy(to->motion, frame->torso_motion, sizeof to->motion);
    }
  }
  if (frame_source->count == 0)
    return session_fail_with(session, "split %s of the clip has no frames, expected one or more", names[split]);
  if (split == FRAME_SOURCE_ALL)
    qsort(frame_source->source_frame, frame_source->count, sizeof *frame_source->source_frame, by_img_id);
  return number_frames(frame_source, session);
}

int frame_source_of_poses(struct frame_source *frame_source, struct session *session, const char *path) {
  ern_pose_list list = {0};
  *frame_source = (struct frame_source){0};
  if (ern_pose_list_load(session->context, path, &list) != ERN_OK) return session_fail(session);
  frame_source->camera = (ern_camera){.focal = (float)list.focal,
                                      .cx = (float)list.cx,
                                      .cy = (float)list.cy,
                                      .width = list.width,
                                      .height = list.height};
  frame_source->source_frame = calloc(list.count, sizeof *frame_source->source_frame);
  for (size_t i = 0; frame_source->source_frame != NULL && i < list.count; i++)
    frame_source->source_frame[i].pose = list.poses[i];
  frame_source->count = list.count;
  ern_pose_list_free(session->context, &list);
  return frame_source->source_frame != NULL ? number_frames(frame_source, session)
                                            : no_memory(session, frame_source->count);
}

/* ---- changes ----------------------------------------------------------------------------------------------------- */

int frame_source_smooth_path(struct frame_source *frame_source, struct session *session, int window) {
  ern_pose *poses = malloc(frame_source->count * sizeof *poses);
  if (poses == NULL) return no_memory(session, frame_source->count);
  for (size_t k = 0; k < frame_source->count; k++) poses[k] = frame_source->source_frame[k].pose;
  const ern_status status = ern_poses_smooth(session->context, poses, frame_source->count, window);
  for (size_t k = 0; status == ERN_OK && k < frame_source->count; k++) frame_source->source_frame[k].pose = poses[k];
  free(poses);
  return status == ERN_OK ? 0 : session_fail(session);
}

/* All frames also get the clip frame of this pose: its torso picture and, if the model has one, its refined pose. */
void frame_source_hold_pose(struct frame_source *frame_source, size_t frame) {
  const struct source_frame held = frame_source->source_frame[frame];
  for (size_t k = 0; k < frame_source->count; k++) {
    struct source_frame *source_frame = &frame_source->source_frame[k];
    source_frame->pose.img_id = held.pose.img_id;
    memcpy(source_frame->pose.matrix, held.pose.matrix, sizeof held.pose.matrix);
    memcpy(source_frame->motion, held.motion, sizeof held.motion);
    source_frame->split = held.split;
    source_frame->index = held.index;
  }
}

void frame_source_turn(struct frame_source *frame_source, struct pair degrees) {
  for (size_t k = 0; k < frame_source->count; k++)
    ern_pose_turn(frame_source->source_frame[k].pose.matrix, (double)degrees.first, (double)degrees.second);
}

int frame_source_smooth_eye(struct frame_source *frame_source, struct session *session) {
  float *eyes = malloc(frame_source->count * sizeof *eyes);
  if (eyes == NULL) return no_memory(session, frame_source->count);
  for (size_t k = 0; k < frame_source->count; k++) eyes[k] = frame_source->source_frame[k].eye;
  for (size_t k = 0; k < frame_source->count; k++) {
    const size_t from = k > 0 ? k - 1 : 0, to = k + 1 < frame_source->count ? k + 2 : frame_source->count;
    float sum = 0;
    for (size_t j = from; j < to; j++) sum += eyes[j];
    frame_source->source_frame[k].eye = sum / (float)(to - from);
  }
  free(eyes);
  return 0;
}

void frame_source_fix_eye(struct frame_source *frame_source, float eye) {
  for (size_t k = 0; k < frame_source->count; k++) frame_source->source_frame[k].eye = eye;
}

int frame_source_replay(struct frame_source *frame_source, struct session *session, size_t windows,
                        const size_t *order) {
  struct source_frame *played = calloc(windows, sizeof *played);
  if (played == NULL) return no_memory(session, windows);
  for (size_t t = 0; t < windows; t++) {
    played[t] = frame_source->source_frame[order != NULL ? order[t] : ern_pose_index(t, frame_source->count)];
    played[t].pose.aud_id = (int64_t)t;
  }
  free(frame_source->source_frame);
  frame_source->source_frame = played;
  frame_source->count = windows;
  return number_frames(frame_source, session);
}

struct source_frame frame_source_between(const struct source_frame *frame, struct rate_place at, size_t k) {
  const struct source_frame *from = &frame[at.place];
  struct source_frame source_frame = *from;
  source_frame.number = k;
  source_frame.toward = (float)at.toward;
  if (at.toward <= 0) return source_frame;
  const struct source_frame *to = from + 1, *nearer = at.toward < 0.5 ? from : to;
  ern_pose_interpolate(source_frame.pose.matrix, from->pose.matrix, to->pose.matrix, at.toward);
  for (int i = 0; i < ERN_MOTION_VALUES; i++)
    source_frame.motion[i] += source_frame.toward * (to->motion[i] - from->motion[i]);
  source_frame.pose.img_id = nearer->pose.img_id;
  source_frame.split = nearer->split;
  source_frame.index = nearer->index;
  source_frame.eye = from->eye + source_frame.toward * (to->eye - from->eye);
  return source_frame;
}

int frame_source_resample(struct frame_source *frame_source, struct session *session, struct rate rate,
                          const ern_features *features) {
  if (rate.numerator == RATE_CLIP * rate.denominator) return 0;
  const size_t count = rate_frames(rate, frame_source->count);
  const size_t values = (size_t)AUDIO_WINDOWS * (size_t)features->window_length * (size_t)features->width;
  struct source_frame *made = count > 0 ? calloc(count, sizeof *made) : NULL;
  if (made == NULL) return no_memory(session, count);
  for (size_t k = 0; k < count; k++)
    made[k] = frame_source_between(frame_source->source_frame, rate_at(rate, k, frame_source->count), k);
  frame_source->frame = frame_source->source_frame;
  frame_source->source_frame = made;
  frame_source->count = count;
  frame_source->second = malloc(values * sizeof *frame_source->second);
  return frame_source->second != NULL ? 0 : no_memory(session, count);
}

struct source_frame frame_source_cycle(const struct frame_source *frame_source, struct rate rate, uint64_t k) {
  const uint64_t period = frame_source->count - 1 > 0 ? frame_source->count - 1 : 1,
                 place = k * (uint64_t)rate.denominator * RATE_CLIP, numerator = (uint64_t)rate.numerator;
  const struct rate_place at = {(size_t)(place / numerator % period), (double)(place % numerator) / (double)numerator};
  return frame_source_between(frame_source->source_frame, at, at.place);
}

void frame_source_keep(struct frame_source *frame_source, size_t begin, size_t end) {
  frame_source->count = end - begin;
  memmove(frame_source->source_frame, frame_source->source_frame + begin,
          frame_source->count * sizeof *frame_source->source_frame);
}

int frame_source_cut(struct frame_source *frame_source, const struct args *args, const struct range *range) {
  const uint64_t end = range->open_end ? frame_source->count : range->end;
  if (range->begin >= end || end > frame_source->count)
    return args_refuse(args,
                       "--frames is %" PRIu64 ":%" PRIu64 ", expected A:B with 0 <= A < B <= %zu, the frames there are",
                       range->begin, end, frame_source->count);
  frame_source_keep(frame_source, (size_t)range->begin, (size_t)end);
  return 0;
}

/* ---- looking ----------------------------------------------------------------------------------------------------- */

const struct source_frame *frame_source_before(const struct frame_source *frame_source, size_t k) {
  const struct source_frame *source_frame = &frame_source->source_frame[k];
  return source_frame->toward > 0 ? &frame_source->frame[source_frame->place] : source_frame;
}

const struct source_frame *frame_source_after(const struct frame_source *frame_source, size_t k) {
  const struct source_frame *source_frame = &frame_source->source_frame[k];
  return source_frame->toward > 0 ? &frame_source->frame[source_frame->place + 1] : source_frame;
}

double frame_source_seconds(const struct frame_source *frame_source, size_t k) {
  const struct source_frame *source_frame = &frame_source->source_frame[k];
  return ((double)source_frame->pose.aud_id + (double)source_frame->toward) / RATE_CLIP;
}

/* The windows of a frame at 25 fps. */
static void frame_windows(const struct frame_source *frame_source, const struct source_frame *frame,
                          const ern_features *features, ern_audio_pad pad, float *windows) {
  if (pad == ERN_AUDIO_PAD_ZERO)
    ern_audio_windows_of_rows(windows, features, frame_source->rows, frame_source->row_count, (int64_t)frame->place);
  else
    ern_audio_windows(windows, features, frame->pose.aud_id, ERN_AUDIO_PAD_EDGE);
}

void frame_source_windows(const struct frame_source *frame_source, size_t k, const ern_features *features,
                          ern_audio_pad pad, float *windows) {
  const float toward = frame_source->source_frame[k].toward;
  frame_windows(frame_source, frame_source_before(frame_source, k), features, pad, windows);
  if (toward <= 0) return;
  const size_t values = (size_t)AUDIO_WINDOWS * (size_t)features->window_length * (size_t)features->width;
  frame_windows(frame_source, frame_source_after(frame_source, k), features, pad, frame_source->second);
  for (size_t i = 0; i < values; i++) windows[i] += toward * (frame_source->second[i] - windows[i]);
}

const float *frame_source_motion(const struct frame_source *frame_source, size_t k) {
  return frame_source->has_motion ? frame_source->source_frame[k].motion : NULL;
}

ern_camera frame_source_camera(const struct frame_source *frame_source, size_t k, float scale, int width, int height,
                               ern_fit fit) {
  ern_camera camera = frame_source->camera;
  ern_camera_pose(camera.pose, frame_source->source_frame[k].pose.matrix, scale);
  return width == camera.width && height == camera.height ? camera : ern_camera_fitted(&camera, width, height, fit);
}
