/* SPDX-License-Identifier: MIT
 * What an earlier training was like, for one that goes on from it where the command line does not say otherwise. */
#ifndef ERN_CLI_INHERIT_H
#define ERN_CLI_INHERIT_H

#include "args.h"
#include "ernerf/media.h"
#include "ernerf/train.h"
#include "session/session.h"

/* What the model is made of. chosen: --effects says whether there are codes. */
void inherit_model(const struct args *args, const ern_model_info *model, bool chosen, ern_train_config *config);

/* How the model is seen, where it says so; torso: its torso too. */
void inherit_view(const struct args *args, const ern_model_info *model, bool torso, ern_train_config *config,
                  float *scale);

/* How the head that a torso goes under is seen. */
void inherit_head(const struct args *args, const ern_model *head, ern_train_config *config, float *scale);

/* Steps, rates, rays, seed, intervals and frames of the state that is resumed. */
void inherit_state(const struct args *args, const ern_train_state *state, const ern_model_info *model,
                   ern_train_config *config);

/* Fails where the clip has fewer training frames than the state that is resumed was trained on. */
int inherit_frames(const struct args *args, struct session *session, const ern_train_state *state,
                   const char *model_path, const char *clip_path, size_t frames);

/* Fails where the clip's features are of another kind than those of `head`, else of `from`; NULL: there is none. */
int inherit_speech(struct session *session, const ern_model *head, const char *head_path, const ern_model_info *from,
                   const char *from_path, const ern_clip *clip);

#endif
