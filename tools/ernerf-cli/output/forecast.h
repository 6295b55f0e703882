/* SPDX-License-Identifier: MIT
 * How long a training will take, said once, soon after it has begun: from the pace of its first steps. */
#ifndef ERN_CLI_FORECAST_H
#define ERN_CLI_FORECAST_H

#include <stdbool.h>
#include <stdint.h>

#include "ernerf/train.h"
#include "session/session.h"

struct forecast {
  double began, first; /* seconds: of the start, and of the first report, 0: none came */
  uint64_t begin, first_step;
  bool said;
};

void forecast_begin(struct forecast *forecast, double now, uint64_t step);

/* At each report; `now` on the same clock. True once, at the first report at which the pace is known: 3 s after the
 * first one, whose step is slower than others, or at the first one where that took 5 s. *left: seconds that the steps
 * up to `steps` take at that pace. Never at the last step. */
bool forecast_due(struct forecast *forecast, double now, uint64_t step, uint64_t steps, double *left);

/* Says it when it is due, as a note. */
void forecast_say(struct forecast *forecast, struct session *session, const ern_train_report *report,
                  const ern_train_config *config);

#endif
