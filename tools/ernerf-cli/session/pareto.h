/* SPDX-License-Identifier: MIT
 * The Pareto front of several measured points: those that no other one betters. */
#ifndef ERN_CLI_PARETO_H
#define ERN_CLI_PARETO_H

#include <stdbool.h>
#include <stddef.h>

#include "session/statistics.h"

enum { PARETO_TURNS = 64, PARETO_FRAMES = 64 /* that are looked at, at most */ };

/* A point to be compared. */
struct candidate {
  struct quartiles ms; /* a frame, milliseconds */
  const double *turns; /* [turn_count] its readings in the order of the turns, which are the same for all points */
  size_t turn_count;
  const double *db; /* [frames] quality of each frame, more is better; the frames are the same for all points */
  size_t changes;   /* settings that are not the default's: of two equals the simpler one is shown */
};

/* 1: a is measurably better; -1: b is; 0: neither. Compared are pairs: the logarithms of the times of one turn (a
 * machine that slows down slows all points of a turn), the qualities of one frame. The mean of the differences must be
 * further from 0 than its standard error allows (Student's t at 99 % for times, 95 % for qualities; one pair is never
 * enough), and than a hundredth of the time, which nobody feels, or 0.01 dB, which nobody sees. */
int pareto_compare_ms(const struct candidate *a, const struct candidate *b);
int pareto_compare_db(const struct candidate *a, const struct candidate *b, size_t frames);

enum standing {
  STANDING_FRONT,     /* nothing that stands on the front betters it */
  STANDING_DOMINATED, /* `by` is measurably better in one way and not measurably worse in the other */
  STANDING_EQUAL,     /* nothing betters it, and nothing tells it from `by`, which is simpler */
  STANDING_UNKNOWN    /* while they are looked for */
};
struct place {
  enum standing standing;
  size_t by;
};
/* places[k] of candidates[k]. At least one stands on the front. count >= 1. */
void pareto_find(struct place *places, const struct candidate *candidates, size_t count, size_t frames);

#endif
