/* SPDX-License-Identifier: MIT
 * AUE, action unit error: compares the action units of drawn and recorded frames, read from OpenFace's tables
 * (docs/evaluation.md). */
#ifndef ERN_CLI_ACTION_UNITS_H
#define ERN_CLI_ACTION_UNITS_H

#include <jansson.h>

#include "session/session.h"

/* Initial state: zero except for the paths. */
struct action_units {
  const char *rendered_path, *recorded_path; /* NULL: not requested */
  double all, lower, upper;                  /* sums over the units of the mean squared difference; NaN: no such unit */
  size_t units, frames, left_out; /* units in both tables; left out: frames without success in either table */
};

/* Reads both tables, of `count` rows each, and compares them. Returns 0, or EXIT_FAILURE after a message. */
int action_units_compare(struct action_units *units, struct session *session, size_t count);

#endif
