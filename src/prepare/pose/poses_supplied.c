/* SPDX-License-Identifier: MIT
 * The step "pose" with poses that the user supplies: they become the clip's, and are compared with the detected faces.
 */
#include <math.h>

#include "prepare/head_shape.h"
#include "prepare/prepare_job.h"

void ern_prepare_check_turn(struct ern_prepare_job *job, double turn) {
  ern_prepare_figure(job, "turn", turn);
  if (turn < 1)
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "the head turns by %.1f degrees in all, which is too little to measure its depth, expected 1 degree or more",
        turn);
  if (turn > 35)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL, "the head turns by %.0f degrees, expected 35 at most", turn);
}

/* A pose and the detected face of its frame. */
struct beside {
  double at[2], found[2]; /* pixels: centres of the pose's face and of the detected face */
  double width, wide;     /* pixels: of the detected face, and of the pose's head */
};

static struct beside lay_beside(const struct ern_prepare_job *job, const struct ern_head_pose *pose,
                                const struct ern_found_face *face) {
  static const double middle[3] = {0, 0, 0.5 * ERN_HEAD_DEEP};
  struct beside b = {.found = {(double)(face->x + 0.5f * face->width), (double)(face->y + 0.5f * face->height)},
                     .width = (double)face->width,
                     .wide = 2 * ERN_HEAD_WIDE * job->focal / -pose->translation[2]};
  (void)ern_head_project(pose, job->focal, 0.5 * job->side, middle, b.at); /* they are in front of the camera */
  return b;
}

/* Statistics over all frames. Our own poses of eight videos gave: width / wide 1.1 to 1.3, at most 0.16 widths apart,
 * and correlations of 0.77 to 0.99 where the face moves by more than 0.025 of its width (standard deviation). */
struct agreement {
  size_t count, mismatches;
  long worst;                  /* frame with the greatest distance */
  double farthest, size;       /* widths of the face; mean of log(width / wide) */
  double moved[2], follows[2]; /* along x and y: standard deviation of found, in widths; correlation with at */
};

static struct agreement agree(const struct ern_prepare_job *job, const struct ern_head_pose *poses,
                              const struct ern_found_face *faces, size_t count) {
  struct agreement a = {.worst = -1, .farthest = -1};
  double mean[2][2] = {{0}}, square[2][2] = {{0}}, product[2] = {0}, width = 0;
  for (size_t i = 0; i < count; i++) {
    if (faces[i].frame >= job->frames || !(faces[i].width > 0)) continue;
    const struct beside b = lay_beside(job, &poses[faces[i].frame], &faces[i]);
    const double apart = hypot(b.at[0] - b.found[0], b.at[1] - b.found[1]) / b.width, n = (double)++a.count;
    a.mismatches += apart > 0.35;
    if (apart > a.farthest) a.worst = (long)faces[i].frame;
    a.farthest = fmax(a.farthest, apart);
    a.size += (log(b.width / b.wide) - a.size) / n;
    width += (b.width - width) / n;
    for (int c = 0; c < 2; c++) { /* Welford's sums */
      const double values[2] = {b.found[c], b.at[c]}, before = values[1] - mean[c][1];
      for (int k = 0; k < 2; k++) {
        const double off = values[k] - mean[c][k];
        mean[c][k] += off / n;
        square[c][k] += off * (values[k] - mean[c][k]);
      }
      product[c] += (values[0] - mean[c][0]) * before;
    }
  }
  for (int c = 0; c < 2 && a.count > 0; c++) {
    a.moved[c] = sqrt(square[c][0] / (double)a.count) / width;
    const double spread = sqrt(square[c][0] * square[c][1]);
    a.follows[c] = spread > 0 ? product[c] / spread : 0;
  }
  return a;
}

static void check_agreement(struct ern_prepare_job *job, const struct agreement *a) {
  const char *file = job->options->poses;
  const double size = exp(a->size);
  ern_prepare_figure(job, "astray", a->count > 0 ? (double)a->mismatches / (double)a->count : 0);
  ern_prepare_figure(job, "face_over_head", size);
  if (a->mismatches > 0)
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "%s: in %zu of the %zu frames where a face was found the pose has the head elsewhere, furthest in "
        "frame %ld; expected it within a third of a face of what was found",
        file, a->mismatches, a->count, a->worst);
  if (a->count > 0 && (size < 0.8 || size > 1.8))
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "%s: the faces that were found are %.2f times as wide as the poses have the head, expected 0.8 to "
        "1.8; the focal length or the unit of distances may be another",
        file, size);
  for (int c = 0; c < 2; c++)
    if (a->count >= 8 && a->moved[c] > 0.025 && a->follows[c] < 0.4)
      ern_prepare_add_reason(
          job, ERN_PREPARE_DOUBTFUL,
          "%s: the poses do not move %s as the faces do that were found (correlation %.2f, expected 0.4 "
          "or more); they may be of other frames, another video or a mirrored one",
          file, c == 0 ? "sideways" : "up and down", a->follows[c]);
}

/* Compares the supplied poses with the faces of the step "face". */
static ern_status check_supplied(struct ern_prepare_job *job, const struct ern_head_pose *poses) {
  ern_status status = ERN_OK;
  struct ern_found_face *faces = NULL;
  size_t count = 0;
  double turn = 0;
  ERN_TRY(ern_prepare_faces_read(job, &faces, &count));
  for (size_t i = 1; i < job->frames; i++) turn = fmax(turn, ern_head_turn(&poses[i], &poses[0]));
  ern_prepare_check_turn(job, turn);
  const struct agreement agreement = agree(job, poses, faces, count);
  check_agreement(job, &agreement);
fail:
  ern_release(job->context, faces);
  return status;
}

ern_status ern_prepare_poses_take(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  struct ern_head_pose *poses = NULL;
  size_t audio_mismatches = 0;
  ERN_TRY(ERN_NEW(job->context, job->frames, &poses));
  ERN_TRY(ern_prepare_poses_supplied(job, poses, &audio_mismatches));
  ERN_TRY(check_supplied(job, poses));
  ERN_TRY(ern_prepare_poses_write(job, poses));
  if (audio_mismatches > 0)
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "aud_id is not img_id in %zu of %zu frames of %s, and was not taken: in the clip, each frame "
        "has the speech window of its own number",
        audio_mismatches, job->frames, job->options->poses);
fail:
  ern_release(job->context, poses);
  return status;
}
