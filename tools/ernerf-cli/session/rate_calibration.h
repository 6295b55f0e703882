/* SPDX-License-Identifier: MIT
 * A quick look at what settings cost, where no front is stored. */
#ifndef ERN_CLI_RATE_CALIBRATION_H
#define ERN_CLI_RATE_CALIBRATION_H

#include "session/rung.h"

/* Draws two frames with each of a few settings, in turns, and leaves those that nothing betters as rungs, with others
 * between them whose cost is interpolated, so that neighbours are a tenth of the time apart. Returns 0, or EXIT_FAILURE
 * after a message. */
int rate_control_calibrate(struct rate_control *rate_control, struct dimensions size, rate_control_draw *draw,
                           void *user);

#endif
