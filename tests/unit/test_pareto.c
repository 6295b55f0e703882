/* SPDX-License-Identifier: MIT
 * Medians, spreads, and which points no other one betters. */
#include "../support.h"

#include <math.h>

#include "../../tools/ernerf-cli/session/pareto.c"

enum { FRAMES = 4 };

static void near(double found, double expected) {
  if (!(fabs(found - expected) <= 1e-9 * fmax(1, fabs(expected)))) fail_msg("%.12g, expected %.12g", found, expected);
}

static void test_spread(void **state) {
  (void)state;
  double one[] = {7}, two[] = {3, 1}, three[] = {5, 1, 3}, five[] = {5, 4, 1, 2, 3};
  struct quartiles s = quartiles_of(one, 1);
  near(s.low, 7), near(s.median, 7), near(s.high, 7);
  s = quartiles_of(two, 2);
  near(s.low, 1.5), near(s.median, 2), near(s.high, 2.5);
  s = quartiles_of(three, 3);
  near(s.low, 2), near(s.median, 3), near(s.high, 4);
  s = quartiles_of(five, 5);
  near(s.low, 2), near(s.median, 3), near(s.high, 4);
  const double values[] = {1, 2, 3, 4};
  struct mean_and_deviation m = mean_of(values, 4);
  near(m.mean, 2.5), near(m.deviation, sqrt(5.0 / 3));
  m = mean_of(values, 1);
  near(m.mean, 1), near(m.deviation, 0);
}

enum { TURNS = 8, POINTS = 64 };

static double random_between(double low, double high) {
  static uint64_t state = 1;
  state = state * 6364136223846793005u + 1442695040888963407u;
  return low + (high - low) * (double)(state >> 40) / (double)(1u << 24);
}

/* A point whose readings are drawn from ms +- 1.5 half. */
static struct candidate point(double ms, double half, const double *db, size_t changes) {
  static double turn_values[POINTS][TURNS];
  static size_t made;
  double *turns = turn_values[made++ % POINTS];
  for (size_t t = 0; t < TURNS; t++) turns[t] = random_between(ms - 1.5 * half, ms + 1.5 * half);
  return (struct candidate){
      .ms = {ms - half, ms, ms + half}, .turns = turns, .turn_count = TURNS, .db = db, .changes = changes};
}

static struct candidate timed(const double *turns, size_t count) {
  return (struct candidate){.turns = turns, .turn_count = count};
}

/* Readings that wander by half and more, all points of a turn alike: what is always a tenth faster is faster. */
static void test_turns(void **state) {
  (void)state;
  static const double slow[] = {10, 25, 12, 40, 11, 18}, fast[] = {9, 22.5, 10.8, 36, 9.9, 16.2};
  static const double hair[] = {9.95, 24.9, 11.95, 39.8, 10.95, 17.9}, other[] = {12, 18, 14, 30, 12, 20};
  const struct candidate a = timed(slow, 6), b = timed(fast, 6), c = timed(hair, 6), d = timed(other, 6);
  assert_int_equal(pareto_compare_ms(&b, &a), 1);
  assert_int_equal(pareto_compare_ms(&a, &b), -1);
  assert_int_equal(pareto_compare_ms(&c, &a), 0); /* always faster, by what nobody feels */
  assert_int_equal(pareto_compare_ms(&d, &a), 0); /* now faster, now slower */
  assert_int_equal(pareto_compare_ms(&a, &a), 0);
  const struct candidate once = timed(fast, 1);
  assert_int_equal(pareto_compare_ms(&once, &a), 0); /* one turn is never enough */
}

static void test_compare(void **state) {
  (void)state;
  static const double base[] = {30, 31, 32, 33}, up[] = {30.5, 31.4, 32.6, 33.5}, mixed[] = {32, 29, 34, 33};
  static const double hair[] = {30.005, 31.005, 32.005, 33.005}, up_far[] = {30, 31, 32, 40};
  const struct candidate a = point(10, 1, base, 0), b = point(10.2, 1, up, 0), c = point(14.1, 1, mixed, 0);
  const struct candidate d = point(10, 1, hair, 0), e = point(10, 1, up_far, 0);
  assert_int_equal(pareto_compare_ms(&a, &b), 0);
  assert_int_equal(pareto_compare_ms(&a, &c), 1);
  assert_int_equal(pareto_compare_ms(&c, &a), -1);
  assert_int_equal(pareto_compare_db(&b, &a, FRAMES), 1);
  assert_int_equal(pareto_compare_db(&a, &b, FRAMES), -1);
  assert_int_equal(pareto_compare_db(&c, &a, FRAMES), 0); /* now better, now worse */
  assert_int_equal(pareto_compare_db(&d, &a, FRAMES), 0); /* always better, by what nobody sees */
  assert_int_equal(pareto_compare_db(&e, &a, FRAMES), 0); /* in one frame alone */
  assert_int_equal(pareto_compare_db(&b, &a, 1), 0);      /* one frame is never enough */
  assert_int_equal(pareto_compare_db(&a, &a, FRAMES), 0);
}

/* Offsets of a quality that varies from frame to frame alike for all points. */
static void qualities(double db[][FRAMES], const double *means, size_t count) {
  for (size_t k = 0; k < count; k++)
    for (size_t f = 0; f < FRAMES; f++) db[k][f] = means[k] + 3 * sin((double)f) + 0.001 * cos((double)(k * 5 + f));
}

static void test_front(void **state) {
  (void)state;
  enum { COUNT = 7 };
  static const double ms[COUNT] = {50, 20, 30, 10, 49.9, 60, 20.1};
  static const double means[COUNT] = {60, 40, 35, 20, 60, 60, 40};
  static const size_t changes[COUNT] = {0, 1, 1, 2, 1, 0, 2};
  double db[COUNT][FRAMES];
  struct candidate c[COUNT];
  struct place places[COUNT];
  qualities(db, means, COUNT);
  for (size_t k = 0; k < COUNT; k++) c[k] = point(ms[k], 0.02 * ms[k], db[k], changes[k]);
  pareto_find(places, c, COUNT, FRAMES);
  assert_int_equal(places[0].standing, STANDING_FRONT);
  assert_int_equal(places[1].standing, STANDING_FRONT);
  assert_int_equal(places[2].standing, STANDING_DOMINATED); /* slower than 1 and worse */
  assert_true(places[2].by == 1 || places[2].by == 6);
  assert_int_equal(places[3].standing, STANDING_FRONT);
  assert_int_equal(places[4].standing, STANDING_EQUAL); /* 0 is simpler, though 0.1 ms slower */
  assert_int_equal(places[4].by, 0);
  assert_int_equal(places[5].standing, STANDING_DOMINATED); /* the same quality, measurably slower */
  assert_int_equal(places[6].standing, STANDING_EQUAL);
  assert_int_equal(places[6].by, 1);
}

/* Of points that are alike, one is shown. */
static void test_one_of_many(void **state) {
  (void)state;
  enum { COUNT = 20 };
  static const double turns[] = {10, 14, 11, 9};
  double means[COUNT], db[COUNT][FRAMES];
  struct candidate c[COUNT];
  struct place places[COUNT];
  for (size_t k = 0; k < COUNT; k++) means[k] = 40;
  qualities(db, means, COUNT);
  for (size_t k = 0; k < COUNT; k++) {
    c[k] = timed(turns, 4);
    c[k].ms.median = 10 + 0.01 * (double)((7 * k) % COUNT);
    c[k].db = db[k];
    c[k].changes = 1 + k % 3;
  }
  pareto_find(places, c, COUNT, FRAMES);
  size_t shown = 0;
  for (size_t k = 0; k < COUNT; k++) {
    shown += places[k].standing == STANDING_FRONT;
    assert_true(places[k].standing != STANDING_DOMINATED);
    assert_int_equal(places[places[k].by].standing, STANDING_FRONT);
  }
  assert_int_equal(shown, 1);
}

/* Of equally fast points whose readings are noise, one pair in a hundred may be told apart: two are allowed for, which
 * is three standard deviations of the count over a thousand pairs. */
static void test_noise(void **state) {
  (void)state;
  enum { COUNT = 20, ROUNDS = 100 };
  static const double db[FRAMES] = {30, 31, 32, 33};
  size_t pairs = 0, told_apart = 0;
  for (int round = 0; round < ROUNDS; round++) {
    struct candidate c[COUNT];
    for (size_t k = 0; k < COUNT; k++) c[k] = point(10, 2, db, 0);
    for (size_t k = 0; k + 1 < COUNT; k += 2, pairs++) told_apart += pareto_compare_ms(&c[k], &c[k + 1]) != 0;
  }
  assert_true(told_apart <= pairs / 50);
}

/* Three points, each faster than the one before and not to be told from it in quality; of the ends the quality differs.
 * The middle one is beaten, so it beats nobody. */
static void test_chain(void **state) {
  (void)state;
  enum { COUNT = 3 };
  static const double db[COUNT][FRAMES] = {
      {30.5, 31.5, 32.5, 33.5}, {30.2, 31.7, 32.2, 33.7}, {30.1, 31.1, 32.1, 33.1}};
  static const double turns[COUNT][4] = {{10, 12, 11, 13}, {9, 10.8, 9.9, 11.7}, {8, 9.6, 8.8, 10.4}};
  struct candidate c[COUNT];
  struct place places[COUNT];
  for (size_t k = 0; k < COUNT; k++) {
    c[k] = timed(turns[k], 4);
    c[k].ms.median = turns[k][0];
    c[k].db = db[k];
  }
  assert_true(dominates(&c[1], &c[0], FRAMES)); /* faster, and nothing tells the qualities apart */
  assert_true(dominates(&c[2], &c[1], FRAMES));
  assert_false(dominates(&c[2], &c[0], FRAMES)); /* what it loses is seen */
  pareto_find(places, c, COUNT, FRAMES);
  assert_int_equal(places[2].standing, STANDING_FRONT);
  assert_int_equal(places[1].standing, STANDING_DOMINATED);
  assert_int_equal(places[1].by, 2);
  assert_int_equal(places[0].standing, STANDING_FRONT); /* only 1 beats it */
}

/* reach[i][k]: i beats k, or beats one that reaches it. */
static void close_over(bool reach[][30], const struct candidate *c, size_t count) {
  for (size_t i = 0; i < count; i++)
    for (size_t k = 0; k < count; k++) reach[i][k] = i != k && dominates(&c[i], &c[k], FRAMES);
  for (size_t j = 0; j < count; j++)
    for (size_t i = 0; i < count; i++)
      for (size_t k = 0; k < count; k++) reach[i][k] |= reach[i][j] && reach[j][k];
}

/* Chains in which neighbours overlap: whatever comes, some point stands, every other one names a reason, and what
 * stands is beaten by nothing that stands, but in a circle. */
static void test_always_a_front(void **state) {
  (void)state;
  enum { COUNT = 30, ROUNDS = 200 };
  double db[COUNT][FRAMES];
  struct candidate c[COUNT];
  struct place places[COUNT];
  bool reach[COUNT][COUNT];
  unsigned seed = 1;
  for (int turn = 0; turn < ROUNDS; turn++) {
    for (size_t k = 0; k < COUNT; k++) {
      for (size_t f = 0; f < FRAMES; f++) {
        seed = seed * 1664525u + 1013904223u;
        db[k][f] = 30 + (double)(seed >> 16) / 65536 * (turn % 2 ? 1 : 20) + (double)k * (turn % 3);
      }
      seed = seed * 1664525u + 1013904223u;
      c[k] = point(10 + (double)(seed >> 16) / 6553.6, 0.2 * (double)(turn % 5), db[k], seed >> 20 & 3);
    }
    pareto_find(places, c, COUNT, FRAMES);
    close_over(reach, c, COUNT);
    size_t shown = 0;
    for (size_t k = 0; k < COUNT; k++) {
      shown += places[k].standing == STANDING_FRONT;
      assert_true(places[k].standing != STANDING_UNKNOWN);
      assert_true(places[k].by < COUNT && (places[k].by != k || places[k].standing == STANDING_FRONT));
      if (places[k].standing == STANDING_EQUAL) {
        assert_int_equal(pareto_compare_ms(&c[k], &c[places[k].by]), 0);
        assert_int_equal(pareto_compare_db(&c[k], &c[places[k].by], FRAMES), 0);
      }
      if (places[k].standing == STANDING_DOMINATED) assert_true(dominates(&c[places[k].by], &c[k], FRAMES));
      for (size_t i = 0; i < COUNT && places[k].standing == STANDING_FRONT; i++)
        if (places[i].standing == STANDING_FRONT && dominates(&c[i], &c[k], FRAMES)) assert_true(reach[k][i]);
    }
    assert_true(shown > 0);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_spread), cmocka_unit_test(test_turns),          cmocka_unit_test(test_compare),
      cmocka_unit_test(test_front),  cmocka_unit_test(test_one_of_many),    cmocka_unit_test(test_noise),
      cmocka_unit_test(test_chain),  cmocka_unit_test(test_always_a_front),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
