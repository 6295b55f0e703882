/* SPDX-License-Identifier: MIT
 * The options of `train` for the fine stage of a head's training. */
#ifndef ERN_CLI_FINE_STAGE_H
#define ERN_CLI_FINE_STAGE_H

#include "session/lpips_weights.h"
#include "setting_choice.h"

struct fine_stage {
  int stage, loss; /* indices into the choices of --stage and --fine-loss */
  struct lpips_weights weights;
  ern_fine_loss function; /* the loss function by `weights`, once they are open */
};

#define FINE_STAGE_NAMES "stage fine-loss lpips-network lpips-heads"
enum { FINE_STAGE_OPTIONS = 2 + LPIPS_OPTIONS };
void fine_stage_options(struct fine_stage *fine, struct option options[FINE_STAGE_OPTIONS]);
/* EXIT_USAGE after a message if options contradict each other; else -1. */
int fine_stage_check(const struct fine_stage *fine, const struct args *args, const struct setting_choice *chosen,
                     bool paper);
/* With --paper and the paper's loss: the fine stage is the last fifth of the steps; without --iters these are 125,000.
 */
void fine_stage_follow_paper(const struct fine_stage *fine, const struct args *args, ern_train_config *config);
/* Sets the fine stage in the configuration. In a resumed training, inherit_state has already set the saved values
 * there. */
void fine_stage_choose(const struct fine_stage *fine, const struct args *args, const struct setting_choice *chosen,
                       bool resumed);
/* Returns an exit status after a message if options concern a fine stage that the resumed training does not have, or
 * one that it is in and cannot leave; else 0. */
int fine_stage_check_resumed(const struct args *args, const struct setting_choice *chosen, struct session *session,
                             const ern_train_state *state, const struct fine_stage *fine);
/* Reads the weights of --fine-loss lpips. Returns 0, or EXIT_FAILURE after a message. */
int fine_stage_open(struct fine_stage *fine, struct session *session, ern_train_config *config);
void fine_stage_close(struct fine_stage *fine);

#endif
