/* SPDX-License-Identifier: MIT
 * The output activations. */
#include "harness.h"
#include "mlp/activation_ops.h"

/* How far two good activations may be apart, in units of 2^-23 relative to the value. Below the normal numbers only an
 * absolute error counts. The colour's subtraction leaves the error of the minuend, 0.001 larger.
 * An instruction set: exp is less than one unit off by libm, less than one by the series of eight terms. The others:
 * that, and half a unit for each of the sum, the product and the quotient after it, so 3 for each side.
 * OpenCL: exp is within 3 units, that of libm within 1; log1p 2 and 1. The others: that, and half a unit on each side
 * for each of the sum, the product and the quotient after it: 4 + 3. (The square of 1 + e counts the error of e twice,
 * but e <= 1 is at most half of it.) A device may take denormal numbers as 0. */
static double tolerance_of(int k, ern_activation kind, double expected) {
  if (kind == ERN_ACT_RELU || !isfinite(expected)) return 0; /* nothing is rounded */
  const double units = kind == ERN_ACT_DENSITY ? (is_device(k) ? 4.5 : 2) : is_device(k) ? 7 : 6;
  return units * 0x1p-23 * (fabs(expected) + (kind == ERN_ACT_COLOUR ? 0.001 : 0)) + (double)FLT_MIN;
}

static float input(size_t i) {
  static const float special[] = {0,      -0.0f, 1e-30f,  -1e-30f,  15,       -15,       15.5f, -15.5f, 80,
                                  79.99f, 81,    88.7f,   88.8f,    -87.3f,   -88,       -103,  -104,   -105,
                                  1e4f,   -1e4f, FLT_MAX, -FLT_MAX, INFINITY, -INFINITY, NAN};
  if (i < COUNT_OF(special)) return special[i];
  return random_at(70, i, i % 3 == 0 ? 1 : i % 3 == 1 ? 20 : 110);
}

static void expect_activated(const char *what, struct many_rows rows, ern_activation kind, const float *x, size_t n) {
  static const char *const name[] = {"density", "colour", "sigmoid", "softplus", "relu"};
  const float *expected = floats_of(0, of_rows(rows));
  EACH_OTHER (k) {
    const float *found = floats_of(k, of_rows(rows));
    for (size_t i = 0; i < rows.on[0].span.count; i++) {
      const double tolerance = tolerance_of(k, kind, (double)expected[i]);
      if (is_near(found[i], expected[i], 0, tolerance)) continue;
      const size_t row = i / rows.on[0].stride, at = i % rows.on[0].stride;
      fail_msg("%s: %s of %s(%.9g): %.9g, reference %.9g +- %.1e", machines.name[k], what, name[kind],
               at < n ? (double)x[row * n + at] : NAN, (double)found[i], (double)expected[i], tolerance);
    }
  }
}

struct args {
  struct ern_activate_fwd_args forward[MACHINES];
  struct ern_activate_bwd_args backward[MACHINES], in_place[MACHINES];
};

enum { ROWS = 3 };

static void check(size_t n) {
  float *x = floats(ROWS * n), *dy = floats(ROWS * n);
  for (size_t i = 0; i < ROWS * n; i++) {
    x[i] = input(n < 50 ? (i + 4 * n) % 25 : i);
    dy[i] = i % 2 ? 1 : -1.5f;
  }
  for (ern_activation kind = ERN_ACT_DENSITY; kind <= ERN_ACT_RELU; kind++) {
    const struct many_rows from = many_strided(x, ROWS, n, ERN_PER_SAMPLE),
                           to = many_strided(NULL, ROWS, n, ERN_PER_SAMPLE),
                           gradient = many_strided(dy, ROWS, n, ERN_PER_SAMPLE),
                           apart = many_strided(NULL, ROWS, n, ERN_PER_SAMPLE);
    struct args args;
    EACH_MACHINE (k) {
      args.forward[k] = (struct ern_activate_fwd_args){to.on[k], from.on[k], kind, n};
      args.backward[k] = (struct ern_activate_bwd_args){apart.on[k], gradient.on[k], from.on[k], kind, n};
      args.in_place[k] = (struct ern_activate_bwd_args){gradient.on[k], gradient.on[k], from.on[k], kind, n};
    }
    RUN(activate_fwd, args.forward);
    RUN(activate_bwd, args.backward);
    RUN(activate_bwd, args.in_place);
    expect_activated("y", to, kind, x, n);
    expect_activated("dx", apart, kind, x, n);
    expect_activated("dx in place", gradient, kind, x, n);
  }
  machines_clear();
}

static void test_activations(void **state) {
  (void)state;
  for (size_t s = 0; s < size_count(); s++) check(test_sizes[s]);
  if (!is_small()) check(20000);
  check(0);
}

/* The same input gives the same output wherever in a register it lies. */
static void test_place(void **state) {
  (void)state;
  enum { N = 101 };
  float x[N];
  for (size_t i = 0; i < N; i++) x[i] = 1.2345f;
  const struct many_rows from = many_strided(x, 1, N, ERN_PER_SAMPLE), to = many_strided(NULL, 1, N, ERN_PER_SAMPLE);
  ON_EACH(activate_fwd, ern_activate_fwd_args, {to.on[k], from.on[k], ERN_ACT_COLOUR, N})
  EACH_MACHINE (k) {
    const float *y = floats_of(k, of_rows(to));
    for (size_t i = 1; i < N; i++) assert_memory_equal(&y[i], &y[0], sizeof y[0]);
  }
  machines_clear();
}

static void bench(void) {
  static const char *const forward[] = {"density", "colour", "sigmoid", "softplus", "relu"}, *const backward[] = {
                                                                                                 "density's gradient",
                                                                                                 "colour's gradient",
                                                                                                 "sigmoid's gradient",
                                                                                                 "softplus' gradient",
                                                                                                 "relu's gradient"};
  enum { N = 1 << 15 };
  float *x = floats(ROWS * N);
  fill_random(x, ROWS * N, 1, 8);
  const struct many_rows from = many_strided(x, ROWS, N, ERN_PER_SAMPLE), to = many_strided(x, ROWS, N, ERN_PER_SAMPLE);
  for (ern_activation kind = ERN_ACT_DENSITY; kind <= ERN_ACT_RELU; kind++) {
    struct args args;
    EACH_MACHINE (k) {
      args.forward[k] = (struct ern_activate_fwd_args){to.on[k], from.on[k], kind, N};
      args.backward[k] = (struct ern_activate_bwd_args){to.on[k], from.on[k], from.on[k], kind, N};
    }
    BENCH(forward[kind], ROWS * N, activate_fwd, args.forward);
    BENCH(backward[kind], ROWS * N, activate_bwd, args.backward);
  }
  machines_clear();
}

static const struct CMUnitTest tests[] = {
    cmocka_unit_test(test_activations),
    cmocka_unit_test(test_place),
};
NOUN(activation, bench, .isa = NULL)
