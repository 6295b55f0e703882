/* SPDX-License-Identifier: MIT
 * With --time: a head and the torso for it as one portrait, X: the head's file, the share of the time, and what of
 * both is there already. */
#ifndef ERN_CLI_HEAD_AND_TORSO_H
#define ERN_CLI_HEAD_AND_TORSO_H

#include "args.h"
#include "verbs/train_options.h"

/* Of the time of a portrait, the head's; the rest is the torso's. */
#define HEAD_SHARE (5 / 6.0)

/* Each returns 0, or an exit status after a message. */

/* Before anything is opened: names the head's file, X.head.safetensors, and looks at what a resume would go on from. */
int head_and_torso_check(struct train_job *job);

/* With the clip open: a head that is all of its portrait has X to itself, and all of the time. */
int head_and_torso_plan(struct train_job *job, const struct args *args);

/* From the head to its torso: what the head was resumed from says how the torso is trained, where no state of its own
 * does. asked: the configuration of the command line. */
void head_and_torso_turn(struct train_job *job, const ern_train_config *asked);

/* Without --time: whether what is to go on is a portrait of which the head alone has begun, as a head would begin under
 * the portrait's name. */
int head_and_torso_check_resumed(struct train_job *job);

#endif
