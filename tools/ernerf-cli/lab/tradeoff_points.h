/* SPDX-License-Identifier: MIT
 * Which settings are worth measuring: each option by itself, and combinations that should lie on the front. */
#ifndef ERN_CLI_TRADEOFF_POINTS_H
#define ERN_CLI_TRADEOFF_POINTS_H

#include "lab/tradeoff.h"

enum { TRADEOFF_POINTS_CHOICES = 40, TRADEOFF_POINTS_COMBINATIONS = 20 };

/* Changes of a single setting, those that tell most first, so that a list that is cut short has something of each. None
 * is the base's own value. Returns how many. */
size_t tradeoff_points_choices(const struct tradeoff *t, struct choice choices[TRADEOFF_POINTS_CHOICES]);

/* What a single change did to the base when it was tried. */
struct effect {
  struct choice choice;
  double ratio; /* of time, over the base's */
  double error; /* mean squared error that it adds to the base's */
};
/* Combinations of two and more changes that should be on the front if times multiply and errors add up: ends first,
 * then between them. milliseconds[k] is what a frame of found[k] should take. Threads do not change a picture and are
 * left alone. Returns how many. */
size_t tradeoff_points_combine(const struct settings *base, double base_ms, double base_error,
                               const struct effect *effects, size_t count,
                               struct settings found[TRADEOFF_POINTS_COMBINATIONS],
                               double milliseconds[TRADEOFF_POINTS_COMBINATIONS]);

#endif
