/* SPDX-License-Identifier: MIT
 * Crops of mouth and eyes, rendered at every point of the Pareto front, with difference pictures. */
#ifndef ERN_CLI_TRADEOFF_CROPS_H
#define ERN_CLI_TRADEOFF_CROPS_H

#include "bytes.h"
#include "lab/tradeoff.h"

/* Returns 0, or EXIT_FAILURE after a message. */
int page_crops(struct tradeoff *t, struct bytes *page);

#endif
