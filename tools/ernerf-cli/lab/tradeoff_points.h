/* SPDX-License-Identifier: MIT
 * Chooses the settings to measure: single options, and combinations that should lie on the Pareto front. */
#ifndef ERN_CLI_TRADEOFF_POINTS_H
#define ERN_CLI_TRADEOFF_POINTS_H

#include "lab/tradeoff.h"

enum { TRADEOFF_POINTS_CHOICES = 40, TRADEOFF_POINTS_COMBINATIONS = 20 };

/* Changes of a single setting, the most informative first, so that a truncated list covers every setting. None is the
 * base's value. Returns their number. */
size_t tradeoff_points_choices(const struct tradeoff *t, struct choice choices[TRADEOFF_POINTS_CHOICES]);

/* The measured effect of a single change to the base. */
struct effect {
  struct choice choice;
  double ratio; /* time / time of the base */
  double error; /* mean squared error that it adds to the base's */
};
/* Combinations of two or more changes that should be on the front if time ratios multiply and errors add: first the
 * ends of the front, then points between them. milliseconds[k]: predicted time of a frame with found[k]. Threads do not
 * affect the picture and are not combined. Returns the number. */
size_t tradeoff_points_combine(const struct settings *base, double base_ms, double base_error,
                               const struct effect *effects, size_t count,
                               struct settings found[TRADEOFF_POINTS_COMBINATIONS],
                               double milliseconds[TRADEOFF_POINTS_COMBINATIONS]);

#endif
