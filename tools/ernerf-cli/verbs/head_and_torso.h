/* SPDX-License-Identifier: MIT
 * With --time, one call trains a head and then its torso, as one portrait X. This file names the head's file, divides
 * the time, and finds what an earlier call has already trained of both. */
#ifndef ERN_CLI_HEAD_AND_TORSO_H
#define ERN_CLI_HEAD_AND_TORSO_H

#include "args.h"
#include "verbs/train_options.h"

/* The head's share of the training time; the rest is the torso's. */
#define HEAD_SHARE (5 / 6.0)

/* Each returns 0, or an exit status after a message. */

/* Runs before anything is opened. Names the head's file, X.head.safetensors, and with --resume checks the saved states.
 */
int head_and_torso_check(struct train_job *job);

/* Runs when the clip is open. A portrait without a torso is a head alone: it is written to X and gets all of the time.
 */
int head_and_torso_plan(struct train_job *job, const struct args *args);

/* Switches the job from the head to its torso. If the torso has no saved state, it takes the settings of the state that
 * the head was resumed from. asked: the configuration of the command line. */
void head_and_torso_switch_to_torso(struct train_job *job, const ern_train_config *asked);

/* Without --time: fails if X has no saved state but X.head.safetensors has one. Such a portrait was begun with --time,
 * and without it a new head would begin under the name X. */
int head_and_torso_check_resumed(struct train_job *job);

#endif
