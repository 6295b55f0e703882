/* SPDX-License-Identifier: MIT
 * AdamW, the moving average and the test for finite values at their ends (docs/numerics.md). */
#include "machines.h"
#include "render/picture_ops.h"
#include "train/optimizer_ops.h"

static const float rate = 0.01f, decay = 0.01f, beta2 = 0.99f, eps = 1e-8f;

struct state {
  struct many p, v;
};

/* One update of n parameters; their first values, moments and gradients. */
static struct state update(const float *p, const float *v, const float *g, size_t n, uint64_t step) {
  machines_clear();
  const struct state state = {many_reals(p, n), many_reals(v, n)};
  const struct many gradient = many_reals(g, n);
  ON_EACH(adamw, ern_adamw_args,
          {.parameters = state.p.on[k],
           .second_moment = state.v.on[k],
           .gradient = gradient.on[k],
           .rate = rate,
           .decay = decay,
           .beta2 = beta2,
           .eps = eps,
           .step = step,
           .n = n})
  return state;
}

enum { N = 67 };
static float parameters[N], moments[N], gradients[N];
static void fill(float parameter, float moment) {
  for (size_t i = 0; i < N; i++) parameters[i] = parameter, moments[i] = moment, gradients[i] = 0;
}

/* case: no gradient, no moment | plain code: `0/sqrt(0)` | here: eps beside the root; only the decay moves it | bound:
 * 8 x 2^-23 */
/* 0/0 without eps: the parameter decays, and that is all. */
static void test_update_without_a_gradient(void **state) {
  (void)state;
  fill(8, 0);
  const struct state s = update(parameters, moments, gradients, N, 1);
  for (size_t i = 0; i < N; i++) expect_at("parameter", s.p, i, 8 * (1 - 1e-4), 8 * 0x1p-23);
  expect_within("moment", s.v, 0, 0);
  moments[3] = FLT_TRUE_MIN;
  const struct state later = update(parameters, moments, gradients, N, 1000000000);
  expect_within("moment", later.v, 0, (double)FLT_MIN);
  expect_truth("parameter", later.p, 2 * 0x1p-23, 0);
}

/* case: gradients of 1e-45 to 1e-10 | plain code: g/0: the longest step | here: g/eps; denormal products in double |
 * bound: 8 x 2^-23 */
/* g^2 is 0 below 1e-23: the step is g/eps, which vanishes as it should, and is never rate/0. */
static void test_update_by_subnormal_gradients(void **state) {
  (void)state;
  static const float tiny[] = {1e-45f, -1e-45f, 1e-40f, -1e-38f, 1e-30f, -1e-23f, 1e-20f, 1e-15f, 1e-10f};
  static const uint64_t steps[] = {1, 100, 1000000000};
  for (size_t s = 0; s < COUNT_OF(steps); s++) {
    fill(0, 0);
    for (size_t i = 0; i < N; i++) gradients[i] = tiny[i % COUNT_OF(tiny)];
    const struct state after = update(parameters, moments, gradients, N, steps[s]);
    expect_within("parameter", after.p, -0.1001, 0.1001);
    /* rate g/eps has 3 roundings; g^2 below the normal numbers counts by its root, 1e-19, beside eps = 1e-8 */
    expect_truth("parameter", after.p, 8 * 0x1p-23 + 1e-10, (double)FLT_MIN);
    expect_truth("moment", after.v, 4 * 0x1p-23, (double)FLT_MIN);
  }
}

/* case: gradients of 1e10 to FLT_MAX | plain code: g^2 infinite from 1.8e19 | here: root and gradient 2^-64 as large;
 * the moment ends at FLT_MAX | bound: 16 x 2^-23; at most rate/sqrt(1 - beta2) */
/* g^2 is infinite from 1.8e19 on, and g over its root 0 or NaN: the step of a gradient has a limit, and it is that. */
static void test_update_by_huge_gradients(void **state) {
  (void)state;
  static const float huge[] = {1e10f, -1e18f, 1.8e19f, -2e19f, 1e20f, -1e25f, 1e30f, 3e38f, FLT_MAX};
  static const float before[] = {0, 1, 1e30f, FLT_MAX};
  for (size_t b = 0; b < COUNT_OF(before); b++) {
    fill(0, before[b]);
    for (size_t i = 0; i < N; i++) gradients[i] = huge[i % COUNT_OF(huge)];
    const struct state first = update(parameters, moments, gradients, N, 1);
    expect_within("first step", first.p, -0.01001, 0.01001);
    expect_truth("first step", first.p, 16 * 0x1p-23, (double)FLT_MIN);
    const struct state late = update(parameters, moments, gradients, N, 1000000000);
    expect_within("late step", late.p, -0.10001, 0.10001); /* rate/sqrt(1 - beta2) */
    expect_truth("late step", late.p, 16 * 0x1p-23, (double)FLT_MIN);
    for (int k = 1; k < machines.count; k++) { /* kept at the largest number where double has more */
      double *v = many_values(k, late.v);
      for (size_t i = MACHINE_GUARD; i < N + MACHINE_GUARD; i++) assert_true(v[i] >= 0 && v[i] <= (double)FLT_MAX);
      free(v);
    }
  }
}

static bool is_opencl(int k) { return strncmp(machines.name[k], "opencl", 6) == 0; }

/* After SPIKE_STEPS steps of gradient 1 from a moment of FLT_MAX: v = FLT_MAX beta2^n, as 1 - beta2 is nothing beside
 * it, and the parameter has moved by the sum of rate/sqrt(v). A step rounds v twice, its root and quotient once each.
 */
enum { SPIKE_STEPS = 3 };
static void expect_spike(struct many p, struct many v) {
  const double bound = 4 * SPIKE_STEPS * (double)FLT_EPSILON;
  double left = (double)FLT_MAX, way = 0;
  for (int n = 0; n < SPIKE_STEPS; n++) {
    left *= (double)beta2;
    way -= (double)rate / sqrt(left);
  }
  for (int k = 0; k < machines.count; k++) {
    double *moved = many_values(k, p), *moment = many_values(k, v);
    for (size_t i = MACHINE_GUARD; i < N + MACHINE_GUARD; i++)
      if (!(fabs(moment[i] / left - 1) <= bound) || !(fabs(moved[i] / way - 1) <= bound))
        fail_msg("%s: moment %g, expected %g; moved by %g, expected %g", machines.name[k], moment[i], left, moved[i],
                 way);
    free(moved);
    free(moment);
  }
}

/* case: a moment of FLT_MAX, then gradients of 1 | plain code: the parameter is dead | here: down by beta2 a step |
 * bound: moves again */
/* A moment that is at the largest number comes down again: one spike does not stop a parameter for good. */
static void test_update_after_a_spike(void **state) {
  (void)state;
  machines_clear();
  fill(0, FLT_MAX);
  for (size_t i = 0; i < N; i++) gradients[i] = 1;
  const struct many p = many_reals(parameters, N), v = many_reals(moments, N), g = many_reals(gradients, N);
  for (uint64_t step = 1; step <= 9400; step++) { /* 0.99^9400 of 3.4e38 is 3e-3 */
    for (int k = 0; k < machines.count; k++) {
      if (is_opencl(k) && step > SPIKE_STEPS) continue; /* each launch takes its time */
      struct ern_adamw_args args = {p.on[k], v.on[k], g.on[k], rate, 0, beta2, eps, 1000000 + step, N};
      support_ok(machines.context, machines.backend[k]->adamw(machines.stream[k], &args));
    }
    if (step == SPIKE_STEPS) expect_spike(p, v);
  }
  for (int k = 0; k < machines.count; k++) {
    if (is_opencl(k)) continue;
    double *moved = many_values(k, p), *moment = many_values(k, v);
    for (size_t i = MACHINE_GUARD; i < N + MACHINE_GUARD; i++)
      assert_true(isfinite(moved[i]) && moment[i] < 1.01 && moved[i] < -0.5);
    free(moved);
    free(moment);
  }
}

/* case: moments of 1.4e-45 to 2.4e-38, gradients of 0 to 1 | plain code: a flushed or slow root | here: denormal
 * moments in double, the reference's bits | bound: 8 x 2^-23 */
/* A root of at most 1e-19 is nothing beside eps: the step is that of no moment. */
static void test_update_of_denormal_moments(void **state) {
  (void)state;
  static const float moment[] = {FLT_TRUE_MIN,     3 * FLT_TRUE_MIN, 1e-44f,       1e-40f,
                                 0x1.fffffcp-127f, FLT_MIN,          0x1.02p-126f, 0x1p-125f};
  static const float gradient[] = {0, 1e-30f, -1e-22f, 1e-19f, -1e-15f, 1e-9f, 1};
  static const uint64_t steps[] = {1, 100, 1000000000};
  for (size_t s = 0; s < COUNT_OF(steps); s++) {
    fill(1, 0);
    for (size_t i = 0; i < N; i++) moments[i] = moment[i % COUNT_OF(moment)], gradients[i] = gradient[i / 8 % 7];
    const struct state after = update(parameters, moments, gradients, N, steps[s]);
    expect_truth("parameter", after.p, 8 * 0x1p-23, 0);
    expect_truth("moment", after.v, 4 * 0x1p-23, (double)FLT_MIN);
    double *plain = many_values(1, after.v);
    for (int k = 2; k < machines.count; k++) { /* to the bit, but where a device has no denormal numbers */
      double *v = many_values(k, after.v);
      for (size_t i = MACHINE_GUARD; i < N + MACHINE_GUARD && !is_opencl(k); i++)
        if (v[i] != plain[i]) fail_msg("%s: moment %zu is %a, expected %a", machines.name[k], i, v[i], plain[i]);
      free(v);
    }
    free(plain);
  }
}

/* case: 3,000 steps without a gradient | plain code: a moment slow for good | here: stays at 51 times 1.4e-45 or less;
 * the next gradient moves as from 0 | bound: 8 x 2^-23 */
/* Without a gradient a moment comes down by beta2 a step, until 1 % of it is less than half a step of the denormal
 * numbers, and stays there; the next gradient counts as if there were none. */
static void test_update_of_a_moment_for_good(void **state) {
  (void)state;
  machines_clear();
  fill(0, 1e-38f);
  for (size_t i = 0; i < N; i++) gradients[i] = 0;
  const struct many p = many_reals(parameters, N), v = many_reals(moments, N), none = many_reals(gradients, N);
  for (size_t i = 0; i < N; i++) gradients[i] = 1e-3f;
  const struct many g = many_reals(gradients, N);
  for (int k = 1; k < machines.count; k++) {
    if (is_opencl(k)) continue; /* each launch takes its time */
    for (uint64_t step = 1; step <= 3000; step++) {
      struct ern_adamw_args args = {p.on[k], v.on[k], none.on[k], rate, 0, beta2, eps, 1000000 + step, N};
      support_ok(machines.context, machines.backend[k]->adamw(machines.stream[k], &args));
    }
    double *moment = many_values(k, v);
    for (size_t i = MACHINE_GUARD; i < N + MACHINE_GUARD; i++)
      assert_true(moment[i] > 0 && moment[i] <= 51 * (double)FLT_TRUE_MIN);
    free(moment);
    struct ern_adamw_args args = {p.on[k], v.on[k], g.on[k], rate, 0, beta2, eps, 2000000, N};
    support_ok(machines.context, machines.backend[k]->adamw(machines.stream[k], &args));
    double *moved = many_values(k, p);
    const double way = -(double)rate * 1e-3 / (1e-3 * sqrt(1 - (double)beta2) + (double)eps);
    for (size_t i = MACHINE_GUARD; i < N + MACHINE_GUARD; i++)
      assert_true(fabs(moved[i] / way - 1) <= 8 * (double)FLT_EPSILON);
    free(moved);
  }
}

/* case: bias correction at steps 1 to 2^64 - 1 | plain code: `1 - pow(beta2, n)` loses its digits | here: `-expm1(n
 * log(beta2))` in double | bound: 1e-6 of the step */
/* 1 - beta2^n is 0 at n = 0 and cancels at n = 1 for beta2 near 1; it is exactly 1 after a billion steps. */
static void test_bias_correction_of_a_billion_steps(void **state) {
  (void)state;
  static const uint64_t steps[] = {1, 2, 69, 100000, 1000000000, (uint64_t)1 << 60, UINT64_MAX};
  for (size_t s = 0; s < COUNT_OF(steps); s++) {
    fill(0, 0);
    for (size_t i = 0; i < N; i++) gradients[i] = (float)i - 33;
    const double corrected = sqrt((1 - pow((double)beta2, (double)steps[s])) / (1 - (double)beta2));
    const struct state after = update(parameters, moments, gradients, N, steps[s]);
    for (size_t i = 0; i < N; i += 11) /* rate sqrt(1 - beta2^n)/sqrt(1 - beta2) */
      expect_at("step", after.p, i, i == 33 ? 0 : -copysign((double)rate * corrected, (double)gradients[i]), 1e-6);
  }
}

/* case: one gradient NaN in a register | plain code: the register is NaN | here: its own is; the training refuses it
 * before | bound: exact */
/* No gradient that is not finite gets here: the training looks before. It harms its own parameter alone. */
static void test_update_by_a_nan(void **state) {
  (void)state;
  fill(1, 1);
  for (size_t i = 0; i < N; i++) gradients[i] = i % 16 == 5 ? NAN : 1;
  const struct state after = update(parameters, moments, gradients, N, 10);
  for (size_t i = 0; i < N; i++) {
    if (i % 16 == 5)
      expect_at("NaN", after.p, i, (double)NAN, 0);
    else
      expect_at("its neighbours", after.p, i, 1 - 1e-4 - 0.01 * sqrt(1 - pow(0.99, 10)), 1e-6);
  }
}

/* case: averages of +-1e38, of denormals | plain code: `d a + (1 - d) p` drifts where a = p | here: `a + (1 - d) (p -
 * a)`; finite within 3.4e38 of each other | bound: 40 x 2^-23 */
static void test_average_of_huge_and_denormal_values(void **state) {
  (void)state;
  static const float own[] = {1e38f, -1e38f, 0, FLT_TRUE_MIN, 1, -0.0f},
                     fresh[] = {1e38f, 1e38f, FLT_TRUE_MIN, 0, 1, 1e-30f};
  machines_clear();
  const struct many average = many_reals(own, 6), p = many_reals(fresh, 6);
  for (int step = 0; step < 20; step++)
    ON_EACH(ema, ern_ema_args, {.average = average.on[k], .parameters = p.on[k], .decay = 0.95f, .n = 6})
  expect_within("average", average, -1e38, 1e38);
  expect_truth("average", average, 40 * 0x1p-23, 2e30);
  expect_at("of itself", average, 0, (double)1e38f, 1e31);
  expect_at("of itself", average, 4, 1, 0);
}

/* case: a NaN or infinity at each of 300 places | plain code: `sum == sum` misses tails | here: all exponents are
 * compared | bound: exact */
/* Each place of each length: a NaN or an infinity is found, FLT_MAX and denormals are not taken for one. */
static void test_finite_finds_every_place(void **state) {
  (void)state;
  static const float bad[] = {NAN, -NAN, INFINITY, -INFINITY};
  enum { LONG = 300 };
  for (size_t place = 0; place <= LONG; place += place < 70 ? 1 : 23) {
    float values[LONG];
    for (size_t i = 0; i < LONG; i++) values[i] = i % 3 == 0 ? FLT_MAX : i % 3 == 1 ? -FLT_TRUE_MIN : 0;
    if (place < LONG) values[place] = bad[place % 4];
    machines_clear();
    const struct many all = many_reals(values, LONG);
    for (int k = 0; k < machines.count; k++) {
      struct ern_finite_args whole = {all.on[k], LONG, false}, front = {all.on[k], place, false};
      support_ok(machines.context, machines.backend[k]->finite(machines.stream[k], &whole));
      support_ok(machines.context, machines.backend[k]->finite(machines.stream[k], &front));
      if (whole.finite != (place == LONG) || !front.finite) fail_msg("%s: place %zu", machines.name[k], place);
    }
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_update_without_a_gradient),
      cmocka_unit_test(test_update_by_subnormal_gradients),
      cmocka_unit_test(test_update_by_huge_gradients),
      cmocka_unit_test(test_update_after_a_spike),
      cmocka_unit_test(test_bias_correction_of_a_billion_steps),
      cmocka_unit_test(test_update_by_a_nan),
      cmocka_unit_test(test_average_of_huge_and_denormal_values),
      cmocka_unit_test(test_update_of_denormal_moments),
      cmocka_unit_test(test_update_of_a_moment_for_good),
      cmocka_unit_test(test_finite_finds_every_place),
  };
  return cmocka_run_group_tests(tests, open_machines, close_machines);
}
