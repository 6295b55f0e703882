/* SPDX-License-Identifier: MIT
 * An axis of a plot: maps values to pixels, and chooses the ticks. */
#ifndef ERN_CLI_PLOT_AXIS_H
#define ERN_CLI_PLOT_AXIS_H

#include <stdbool.h>
#include <stddef.h>

struct plot_axis {
  bool log;
  double low, high;  /* values at its ends */
  double begin, end; /* pixels at its ends */
};

enum { PLOT_MOST_TICKS = 24 };

/* Chooses ends around the values from `low` to `high`, with a margin; an empty range or a single value is widened. */
struct plot_axis plot_axis_around(double low, double high, bool log);
double plot_axis_at(const struct plot_axis *axis, double value);
bool plot_axis_shows(const struct plot_axis *axis, double value);
/* Values of the ticks: 1, 2 or 5 times a power of ten, about `wanted` of them. A logarithmic axis of less than a decade
 * has linear ticks. Returns their number. */
size_t plot_axis_ticks(const struct plot_axis *axis, size_t wanted, double ticks[PLOT_MOST_TICKS]);

#endif
