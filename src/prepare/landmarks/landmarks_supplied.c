/* SPDX-License-Identifier: MIT */
#include "prepare/landmarks/landmarks_supplied.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "prepare/head_shape.h"
#include "prepare/landmarks/landmark_network.h"
#include "prepare/landmarks/landmarks_template.h"
#include "prepare/landmarks/openface.h"

enum { EXAMPLES = 6, MOUTH = 48 };

static bool ends_with(const char *text, const char *end) {
  const size_t length = strlen(text), tail = strlen(end);
  return length > tail && strcmp(text + length - tail, end) == 0;
}

bool ern_landmarks_are_files(const struct ern_prepare_job *job) {
  return !ends_with(job->options->landmarks, ".onnx") && !ends_with(job->options->landmarks, ".csv");
}

bool ern_landmarks_at_pose(const struct ern_prepare_job *job, const struct ern_head_pose *pose,
                           float points[ERN_LANDMARKS][2]) {
  for (int k = 0; k < ERN_LANDMARKS; k++) {
    const double *t = ern_landmarks_template[k];
    const double point[3] = {0.001 * t[0], ERN_HEAD_EYES_Y + 0.001 * t[1], ERN_HEAD_EYES_Z + 0.001 * t[2]};
    double pixel[2];
    if (!ern_head_project(pose, job->focal, 0.5 * job->side, point, pixel)) return false;
    for (int c = 0; c < 2; c++) points[k][c] = (float)fmin(fmax(pixel[c], -1e6), 1e6);
  }
  return true;
}

static size_t frame_of(const size_t *frames, size_t i) { return frames != NULL ? frames[i] : i; }

static ern_status from_folder(struct ern_prepare_job *job, const size_t *frames, size_t count,
                              float (*points)[ERN_LANDMARKS][2]) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH];
  ERN_TRY(ern_prepare_check_count(job, job->options->landmarks, ".lms"));
  for (size_t i = 0; i < count; i++) {
    if (snprintf(path, sizeof path, "%s/%zu.lms", job->options->landmarks, frame_of(frames, i)) >= (int)sizeof path)
      ERN_TRY(ern_fail(job->context, ERN_E_ARGUMENT, "%s: the path is too long", job->options->landmarks));
    ERN_TRY(ern_landmarks_read(job->context, path, points[i]));
    for (int k = 0; k < ERN_LANDMARKS; k++)
      if (!(fmaxf(fabsf(points[i][k][0]), fabsf(points[i][k][1])) < (float)(ERN_PREPARE_REACH * job->side)))
        ERN_TRY(ern_fail(job->context, ERN_E_FORMAT, "%s: line %d: point (%g, %g), expected pixels of a picture of %d",
                         path, k + 1, (double)points[i][k][0], (double)points[i][k][1], job->side));
    ERN_TRY(ern_prepare_progress(job, i, count));
  }
fail:
  return status;
}

static ern_status from_table(struct ern_prepare_job *job, const size_t *frames, size_t count,
                             float (*points)[ERN_LANDMARKS][2], size_t *held) {
  ern_status status = ERN_OK;
  float(*all)[ERN_LANDMARKS][2] = NULL;
  ERN_TRY(ERN_NEW(job->context, job->frames, &all));
  ERN_TRY(ern_openface_landmarks(job, job->options->landmarks, all, held));
  for (size_t i = 0; i < count; i++) memcpy(points[i], all[frame_of(frames, i)], sizeof *points);
fail:
  ern_release(job->context, all);
  return status;
}

struct looking {
  struct ern_prepare_job *job;
  ern_landmark_network *network;
  ern_image image;
  float guess[ERN_LANDMARKS][2];
};

/* Reads a frame and guesses its points. */
static ern_status look_at(struct looking *looking, size_t frame, const struct ern_head_pose *pose) {
  char name[64];
  ern_image_free(looking->job->context, &looking->image);
  if (!ern_landmarks_at_pose(looking->job, pose, looking->guess))
    return ern_fail(looking->job->context, ERN_E_UNSUPPORTED,
                    "%s: the head of frame %zu is not before the camera, expected poses of a face that is seen",
                    looking->job->folder, frame);
  snprintf(name, sizeof name, "ori_imgs/%zu.jpg", frame);
  return ern_prepare_picture(looking->job, name, 3, &looking->image);
}

/* Smooths each point in time to (before + 2 at + after) / 4, except the mouth, which moves fast. */
static void smooth(float (*points)[ERN_LANDMARKS][2], size_t count) {
  for (int k = 0; k < MOUTH; k++)
    for (int c = 0; c < 2; c++) {
      float before = points[0][k][c];
      for (size_t i = 0; i < count; i++) {
        const float at = points[i][k][c], after = points[i + 1 < count ? i + 1 : i][k][c];
        points[i][k][c] = 0.25f * (before + 2 * at + after);
        before = at;
      }
    }
}

static ern_status from_network(struct ern_prepare_job *job, const size_t *frames, const struct ern_head_pose *poses,
                               size_t count, float (*points)[ERN_LANDMARKS][2]) {
  ern_status status = ERN_OK;
  struct looking looking = {.job = job};
  const size_t examples = count < EXAMPLES ? count : EXAMPLES;
  ERN_TRY(ern_landmark_network_open(job->context, job->options->landmarks, &looking.network));
  for (size_t k = 0; k < examples; k++) {
    const size_t i = k * count / examples;
    ERN_TRY(look_at(&looking, frame_of(frames, i), &poses[i]));
    ERN_TRY(ern_landmark_network_learn(looking.network, looking.image.data, job->side, job->side,
                                       (const float(*)[2])looking.guess));
  }
  ERN_TRY(ern_landmark_network_decide(looking.network));
  for (size_t i = 0; i < count; i++) {
    ERN_TRY(look_at(&looking, frame_of(frames, i), &poses[i]));
    ERN_TRY(ern_landmark_network_find(looking.network, looking.image.data, job->side, job->side,
                                      (const float(*)[2])looking.guess, points[i]));
    ERN_TRY(ern_prepare_progress(job, i, count));
  }
  if (frames == NULL && count > 0) smooth(points, count);
fail:
  ern_landmark_network_free(&looking.network);
  ern_image_free(job->context, &looking.image);
  return status;
}

ern_status ern_prepare_landmarks_check(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  ern_landmark_network *network = NULL;
  float(*points)[ERN_LANDMARKS][2] = NULL;
  size_t held = 0;
  if (job->options->landmarks == NULL) return ERN_OK;
  if (ends_with(job->options->landmarks, ".onnx")) {
    ERN_TRY(ern_landmark_network_open(job->context, job->options->landmarks, &network));
  } else {
    ERN_TRY(ERN_NEW(job->context, job->frames, &points));
    ERN_TRY(ern_landmarks_supplied(job, NULL, NULL, job->frames, points, &held));
  }
fail:
  ern_landmark_network_free(&network);
  ern_release(job->context, points);
  return status;
}

ern_status ern_landmarks_supplied(struct ern_prepare_job *job, const size_t *frames, const struct ern_head_pose *poses,
                                  size_t count, float (*points)[ERN_LANDMARKS][2], size_t *held) {
  *held = 0;
  if (ends_with(job->options->landmarks, ".onnx")) return from_network(job, frames, poses, count, points);
  if (ends_with(job->options->landmarks, ".csv")) return from_table(job, frames, count, points, held);
  return from_folder(job, frames, count, points);
}

/* The pose of a frontal face. Eyes that were not found are put at their usual position in a face's box. */
static void pose_of(const struct ern_prepare_job *job, const struct ern_found_face *face, struct ern_head_pose *pose) {
  const float eyes[2][2] = {{face->x + 0.3f * face->width, face->y + 0.4f * face->height},
                            {face->x + 0.7f * face->width, face->y + 0.4f * face->height}};
  ern_head_pose_of_eyes(face->has_eyes ? (const float(*)[2])face->eyes : eyes, job->focal, 0.5 * job->side, pose);
}

ern_status ern_landmarks_supplied_eyes(struct ern_prepare_job *job, struct ern_found_face *faces, size_t count) {
  ern_status status = ERN_OK;
  size_t *frames = NULL, held = 0;
  struct ern_head_pose *poses = NULL;
  float(*points)[ERN_LANDMARKS][2] = NULL;
  ERN_TRY(ERN_NEW(job->context, count, &frames));
  ERN_TRY(ERN_NEW(job->context, count, &poses));
  ERN_TRY(ERN_NEW(job->context, count, &points));
  for (size_t i = 0; i < count; i++) {
    frames[i] = faces[i].frame;
    pose_of(job, &faces[i], &poses[i]);
  }
  ERN_TRY(ern_landmarks_supplied(job, frames, poses, count, points, &held));
  for (size_t i = 0; i < count; i++) {
    memset(faces[i].eyes, 0, sizeof faces[i].eyes);
    for (int k = 0; k < 24; k++) faces[i].eyes[k / 12][k % 2] += points[i][36 + k / 2][k % 2] / 6;
    faces[i].has_eyes = faces[i].eyes[0][0] < faces[i].eyes[1][0];
  }
fail:
  ern_release(job->context, frames);
  ern_release(job->context, poses);
  ern_release(job->context, points);
  return status;
}
