/* SPDX-License-Identifier: MIT
 * The state that a training saves and a resume goes on from. Internal. */
#ifndef ERN_TRAIN_TRAINER_STATE_H
#define ERN_TRAIN_TRAINER_STATE_H

#include "train/parts/trainer_poses.h"
#include "train/parts/trainer_refresh.h"
#include "train/parts/trainer_values.h"
#include "train/run_folder.h"

struct ern_trainer_state {
  struct ern_training *training;
  struct ern_trainer_values *values;
  struct ern_trainer_occupancy *occupancy;
  struct ern_trainer_fine *fine;
  struct ern_trainer_poses *poses; /* NULL: poses are not refined */
  char *output;                    /* NULL: nothing is saved */
  struct ern_run_folder run;
  uint64_t saved; /* step of this training's newest state in the run folder; 0: none */
  bool diverged;  /* since the last save, and the folder has a state from before */
};

/* `from`, occupancy and poses into training->model. */
ERN_NODISCARD ern_status ern_trainer_download(struct ern_trainer_state *state, ern_span from);
ERN_NODISCARD ern_status ern_trainer_state_save(struct ern_trainer_state *state);
ERN_NODISCARD ern_status ern_trainer_resume(struct ern_trainer_state *state, bool *resumed);
ERN_NODISCARD ern_status ern_trainer_take_file(struct ern_trainer_state *state, const char *path); /* --from */

#endif
