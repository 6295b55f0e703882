/* SPDX-License-Identifier: MIT
 * How long a training will take, from reports on a clock that the test moves. */
#include "output/forecast.h"

#include <math.h>

#include "support.h"

enum { STEPS = 1000 };

/* Steps of `each` seconds, the first of `first`; reports after `every` steps. Returns the clock when it is said, and
 * the seconds left as said; -1: it never was. */
static double said_at(double first, double each, uint64_t begin, uint64_t every, double *left) {
  struct forecast forecast;
  double at = -1, now = 100;
  forecast_begin(&forecast, now, begin);
  for (uint64_t step = begin + 1; step <= STEPS; step++) {
    double found = -1;
    now += step == begin + 1 ? first : each;
    if ((step - begin) % every != 0 && step != STEPS) continue;
    if (!forecast_due(&forecast, now, step, STEPS, &found)) continue;
    assert_true(at < 0); /* once */
    at = now - 100;
    *left = found;
    if (!(fabs(found - each * (double)(STEPS - step)) < 1e-6 * found))
      fail_msg("step %llu: %g s left, expected %g", (unsigned long long)step, found, each * (double)(STEPS - step));
  }
  return at;
}

static void test_said(void **state) {
  (void)state;
  double left = 0;
  assert_true(said_at(1, 0.1, 0, 1, &left) <= 4.2);   /* the slow first step does not count */
  assert_true(said_at(2, 0.5, 700, 1, &left) <= 5.6); /* a training that goes on */
  assert_true(said_at(0.6, 0.01, 0, 50, &left) <= 5); /* a report now and then */
  assert_true(said_at(4, 3.9, 0, 1, &left) <= 8);     /* within ten seconds for any step of less than five */
  assert_true(fabs(said_at(8, 8, 0, 1, &left) - 8) < 1e-9 && fabs(left - 8 * (STEPS - 1)) < 1e-6);
  assert_true(said_at(0.01, 0.002, 0, 1, &left) < 0);  /* over before there is anything to say */
  assert_true(said_at(9, 9, STEPS - 1, 1, &left) < 0); /* its first step is its last */
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_said)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
