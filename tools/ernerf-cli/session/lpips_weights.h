/* SPDX-License-Identifier: MIT
 * --lpips-network and --lpips-heads: the weights of LPIPS. */
#ifndef ERN_CLI_LPIPS_WEIGHTS_H
#define ERN_CLI_LPIPS_WEIGHTS_H

#include "ernerf/media.h"
#include "session/session.h"

struct lpips_weights {
  const char *network, *heads; /* from the command line; NULL: none */
  ern_lpips *lpips;            /* NULL until it is opened */
};

enum { LPIPS_OPTIONS = 2 };
void lpips_weights_options(struct lpips_weights *weights, struct option options[LPIPS_OPTIONS]);
/* EXIT_USAGE where one of the two is given without the other; else -1. */
int lpips_weights_check(const struct lpips_weights *weights, const struct args *args);
/* Reads them if they are given. Returns 0, or EXIT_FAILURE after a message. */
int lpips_weights_open(struct lpips_weights *weights, struct session *session);
void lpips_weights_close(struct lpips_weights *weights);

#endif
