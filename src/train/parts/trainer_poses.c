/* SPDX-License-Identifier: MIT
 * Refinement of poses during training: one row per frame, updated when a step trains on the frame. */
#include "train/parts/trainer_poses.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/memory.h"
#include "train/parts/trainer_data.h"

enum { N = ERN_POSE_PARAMETERS };

/* Found by experiment: limits of a row's change in a whole training, if every visit pulls it the same way, and in one
 * visit; radians, and the length unit of the clip's poses, metres. */
static const double reach_turn = 0.3 * 3.14159265358979323846 / 180, reach_move = 2e-3;
static const double most_turn = 0.06 * 3.14159265358979323846 / 180, most_move = 0.3e-3;
static const double path_share = 0.1; /* of the distance to where the path bends least, per visit */
static const double beta2 = 0.99;
static const double ridge = 0.3; /* of ern_pose_regression_fit (docs/results.md) */

/* ---- the clip's own path ----------------------------------------------------------------------------------------- */

struct frame_time {
  int64_t at;
  size_t frame;
};
static int by_time(const void *left, const void *right) {
  const struct frame_time *a = left, *b = right;
  if (a->at != b->at) return a->at < b->at ? -1 : 1;
  return a->frame < b->frame ? -1 : a->frame > b->frame;
}

/* Frames of [data_begin, data_end) with consecutive moments are neighbours. */
static ern_status find_neighbours(struct ern_trainer_poses *p) {
  const struct ern_training *t = p->training;
  const size_t begin = t->config.data_begin, count = t->config.data_end - begin;
  struct frame_time *frame_time = NULL;
  ern_status status = ERN_NEW(t->context, count, &frame_time);
  if (status != ERN_OK) return status;
  for (size_t i = 0; i < t->data.frames[0]; i++) {
    ern_dataset_frame about;
    ERN_TRY(ern_trainer_frame(t, 0, i, &about));
    p->speech_row[i] = about.aud_id;
    p->beside[2 * i] = p->beside[2 * i + 1] = i;
  }
  for (size_t i = 0; i < count; i++) frame_time[i] = (struct frame_time){p->speech_row[begin + i], begin + i};
  qsort(frame_time, count, sizeof *frame_time, by_time);
  for (size_t i = 1; i < count; i++) {
    if (frame_time[i].at != frame_time[i - 1].at + 1) continue;
    p->beside[2 * frame_time[i].frame] = frame_time[i - 1].frame;
    p->beside[2 * frame_time[i - 1].frame + 1] = frame_time[i].frame;
  }
fail:
  ern_release(t->context, frame_time);
  return status;
}

/* sum += the row that takes pose `from` to pose `to`: to = exp([-angles]) from + move, to first order in the angles. */
static void add_way(float sum[N], const float to[16], const float from[16]) {
  double turn[3][3], axis[3], move[3];
  for (int r = 0; r < 3; r++)
    for (int c = 0; c < 3; c++) {
      turn[r][c] = 0;
      for (int i = 0; i < 3; i++) turn[r][c] += (double)to[4 * r + i] * (double)from[4 * c + i];
    }
  for (int r = 0; r < 3; r++) {
    move[r] = (double)to[4 * r + 3];
    for (int c = 0; c < 3; c++) move[r] -= turn[r][c] * (double)from[4 * c + 3];
    axis[r] = (turn[(r + 2) % 3][(r + 1) % 3] - turn[(r + 1) % 3][(r + 2) % 3]) / 2;
    sum[r] -= (float)axis[r];
    sum[3 + r] += (float)move[r];
  }
}

static bool has_both(const struct ern_trainer_poses *p, size_t frame) {
  return p->beside[2 * frame] != frame && p->beside[2 * frame + 1] != frame;
}

ern_status ern_trainer_poses_make(struct ern_trainer_poses **poses, const struct ern_trainer_fine *fine) {
  const struct ern_training *t = fine->training;
  const size_t frames = t->data.frames[0];
  struct ern_trainer_poses *p = NULL;
  ern_status status = ERN_OK;
  if (!t->config.refine_poses || t->config.torso) return ERN_OK;
  ERN_TRY(ERN_NEW(t->context, 1, &p));
  *poses = p;
  p->training = t;
  p->fine = fine;
  ERN_TRY(ERN_NEW(t->context, N * frames, &p->row));
  ERN_TRY(ERN_NEW(t->context, N * frames, &p->bend));
  ERN_TRY(ERN_NEW(t->context, 2 * frames, &p->beside));
  ERN_TRY(ERN_NEW(t->context, frames, &p->speech_row));
  if (t->model->camera == NULL) ERN_TRY(ERN_NEW(t->context, N * frames, &t->model->camera));
  t->model->cameras = frames;
  ERN_TRY(find_neighbours(p));
  for (size_t i = 0; i < frames; i++) {
    if (!has_both(p, i)) continue;
    add_way(p->bend + N * i, t->views[p->beside[2 * i]].pose, t->views[i].pose);
    add_way(p->bend + N * i, t->views[p->beside[2 * i + 1]].pose, t->views[i].pose);
  }
fail:
  return status;
}

void ern_trainer_poses_free(struct ern_trainer_poses **poses) {
  struct ern_trainer_poses *p = *poses;
  if (p == NULL) return;
  ern_context *context = p->training->context;
  ern_release(context, p->row);
  ern_release(context, p->bend);
  ern_release(context, p->beside);
  ern_release(context, p->speech_row);
  ern_release(context, p);
  *poses = NULL;
}

/* ---- from rows to poses ------------------------------------------------------------------------------------------ */

/* Removes the mean of the rows: an offset common to all frames describes another head, not other poses. */
static void hold_mean(struct ern_trainer_poses *p) {
  const struct ern_training *t = p->training;
  const size_t begin = t->config.data_begin, end = t->config.data_end;
  double mean[N] = {0};
  for (size_t i = begin; i < end; i++)
    for (size_t k = 0; k < N; k++) mean[k] += (double)p->row[N * i + k] / (double)(end - begin);
  for (size_t i = begin; i < end; i++)
    for (size_t k = 0; k < N; k++) p->row[N * i + k] = (float)((double)p->row[N * i + k] - mean[k]);
}

/* Row `frame` of the model, a trained one: degrees, and how far the camera goes, turn included. */
static void give_row(const struct ern_trainer_poses *p, size_t frame) {
  const struct ern_training *t = p->training;
  const double degree = 3.14159265358979323846 / 180;
  const float *row = p->row + N * frame, *pose = t->views[frame].pose;
  float *angle = t->model->camera + 3 * frame, *move = t->model->camera + 3 * (t->model->cameras + frame);
  float turned[16];
  for (size_t k = 0; k < 3; k++) {
    angle[k] = (float)((double)row[k] / degree);
    move[k] = 0;
  }
  /* the columns of a rotation turn as any vector does: the origin stands where the first one was */
  memcpy(turned, pose, sizeof turned);
  for (int r = 0; r < 3; r++) turned[4 * r] = pose[4 * r + 3];
  ern_model_refine(t->model, frame, turned);
  for (int r = 0; r < 3; r++) move[r] = (float)((double)turned[4 * r] - (double)pose[4 * r + 3] + (double)row[3 + r]);
}

struct ern_view ern_trainer_poses_view(const struct ern_trainer_poses *p, size_t frame) {
  const struct ern_training *t = p->training;
  struct ern_view view = t->views[frame];
  give_row(p, frame);
  ern_model_refine(t->model, frame, view.pose);
  return view;
}

/* Frames that are not trained on get the rows that the regression predicts. */
static void give_predicted(const struct ern_training *t) {
  ern_model *model = t->model;
  for (size_t i = 0; i < t->data.frames[0]; i++) {
    double row[N];
    if (i >= t->config.data_begin && i < t->config.data_end) continue;
    ern_pose_regression_predict(model->unseen[0], ERN_POSE_CORRECTION, t->views[i].pose, row);
    for (size_t k = 0; k < 3; k++) {
      model->camera[3 * i + k] = (float)row[k];
      model->camera[3 * (model->cameras + i) + k] = (float)row[3 + k];
    }
  }
}

ern_status ern_trainer_poses_download(const struct ern_trainer_poses *p) {
  if (p == NULL) return ERN_OK;
  const struct ern_training *t = p->training;
  const size_t begin = t->config.data_begin, count = t->config.data_end - begin;
  const ern_model *model = t->model;
  float *pose = NULL, *row = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(t->context, 16 * count, &pose));
  ERN_TRY(ERN_NEW(t->context, N * count, &row));
  for (size_t i = 0; i < count; i++) {
    give_row(p, begin + i);
    memcpy(pose + 16 * i, t->views[begin + i].pose, 16 * sizeof *pose);
    for (size_t k = 0; k < 3; k++) {
      row[N * i + k] = model->camera[3 * (begin + i) + k];
      row[N * i + 3 + k] = model->camera[3 * (model->cameras + begin + i) + k];
    }
  }
  ern_pose_regression_fit(t->model->unseen[0], ERN_POSE_CORRECTION, pose, row, count, ridge);
  give_predicted(t);
fail:
  ern_release(t->context, pose);
  ern_release(t->context, row);
  return status;
}

ern_status ern_trainer_poses_take(struct ern_trainer_poses *p, const ern_model *model) {
  if (p == NULL) return ERN_OK;
  const struct ern_training *t = p->training;
  const double degree = 3.14159265358979323846 / 180;
  const size_t rows = model->cameras < t->data.frames[0] ? model->cameras : t->data.frames[0];
  for (size_t i = 0; i < rows; i++) {
    const float *pose = t->views[i].pose;
    float *row = p->row + N * i, turned[16];
    memcpy(turned, pose, sizeof turned);
    for (int r = 0; r < 3; r++) turned[4 * r] = pose[4 * r + 3];
    ern_model_refine(model, i, turned); /* its last column has the model's move, its first the turn's */
    for (int r = 0; r < 3; r++) {
      row[r] = (float)((double)model->camera[3 * i + (size_t)r] * degree);
      row[3 + r] = (float)((double)turned[4 * r + 3] - (double)turned[4 * r]);
    }
  }
  hold_mean(p);
  return ern_trainer_poses_download(p);
}

/* ---- a step ------------------------------------------------------------------------------------------------------ */

static uint64_t first_step(const struct ern_trainer_poses *p) { return ern_trainer_coarse_steps(p->fine) / 10; }

/* Not in the fine stage: a patch shows too little of the head. */
bool ern_trainer_poses_due(const struct ern_trainer_poses *p) {
  return p != NULL && p->training->step >= first_step(p) && !ern_trainer_is_fine(p->fine);
}

/* r_k = bend + second difference of the rows: what the path bends by at a frame. */
static double bend_at(const struct ern_trainer_poses *p, size_t frame, size_t k) {
  if (!has_both(p, frame)) return 0;
  return (double)p->bend[N * frame + k] + (double)p->row[N * p->beside[2 * frame] + k] -
         2 * (double)p->row[N * frame + k] + (double)p->row[N * p->beside[2 * frame + 1] + k];
}

/* Running mean square of the gradient by angles or by moves; returns its root. The three components share one, so that
 * a direction which the picture hardly shows, such as depth, is not moved as far as the others. */
static double size_of(float *mean_square, const double gradient[3]) {
  double square = 0;
  for (size_t k = 0; k < 3; k++) square += gradient[k] * gradient[k] / 3;
  const double kept = *mean_square > 0 ? beta2 * (double)*mean_square + (1 - beta2) * square : square;
  *mean_square = (float)fmin(kept, 1e30);
  return sqrt((double)*mean_square);
}

void ern_trainer_poses_step(struct ern_trainer_poses *p, size_t frame, const double *dpose) {
  const struct ern_training *t = p->training;
  const uint64_t last = ern_trainer_coarse_steps(p->fine);
  const double left = (double)(last - first_step(p)), s = last > t->step ? (double)(last - t->step) / left : 0;
  const double fall = s * s,
               visits = left * t->config.frames_per_step / (double)(t->config.data_end - t->config.data_begin);
  const double scale = (double)t->data.scale;
  const double rate[2] = {fall * fmin(3 * reach_turn / visits, most_turn),
                          fall * scale * fmin(3 * reach_move / visits, most_move)};
  const double size[2] = {size_of(&p->mean_square[0], dpose), size_of(&p->mean_square[1], dpose + 3)};
  const size_t before = p->beside[2 * frame], after = p->beside[2 * frame + 1];
  for (size_t k = 0; k < N; k++) {
    const double gradient = k < 3 ? -dpose[k] : dpose[k]; /* a row's angles turn the other way */
    const double bends = (before != frame ? bend_at(p, before, k) : 0) - 2 * bend_at(p, frame, k) +
                         (after != frame ? bend_at(p, after, k) : 0);
    double by = fall * path_share * bends / 6;
    if (size[k / 3] > 0) by += rate[k / 3] * fmax(-3, fmin(3, gradient / size[k / 3]));
    p->row[N * frame + k] -= (float)by;
  }
  hold_mean(p);
}
