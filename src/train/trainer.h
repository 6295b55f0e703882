/* SPDX-License-Identifier: MIT
 * A trainer: what its parts share, and the parts. Internal. */
#ifndef ERN_TRAIN_TRAINER_H
#define ERN_TRAIN_TRAINER_H

#include "train/parts/trainer_batch.h"
#include "train/parts/trainer_parts.h"
#include "train/parts/trainer_processes.h"
#include "train/parts/trainer_prune.h"
#include "train/parts/trainer_state.h"
#include "train/parts/trainer_validate.h"

enum { ERN_SMOOTH_EVERY = 16 /* steps between smoothness terms */ };

struct ern_trainer {
  struct ern_training shared;
  struct ern_trainer_values values;
  struct ern_trainer_fine fine;
  struct ern_trainer_speech speech;
  struct ern_trainer_poses *poses; /* NULL: poses are not refined */
  struct ern_trainer_batches batches;
  struct ern_trainer_parts parts; /* of a step */
  struct ern_trainer_occupancy occupancy;
  bool between; /* a step has changed the occupancy grid and is not complete: a resume would change it again */
  struct ern_trainer_state state;
  struct ern_run_folder torso_run; /* of config.torso_output: only locked */
};

/* trainer_distributed.c */
/* Copies the state of rank 0 to all processes, after checking that they have the same settings and data. Waits for
 * all. */
ERN_NODISCARD ern_status ern_trainer_share_state(ern_trainer *t);

#endif
