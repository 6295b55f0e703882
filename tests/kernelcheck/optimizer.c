/* SPDX-License-Identifier: MIT
 * AdamW and the moving average: the same bits where division and root are correctly rounded. */
#include "harness.h"
#include "train/optimizer_ops.h"

enum { MANY = 5000 };

static const float odd[] = {0,     -0.0f,   1e-45f,   -1e-40f,  FLT_MIN,   1e-20f, 1e18f,
                            1e20f, FLT_MAX, -FLT_MAX, INFINITY, -INFINITY, NAN,    1};
enum { ODD = COUNT_OF(odd) };

static float value_of(uint64_t seed, size_t i) {
  const struct ern_random random = words_at(seed, 0, i);
  if (random.word[1] % 4 == 0) return odd[random.word[0] % ODD];
  return (ern_uniform(random.word[0]) * 2 - 1) * powf(10, (float)(random.word[2] % 9) - 6);
}

static struct many values_of(uint64_t seed, size_t n, bool positive) {
  float *values = floats(n);
  for (size_t i = 0; i < n; i++) values[i] = positive ? fabsf(value_of(seed, i)) : value_of(seed, i);
  return many_reals(values, n);
}

/* The same bits. A device whose quotients and roots are not correctly rounded: a root of 3 ulp and a quotient of 2.5
 * make 8 of the step, which is rate/sqrt(1 - beta2) at most, 0.05 of what is tested here; three of them. */
static void expect_same(const char *what, struct many span, bool of_step) {
  const float *expected = floats_of(0, span);
  EACH_OTHER (k) {
    const float *found = floats_of(k, span);
    const double tolerance = of_step && !divides_exactly(k) ? 3 * 0.05 * 8 * 0x1p-23 : 0;
    for (size_t i = 0; i < span.on[k].count; i++)
      if (!same_bits(found[i], expected[i]) && !(tolerance > 0 && is_near(found[i], expected[i], 0, tolerance)))
        fail_msg("%s: %s [%zu] of %zu: %.9g, reference %.9g", machines.name[k], what, i, span.on[k].count,
                 (double)found[i], (double)expected[i]);
  }
}

static void check_adamw(size_t n) {
  const struct many p = values_of(1, n, false), v = values_of(2, n, true), g = values_of(3, n, false);
  for (uint64_t step = 1; step <= 3; step++) {
    struct ern_adamw_args args[MACHINES];
    EACH_MACHINE (k)
      args[k] = (struct ern_adamw_args){p.on[k], v.on[k], g.on[k], 5e-3f / (float)step, 0.01f, 0.99f, 1e-8f, step, n};
    RUN(adamw, args);
  }
  expect_same("parameters", p, true);
  expect_same("second moment", v, false);
  machines_clear();
}

static void test_adamw(void **state) {
  (void)state;
  for (size_t s = 0; s < size_count(); s++) check_adamw(test_sizes[s]);
  check_adamw(MANY);
  check_adamw(0);
}

/* From the first step to the billionth, with moments that forget at once and such that hardly forget. */
static void test_steps(void **state) {
  (void)state;
  static const float betas[] = {0, 0.5f, 0.99f, 0.999f, 0.99999994f};
  static const uint64_t steps[] = {1, 2, 3, 10, 1000, 100000, 125000, 16777217, 1000000000, UINT64_C(4000000000000)};
  for (size_t b = 0; b < COUNT_OF(betas); b++) {
    for (size_t s = 0; s < COUNT_OF(steps); s++) {
      float values[3][65];
      for (size_t i = 0; i < 65; i++) {
        values[0][i] = random_at(1, i, 1);
        values[1][i] = fabsf(random_at(2, i, 1e-4f));
        values[2][i] = random_at(3, i, 1e-2f);
      }
      struct many span[3];
      for (int k = 0; k < 3; k++) span[k] = many_reals(values[k], 65);
      struct ern_adamw_args args[MACHINES];
      EACH_MACHINE (k)
        args[k] = (struct ern_adamw_args){span[0].on[k], span[1].on[k], span[2].on[k], 5e-3f, 0,
                                          betas[b],      1e-15f,        steps[s],      65};
      RUN(adamw, args);
      expect_same("parameters", span[0], true);
      expect_same("second moment", span[1], false);
      machines_clear();
    }
  }
}

/* Second moments and squares of gradients all around the smallest normal number, and far below it; huge ones. */
static void test_denormal(void **state) {
  (void)state;
  enum { N = 20000 };
  static float gradient[N], moment[N];
  const size_t n = is_small() ? 1000 : N;
  for (size_t i = 0; i < n; i++) {
    const struct ern_random random = words_at(9, 0, i);
    const struct ern_random other = words_at(10, 0, i);
    const float sign = random.word[0] % 2 ? 1.0f : -1.0f, spread = ern_uniform(random.word[1]);
    gradient[i] = random.word[2] % 3 == 0 ? 0 : sign * powf(10, -16 - 8 * spread);
    if (random.word[2] % 100 == 1) gradient[i] = sign * powf(10, -30 - 15 * spread);
    if (random.word[2] % 100 == 4) gradient[i] = odd[random.word[0] % ODD];
    if (random.word[2] % 100 == 7) gradient[i] = sign * powf(10, 17 + 4 * spread);
    moment[i] = other.word[0] % 5 == 0 ? 0 : powf(10, -36 - 9 * ern_uniform(other.word[1]));
    if (other.word[2] % 100 == 1) moment[i] = fabsf(odd[other.word[0] % ODD]);
    if (other.word[2] % 100 == 2) moment[i] = -1e-40f;
    if (other.word[2] % 100 == 3) moment[i] = powf(10, 34 + 4 * ern_uniform(other.word[1]));
  }
  const struct many p = values_of(1, n, false), v = many_reals(moment, n), g = many_reals(gradient, n);
  for (uint64_t step = 1; step <= (is_small() ? 3u : 20u); step++) {
    struct ern_adamw_args args[MACHINES];
    EACH_MACHINE (k)
      args[k] = (struct ern_adamw_args){
          p.on[k], v.on[k], g.on[k], 5e-3f, 0.01f, step % 2 ? 0.99f : 0.999f, step % 3 ? 1e-8f : 1e-15f, step, n};
    RUN(adamw, args);
  }
  expect_same("parameters", p, true);
  expect_same("second moment", v, false);
  machines_clear();
}

static void test_ema(void **state) {
  (void)state;
  for (size_t s = 0; s <= size_count(); s++) {
    const size_t n = s < size_count() ? test_sizes[s] : 0;
    const struct many average = values_of(5, n, false), p = values_of(4, n, false);
    struct ern_ema_args args[MACHINES];
    EACH_MACHINE (k) args[k] = (struct ern_ema_args){average.on[k], p.on[k], 0.95f, n};
    RUN(ema, args);
    expect_same("average", average, false);
    machines_clear();
  }
}

/* The parameters of a head. */
static void bench(void) {
  enum { N = 655360 };
  float *values = floats(N), *low = floats(N);
  for (size_t i = 0; i < N; i++) values[i] = fabsf(random_at(2, i, 1)), low[i] = 1e-42f;
  const struct many p = many_reals(values, N), v = many_reals(values, N), g = many_reals(values, N),
                    none = many_zeros(N), tiny = many_reals(low, N);
  struct ern_adamw_args adamw[MACHINES], denormal[MACHINES];
  struct ern_ema_args ema[MACHINES];
  EACH_MACHINE (k) {
    adamw[k] = (struct ern_adamw_args){p.on[k], v.on[k], g.on[k], 1e-3f, 0, 0.99f, 1e-8f, 100, N};
    denormal[k] = (struct ern_adamw_args){p.on[k], tiny.on[k], none.on[k], 1e-3f, 0, 1, 1e-8f, 100, N};
    ema[k] = (struct ern_ema_args){v.on[k], g.on[k], 0.95f, N};
  }
  BENCH("adamw", N, adamw, adamw);
  BENCH("adamw of denormal moments", N, adamw, denormal);
  BENCH("ema", N, ema, ema);
  machines_clear();
}

static const struct CMUnitTest tests[] = {
    cmocka_unit_test(test_adamw),
    cmocka_unit_test(test_steps),
    cmocka_unit_test(test_denormal),
    cmocka_unit_test(test_ema),
};
NOUN(optimizer, bench, .isa = NULL)
