/* SPDX-License-Identifier: MIT
 * Predicts the duration of a training from the speed of its first steps, and prints it once, soon after the start. */
#ifndef ERN_CLI_FORECAST_H
#define ERN_CLI_FORECAST_H

#include <stdbool.h>
#include <stdint.h>

#include "ernerf/train.h"
#include "session/session.h"

struct forecast {
  double began, first; /* times in seconds: the start, and the first report (0: none yet) */
  uint64_t begin, first_step;
  bool reported;
};

void forecast_begin(struct forecast *forecast, double now, uint64_t step);

/* Call it at each report; `now` on the same clock. Returns true once, when the speed is known: at 3 s after the first
 * report, whose step is slower than others, or at the first report if that took 5 s. Never at the last step. *left:
 * seconds that the remaining steps up to `steps` take at that speed. */
bool forecast_due(struct forecast *forecast, double now, uint64_t step, uint64_t steps, double *left);

/* Prints it as a note when it is due. */
void forecast_say(struct forecast *forecast, struct session *session, const ern_train_report *report,
                  const ern_train_config *config);

#endif
