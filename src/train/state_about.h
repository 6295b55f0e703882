/* SPDX-License-Identifier: MIT
 * The JSON description, in a state file, of the training that wrote it; and the check of what a resume may change. */
#ifndef ERN_TRAIN_STATE_ABOUT_H
#define ERN_TRAIN_STATE_ABOUT_H

#include "train/trainer.h"

struct ern_state_about {
  bool torso;
  uint64_t step, ema_updates, seed;
  int rays; /* 0: a state of the public program */
  double seconds;
  /* Not in states of early versions: */
  bool said;
  uint64_t iters, ema_every, refresh_every, data_begin, data_end;
  float lr, lr_net, lr_att;
  bool ema, layer;      /* the model is the average; the clip's torso lies behind the head */
  bool bf16;            /* products in bf16; missing in earlier files, which were trained in fp32 */
  char features[65];    /* SHA-256 of the speech features */
  char fingerprint[65]; /* of the frames' files; "": not known */
  ern_ray_sampling ray_sampling;
  double budget, beside; /* seconds: config.seconds; time spent on validations and saves */
  bool refine_poses;
  bool torso_gamma;             /* config.torso_gamma; in a head's state, the setting of its torso */
  bool torso_random_background; /* likewise */
  bool head_random_background;  /* likewise */
  int frames_per_step, step_parts;
  uint64_t fine_from; /* UINT64_MAX: no fine stage; then the next four are 0 */
  int patch_size;
  float fine_weight, fine_lips_weight;
  char fine_loss[32];
  double fine_share; /* of config.seconds */
  float prune_share;
  bool pruned; /* the occupancy bits are pruned */
};

/* *text is owned by the caller (ern_release). */
ERN_NODISCARD ern_status ern_state_about_text(const ern_trainer *t, char **text);
ERN_NODISCARD ern_status ern_state_about_parse(ern_context *context, const char *text, const char *path,
                                               struct ern_state_about *about);

const char *ern_precision_word(bool bf16); /* "fp32", "bf16" */

/* The view settings of this training. */
struct ern_view_settings ern_trainer_view_settings(const ern_trainer *t);

/* Compares the settings of the model in `path` with this training's; does nothing where the file has none. A difference
 * is ERN_E_MISMATCH where `strict`, else a line of the log. torso_shrink is compared only where `torso`. */
ERN_NODISCARD ern_status ern_trainer_check_view(const ern_trainer *t, const char *path,
                                                const struct ern_view_settings *found, bool torso, bool strict);

/* Checks a resume: a difference that would mix two trainings is ERN_E_MISMATCH; each one that is allowed is a line of
 * the log. */
ERN_NODISCARD ern_status ern_state_about_check(const ern_trainer *t, const char *path,
                                               const struct ern_state_about *about,
                                               const struct ern_view_settings *view);

#endif
