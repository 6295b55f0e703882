/* SPDX-License-Identifier: MIT
 * AUE: how far the action units of drawn frames are from those of the true ones, by OpenFace's tables
 * (docs/evaluation.md). */
#ifndef ERN_CLI_ACTION_UNITS_H
#define ERN_CLI_ACTION_UNITS_H

#include <jansson.h>

#include "session/session.h"

/* Zeroed but for the paths: none yet. */
struct action_units {
  const char *rendered_path, *recorded_path; /* NULL: not wanted */
  double all, lower, upper; /* sums over the units of the mean squared difference; NaN where there is no such unit */
  size_t units, frames, left_out; /* units that both tables have; left out: no success in either table */
};

/* Reads both tables, of `count` rows each, and compares them. Returns 0, or EXIT_FAILURE after a message. */
int action_units_compare(struct action_units *units, struct session *session, size_t count);

#endif
