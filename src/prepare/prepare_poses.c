/* SPDX-License-Identifier: MIT
 * Head poses as transforms_train.json and transforms_val.json (docs/formats.md). */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/format.h"
#include "io/file.h"
#include "prepare/head_shape.h"
#include "prepare/prepare_job.h"

/* Bounds of the projected height of a head with a supplied pose, in sides of the picture. */
static const double least_head = 0.1, most_head = 3;
/* Bounds in degrees for most frames of supplied poses: of the roll about the line of sight, and of the angle between
 * the face's direction and the camera. */
static const double most_roll = 60, most_aside = 60;

/* The first ten elevenths are for training; each part has at least one frame. */
static size_t training_frames(size_t frames) {
  const size_t validation = frames / 11 > 0 ? frames / 11 : 1;
  return frames - validation;
}

/* transform_matrix is the inverse transform: [R^T | -R^T t]. */
static void to_matrix(const struct ern_head_pose *pose, double m[4][4]) {
  for (int i = 0; i < 3; i++) {
    m[i][3] = 0;
    for (int k = 0; k < 3; k++) {
      m[i][k] = pose->rotation[k][i];
      m[i][3] -= pose->rotation[k][i] * pose->translation[k];
    }
    m[3][i] = 0;
  }
  m[3][3] = 1;
}

static void from_matrix(const float m[16], struct ern_head_pose *pose) {
  for (int i = 0; i < 3; i++) {
    pose->translation[i] = 0;
    for (int k = 0; k < 3; k++) {
      pose->rotation[i][k] = (double)m[4 * k + i];
      pose->translation[i] -= (double)m[4 * k + i] * (double)m[4 * k + 3];
    }
  }
}

static ern_status write_part(struct ern_prepare_job *job, const char *name, const struct ern_head_pose *poses,
                             size_t begin, size_t end) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH], line[1024];
  struct ern_file_writer file = {0};
  const double centre = 0.5 * job->side;
  ERN_TRY(ern_prepare_register_output(job, name, path));
  ERN_TRY(ern_file_writer_open(job->context, path, ERN_EXISTING_REPLACE, &file));
  int length = ern_format(line, sizeof line,
                          "{\"focal_len\": %.9g, \"cx\": %.9g, \"cy\": %.9g, \"w\": %d, \"h\": %d, \"frames\": [",
                          job->focal, centre, centre, job->side, job->side);
  ERN_TRY(ern_file_writer_write(&file, line, (size_t)length));
  for (size_t i = begin; i < end; i++) {
    double m[4][4];
    to_matrix(&poses[i], m);
    length = snprintf(line, sizeof line, "%s\n{\"img_id\": %zu, \"aud_id\": %zu, \"transform_matrix\": [",
                      i > begin ? "," : "", i, i);
    for (int r = 0; r < 4; r++)
      length += ern_format(line + length, sizeof line - (size_t)length, "%s[%.9g, %.9g, %.9g, %.9g]", r > 0 ? ", " : "",
                           m[r][0], m[r][1], m[r][2], m[r][3]);
    length += snprintf(line + length, sizeof line - (size_t)length, "]}");
    ERN_TRY(ern_file_writer_write(&file, line, (size_t)length));
  }
  ERN_TRY(ern_file_writer_write(&file, "\n]}\n", 4));
  return ern_file_writer_commit(&file);
fail:
  ern_file_writer_abandon(&file);
  return status;
}

ern_status ern_prepare_poses_write(struct ern_prepare_job *job, const struct ern_head_pose *poses) {
  const size_t middle = training_frames(job->frames);
  const ern_status status = write_part(job, "transforms_val.json", poses, middle, job->frames);
  return status == ERN_OK ? write_part(job, "transforms_train.json", poses, 0, middle) : status;
}

static ern_status check_camera(struct ern_prepare_job *job, const char *path, double focal) {
  const double least = ERN_PREPARE_FOCAL_LEAST * job->side, most = ERN_PREPARE_FOCAL_MOST * job->side;
  if (focal >= least && focal <= most) return ERN_OK;
  return ern_fail(job->context, ERN_E_FORMAT, "%s: field focal_len is %g, expected %g to %g pixels", path, focal, least,
                  most);
}

/* Checks the head's projected size, which does not depend on the unit of length. */
static ern_status check_distance(struct ern_prepare_job *job, const char *path, size_t frame, double focal,
                                 double distance) {
  const double height = 2 * ERN_HEAD_TALL * focal / distance / job->side;
  if (height >= least_head && height <= most_head) return ERN_OK;
  return ern_fail(job->context, ERN_E_FORMAT,
                  "%s: frame %zu: field transform_matrix has the head %g m before the camera, where it takes %.3g of "
                  "the picture's height; expected %g to %g, and metres",
                  path, frame, distance, height, least_head, most_head);
}

/* Checks that the head's centre projects into the picture. */
static ern_status check_place(struct ern_prepare_job *job, const char *path, size_t frame, double focal,
                              const struct ern_head_pose *pose) {
  const double *at = pose->translation;
  const double x = 0.5 * job->side - focal * at[0] / at[2], y = 0.5 * job->side + focal * at[1] / at[2];
  if (x >= 0 && x <= job->side && y >= 0 && y <= job->side) return ERN_OK;
  return ern_fail(job->context, ERN_E_FORMAT,
                  "%s: frame %zu: field transform_matrix has the head's middle at pixel %.0f, %.0f; expected it in the "
                  "picture, 0 to %d",
                  path, frame, x, y, job->side);
}

/* The head's roll in the picture, degrees. */
static double roll_of(const struct ern_head_pose *pose) {
  return atan2(-pose->rotation[0][1], pose->rotation[1][1]) * 57.29577951308232;
}

/* The angle between the face's direction (the head's z) and the direction from the head to the camera, degrees, 0..180.
 */
static double aside_of(const struct ern_head_pose *pose) {
  const double *t = pose->translation;
  double along = 0;
  for (int i = 0; i < 3; i++) along -= pose->rotation[i][2] * t[i];
  along /= sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2]);
  return acos(fmin(fmax(along, -1), 1)) * 57.29577951308232;
}

/* Checks roll and direction of most frames: a head may lie or face aside for a while only. */
static ern_status check_angle(struct ern_prepare_job *job, const char *path, const struct ern_head_pose *poses,
                              double angle(const struct ern_head_pose *pose), double most, const char *found,
                              const char *expected) {
  size_t beyond = 0, first = 0;
  for (size_t i = job->frames; i-- > 0;)
    if (fabs(angle(&poses[i])) > most) {
      beyond++;
      first = i;
    }
  if (2 * beyond <= job->frames) return ERN_OK;
  return ern_fail(job->context, ERN_E_FORMAT,
                  "%s: img_id %zu: field transform_matrix has the head %s by %.0f degrees, and %zu of %zu frames by "
                  "more than %g; expected %s",
                  path, first, found, angle(&poses[first]), beyond, job->frames, most, expected);
}

/* Reads the poses of a file by img_id; seen[frames] marks the frames that have one. `audio_mismatches`: as in
 * ern_prepare_poses_supplied(), counted on; NULL: a file of the clip's own. */
static ern_status read_file(struct ern_prepare_job *job, const char *path, struct ern_head_pose *poses, bool *seen,
                            size_t *audio_mismatches) {
  ern_pose_list list = {0};
  ern_status status = ERN_OK;
  ERN_TRY(ern_pose_list_load(job->context, path, &list));
  if (list.width != job->side || list.height != job->side || fabs(list.cx - 0.5 * job->side) > 0.51 ||
      fabs(list.cy - 0.5 * job->side) > 0.51)
    ERN_TRY(ern_fail(job->context, ERN_E_MISMATCH,
                     "%s: is for pictures of %d x %d with the middle at %g, %g; expected %d x %d with the middle at %g",
                     path, list.width, list.height, list.cx, list.cy, job->side, job->side, 0.5 * job->side));
  if (audio_mismatches != NULL) ERN_TRY(check_camera(job, path, list.focal));
  for (size_t i = 0; i < list.count; i++) {
    const size_t frame = (size_t)list.poses[i].img_id;
    if (frame >= job->frames)
      ERN_TRY(ern_fail(job->context, ERN_E_MISMATCH, "%s: img_id %zu is no frame of the clip, expected 0 to %zu", path,
                       frame, job->frames - 1));
    if (seen[frame])
      ERN_TRY(ern_fail(job->context, ERN_E_FORMAT, "%s: frame %zu: img_id %zu has a pose already, expected one of each",
                       path, i, frame));
    from_matrix(list.poses[i].matrix, &poses[frame]);
    if (!(poses[frame].translation[2] < 0))
      ERN_TRY(ern_fail(job->context, ERN_E_FORMAT,
                       "%s: frame %zu: field transform_matrix has the head %g behind the camera, which looks along -z; "
                       "expected it before the camera",
                       path, i, poses[frame].translation[2]));
    if (audio_mismatches != NULL) ERN_TRY(check_distance(job, path, i, list.focal, -poses[frame].translation[2]));
    if (audio_mismatches != NULL) ERN_TRY(check_place(job, path, i, list.focal, &poses[frame]));
    if (audio_mismatches != NULL) *audio_mismatches += list.poses[i].aud_id != list.poses[i].img_id;
    seen[frame] = true;
  }
  job->focal = list.focal;
fail:
  ern_pose_list_free(job->context, &list);
  return status;
}

/* Reads the poses from one file; supplied NULL: from the clip's two files. */
static ern_status read_poses(struct ern_prepare_job *job, const char *supplied, struct ern_head_pose *poses,
                             size_t *audio_mismatches) {
  static const char *const parts[] = {"transforms_train.json", "transforms_val.json"};
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH];
  bool *seen = NULL;
  if (audio_mismatches != NULL) *audio_mismatches = 0;
  ERN_TRY(ERN_NEW(job->context, job->frames, &seen));
  if (supplied != NULL) ERN_TRY(read_file(job, supplied, poses, seen, audio_mismatches));
  for (int i = 0; i < 2 && supplied == NULL; i++) {
    ERN_TRY(ern_prepare_path(job, path, "%s", parts[i]));
    ERN_TRY(read_file(job, path, poses, seen, audio_mismatches));
  }
  for (size_t i = 0; i < job->frames; i++)
    if (!seen[i])
      ERN_TRY(ern_fail(job->context, ERN_E_MISSING, "%s: has no pose of frame %zu, expected all of 0 to %zu",
                       supplied != NULL ? supplied : job->folder, i, job->frames - 1));
  if (supplied != NULL)
    ERN_TRY(check_angle(job, supplied, poses, roll_of, most_roll, "rolled",
                        "an upright head, and a camera whose y goes up"));
  if (supplied != NULL)
    ERN_TRY(check_angle(job, supplied, poses, aside_of, most_aside, "turned away from the camera",
                        "a face that looks into the camera, along the head's z"));
fail:
  ern_release(job->context, seen);
  return status;
}

ern_status ern_prepare_poses_read(struct ern_prepare_job *job, struct ern_head_pose *poses) {
  return read_poses(job, NULL, poses, NULL);
}

ern_status ern_prepare_poses_supplied(struct ern_prepare_job *job, struct ern_head_pose *poses,
                                      size_t *audio_mismatches) {
  return read_poses(job, job->options->poses, poses, audio_mismatches);
}

ern_status ern_prepare_pose_check(struct ern_prepare_job *job) {
  struct ern_head_pose *poses = NULL;
  size_t audio_mismatches = 0;
  if (job->options->poses == NULL) return ERN_OK;
  ern_status status = ERN_NEW(job->context, job->frames, &poses);
  if (status == ERN_OK) status = ern_prepare_poses_supplied(job, poses, &audio_mismatches);
  ern_release(job->context, poses);
  return status;
}
