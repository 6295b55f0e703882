/* SPDX-License-Identifier: MIT */
#include "output/forecast.h"

#include <inttypes.h>
#include <stdio.h>

#include "session/progress.h"

static const double settled = 3, patience = 5, long_time = 600; /* seconds */

void forecast_begin(struct forecast *forecast, double now, uint64_t step) {
  *forecast = (struct forecast){.began = now, .begin = step};
}

bool forecast_due(struct forecast *f, double now, uint64_t step, uint64_t steps, double *left) {
  const bool first = f->first <= 0;
  if (f->reported || step <= f->begin || step >= steps) return false;
  if (first && now - f->began < patience) {
    f->first = now;
    f->first_step = step;
    return false;
  }
  const double from = first ? f->began : f->first;
  const uint64_t taken = step - (first ? f->begin : f->first_step);
  if (taken == 0 || now - from < settled) return false;
  *left = (now - from) / (double)taken * (double)(steps - step);
  f->reported = true;
  return true;
}

/* The first steps of a head are slow: no space is known to be empty yet, so they take the most samples a ray; later
 * steps take 2 to 4. */
void forecast_say(struct forecast *forecast, struct session *session, const ern_train_report *report,
                  const ern_train_config *config) {
  char time[32];
  double left = 0;
  if (!forecast_due(forecast, session_seconds(), report->step, report->iters, &left)) return;
  const bool slow = !config->torso && report->samples_per_ray > 0.9 * config->max_steps;
  progress_duration(left, time);
  session_note(session, "train: %s %s for the %" PRIu64 " steps of %d rays to go, at the pace of the first ones%s%s",
               slow ? "at most about" : "about", time, report->iters - report->step, config->rays,
               slow ? ", which are slower than later ones, as no space is known to be empty yet" : "",
               left > long_time ? "; --iters N and --rays N make it shorter" : "");
}
