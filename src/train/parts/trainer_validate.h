/* SPDX-License-Identifier: MIT
 * Validation. Internal. */
#ifndef ERN_TRAIN_TRAINER_VALIDATE_H
#define ERN_TRAIN_TRAINER_VALIDATE_H

#include "train/parts/trainer_poses.h"
#include "train/parts/trainer_speech.h"

/* Renders validation frames with training->model. poses NULL: they are not refined. *psnr: the mean */
ERN_NODISCARD ern_status ern_trainer_validate(const struct ern_trainer_speech *speech,
                                              const struct ern_trainer_poses *poses, const ern_train_hooks *hooks,
                                              double *psnr);

#endif
