/* SPDX-License-Identifier: MIT
 * The step "pose" where the user brings the poses: they become the clip's, and are held against the faces found. */
#include <math.h>

#include "prepare/head_shape.h"
#include "prepare/prepare_job.h"

void ern_prepare_judge_turn(struct ern_prepare_job *job, double turn) {
  ern_prepare_figure(job, "turn", turn);
  if (turn < 1)
    ern_prepare_judge(job, ERN_PREPARE_DOUBTFUL,
                      "the head turns by %.1f degrees in all; how deep it is cannot be told, expected 1 degree or more",
                      turn);
  if (turn > 35)
    ern_prepare_judge(job, ERN_PREPARE_DOUBTFUL, "the head turns by %.0f degrees, expected 35 at most", turn);
}

/* How many of the faces that were found lie elsewhere: their middle is further from the pose's than half their width.
 * *worst: the frame where it is furthest, -1: no face was found. */
static size_t count_astray(const struct ern_prepare_job *job, const struct ern_head_pose *poses,
                           const struct ern_found_face *faces, size_t count, long *worst) {
  static const double middle[3] = {0, 0, 0.5 * ERN_HEAD_DEEP};
  size_t astray = 0;
  double most = -1;
  *worst = -1;
  for (size_t i = 0; i < count; i++) {
    const struct ern_found_face *f = &faces[i];
    double at[2] = {0, 0}, apart = HUGE_VAL;
    if (f->frame >= job->frames || !(f->width > 0)) continue;
    if (ern_head_project(&poses[f->frame], job->focal, 0.5 * job->side, middle, at))
      apart =
          hypot(at[0] - (double)(f->x + 0.5f * f->width), at[1] - (double)(f->y + 0.5f * f->height)) / (double)f->width;
    astray += apart > 0.5;
    if (apart <= most) continue;
    most = apart;
    *worst = (long)f->frame;
  }
  return astray;
}

/* What was brought, beside what the step "face" found. */
static ern_status judge_brought(struct ern_prepare_job *job, const struct ern_head_pose *poses) {
  ern_status status = ERN_OK;
  struct ern_found_face *faces = NULL;
  size_t count = 0;
  long worst = -1;
  double turn = 0;
  ERN_TRY(ern_prepare_faces_read(job, &faces, &count));
  for (size_t i = 1; i < job->frames; i++) turn = fmax(turn, ern_head_turn(&poses[i], &poses[0]));
  ern_prepare_judge_turn(job, turn);
  const size_t astray = count_astray(job, poses, faces, count, &worst);
  ern_prepare_figure(job, "astray", count > 0 ? (double)astray / (double)count : 0);
  if (astray > 0)
    ern_prepare_judge(
        job, ERN_PREPARE_DOUBTFUL,
        "%s: in %zu of the %zu frames where a face was found the pose has the head elsewhere, furthest in "
        "frame %ld; expected it within half a face of what was found",
        job->options->poses, astray, count, worst);
fail:
  ern_release(job->context, faces);
  return status;
}

ern_status ern_prepare_poses_take(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  struct ern_head_pose *poses = NULL;
  size_t unheard = 0;
  ERN_TRY(ERN_NEW(job->context, job->frames, &poses));
  ERN_TRY(ern_prepare_poses_bring(job, poses, &unheard));
  ERN_TRY(judge_brought(job, poses));
  ERN_TRY(ern_prepare_poses_write(job, poses));
  if (unheard > 0)
    ern_prepare_judge(job, ERN_PREPARE_DOUBTFUL,
                      "aud_id is not img_id in %zu of %zu frames of %s, and was not taken: a frame of the clip hears "
                      "what it shows",
                      unheard, job->frames, job->options->poses);
fail:
  ern_release(job->context, poses);
  return status;
}
