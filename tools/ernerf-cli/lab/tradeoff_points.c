/* SPDX-License-Identifier: MIT */
#include "lab/tradeoff_points.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- one at a time ----------------------------------------------------------------------------------------------- */

enum { LADDER = 6 };
/* Values of each axis, the most informative first. */
static const struct {
  enum axis axis;
  size_t count;
  double values[LADDER];
} ladders[] = {
    {AXIS_SCALE, 5, {0.5, 0.75, 0.35, 0.25, 0.6}},
    {AXIS_STEPS, 6, {8, 12, 6, 4, 24, 32}},
    {AXIS_STOP, 6, {0.03, 0.1, 1e-4, 0.01, 0.3, 0}},
    {AXIS_THRESHOLD, 4, {1, 10, 0.1, 3}},
};

static size_t thread_ladder(int cores, double values[LADDER]) {
  size_t count = 0;
  for (int threads = 1; threads < cores && count < LADDER; threads *= 2) values[count++] = threads;
  return count;
}

size_t tradeoff_points_choices(const struct tradeoff *t, struct choice choices[TRADEOFF_POINTS_CHOICES]) {
  double threads[LADDER];
  const size_t thread_count = thread_ladder(t->base.threads, threads);
  size_t count = 0;
  for (size_t rung = 0; rung < LADDER || rung < t->unit_count; rung++) {
    struct choice wanted[AXES];
    size_t axes = 0;
    for (size_t a = 0; a < sizeof ladders / sizeof *ladders; a++)
      if (rung < ladders[a].count)
        wanted[axes++] = (struct choice){ladders[a].axis, ladders[a].values[rung], NULL, NULL};
    if (rung < t->unit_count && strcmp(t->units[rung].isa, "ref64") != 0) { /* the exact render itself */
      const struct unit *unit = &t->units[rung];
      wanted[axes++] = (struct choice){AXIS_UNIT, unit->device, unit->backend, unit->isa};
    }
    if (rung < thread_count) wanted[axes++] = (struct choice){AXIS_THREADS, threads[rung], NULL, NULL};
    for (size_t k = 0; k < axes && count < TRADEOFF_POINTS_CHOICES; k++) {
      const struct settings changed = settings_with(t->base, &wanted[k]);
      if (settings_changes(&changed, &t->base) > 0) choices[count++] = wanted[k];
    }
  }
  return count;
}

/* ---- combinations ------------------------------------------------------------------------------------------------ */

struct guess {
  struct settings settings;
  double ms, error;
  size_t changes;
};

static int by_ms(const void *left, const void *right) {
  const struct guess *a = left, *b = right;
  if (a->ms != b->ms) return a->ms < b->ms ? -1 : 1;
  return (a->error > b->error) - (a->error < b->error);
}

/* Enumerates all combinations as numbers with one digit for each axis; 0: the base's value. */
static size_t guess_all(const struct settings *base, double base_ms, double base_error, const struct effect *effects,
                        size_t count, struct guess *guesses, size_t most) {
  const struct effect *of[AXIS_THREADS][TRADEOFF_POINTS_CHOICES];
  size_t values[AXIS_THREADS] = {0}, digit[AXIS_THREADS] = {0}, made = 0;
  for (size_t i = 0; i < count; i++)
    if (effects[i].choice.axis < AXIS_THREADS && effects[i].ratio > 0)
      of[effects[i].choice.axis][values[effects[i].choice.axis]++] = &effects[i];
  for (bool over = false; !over && made < most;) {
    struct guess guess = {*base, base_ms, base_error, 0};
    for (int a = 0; a < AXIS_THREADS; a++) {
      if (digit[a] == 0) continue;
      const struct effect *effect = of[a][digit[a] - 1];
      guess.settings = settings_with(guess.settings, &effect->choice);
      guess.ms *= effect->ratio;
      guess.error += fmax(effect->error, 0);
      guess.changes++;
    }
    guesses[made++] = guess;
    over = true;
    for (int a = 0; a < AXIS_THREADS && over; a++) {
      digit[a] = digit[a] < values[a] ? digit[a] + 1 : 0;
      over = digit[a] == 0;
    }
  }
  return made;
}

/* Keeps the guesses whose error is at least a tenth less than that of all faster ones. */
static size_t keep_front(struct guess *guesses, size_t count) {
  size_t kept = 0;
  double least = INFINITY;
  qsort(guesses, count, sizeof *guesses, by_ms);
  for (size_t i = 0; i < count; i++) {
    if (!(guesses[i].error < 0.9 * least)) continue;
    least = guesses[i].error;
    if (guesses[i].changes >= 2) guesses[kept++] = guesses[i];
  }
  return kept;
}

size_t tradeoff_points_combine(const struct settings *base, double base_ms, double base_error,
                               const struct effect *effects, size_t count,
                               struct settings found[TRADEOFF_POINTS_COMBINATIONS],
                               double milliseconds[TRADEOFF_POINTS_COMBINATIONS]) {
  enum { MOST = 20000 };
  struct guess *guesses = malloc(MOST * sizeof *guesses);
  size_t taken = 0;
  if (guesses == NULL) return 0; /* the single changes remain */
  const size_t kept = keep_front(guesses, guess_all(base, base_ms, base_error, effects, count, guesses, MOST));
  /* the ends, the middle, quarters, ...: a truncated list still spans the front */
  for (size_t parts = 1; kept > 0 && taken < TRADEOFF_POINTS_COMBINATIONS && parts < 4 * kept; parts *= 2)
    for (size_t k = parts == 1 ? 0 : 1; k <= parts && taken < TRADEOFF_POINTS_COMBINATIONS; k += parts == 1 ? 1 : 2) {
      const size_t at = (kept - 1) * k / parts;
      bool there = false;
      for (size_t i = 0; i < taken; i++) there |= settings_changes(&found[i], &guesses[at].settings) == 0;
      if (there) continue;
      milliseconds[taken] = guesses[at].ms;
      found[taken++] = guesses[at].settings;
    }
  free(guesses);
  return taken;
}
