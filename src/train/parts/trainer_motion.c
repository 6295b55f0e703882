/* SPDX-License-Identifier: MIT */
#include "train/parts/trainer_motion.h"

#include <string.h>

#include "core/memory.h"
#include "model/torso.h"
#include "train/parts/trainer_data.h"

/* Of ern_pose_regression_fit; found by experiment (docs/results.md). */
static const double ridge = 1e-3;

ern_status ern_trainer_motion_set(struct ern_training *t, bool on) {
  const size_t frames = t->data.frames[0], begin = t->config.data_begin, count = t->config.data_end - begin;
  float *pose = NULL, *motion = NULL;
  ern_dataset_frame about;
  ern_status status = ERN_OK;
  if (t->motion == NULL) ERN_TRY(ERN_NEW(t->context, frames, &t->motion));
  memset(t->motion, 0, frames * sizeof *t->motion);
  t->model->has_motion = on;
  if (!on) return ERN_OK;
  ERN_TRY(ERN_NEW(t->context, 16 * count, &pose));
  ERN_TRY(ERN_NEW(t->context, ERN_MOTION_VALUES * count, &motion));
  for (size_t i = 0; i < frames; i++) {
    ERN_TRY(ern_trainer_frame(t, 0, i, &about));
    ern_torso_motion_of(t->motion[i], about.torso_motion, t->config.torso_shrink);
    if (i < begin || i >= begin + count) continue;
    memcpy(pose + 16 * (i - begin), t->views[i].pose, 16 * sizeof *pose);
    memcpy(motion + ERN_MOTION_VALUES * (i - begin), about.torso_motion, sizeof about.torso_motion);
  }
  ern_pose_regression_fit(t->model->motion[0], ERN_MOTION_VALUES, pose, motion, count, ridge);
fail:
  ern_release(t->context, pose);
  ern_release(t->context, motion);
  return status;
}

ern_status ern_trainer_motion_follow(struct ern_training *t, const ern_model *model, const char *path, bool strict) {
  if (!t->config.torso) return ERN_OK;
  if (model->has_motion && !t->data.has_torso_motion) {
    if (strict)
      return ern_fail(t->context, ERN_E_MISMATCH,
                      "%s: was trained with the body's motion, and the clip has none; expected its torso.npy", path);
    ern_log(t->context, ERN_LOG_WARNING,
            "%s: was trained with the body's motion, and goes on without: the clip has none", path);
  }
  if (model->has_motion && t->data.has_torso_motion && !t->config.torso_motion)
    ern_log(t->context, ERN_LOG_WARNING,
            "%s: torso_motion is no, but it was trained with the body's motion, and goes on with it: only a new "
            "training is without",
            path);
  if (!model->has_motion && t->model->has_motion)
    ern_log(t->context, ERN_LOG_INFO, "%s: was trained without the body's motion, and goes on without", path);
  return ern_trainer_motion_set(t, model->has_motion && t->data.has_torso_motion);
}
