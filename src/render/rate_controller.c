/* SPDX-License-Identifier: MIT
 * Holding a rate: a controller over a list of settings whose cost is known. */
#include <math.h>

#include "core/floats.h"
#include "ernerf/render.h"

static const double weight_of_newest = 0.2; /* in the mean of how slow the machine is: a load is seen in five frames */
static const double outlier = 1.5;          /* a frame so many times slower than the mean counts as one of this */
static const double slowness_least = 0.25;  /* of a mean to which that is applied: it comes back from any */
static const double debt_frames = 12;       /* over which frames that were late are made up for */
static const double debt_most = 24, credit_most = 8; /* frames of lateness, and of being early, that are remembered */
static const double room_least = 0.6;                /* of the budget: what making up may squeeze a frame to */
enum { CALM_FRAMES = 12 }; /* for so many frames a better setting must fit, before it is taken */

/* The most accurate setting that takes `room` ms at most at the machine's pace of now; else the fastest. */
static size_t fitting(const ern_rate_controller *pace, double room) {
  for (size_t i = 0; i < pace->count; i++)
    if (pace->cost[i] * pace->slowness <= room) return i;
  return pace->count - 1;
}

void ern_rate_controller_begin(ern_rate_controller *pace, const double *cost, size_t count, double budget) {
  ERN_PLAIN_FLOATS;
  if (pace == NULL) return;
  *pace = (ern_rate_controller){0};
  if (cost == NULL || count == 0) return;
  *pace = (ern_rate_controller){.cost = cost, .count = count, .budget = budget, .slowness = 1};
  pace->at = fitting(pace, budget);
}

bool ern_rate_controller_holds(const ern_rate_controller *pace) {
  return pace != NULL && pace->cost != NULL && pace->count > 0 &&
         pace->cost[pace->count - 1] * pace->slowness <= pace->budget;
}

size_t ern_rate_controller_next(ern_rate_controller *pace, double milliseconds) {
  ERN_PLAIN_FLOATS;
  if (pace == NULL || pace->cost == NULL || pace->at >= pace->count) return 0;
  if (!(milliseconds > 0) || !isfinite(milliseconds)) return pace->at;
  const double ratio = milliseconds / pace->cost[pace->at];
  pace->slowness += weight_of_newest * (fmin(ratio, outlier * fmax(pace->slowness, slowness_least)) - pace->slowness);
  pace->late =
      fmin(fmax(pace->late + milliseconds - pace->budget, -credit_most * pace->budget), debt_most * pace->budget);
  const double room = pace->budget - pace->late / debt_frames;
  const size_t now = fitting(pace, fmax(room, room_least * pace->budget));
  const size_t better = fitting(pace, pace->budget);
  if (now > pace->at) {
    pace->at = now;
    pace->calm = 0;
  } else if (better >= pace->at || pace->late > 0) {
    pace->calm = 0;
  } else {
    pace->better = pace->calm == 0 || better > pace->better ? better : pace->better;
    if (++pace->calm < CALM_FRAMES) return pace->at;
    pace->at = pace->better;
    pace->calm = 0;
  }
  return pace->at;
}
