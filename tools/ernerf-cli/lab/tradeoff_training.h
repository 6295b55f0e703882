/* SPDX-License-Identifier: MIT */
#ifndef ERN_CLI_TRADEOFF_TRAINING_H
#define ERN_CLI_TRADEOFF_TRAINING_H

/* `ernerf tradeoff --training`; as a verb. */
int tradeoff_training(int argc, char **argv);

#endif
