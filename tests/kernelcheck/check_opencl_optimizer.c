/* SPDX-License-Identifier: MIT
 * AdamW, the moving average and the test for finite values on an OpenCL device against the reference: the same bits
 * where the device's division and root are correctly rounded. */
#include "twin.h"

#include <float.h>

#include "backend_opencl/opencl.h"

enum { MANY = 5000 };

static ern_context *context;
static struct twin twin;

static const float odd[] = {0,     -0.0f,   1e-45f,   -1e-40f,  FLT_MIN,   1e-20f, 1e18f,
                            1e20f, FLT_MAX, -FLT_MAX, INFINITY, -INFINITY, NAN,    1};
enum { ODD = sizeof odd / sizeof *odd };

static float value_of(uint64_t seed, size_t i) {
  const struct ern_random random = ern_random_at(seed, 0, (uint32_t)i, ERN_RNG_INIT);
  if (random.word[1] % 4 == 0) return odd[random.word[0] % ODD];
  return (ern_uniform(random.word[0]) * 2 - 1) * powf(10, (float)(random.word[2] % 9) - 6);
}

static struct twin_span values_of(uint64_t seed, size_t n, bool positive) {
  float *values = calloc(n + 1, sizeof *values);
  assert_non_null(values);
  for (size_t i = 0; i < n; i++) values[i] = positive ? fabsf(value_of(seed, i)) : value_of(seed, i);
  const struct twin_span made = twin_reals(&twin, values, n);
  free(values);
  return made;
}

/* Where they are not correctly rounded: a root of 3 ulp and a quotient of 2.5 make 8 of the step, which is
 * rate/sqrt(1 - beta2) at most, 0.05 of what is tested here; three of them. */
static void expect_same(const char *what, struct twin_span span, bool of_step) {
  const bool exact = ((const struct ern_cl_backend *)twin.backend[1])->device.exact_divide;
  twin_same(&twin, what, span, 0, of_step && !exact ? 3 * 0.05 * 8 * 0x1p-23 : 0);
}

static void check_adamw(size_t n) {
  const struct twin_span p = values_of(1, n, false), v = values_of(2, n, true), g = values_of(3, n, false);
  for (uint64_t step = 1; step <= 3; step++) {
    struct ern_adamw_args args[2];
    for (int k = 0; k < 2; k++)
      args[k] = (struct ern_adamw_args){p.on[k], v.on[k], g.on[k], 5e-3f / (float)step, 0.01f, 0.99f, 1e-8f, step, n};
    TWIN_RUN(&twin, adamw, args)
  }
  expect_same("parameters", p, true);
  expect_same("second moment", v, false);
  twin_clear(&twin);
}

static void test_adamw(void **state) {
  (void)state;
  for (size_t s = 0; s < TWIN_SIZES; s++) check_adamw(twin_sizes[s]);
  check_adamw(MANY);
  check_adamw(0);
}

/* From the first step to the billionth, with moments that forget at once and such that hardly forget. */
static void test_steps(void **state) {
  (void)state;
  static const float betas[] = {0, 0.5f, 0.99f, 0.999f, 0.99999994f};
  static const uint64_t steps[] = {1, 2, 3, 10, 1000, 100000, 125000, 16777217, 1000000000, UINT64_C(4000000000000)};
  for (size_t b = 0; b < sizeof betas / sizeof *betas; b++) {
    for (size_t s = 0; s < sizeof steps / sizeof *steps; s++) {
      float values[3][65];
      for (size_t i = 0; i < 65; i++) {
        values[0][i] = twin_random(1, i, 1);
        values[1][i] = fabsf(twin_random(2, i, 1e-4f));
        values[2][i] = twin_random(3, i, 1e-2f);
      }
      struct twin_span span[3];
      for (int k = 0; k < 3; k++) span[k] = twin_reals(&twin, values[k], 65);
      struct ern_adamw_args args[2];
      for (int k = 0; k < 2; k++)
        args[k] = (struct ern_adamw_args){span[0].on[k], span[1].on[k], span[2].on[k], 5e-3f, 0,
                                          betas[b],      1e-15f,        steps[s],      65};
      TWIN_RUN(&twin, adamw, args)
      expect_same("parameters", span[0], true);
      expect_same("second moment", span[1], false);
      twin_clear(&twin);
    }
  }
}

/* Second moments and squares of gradients all around the smallest normal number, and far below it; huge ones. */
static void test_denormal(void **state) {
  (void)state;
  enum { N = 20000 };
  static float gradient[N], moment[N];
  const size_t n = twin_is_small() ? 1000 : N;
  for (size_t i = 0; i < n; i++) {
    const struct ern_random random = ern_random_at(9, 0, (uint32_t)i, ERN_RNG_INIT);
    const struct ern_random other = ern_random_at(10, 0, (uint32_t)i, ERN_RNG_INIT);
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
  const struct twin_span p = values_of(1, n, false), v = twin_reals(&twin, moment, n),
                         g = twin_reals(&twin, gradient, n);
  for (uint64_t step = 1; step <= (twin_is_small() ? 3u : 20u); step++) {
    struct ern_adamw_args args[2];
    for (int k = 0; k < 2; k++)
      args[k] = (struct ern_adamw_args){
          p.on[k], v.on[k], g.on[k], 5e-3f, 0.01f, step % 2 ? 0.99f : 0.999f, step % 3 ? 1e-8f : 1e-15f, step, n};
    TWIN_RUN(&twin, adamw, args)
  }
  expect_same("parameters", p, true);
  expect_same("second moment", v, false);
  twin_clear(&twin);
}

static void test_ema(void **state) {
  (void)state;
  for (size_t s = 0; s <= TWIN_SIZES; s++) {
    const size_t n = s < TWIN_SIZES ? twin_sizes[s] : 0;
    const struct twin_span average = values_of(5, n, false), p = values_of(4, n, false);
    struct ern_ema_args args[2] = {{average.on[0], p.on[0], 0.95f, n}, {average.on[1], p.on[1], 0.95f, n}};
    TWIN_RUN(&twin, ema, args)
    expect_same("average", average, false);
    twin_clear(&twin);
  }
}

/* One value that is not finite anywhere among finite ones, the largest of them too; what lies behind does not count. */
static void check_finite(size_t n) {
  static const float bad[] = {NAN, INFINITY, -INFINITY};
  struct ern_backend *backend = twin.backend[1];
  struct ern_stream *stream = twin.stream[1];
  float *values = calloc(n + 1, sizeof *values);
  assert_non_null(values);
  for (size_t i = 0; i < n; i++) {
    values[i] = i % 5 == 0 ? FLT_MAX : i % 5 == 1 ? -FLT_MAX : i % 5 == 2 ? 1e-45f : value_of(6, i);
    if (!isfinite(values[i])) values[i] = 0;
  }
  const struct twin_span span = twin_reals(&twin, values, n);
  struct ern_finite_args args = {.values = span.on[1], .n = n};
  support_ok(context, backend->finite(stream, &args));
  assert_true(args.finite);
  for (size_t i = 0; i<n; i += n> 300 ? 37 : 1) {
    const ern_span one = ern_span_part(span.on[1], i, 1);
    support_ok(context, backend->upload_reals(stream, one, &bad[i % 3], 1));
    args.n = n;
    support_ok(context, backend->finite(stream, &args));
    if (args.finite) fail_msg("%g at %zu of %zu is called finite", (double)bad[i % 3], i, n);
    args.n = i;
    support_ok(context, backend->finite(stream, &args));
    assert_true(args.finite);
    support_ok(context, backend->upload_reals(stream, one, &values[i], 1));
  }
  twin_clear(&twin);
  free(values);
}

static void test_finite(void **state) {
  (void)state;
  for (size_t s = 0; s < TWIN_SIZES; s++) check_finite(twin_sizes[s]);
  if (!twin_is_small()) check_finite(MANY);
  check_finite(0);
}

static int set_up(void **state) {
  (void)state;
  context = support_context();
  twin_open(&twin, context);
  return 0;
}
static int tear_down(void **state) {
  (void)state;
  twin_close(&twin);
  ern_context_free(&context);
  return 0;
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_adamw), cmocka_unit_test(test_steps),  cmocka_unit_test(test_denormal),
      cmocka_unit_test(test_ema),   cmocka_unit_test(test_finite),
  };
  return cmocka_run_group_tests_name("opencl optimizer", tests, set_up, tear_down);
}
