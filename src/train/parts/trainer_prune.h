/* SPDX-License-Identifier: MIT
 * Pruning of a head's occupancy. Internal. */
#ifndef ERN_TRAIN_TRAINER_PRUNE_H
#define ERN_TRAIN_TRAINER_PRUNE_H

#include "train/parts/trainer_poses.h"
#include "train/parts/trainer_refresh.h"

/* Whether the next step is one of the last part of a head's training, in which the occupancy grid stays pruned. */
bool ern_trainer_prune_due(const struct ern_trainer_fine *fine);
/* Clears the bits of cells that contribute less than config.prune_share. poses NULL: they are not refined. */
ERN_NODISCARD ern_status ern_trainer_prune(struct ern_trainer_occupancy *occupancy,
                                           const struct ern_trainer_poses *poses);

#endif
