/* SPDX-License-Identifier: MIT
 * The motion of the body that a torso is trained with (docs/maths.md, Torso). Internal. */
#ifndef ERN_TRAIN_TRAINER_MOTION_H
#define ERN_TRAIN_TRAINER_MOTION_H

#include "train/parts/trainer_shared.h"

/* Fills t->motion with the dataset's or, where `on` is false, with zeros; and the model's regression of it. */
ERN_NODISCARD ern_status ern_trainer_motion_set(struct ern_training *t, bool on);
/* A torso goes on from that of `model`, with motion or without as it began. `path`: of its file. strict: ERN_E_MISMATCH
 * where it began with motion and the dataset has none; else it goes on without, with a warning. */
ERN_NODISCARD ern_status ern_trainer_motion_follow(struct ern_training *t, const ern_model *model, const char *path,
                                                   bool strict);

#endif
