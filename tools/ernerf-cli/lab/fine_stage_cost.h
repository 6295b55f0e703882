/* SPDX-License-Identifier: MIT
 * What a step of the fine stage takes, beside a coarse step of the same training (docs/maths.md, The fine stage). */
#ifndef ERN_CLI_FINE_STAGE_COST_H
#define ERN_CLI_FINE_STAGE_COST_H

#include "ernerf/train.h"
#include "output/training_report.h"
#include "session/lpips_weights.h"

/* Trains as `config` says but for iters, fine stage and output: up to three trainers with the same weights after the
 * same coarse steps, which then make a step each in turns: a coarse one, a fine one with structural similarity, and
 * with the weights of LPIPS (open, else none) a fine one with that. seconds: that it takes, about. Fills *price; where
 * the clip or the rays have no room for patches, with the reason. Returns 0, or EXIT_FAILURE after a message. */
int fine_stage_cost_measure(struct fine_stage_cost *price, struct session *session, ern_backend *backend,
                            const ern_dataset *dataset, const ern_train_config *config,
                            const struct lpips_weights *weights, double seconds);

#endif
