/* SPDX-License-Identifier: MIT
 * Calls the callbacks of a dataset and checks their results at every step: they are the caller's code, and may return
 * something else each time. */
#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "core/status.h"
#include "train/trainer.h"

static const char *name_of(int split) { return split == 0 ? "training" : "validation"; }

bool ern_trainer_said_nothing(const ern_trainer *t, const char before[ERN_ERROR_BYTES]) {
  char now[ERN_ERROR_BYTES];
  ern_error_keep(t->shared.context, now);
  return strcmp(before, now) == 0;
}

static ern_status answered(const ern_trainer *t, ern_status status, const char *callback, int split, size_t frame,
                           const char before[ERN_ERROR_BYTES]) {
  if (!ern_trainer_said_nothing(t, before)) return status;
  return ern_fail(t->shared.context, status, "train: the dataset's `%s` answered %s for %s frame %zu", callback,
                  ern_status_name(status), name_of(split), frame);
}

ern_status ern_trainer_frame(const ern_trainer *t, int split, size_t frame, ern_dataset_frame *about) {
  char before[ERN_ERROR_BYTES];
  ern_error_keep(t->shared.context, before);
  *about = (ern_dataset_frame){0};
  const ern_status status = t->shared.data.frame(t->shared.data.user, split, frame, about);
  if (status != ERN_OK) return answered(t, status, "frame", split, frame, before);
  if (about->aud_id < 0)
    return ern_fail(t->shared.context, ERN_E_ARGUMENT, "train: %s frame %zu: aud_id is %" PRId64 ", expected 0 or more",
                    name_of(split), frame, about->aud_id);
  if (!(about->eye >= 0 && about->eye <= 1))
    return ern_fail(t->shared.context, isnan(about->eye) ? ERN_E_NONFINITE : ERN_E_ARGUMENT,
                    "train: %s frame %zu: eye is %g, expected 0 to 1", name_of(split), frame, (double)about->eye);
  return ERN_OK;
}

ern_status ern_trainer_pixels(const ern_trainer *t, int split, size_t frame, const uint8_t **truth,
                              const uint8_t **torso) {
  char before[ERN_ERROR_BYTES];
  ern_error_keep(t->shared.context, before);
  *truth = *torso = NULL;
  const ern_status status = t->shared.data.pixels(t->shared.data.user, split, frame, truth, torso);
  if (status != ERN_OK) return answered(t, status, "pixels", split, frame, before);
  if (!t->shared.data.has_torso) *torso = NULL;
  if (*truth != NULL) return ERN_OK;
  return ern_fail(t->shared.context, ERN_E_ARGUMENT, "train: the dataset's `pixels` gives no truth for %s frame %zu",
                  name_of(split), frame);
}

ern_status ern_trainer_head(const ern_trainer *t, size_t frame, const uint8_t **head) {
  char before[ERN_ERROR_BYTES];
  ern_error_keep(t->shared.context, before);
  *head = NULL;
  const bool used =
      t->shared.config.head_random_background || t->shared.config.ray_sampling == ERN_RAY_SAMPLING_REGIONS;
  if (t->shared.data.head == NULL || t->shared.config.torso || !used) return ERN_OK;
  const ern_status status = t->shared.data.head(t->shared.data.user, 0, frame, head);
  return status == ERN_OK ? ERN_OK : answered(t, status, "head", 0, frame, before);
}
