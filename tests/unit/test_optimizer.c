/* SPDX-License-Identifier: MIT
 * AdamW, the moving average and the test for finite values, against numbers worked by hand in double. */
#include "../support.h"

#include <float.h>
#include <math.h>

#include "core/rng.h"
#include "render/picture_ops.h"
#include "train/optimizer_ops.h"

/* The double build of the same kernel. */
void ern_adamw_ref64(double *parameters, double *second_moment, const double *gradient, float rate, float decay,
                     float beta2, float eps, double bias_correction, size_t n);

static void near(double found, double expected, double relative) {
  if (!(fabs(found - expected) <= relative * fabs(expected))) fail_msg("%.17g, expected %.17g", found, expected);
}

static double correction(float beta2, uint64_t step) { return -expm1((double)step * log((double)beta2)); }

/* The first step: v/(1 - beta2) is g^2, so that every parameter moves by rate*g/(|g| + eps). beta2 = 0.75, a power of
 * two short of 1, so that the numbers by hand are exact. */
static void test_first_step(void **state) {
  (void)state;
  double p[3] = {1, -2, 0.5}, v[3] = {0, 0, 0};
  const double g[3] = {0.5, -4, 3};
  ern_adamw_ref64(p, v, g, 0.125f, 0.25f, 0.75f, 0.5f, 0.25, 3);
  /* decay: p *= 1 - 1/32; v = g^2/4, v/0.25 = g^2 */
  near(v[0], 0.0625, 1e-15);
  near(v[1], 4, 1e-15);
  near(v[2], 2.25, 1e-15);
  near(p[0], 0.96875 - 0.125 * 0.5 / 1, 1e-15);
  near(p[1], -1.9375 + 0.125 * 4 / 4.5, 1e-15);
  near(p[2], 0.484375 - 0.125 * 3 / 3.5, 1e-15);
}

/* The second: v = 0.75 v + 0.25 g^2, correction 1 - 0.75^2 = 0.4375. */
static void test_second_step(void **state) {
  (void)state;
  double p[1] = {1}, v[1] = {4};
  const double g[1] = {-2};
  ern_adamw_ref64(p, v, g, 0.125f, 0, 0.75f, 0.5f, correction(0.75f, 2), 1);
  near(v[0], 4, 1e-15);
  near(p[0], 1 + 0.125 * 2 / (sqrt(4 / 0.4375) + 0.5), 1e-15);
}

/* A thousand steps in float against the plain recurrence in double. */
static void test_recurrence(void **state) {
  (void)state;
  enum { COUNT = 50, STEPS = 1000 };
  float p[COUNT], v[COUNT] = {0}, g[COUNT];
  double p64[COUNT], v64[COUNT] = {0};
  const float rate = 1e-2f, decay = 1e-2f, beta2 = 0.99f, eps = 1e-8f;
  for (uint32_t i = 0; i < COUNT; i++) p64[i] = p[i] = ern_uniform(ern_random_at(1, 0, i, ERN_RNG_INIT).word[0]);
  for (uint64_t step = 1; step <= STEPS; step++) {
    for (uint32_t i = 0; i < COUNT; i++) {
      g[i] = (2 * ern_uniform(ern_random_at(2, step, i, ERN_RNG_INIT).word[0]) - 1) * powf(10, (float)i / 5 - 5);
      v64[i] = (double)beta2 * v64[i] + (1 - (double)beta2) * (double)g[i] * (double)g[i];
      p64[i] -= (double)rate * (double)decay * p64[i];
      p64[i] -= (double)rate * (double)g[i] / (sqrt(v64[i] / (1 - pow((double)beta2, (double)step))) + (double)eps);
    }
    ern_adamw_ref(p, v, g, rate, decay, beta2, eps, correction(beta2, step), COUNT);
  }
  for (int i = 0; i < COUNT; i++) {
    near(v[i], v64[i], 1e-5);
    if (!(fabs((double)p[i] - p64[i]) < 1e-4)) fail_msg("%g, expected %g", (double)p[i], p64[i]); /* 1,000 roundings */
  }
}

/* Zero, subnormal and huge gradients, at the first step and after endlessly many: everything stays finite, no step is
 * longer than rate/sqrt(1 - beta2), and none goes uphill. */
static void test_hard_gradients(void **state) {
  (void)state;
  static const float hard[] = {0, 1e-45f, 1e-38f, 1e-30f, 1e-20f, 1e-8f, 1, 1e10f, 1e18f, 1.5e19f, 1e25f, FLT_MAX};
  enum { COUNT = 2 * (int)(sizeof hard / sizeof *hard) };
  static const uint64_t steps[] = {1, 2, 100, 125000, 1000000000, (uint64_t)1 << 60, UINT64_MAX};
  float g[COUNT], p[COUNT], v[COUNT];
  for (int i = 0; i < COUNT; i++) g[i] = i % 2 ? -hard[i / 2] : hard[i / 2];
  for (size_t k = 0; k < sizeof steps / sizeof *steps; k++) {
    const double bias = correction(0.99f, steps[k]);
    assert_true(bias > 0 && bias <= 1);
    memset(p, 0, sizeof p), memset(v, 0, sizeof v);
    ern_adamw_ref(p, v, g, 0.01f, 0.01f, 0.99f, 1e-8f, bias, COUNT);
    for (int i = 0; i < COUNT; i++) {
      assert_true(isfinite(p[i]) && isfinite(v[i]) && v[i] >= 0);
      assert_true(fabsf(p[i]) <= 0.1001f * (g[i] == 0 ? 0 : 1) && p[i] * (g[i] > 0 ? 1.0f : -1.0f) <= 0);
      if (steps[k] == 1 && fabsf(g[i]) >= 1e-6f) near(fabs((double)p[i]), 0.01, 0.02);
      if (steps[k] > 1000 && fabsf(g[i]) >= 1e25f) near(fabs((double)p[i]), 0.1, 1e-5); /* its square is infinite */
    }
    if (steps[k] > 1000000) assert_true(bias == 1);
  }
  /* a gradient too large to be squared is got over: later ones move the parameter again */
  float one[1] = {0}, moment[1] = {0};
  const float large[1] = {FLT_MAX}, small[1] = {1};
  ern_adamw_ref(one, moment, large, 0.01f, 0, 0.5f, 1e-8f, 0.5, 1);
  for (int step = 0; step < 200; step++) ern_adamw_ref(one, moment, small, 0.01f, 0, 0.5f, 1e-8f, 1, 1);
  const float before = one[0];
  ern_adamw_ref(one, moment, small, 0.01f, 0, 0.5f, 1e-8f, 1, 1);
  near((double)before - (double)one[0], 0.01, 1e-3);
}

/* No gradient: only the decay moves a parameter. */
static void test_no_gradient(void **state) {
  (void)state;
  float p[2] = {8, -8}, v[2] = {0, 4};
  const float g[2] = {0, 0};
  ern_adamw_ref(p, v, g, 0.5f, 0.25f, 0.75f, 1e-8f, 1, 2);
  assert_true(p[0] == 7 && p[1] == -7 && v[0] == 0 && v[1] == 3);
}

static void test_ema(void **state) {
  (void)state;
  float average[3] = {1, 2, -4};
  const float p[3] = {3, 2, 4};
  ern_ema_ref(average, p, 0.75f, 3);
  assert_true(average[0] == 1.5f && average[1] == 2 && average[2] == -2);
  ern_ema_ref(average, p, 0, 2);
  assert_true(average[0] == 3 && average[1] == 2 && average[2] == -2);
}

static void test_finite(void **state) {
  (void)state;
  enum { COUNT = 1000 };
  float values[COUNT];
  for (int i = 0; i < COUNT; i++) values[i] = i % 2 ? FLT_MAX : -1e-45f;
  assert_true(ern_finite_ref(values, COUNT));
  assert_true(ern_finite_ref(values, 0));
  static const float bad[] = {NAN, INFINITY, -INFINITY};
  for (int i = 0; i < COUNT; i += 37) {
    for (int k = 0; k < 3; k++) {
      const float kept = values[i];
      values[i] = bad[k];
      assert_false(ern_finite_ref(values, COUNT));
      assert_true(ern_finite_ref(values, (size_t)i));
      values[i] = kept;
    }
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_first_step),     cmocka_unit_test(test_second_step), cmocka_unit_test(test_recurrence),
      cmocka_unit_test(test_hard_gradients), cmocka_unit_test(test_no_gradient), cmocka_unit_test(test_ema),
      cmocka_unit_test(test_finite),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
