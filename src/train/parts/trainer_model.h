/* SPDX-License-Identifier: MIT
 * What a training's model takes from other models. Internal. */
#ifndef ERN_TRAIN_TRAINER_MODEL_H
#define ERN_TRAIN_TRAINER_MODEL_H

#include "train/parts/trainer_shared.h"

/* Sets t->bf16, whether products are in bf16. `path`: the origin of the request, for messages. */
ERN_NODISCARD ern_status ern_trainer_choose_precision(struct ern_training *t, const char *path, ern_precision wanted);
/* Whether the model is known to be of another clip. */
bool ern_trainer_is_foreign(const struct ern_training *t, const ern_model *model);
/* Copies the consent text of a model that is not of another clip, where the configuration gives none. */
void ern_trainer_keep_consent(const struct ern_training *t, const ern_model *from);
/* Copies the rows of the torso or those of the head, with the other data that belongs to either; of individual codes as
 * many as both have. Other rows have the same shape in both. */
void ern_trainer_copy_rows(ern_model *to, const ern_model *from, bool torso);
/* Copies the camera refinement into a model without one. */
ERN_NODISCARD ern_status ern_trainer_copy_camera(ern_model *to, const ern_model *from);
/* Logs that a file has another number of individual codes than this training, where it has. */
void ern_trainer_log_codes(const struct ern_training *t, const char *path, int found);

#endif
