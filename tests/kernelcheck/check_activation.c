/* SPDX-License-Identifier: MIT
 * The output activations of each instruction set against the reference. */
#include "kernelcheck.h"

#include <float.h>

#include "core/kernels.h"
#include "mlp/mlp_tile.h"

struct kernel {
  const char *name;
  machine_isa isa;
  ern_activate_fwd_kernel *activate_fwd;
  ern_activate_bwd_kernel *activate_bwd;
};

static const struct kernel kernels[] = {
    {"ref", MACHINE_REF, ern_activate_fwd_ref, ern_activate_bwd_ref},
#if defined(ERN_X86_KERNELS)
    {"avx2", MACHINE_AVX2, ern_activate_fwd_avx2, ern_activate_bwd_avx2},
    {"avx512", MACHINE_AVX512, ern_activate_fwd_avx512, ern_activate_bwd_avx512},
#elif defined(ERN_ARM_KERNELS)
    {"neon", MACHINE_NEON, ern_activate_fwd_neon, ern_activate_bwd_neon},
#endif
};
enum { KERNELS = sizeof kernels / sizeof *kernels };

/* How far two good activations may be apart, in units of 2^-23 relative to the value. exp: less than one unit off by
 * libm, less than one by the series of eight terms. The others: that, and half a unit for each of the sum, the product
 * and the quotient after it, so 3 for each side. The colour's subtraction leaves the error of the minuend, 0.001
 * larger. Below the normal numbers only an absolute error counts. */
static double activation_tolerance(ern_activation kind, double expected) {
  if (kind == ERN_ACT_RELU) return 0; /* nothing is rounded */
  const double units = kind == ERN_ACT_DENSITY ? 2 : 6;
  return units * 0x1p-23 * (fabs(expected) + (kind == ERN_ACT_COLOUR ? 0.001 : 0)) + FLT_MIN;
}

static float act_input(size_t i) {
  static const float special[] = {0,      -0.0f, 1e-30f,  -1e-30f,  15,       -15,       15.5f, -15.5f, 80,
                                  79.99f, 81,    88.7f,   88.8f,    -87.3f,   -88,       -103,  -104,   -105,
                                  1e4f,   -1e4f, FLT_MAX, -FLT_MAX, INFINITY, -INFINITY, NAN};
  enum { SPECIAL = sizeof special / sizeof *special };
  if (i < SPECIAL) return special[i];
  return random_at(70, i, i % 3 == 0 ? 1 : i % 3 == 1 ? 20 : 110);
}

static void expect_near(const char *kind, const char *kernel, const char *what, double found, double expected,
                        double tolerance, double x) {
  if (fabs(found - expected) <= tolerance || (isnan(found) && isnan(expected))) return;
  fail_msg("%s %s %s(%.9g): %.9g, reference %.9g +- %.1e", kind, kernel, what, x, found, expected, tolerance);
}

static void test_activations(void **state) {
  (void)state;
  static const char *const name[] = {"density", "colour", "sigmoid", "softplus", "relu"};
  enum { MOST = 20000 };
  static const size_t counts[] = {1, 7, 8, 9, 15, 16, 17, 100, MOST};
  if (KERNELS == 1) skip(); /* built without instruction sets */
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    for (size_t c = 0; c < sizeof counts / sizeof *counts; c++) {
      for (ern_activation kind = ERN_ACT_DENSITY; kind <= ERN_ACT_RELU; kind++) {
        const size_t n = counts[c];
        struct guarded x = guarded_make(n), y[2] = {guarded_make(n), guarded_make(n)};
        struct guarded dx[2] = {guarded_make(n), guarded_make(n)};
        for (size_t i = 0; i < n; i++) {
          x.data[i] = act_input(n < 100 ? (i + 4 * c) % 25 : i);
          dx[0].data[i] = dx[1].data[i] = i % 2 ? 1 : -1.5f;
        }
        for (int with = 0; with < 2; with++) {
          const struct kernel *kernel = &kernels[with == 0 ? 0 : k];
          kernel->activate_fwd(y[with].data, x.data, kind, n);
          kernel->activate_bwd(dx[with].data, dx[with].data, x.data, kind, n); /* in place */
        }
        for (size_t i = 0; i < n; i++) {
          const double expected = y[0].data[i], slope = dx[0].data[i];
          if (isinf(expected) && y[1].data[i] == y[0].data[i]) continue;
          expect_near(name[kind], kernels[k].name, "y", y[1].data[i], expected, activation_tolerance(kind, expected),
                      x.data[i]);
          expect_near(name[kind], kernels[k].name, "dx", dx[1].data[i], slope, activation_tolerance(kind, slope),
                      x.data[i]);
        }
        for (int with = 0; with < 2; with++) {
          guarded_check(&y[with], 0, 0, 0, "y");
          guarded_check(&dx[with], 0, 0, 0, "dx");
          guarded_free(&y[with]);
          guarded_free(&dx[with]);
        }
        guarded_free(&x);
      }
    }
  }
}

/* The same input gives the same output wherever in a register it lies. */
static void test_place(void **state) {
  (void)state;
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    enum { N = 101 };
    float x[N], y[N];
    for (size_t i = 0; i < N; i++) x[i] = 1.2345f;
    kernels[k].activate_fwd(y, x, ERN_ACT_COLOUR, N);
    for (size_t i = 1; i < N; i++) assert_memory_equal(&y[i], &y[0], sizeof y[0]);
  }
}

struct activation_bench {
  const struct kernel *kernel;
  ern_activation kind;
  float x[4096], y[4096];
};

static void activation_run(void *user) {
  struct activation_bench *bench = user;
  bench->kernel->activate_fwd(bench->y, bench->x, bench->kind, sizeof bench->x / sizeof *bench->x);
}

static void measure_activations(void) {
  static struct activation_bench bench;
  const size_t n = sizeof bench.x / sizeof *bench.x;
  for (size_t i = 0; i < n; i++) bench.x[i] = random_at(1, i, 8);
  for (bench.kind = ERN_ACT_DENSITY; bench.kind <= ERN_ACT_RELU; bench.kind++) {
    double first = 0;
    for (size_t k = 0; k < KERNELS; k++) {
      if (!machine_has(kernels[k].isa)) continue;
      bench.kernel = &kernels[k];
      const double seconds = seconds_of(activation_run, &bench);
      if (k == 0) first = seconds;
      printf("activation %d %-6s: %7.1f million/s, %.1f times ref\n", (int)bench.kind, kernels[k].name,
             (double)n / seconds * 1e-6, first / seconds);
    }
  }
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) {
    measure_activations();
    return 0;
  }
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_activations),
      cmocka_unit_test(test_place),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
