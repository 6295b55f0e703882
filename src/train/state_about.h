/* SPDX-License-Identifier: MIT
 * What a state says of the training that wrote it, as JSON; and what a resume may change of it. */
#ifndef ERN_TRAIN_STATE_ABOUT_H
#define ERN_TRAIN_STATE_ABOUT_H

#include "train/trainer.h"

struct ern_state_about {
  bool torso;
  uint64_t step, ema_updates, seed;
  int rays; /* 0: a state of the public program */
  double seconds;
  /* Of states since these are kept: */
  bool said;
  uint64_t iters, ema_every, refresh_every, data_begin, data_end;
  float lr, lr_net, lr_att;
  bool ema, layer;   /* the model is the average; the clip's torso lies behind the head */
  bool bf16;         /* of products; files of before do not say it, and were trained in fp32 */
  char features[65]; /* SHA-256 of the speech features */
  ern_ray_sampling ray_sampling;
  double budget, beside; /* seconds: of config.seconds, and of validations and saves */
  bool refine_poses;
  bool torso_gamma;             /* config.torso_gamma; of a head what its torso is to have */
  bool torso_random_background; /* likewise */
  bool head_random_background;  /* likewise */
  int frames_per_step, step_parts;
  uint64_t fine_from; /* UINT64_MAX: no fine stage; then the next four are 0 */
  int patch_size;
  float fine_weight, fine_lips_weight;
  char fine_loss[32];
  double fine_share; /* of config.seconds */
  float prune_share;
  bool pruned; /* the occupancy bits */
};

/* *text is the caller's (ern_release). */
ERN_NODISCARD ern_status ern_state_about_text(const ern_trainer *t, char **text);
ERN_NODISCARD ern_status ern_state_about_parse(ern_context *context, const char *text, const char *path,
                                               struct ern_state_about *about);

const char *ern_precision_word(bool bf16); /* "fp32", "bf16" */

/* The view settings of this training. */
struct ern_view_settings ern_trainer_view_settings(const ern_trainer *t);

/* Settings of the model in `path` against this training's; nothing where the file does not say them. What differs is
 * ERN_E_MISMATCH where `strict`, else a line of the log. torso_shrink is looked at where `torso`. */
ERN_NODISCARD ern_status ern_trainer_check_view(const ern_trainer *t, const char *path,
                                                const struct ern_view_settings *found, bool torso, bool strict);

/* A resume: what would mix two trainings is ERN_E_MISMATCH; what may change is told line by line. */
ERN_NODISCARD ern_status ern_state_about_check(const ern_trainer *t, const char *path,
                                               const struct ern_state_about *about,
                                               const struct ern_view_settings *view);

#endif
