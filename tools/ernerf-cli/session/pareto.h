/* SPDX-License-Identifier: MIT
 * The Pareto front of measured points: the points that no other point dominates. */
#ifndef ERN_CLI_PARETO_H
#define ERN_CLI_PARETO_H

#include <stdbool.h>
#include <stddef.h>

#include "session/statistics.h"

enum { PARETO_TURNS = 64, PARETO_FRAMES = 64 /* at most */ };

/* A point of the comparison. */
struct candidate {
  struct quartiles ms; /* time of a frame, milliseconds */
  const double *turns; /* [turn_count] its time in each turn; all points are measured once in a turn */
  size_t turn_count;
  const double *db; /* [frames] quality of each frame, larger is better; all points have the same frames */
  size_t changes;   /* settings that differ from the default: of two equal points the one with fewer is shown */
};

/* 1: a is measurably better; -1: b is; 0: neither. This is a paired t-test: the pairs are the logarithms of the times
 * in one turn (a machine that slows down slows all points of a turn), or the qualities of one frame. The mean
 * difference must be significant (Student's t at 99 % for times, 95 % for qualities; one pair is never enough), and
 * exceed 1 % of the time or 0.01 dB, below which nobody notices a difference. */
int pareto_compare_ms(const struct candidate *a, const struct candidate *b);
int pareto_compare_db(const struct candidate *a, const struct candidate *b, size_t frames);

enum standing {
  STANDING_FRONT,     /* no point of the front dominates it */
  STANDING_DOMINATED, /* `by` is measurably better in time or quality and not measurably worse in the other */
  STANDING_EQUAL,     /* no point dominates it, but it cannot be distinguished from `by`, which is simpler */
  STANDING_UNKNOWN    /* only inside pareto_find: not decided yet */
};
struct place {
  enum standing standing;
  size_t by;
};
/* Fills places[k] for candidates[k]. At least one is on the front. count >= 1. */
void pareto_find(struct place *places, const struct candidate *candidates, size_t count, size_t frames);

#endif
