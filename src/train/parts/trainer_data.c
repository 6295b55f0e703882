/* SPDX-License-Identifier: MIT
 * Calls the callbacks of a dataset and checks their results at every step: they are the caller's code, and may return
 * something else each time. */
#include "train/parts/trainer_data.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/rng.h"
#include "core/status.h"
#include "render/frame_input.h"

static const char *name_of(int split) { return split == 0 ? "training" : "validation"; }

bool ern_trainer_error_is(ern_context *context, const char before[ERN_ERROR_BYTES]) {
  char now[ERN_ERROR_BYTES];
  ern_error_keep(context, now);
  return strcmp(before, now) == 0;
}

static ern_status answered(const struct ern_training *t, ern_status status, const char *callback, int split,
                           size_t frame, const char before[ERN_ERROR_BYTES]) {
  if (!ern_trainer_error_is(t->context, before)) return status;
  return ern_fail(t->context, status, "train: the dataset's `%s` answered %s for %s frame %zu", callback,
                  ern_status_name(status), name_of(split), frame);
}

ern_status ern_trainer_frame(const struct ern_training *t, int split, size_t frame, ern_dataset_frame *about) {
  char before[ERN_ERROR_BYTES];
  ern_error_keep(t->context, before);
  *about = (ern_dataset_frame){0};
  const ern_status status = t->data.frame(t->data.user, split, frame, about);
  if (status != ERN_OK) return answered(t, status, "frame", split, frame, before);
  if (about->aud_id < 0)
    return ern_fail(t->context, ERN_E_ARGUMENT, "train: %s frame %zu: aud_id is %" PRId64 ", expected 0 or more",
                    name_of(split), frame, about->aud_id);
  for (int i = 0; i < ERN_MOTION_VALUES && t->data.has_torso_motion; i++)
    if (!(fabsf(about->torso_motion[i]) <= 1e3f))
      return ern_fail(t->context, ERN_E_ARGUMENT,
                      "train: %s frame %zu: torso_motion: value %d is %g, expected -1000 to 1000", name_of(split),
                      frame, i, (double)about->torso_motion[i]);
  if (!(about->eye >= 0 && about->eye <= 1))
    return ern_fail(t->context, isnan(about->eye) ? ERN_E_NONFINITE : ERN_E_ARGUMENT,
                    "train: %s frame %zu: eye is %g, expected 0 to 1", name_of(split), frame, (double)about->eye);
  return ERN_OK;
}

ern_status ern_trainer_pixels(const struct ern_training *t, int split, size_t frame, const uint8_t **truth,
                              const uint8_t **torso) {
  char before[ERN_ERROR_BYTES];
  ern_error_keep(t->context, before);
  *truth = *torso = NULL;
  const ern_status status = t->data.pixels(t->data.user, split, frame, truth, torso);
  if (status != ERN_OK) return answered(t, status, "pixels", split, frame, before);
  if (!t->data.has_torso) *torso = NULL;
  if (*truth != NULL) return ERN_OK;
  return ern_fail(t->context, ERN_E_ARGUMENT, "train: the dataset's `pixels` gives no truth for %s frame %zu",
                  name_of(split), frame);
}

ern_status ern_trainer_head(const struct ern_training *t, size_t frame, const uint8_t **head) {
  char before[ERN_ERROR_BYTES];
  ern_error_keep(t->context, before);
  *head = NULL;
  const bool used = t->config.head_random_background || t->config.ray_sampling == ERN_RAY_SAMPLING_REGIONS;
  if (t->data.head == NULL || t->config.torso || !used) return ERN_OK;
  const ern_status status = t->data.head(t->data.user, 0, frame, head);
  return status == ERN_OK ? ERN_OK : answered(t, status, "head", 0, frame, before);
}

ern_status ern_trainer_view(const struct ern_training *t, int split, size_t frame, struct ern_view *view) {
  ern_dataset_frame about;
  const ern_status status = ern_trainer_frame(t, split, frame, &about);
  *view = (struct ern_view){.focal = (float)t->data.focal,
                            .cx = (float)t->data.cx,
                            .cy = (float)t->data.cy,
                            .width = t->data.width,
                            .height = t->data.height};
  if (status != ERN_OK) return status;
  char name[64];
  snprintf(name, sizeof name, "train: pose of %s frame %zu", split == 0 ? "training" : "validation", frame);
  ern_camera_pose(view->pose, about.matrix, t->data.scale);
  return ern_pose_check(t->context, name, view->pose);
}

size_t ern_trainer_random_frame(const struct ern_training *t, uint32_t word) {
  return t->config.data_begin + ern_below(word, (uint32_t)(t->config.data_end - t->config.data_begin));
}
