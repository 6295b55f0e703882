/* SPDX-License-Identifier: MIT
 * Copies settings of an earlier training into a training that continues it. Options of the command line take
 * precedence. */
#ifndef ERN_CLI_INHERIT_H
#define ERN_CLI_INHERIT_H

#include "args.h"
#include "ernerf/media.h"
#include "ernerf/train.h"
#include "session/session.h"
#include "setting_choice.h"

/* Copies the architecture of the model into the configuration; `codes`: the number of its individual codes too. */
void inherit_model(const struct setting_choice *chosen, const ern_model_info *model, bool codes);

/* Copies the camera settings of the model where its file has them; torso: those of its torso too. */
void inherit_camera_settings(const struct args *args, const struct setting_choice *chosen, const ern_model_info *model,
                             bool torso, float *scale);

/* Copies all settings that the resumed state keeps. */
void inherit_state(const struct args *args, const struct setting_choice *chosen, const ern_train_state *state,
                   const ern_model_info *model);

/* Fails if the clip has fewer training frames than the resumed state was trained on. */
int inherit_frames(const struct args *args, struct session *session, const ern_train_state *state,
                   const char *model_path, const char *clip_path, size_t frames);

/* Fails if the kind of the clip's speech features differs from that of `head`, or, if head is NULL, from that of
 * `from`. NULL: there is none. */
int inherit_speech(struct session *session, const ern_model *head, const char *head_path, const ern_model_info *from,
                   const char *from_path, const ern_clip *clip);

#endif
