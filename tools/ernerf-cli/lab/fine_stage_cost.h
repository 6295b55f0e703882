/* SPDX-License-Identifier: MIT
 * Times a step of the fine stage against a coarse step of the same training (docs/maths.md, The fine stage). */
#ifndef ERN_CLI_FINE_STAGE_COST_H
#define ERN_CLI_FINE_STAGE_COST_H

#include "ernerf/train.h"
#include "output/training_report.h"
#include "session/lpips_weights.h"

/* Trains with `config` except for iters, fine stage and output. Up to three trainers with the same weights after the
 * same coarse steps make steps in turns: a coarse one, a fine one with structural similarity, and, if the weights of
 * LPIPS are open, a fine one with LPIPS. seconds: approximate duration. Fills *price; its count is 0 if the clip or the
 * rays have no room for patches. Returns 0, or EXIT_FAILURE after a message. */
int fine_stage_cost_measure(struct fine_stage_cost *price, struct session *session, ern_backend *backend,
                            const ern_dataset *dataset, const ern_train_config *config,
                            const struct lpips_weights *weights, double seconds);

#endif
