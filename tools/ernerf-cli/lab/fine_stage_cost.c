/* SPDX-License-Identifier: MIT */
#include "lab/fine_stage_cost.h"

#include <stdlib.h>

/* WARM: most coarse steps before the measurement; STEPS: length of the training, which is never reached. */
enum { WARM = 256, LEAST_WARM = 4, MOST_TURNS = 256, LEAST_TURNS = 8, STEPS = 1000000 };
static const double warm_share = 0.3; /* share of the seconds for the warm-up of all trainers */

struct race {
  struct session *session;
  size_t count;
  ern_fine_loss lpips; /* loss of the third trainer */
  ern_trainer *trainer[FINE_STEPS];
  double ms[FINE_STEPS][MOST_TURNS], ratio[FINE_STEPS][MOST_TURNS];
};

/* Creates trainer i; the fine ones make `warm` coarse steps first. */
static int make(struct race *race, size_t i, ern_backend *backend, const ern_dataset *dataset,
                const ern_train_config *common, uint64_t warm) {
  ern_train_config config = *common;
  config.iters = STEPS;
  config.fine_steps = i > 0 ? STEPS - warm : 0;
  config.fine_loss = i == 2 ? &race->lpips : NULL;
  config.output = NULL;
  return ern_trainer_create(&race->trainer[i], backend, dataset, &config) == ERN_OK ? 0 : session_fail(race->session);
}

static int step(struct race *race, size_t i, double *ms) {
  ern_train_report report;
  if (session_interrupted()) return session_stop_with(race->session, "stopped: nothing is written");
  const double began = session_seconds();
  const ern_status status = ern_trainer_step(race->trainer[i], &report);
  *ms = 1000 * (session_seconds() - began);
  return status == ERN_OK ? 0 : session_fail(race->session);
}

/* The coarse trainer runs first and determines how many steps fit into the time; the others make the same number. */
static int warm_up(struct race *race, ern_backend *backend, const ern_dataset *dataset, const ern_train_config *config,
                   double seconds) {
  const double began = session_seconds(), most = warm_share * seconds / (double)race->count;
  uint64_t warm = 0;
  double ms;
  int status = make(race, 0, backend, dataset, config, 0);
  while (status == 0 && warm < WARM && (warm < LEAST_WARM || session_seconds() - began < most)) {
    status = step(race, 0, &ms);
    warm++;
  }
  for (size_t i = 1; i < race->count && status == 0; i++) {
    status = make(race, i, backend, dataset, config, warm);
    for (uint64_t k = 0; k < warm && status == 0; k++) status = step(race, i, &ms);
  }
  return status;
}

/* Fills ms and ratio in turns; each turn begins with another trainer. */
static int take_turns(struct race *race, double seconds, size_t *turns) {
  const double began = session_seconds();
  for (*turns = 0; *turns < MOST_TURNS && (*turns < LEAST_TURNS || session_seconds() - began < seconds); ++*turns) {
    for (size_t k = 0; k < race->count; k++) {
      const size_t i = (*turns + k) % race->count;
      if (step(race, i, &race->ms[i][*turns]) != 0) return EXIT_FAILURE;
    }
    for (size_t i = 0; i < race->count; i++) race->ratio[i][*turns] = race->ms[i][*turns] / race->ms[0][*turns];
  }
  return 0;
}

int fine_stage_cost_measure(struct fine_stage_cost *price, struct session *session, ern_backend *backend,
                            const ern_dataset *dataset, const ern_train_config *config,
                            const struct lpips_weights *weights, double seconds) {
  const int side = config->patch_size;
  *price = (struct fine_stage_cost){.rays = config->rays, .patch = side};
  if (config->rays < side * side || dataset->width < side || dataset->height < side) return 0;
  struct race *race = calloc(1, sizeof *race);
  if (race == NULL) return session_fail_with(session, "no memory for %d steps", (int)MOST_TURNS);
  const bool lpips = weights->lpips != NULL;
  race->session = session;
  race->count = lpips ? 3 : 2;
  if (lpips) race->lpips = ern_lpips_fine_loss(weights->lpips);
  size_t turns = 0;
  int status = warm_up(race, backend, dataset, config, seconds);
  if (status == 0) status = take_turns(race, (1 - warm_share) * seconds, &turns);
  for (size_t i = 0; i < race->count && status == 0; i++) {
    struct fine_step *of = &price->step[i];
    snprintf(of->loss, sizeof of->loss, "%s", i == 0 ? "coarse" : i == 1 ? "ssim" : race->lpips.name);
    of->ms = quartiles_of(race->ms[i], turns);
    of->times = quartiles_of(race->ratio[i], turns);
    price->count = i + 1;
  }
  price->turns = turns;
  for (size_t i = 0; i < race->count; i++) ern_trainer_free(&race->trainer[i]);
  free(race);
  return status;
}
