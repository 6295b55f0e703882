/* SPDX-License-Identifier: MIT
 * Points under the clock, in turns, and against two truths. */
#ifndef ERN_CLI_TRADEOFF_MEASURE_H
#define ERN_CLI_TRADEOFF_MEASURE_H

#include "lab/tradeoff.h"

/* Finds the machine and what it can compute on, and takes the frames that are measured: those of --frames, else up to
 * four, evenly spaced. `portrait` and `evaluation` are open. Returns 0, or the exit status after a message, as the next
 * ones do. */
int tradeoff_measure_open(struct tradeoff *t, const struct args *args);
/* Draws the exact frames, tries settings, takes turns, and finds the fronts. */
int tradeoff_measure_all(struct tradeoff *t);
void tradeoff_measure_close(struct tradeoff *t);

/* Draws frame k with the point's settings: t->evaluation.rgb. */
int tradeoff_measure_draw(struct tradeoff *t, struct point *point, size_t k);

#endif
