/* SPDX-License-Identifier: MIT
 * The JSON description, in a state file, of the training that wrote it; and the check of what a resume may change. */
#ifndef ERN_TRAIN_STATE_ABOUT_H
#define ERN_TRAIN_STATE_ABOUT_H

#include "train/parts/trainer_shared.h"

struct ern_state_about {
  bool torso;
  uint64_t step, ema_updates;
  double seconds;
  bool has_settings;       /* false: a state of the public program, which has none of the following */
  ern_train_config config; /* the settings that a state keeps; the others are the defaults */
  bool layer;              /* the clip's torso lies behind the head */
  char features[65];       /* SHA-256 of the speech features */
  char fingerprint[65];    /* of the frames' files; "": not known */
  double beside;           /* seconds spent on validations and saves */
  uint64_t fine_from;      /* UINT64_MAX: no fine stage */
  char fine_loss[32];
  double fine_value; /* of a given fine_loss for a made-up patch; NAN: not known */
  bool pruned;       /* the occupancy bits are pruned */
};

/* *text is owned by the caller (ern_release). */
ERN_NODISCARD ern_status ern_state_about_text(ern_context *context, const struct ern_state_about *about, char **text);
ERN_NODISCARD ern_status ern_state_about_parse(ern_context *context, const char *text, const char *path,
                                               struct ern_state_about *about);

/* The view settings of this training. */
struct ern_view_settings ern_trainer_view_settings(const struct ern_training *t);

/* Compares the settings of the model in `path` with this training's; does nothing where the file has none. A difference
 * is ERN_E_MISMATCH where `strict`, else a line of the log. torso_shrink is compared only where `torso`. */
ERN_NODISCARD ern_status ern_trainer_check_view(const struct ern_training *t, const char *path,
                                                const struct ern_view_settings *found, bool torso, bool strict);

/* Checks a resume of `about`, where this training is `here`: a difference that would mix two trainings is
 * ERN_E_MISMATCH; each one that is allowed is a line of the log. */
ERN_NODISCARD ern_status ern_state_about_check(const struct ern_training *t, const char *path,
                                               const struct ern_state_about *about, const struct ern_state_about *here,
                                               const struct ern_view_settings *view);

#endif
