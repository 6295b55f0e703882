/* SPDX-License-Identifier: MIT
 * A step of a training. Internal. */
#ifndef ERN_TRAIN_TRAINER_STEP_H
#define ERN_TRAIN_TRAINER_STEP_H

#include "train/trainer.h"

ERN_NODISCARD ern_status ern_trainer_take_step(ern_trainer *t, ern_train_report *report);

#endif
