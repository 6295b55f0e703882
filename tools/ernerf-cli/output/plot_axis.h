/* SPDX-License-Identifier: MIT
 * An axis of a plot: from values to pixels, and where its ticks stand. */
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

/* Ends around values from `low` to `high`, with a little room; what is empty or a single value gets some width. */
struct plot_axis plot_axis_around(double low, double high, bool log);
double plot_axis_at(const struct plot_axis *axis, double value);
bool plot_axis_shows(const struct plot_axis *axis, double value);
/* Values of the ticks: 1, 2 or 5 times a power of ten, `wanted` of them or so; on a logarithmic axis of less than a
 * decade as on a linear one. Returns how many. */
size_t plot_axis_ticks(const struct plot_axis *axis, size_t wanted, double ticks[PLOT_MOST_TICKS]);

#endif
