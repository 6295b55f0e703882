/* SPDX-License-Identifier: MIT */
#include "train/parts/trainer_shared.h"

#include <math.h>
#include <time.h>

void ern_trainer_follow_time(struct ern_training *t, uint64_t least) {
  if (!(t->config.seconds > 0) || t->step == 0) return;
  /* of the time that is spent, an estimate of step/iters */
  const double share = ern_trainer_spent(t) / t->config.seconds;
  const uint64_t steps = share < 1 ? (uint64_t)((double)t->step / fmax(share, 1e-6)) + 1 : t->step;
  t->config.iters = steps > least ? steps : least;
}

double ern_trainer_clock(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + (double)now.tv_nsec * 1e-9;
}
