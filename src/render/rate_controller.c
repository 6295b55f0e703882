/* SPDX-License-Identifier: MIT
 * Holds a frame rate: a controller that chooses from a list of settings with known costs. */
#include <math.h>

#include "core/floats.h"
#include "ernerf/render.h"

static const double weight_of_newest = 0.2; /* in the mean slowness of the machine: reacts in five frames */
static const double outlier = 1.5;          /* a frame slower than this many times the mean counts as this many times */
static const double slowness_least = 0.25;  /* least mean used for that limit, so that it always recovers */
static const double debt_frames = 12;       /* over which lateness is made up for */
static const double debt_most = 24, credit_most = 8; /* frames of lateness, and of being early, that are remembered */
static const double least_share = 0.6;               /* of the budget: shortest frame while making up for lateness */
enum { CALM_FRAMES = 12 }; /* for so many frames a better setting must fit, before it is taken */

/* The most accurate setting that takes `allowed` at most at the machine's present speed; else the fastest. */
static size_t fitting(const ern_rate_controller *controller, double allowed) {
  for (size_t i = 0; i < controller->count; i++)
    if (controller->cost[i] * controller->slowness <= allowed) return i;
  return controller->count - 1;
}

void ern_rate_controller_begin(ern_rate_controller *controller, const double *cost, size_t count, double budget) {
  ERN_PLAIN_FLOATS;
  if (controller == NULL) return;
  *controller = (ern_rate_controller){0};
  if (cost == NULL || count == 0) return;
  *controller = (ern_rate_controller){.cost = cost, .count = count, .budget = budget, .slowness = 1};
  controller->at = fitting(controller, budget);
}

bool ern_rate_controller_holds(const ern_rate_controller *controller) {
  ERN_PLAIN_FLOATS;
  return controller != NULL && controller->cost != NULL && controller->count > 0 &&
         controller->cost[controller->count - 1] * controller->slowness <= controller->budget;
}

size_t ern_rate_controller_next(ern_rate_controller *controller, double milliseconds) {
  ERN_PLAIN_FLOATS;
  if (controller == NULL || controller->cost == NULL || controller->at >= controller->count) return 0;
  if (!(milliseconds > 0) || !isfinite(milliseconds)) return controller->at;
  const double ratio = milliseconds / controller->cost[controller->at];
  controller->slowness +=
      weight_of_newest * (fmin(ratio, outlier * fmax(controller->slowness, slowness_least)) - controller->slowness);
  controller->late = fmin(fmax(controller->late + milliseconds - controller->budget, -credit_most * controller->budget),
                          debt_most * controller->budget);
  const double allowed = controller->budget - controller->late / debt_frames;
  const size_t now = fitting(controller, fmax(allowed, least_share * controller->budget));
  const size_t better = fitting(controller, controller->budget);
  if (now > controller->at) {
    controller->at = now;
    controller->calm = 0;
  } else if (better >= controller->at || controller->late > 0) {
    controller->calm = 0;
  } else {
    controller->better = controller->calm == 0 || better > controller->better ? better : controller->better;
    if (++controller->calm < CALM_FRAMES) return controller->at;
    controller->at = controller->better;
    controller->calm = 0;
  }
  return controller->at;
}
