/* SPDX-License-Identifier: MIT
 * Holding a rate, on machines that are made up: steady, noisy, loaded for a while, too slow. */
#include "../support.h"

#include <math.h>

#include "core/rng.h"
#include "ernerf/render.h"

enum { POINTS = 5, FRAMES = 400 };
static const double cost[POINTS] = {60, 38, 30, 20, 12}; /* ms */

/* A made-up machine: slower by `load` in frames [from, to), each frame by up to `noise` more or less. */
struct machine {
  double load;
  int from, to;
  double noise;
  double disturbed; /* how many times slower one frame in sixteen is, at random; 0: none */
  double overhead;  /* ms a frame that no setting changes */
};

struct outcome {
  double milliseconds, accuracy; /* of all frames; mean of `at` */
  int switches, worst;
  size_t last;
};

static struct outcome run_with(const double *costs, size_t count, const struct machine *machine, double budget,
                               int frames) {
  struct outcome outcome = {0};
  ern_rate_controller pace;
  ern_rate_controller_begin(&pace, costs, count, budget);
  for (int f = 0; f < frames; f++) {
    const double jitter = machine->noise * (2 * (double)ern_uniform(ern_random_at(3, 0, (uint32_t)f, 0).word[0]) - 1);
    const double other = ern_random_at(4, 0, (uint32_t)f, 0).word[0] < UINT32_MAX / 16 ? machine->disturbed : 0;
    const double slow = fmax(f >= machine->from && f < machine->to ? machine->load : 1, other);
    const double took = (costs[pace.at] + machine->overhead) * slow * (1 + jitter);
    const size_t before = pace.at;
    outcome.milliseconds += took;
    outcome.accuracy += (double)pace.at / frames;
    outcome.last = ern_rate_controller_next(&pace, took);
    outcome.switches += outcome.last != before;
    if ((int)outcome.last > outcome.worst) outcome.worst = (int)outcome.last;
  }
  return outcome;
}

static struct outcome run(const struct machine *machine, double budget, int frames) {
  return run_with(cost, POINTS, machine, budget, frames);
}

static void test_first_choice(void **state) {
  (void)state;
  static const struct {
    double budget;
    size_t at;
  } cases[] = {{100, 0}, {60, 0}, {59.9, 1}, {40, 1}, {25, 3}, {12, 4}, {1, 4}};
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    ern_rate_controller pace;
    ern_rate_controller_begin(&pace, cost, POINTS, cases[i].budget);
    assert_int_equal(pace.at, cases[i].at);
    assert_int_equal(ern_rate_controller_holds(&pace), cases[i].budget >= 12);
  }
}

static void test_steady(void **state) {
  (void)state;
  const struct outcome outcome = run(&(struct machine){.load = 1}, 40, FRAMES);
  assert_int_equal(outcome.switches, 0);
  assert_int_equal(outcome.last, 1);
}

/* A fifth more or less at every frame is no reason to change back and forth: a change in 40 frames at most. */
static void test_noise(void **state) {
  (void)state;
  for (double budget = 13; budget < 70; budget += 1.5) {
    const struct outcome outcome = run(&(struct machine){.load = 1, .noise = 0.2}, budget, FRAMES);
    assert_true(outcome.switches <= FRAMES / 40);
    assert_true(outcome.milliseconds <= 1.05 * budget * FRAMES);
  }
}

/* Twice as slow for a while: the rate holds within 10 % over the whole, it falls back, and returns. */
static void test_load(void **state) {
  (void)state;
  const struct outcome outcome = run(&(struct machine){.load = 2, .from = 60, .to = 200, .noise = 0.1}, 40, FRAMES);
  assert_true(outcome.milliseconds <= 1.10 * 40 * FRAMES);
  assert_true(outcome.worst >= 3);
  assert_int_equal(outcome.last, 1);
  /* 200 frames of which all are loaded from the first on */
  const struct outcome loaded = run(&(struct machine){.load = 1.9, .to = 200, .noise = 0.15}, 40, 200);
  assert_true(loaded.milliseconds <= 1.10 * 40 * 200);
  assert_true(loaded.accuracy < 4); /* not simply the fastest */
}

/* Settings a tenth of their time apart: the rate is held from both sides, steady and loaded. */
static void test_both_sides(void **state) {
  (void)state;
  enum { FINE = 26 };
  double fine[FINE];
  for (int i = 0; i < FINE; i++) fine[i] = 80 * pow(0.9, i);
  for (double budget = 14; budget < 60; budget += 1.5)
    for (int loaded = 0; loaded < 3; loaded++) {
      /* steady; loaded all the time; a frame in sixteen disturbed by something else */
      const struct machine machine = {
          .load = loaded == 1 ? 1.6 : 1, .to = 200, .noise = 0.2, .disturbed = loaded == 2 ? 3.5 : 1};
      if (machine.load * fine[FINE - 1] > 0.8 * budget) continue;
      const struct outcome outcome = run_with(fine, FINE, &machine, budget, 200);
      assert_true(outcome.milliseconds <= 1.05 * budget * 200);
      assert_true(outcome.milliseconds >= 0.90 * budget * 200);
      assert_true(outcome.switches <= 12);
    }
}

/* What no setting changes, such as encoding, is part of the pace. */
static void test_overhead(void **state) {
  (void)state;
  const struct outcome outcome = run(&(struct machine){.load = 1, .overhead = 8}, 40, FRAMES);
  assert_true(outcome.milliseconds <= 1.02 * 40 * FRAMES);
  assert_int_equal(outcome.last, 2); /* 30 + 8 fits; 38 + 8 does not */
}

static void test_too_slow(void **state) {
  (void)state;
  ern_rate_controller pace;
  ern_rate_controller_begin(&pace, cost, POINTS, 21);
  for (int f = 0; f < 100; f++) ern_rate_controller_next(&pace, 3 * cost[pace.at]);
  assert_int_equal(pace.at, POINTS - 1);
  assert_false(ern_rate_controller_holds(&pace));
  for (int f = 0; f < 600; f++) ern_rate_controller_next(&pace, cost[pace.at]);
  assert_int_equal(pace.at, 3); /* the debt is bounded, so it comes back */
  assert_true(ern_rate_controller_holds(&pace));
}

static void test_hostile(void **state) {
  (void)state;
  static const double times[] = {NAN, INFINITY, -INFINITY, 0, -5, 1e300, 1e-300, 40};
  ern_rate_controller pace;
  ern_rate_controller_begin(&pace, cost, POINTS, 40);
  for (int f = 0; f < 1000; f++) {
    assert_true(ern_rate_controller_next(&pace, times[f % 8]) < POINTS);
    assert_true(isfinite(pace.slowness) && isfinite(pace.late));
  }
  static const double one[] = {10};
  ern_rate_controller_begin(&pace, one, 1, 1);
  assert_int_equal(ern_rate_controller_next(&pace, 10), 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_first_choice), cmocka_unit_test(test_steady),
                                     cmocka_unit_test(test_noise),        cmocka_unit_test(test_load),
                                     cmocka_unit_test(test_both_sides),   cmocka_unit_test(test_overhead),
                                     cmocka_unit_test(test_too_slow),     cmocka_unit_test(test_hostile)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
