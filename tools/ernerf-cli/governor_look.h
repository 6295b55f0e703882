/* SPDX-License-Identifier: MIT
 * A quick look at what settings cost, where no front is stored. */
#ifndef ERN_CLI_GOVERNOR_LOOK_H
#define ERN_CLI_GOVERNOR_LOOK_H

#include "governor.h"

/* Draws two frames with each of a few settings, in turns, and leaves those that nothing betters as rungs, with others
 * between them whose cost is interpolated, so that neighbours are a tenth of the time apart. Returns 0, or EXIT_FAILURE
 * after a message. */
int governor_look(struct governor *governor, struct dimensions size, governor_draw *draw, void *user);

/* Makes the rung's renderer where it is not there yet. Returns as above. */
int governor_make(struct governor *governor, struct rung *rung);

#endif
