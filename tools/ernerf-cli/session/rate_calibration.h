/* SPDX-License-Identifier: MIT
 * A short calibration of the cost of settings, used if no Pareto front is stored. */
#ifndef ERN_CLI_RATE_CALIBRATION_H
#define ERN_CLI_RATE_CALIBRATION_H

#include "session/rung.h"

/* Draws two frames with each of a few settings, in turns. The Pareto-optimal settings become rungs; rungs with
 * interpolated cost are added between them, so that neighbours are a tenth of the time apart. Returns 0, or
 * EXIT_FAILURE after a message. */
int rate_control_calibrate(struct rate_control *rate_control, struct dimensions size, rate_control_draw *draw,
                           void *user);

#endif
