/* SPDX-License-Identifier: MIT
 * The fine stage of a head's training, as the command line of `train` has it. */
#ifndef ERN_CLI_FINE_STAGE_H
#define ERN_CLI_FINE_STAGE_H

#include "session/lpips_weights.h"

struct fine_stage {
  int stage, loss; /* places among the words of --stage and --fine-loss */
  struct lpips_weights weights;
  ern_fine_loss function; /* of the weights, once they are open */
};

#define FINE_STAGE_NAMES "stage fine-steps patch-size fine-weight fine-lips-weight fine-loss lpips-network lpips-heads"
enum { FINE_STAGE_OPTIONS = 6 + LPIPS_OPTIONS };
void fine_stage_options(struct fine_stage *fine, ern_train_config *config, struct option options[FINE_STAGE_OPTIONS]);
/* EXIT_USAGE where the words do not go together; else -1. */
int fine_stage_check(const struct fine_stage *fine, const struct args *args, const ern_train_config *config,
                     bool paper);
/* With --paper and the loss of the paper: the last fifth of the steps, of 125,000 where --iters does not say. */
void fine_stage_follow_paper(const struct fine_stage *fine, const struct args *args, ern_train_config *config);
/* Sets what `config` has of it, in which inherit_state has put what the training to resume has. */
void fine_stage_choose(const struct fine_stage *fine, const struct args *args, bool resumed, ern_train_config *config);
/* Where words are about a fine stage that the training to resume does not have, or is in and does not leave: a message
 * and its exit status; else 0. */
int fine_stage_check_resumed(const struct args *args, struct session *session, const ern_train_state *state,
                             const struct fine_stage *fine, const ern_train_config *config);
/* Reads the weights of --fine-loss lpips. Returns 0, or EXIT_FAILURE after a message. */
int fine_stage_open(struct fine_stage *fine, struct session *session, ern_train_config *config);
void fine_stage_close(struct fine_stage *fine);

#endif
