/* SPDX-License-Identifier: MIT
 * The heights between which a head's voice ends (docs/maths.md, Field). Internal. */
#ifndef ERN_TRAIN_TRAINER_FADE_H
#define ERN_TRAIN_TRAINER_FADE_H

#include "train/parts/trainer_shared.h"

/* Sets the model's voice_fade from the places of lips and eyes in the training frames; zeros where these are not
 * known. */
ERN_NODISCARD ern_status ern_trainer_fade_find(struct ern_training *t);
/* A training goes on from `model` of the file `path`, with the heights that it began with. */
void ern_trainer_fade_follow(struct ern_training *t, const ern_model *model, const char *path);

#endif
