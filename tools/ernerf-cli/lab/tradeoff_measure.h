/* SPDX-License-Identifier: MIT
 * Measures points: times, in turns, and PSNR against two references. */
#ifndef ERN_CLI_TRADEOFF_MEASURE_H
#define ERN_CLI_TRADEOFF_MEASURE_H

#include "lab/tradeoff.h"

/* Detects the machine and its compute units, and selects the frames to measure: those of --frames, else up to four,
 * evenly spaced. `portrait` and `evaluation` must be open. Returns 0, or the exit status after a message, as the next
 * ones do. */
int tradeoff_measure_open(struct tradeoff *t, const struct args *args);
/* Draws the exact frames, tries settings, times them in turns, and finds the Pareto fronts. */
int tradeoff_measure_all(struct tradeoff *t);
void tradeoff_measure_close(struct tradeoff *t);

/* Draws frame k with the point's settings into t->evaluation.rgb. */
int tradeoff_measure_draw(struct tradeoff *t, struct point *point, size_t k);

#endif
