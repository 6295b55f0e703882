/* SPDX-License-Identifier: MIT
 * The results of `ernerf tradeoff` as a table, as JSON for programs, and as plots (docs/formats-results.md). */
#ifndef ERN_CLI_TRADEOFF_FILES_H
#define ERN_CLI_TRADEOFF_FILES_H

#include <jansson.h>

#include "lab/tradeoff.h"
#include "output/plot.h"

/* "front", "dominated" or "equal". */
const char *tradeoff_standing(const struct point *point, enum reference reference);

void tradeoff_csv(const struct tradeoff *t, struct bytes *csv);
/* NULL without memory, or where a path is not UTF-8. */
json_t *tradeoff_json(const struct tradeoff *t);
/* Plots time against the PSNR by a reference. Returns 0, or -1 without memory. */
int tradeoff_plot(const struct tradeoff *t, enum reference reference, enum plot_form form, struct bytes *bytes);

#endif
