/* SPDX-License-Identifier: MIT
 * The elementary functions of a register against those in double, within the bounds that their header states. Compiled
 * for no instruction set: the form that any machine can run, without fused multiply-adds. */
#include "../support.h"

#include <stdbool.h>

#include "backend_cpu/simd/lanes_math.h"
#include "core/rng.h"

typedef vf lanes_function(vf x);
typedef double function(double x);

static vf exp_pair(vf x) {
  vf expm1;
  return vf_exp_expm1(x, &expm1);
}
#define LANES_FUNCTION(name) \
  static vf lanes_##name(vf x) { return vf_##name(x); }
LANES_FUNCTION(exp)
LANES_FUNCTION(expm1)
LANES_FUNCTION(sigmoid)
LANES_FUNCTION(sigmoid_derivative)
LANES_FUNCTION(log)
LANES_FUNCTION(log2)
LANES_FUNCTION(log1p)
LANES_FUNCTION(softplus)
LANES_FUNCTION(sine)

static double sigmoid(double x) { return 1 / (1 + exp(-x)); }
static double sigmoid_derivative(double x) {
  const double e = exp(-fabs(x));
  return e / ((1 + e) * (1 + e));
}
static double softplus(double x) { return (x < 0 ? 0 : x) + log1p(exp(-fabs(x))); }

/* ulp: the bound of the header. By bits: every size of number alike; else evenly spread. */
static const struct elementary {
  const char *name;
  lanes_function *lanes;
  function *exact;
  double ulp;
  float low, high;
  bool by_bits;
} elementaries[] = {
    {"exp", lanes_exp, exp, 1.25, -105, 90, false},
    {"exp", lanes_exp, exp, 1.25, 1e-40f, 90, true},
    {"exp of the pair", exp_pair, exp, 1.25, -105, 90, false},
    {"exp of the pair", exp_pair, exp, 1.25, -1, 1, false},
    {"expm1", lanes_expm1, expm1, 1.5, -110, 90, false},
    {"expm1", lanes_expm1, expm1, 1.5, -2, 2, false},
    {"expm1", lanes_expm1, expm1, 1.5, 0, 90, true},
    {"expm1", lanes_expm1, expm1, 1.5, -0.0f, -1e30f, true},
    {"sigmoid", lanes_sigmoid, sigmoid, 2.5, -88, 110, false},
    {"sigmoid", lanes_sigmoid, sigmoid, 2.5, -3, 3, false},
    {"gradient", lanes_sigmoid_derivative, sigmoid_derivative, 4, -110, 110, false},
    {"gradient", lanes_sigmoid_derivative, sigmoid_derivative, 4, -3, 3, false},
    {"log", lanes_log, log, 1.5, 0, FLT_MAX, true},
    {"log", lanes_log, log, 1.5, 0.4f, 2.5f, false},
    {"log", lanes_log, log, 1.5, 0.999f, 1.001f, false},
    {"log2", lanes_log2, log2, 3, 0, FLT_MAX, true},
    {"log2", lanes_log2, log2, 3, 0.4f, 2.5f, false},
    {"log1p", lanes_log1p, log1p, 2.5, 0, FLT_MAX, true},
    {"log1p", lanes_log1p, log1p, 2.5, -0.0f, -0.9999f, true},
    {"log1p", lanes_log1p, log1p, 2.5, -1, 1, false},
    {"softplus", lanes_softplus, softplus, 3, -110, 110, false},
    {"softplus", lanes_softplus, softplus, 3, -3, 3, false},
};

static uint32_t bits_of(float value) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  return bits;
}

static float argument(const struct elementary *e, uint32_t word) {
  const uint32_t low = bits_of(e->low), bits = low + ern_below(word, bits_of(e->high) - low + 1);
  float value = e->low + (e->high - e->low) * ern_uniform(word);
  if (e->by_bits) memcpy(&value, &bits, sizeof value);
  return value;
}

/* The distance of the floats around a value. */
static double last_place(double value) {
  int exponent;
  (void)frexp(fmax(fabs(value), FLT_MIN), &exponent);
  return ldexp(1, exponent - 24);
}

static void expect_close(const char *name, float x, double found, double expected, double tolerance) {
  if (expected > FLT_MAX && found >= FLT_MAX) return;
  if (fabs(found - expected) <= tolerance || (isnan(found) && isnan(expected)) || found == expected) return;
  fail_msg("%s(%.9g): %.9g, in double %.17g; %.2f of the tolerance", name, x, found, expected,
           fabs(found - expected) / tolerance);
}

static void test_ranges(void **state) {
  (void)state;
  enum { TIMES = 200000 };
  for (size_t k = 0; k < sizeof elementaries / sizeof *elementaries; k++) {
    const struct elementary *e = &elementaries[k];
    for (uint32_t i = 0; i < TIMES; i += LANES) {
      vf x = {0};
      for (uint32_t l = 0; l < LANES; l++) x[l] = argument(e, ern_random_at(k, 0, i + l, ERN_RNG_INIT).word[0]);
      const vf y = e->lanes(x);
      for (int l = 0; l < LANES; l++) {
        const double exact = e->exact((double)x[l]);
        expect_close(e->name, x[l], (double)y[l], exact, e->ulp * last_place(exact));
      }
    }
  }
}

/* The ends of the ranges, and what is no number. */
static void test_edges(void **state) {
  (void)state;
  static const float edge[] = {0,         -0.0f,   NAN,      INFINITY, -INFINITY, 1,       -1,
                               -1.00001f, FLT_MAX, -FLT_MAX, FLT_MIN,  1e-45f,    -1e-45f, 0x1.62e43p+6f};
  for (size_t k = 0; k < sizeof elementaries / sizeof *elementaries; k++) {
    const struct elementary *e = &elementaries[k];
    for (size_t i = 0; i < sizeof edge / sizeof *edge; i++) {
      const double exact = e->exact((double)edge[i]);
      expect_close(e->name, edge[i], (double)e->lanes(vf_all(edge[i]))[0], exact, e->ulp * last_place(exact));
    }
  }
}

/* To 2^-23 however large the argument; beyond the limit, and for what is no number, as libm. */
static void test_sine(void **state) {
  (void)state;
  static const float scales[] = {1, 10, 700, VF_SINE_LIMIT, 1e6f, 1e30f};
  for (size_t s = 0; s < sizeof scales / sizeof *scales; s++) {
    for (uint32_t i = 0; i < 200000; i += LANES) {
      vf x = {0}, cosine = {0};
      for (uint32_t l = 0; l < LANES; l++)
        x[l] = (2 * ern_uniform(ern_random_at(s, 1, i + l, ERN_RNG_INIT).word[0]) - 1) * scales[s];
      const vf sine = vf_sine_cosine(x, &cosine), alone = lanes_sine(x);
      for (int l = 0; l < LANES; l++) {
        expect_close("sin", x[l], (double)sine[l], sin((double)x[l]), 0x1p-23);
        expect_close("cos", x[l], (double)cosine[l], cos((double)x[l]), 0x1p-23);
        assert_true(alone[l] == sine[l]);
      }
    }
  }
  const vf odd = {NAN, INFINITY, -INFINITY, 0};
  vf cosine = odd;
  const vf sine = vf_sine_cosine(odd, &cosine);
  for (int l = 0; l < 3; l++) assert_true(isnan(sine[l]) && isnan(cosine[l]));
  assert_true(sine[3] == 0 && cosine[3] == 1);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_ranges),
      cmocka_unit_test(test_edges),
      cmocka_unit_test(test_sine),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
