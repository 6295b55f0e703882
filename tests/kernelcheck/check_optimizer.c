/* SPDX-License-Identifier: MIT
 * AdamW, the moving average and the test for finite values of each instruction set against the reference: they round as
 * it does, so nothing but the same bits is accepted. */
#include "kernelcheck.h"

#include <float.h>

#include "core/kernels.h"

struct kernel {
  const char *name;
  machine_isa isa;
  ern_adamw_kernel *adamw;
  ern_ema_kernel *ema;
  ern_finite_kernel *finite;
};

static const struct kernel kernels[] = {
    {"ref", MACHINE_REF, ern_adamw_ref, ern_ema_ref, ern_finite_ref},
#if defined(ERN_X86_KERNELS)
    {"avx2", MACHINE_AVX2, ern_adamw_avx2, ern_ema_avx2, ern_finite_avx2},
    {"avx512", MACHINE_AVX512, ern_adamw_avx512, ern_ema_avx512, ern_finite_avx512},
#elif defined(ERN_ARM_KERNELS)
    {"neon", MACHINE_NEON, ern_adamw_neon, ern_ema_neon, ern_finite_neon},
#endif
};
enum { KERNELS = sizeof kernels / sizeof *kernels };

static const size_t sizes[] = {0, 1, 3, 4, 5, 7, 8, 9, 15, 16, 17, 33, 63, 64, 65, 127, 128, 129, 5000};
enum { SIZES = sizeof sizes / sizeof *sizes };

static const float odd[] = {0,     -0.0f,   1e-45f,   -1e-40f,  FLT_MIN,   1e-20f, 1e18f,
                            1e20f, FLT_MAX, -FLT_MAX, INFINITY, -INFINITY, NAN,    1};
enum { ODD = sizeof odd / sizeof *odd };

static float value_of(uint64_t seed, size_t i) {
  const struct ern_random random = ern_random_at(seed, 0, (uint32_t)i, ERN_RNG_INIT);
  if (random.word[1] % 4 == 0) return odd[random.word[0] % ODD];
  return (ern_uniform(random.word[0]) * 2 - 1) * powf(10, (float)(random.word[2] % 9) - 6);
}

static struct guarded values_of(uint64_t seed, size_t n, bool positive) {
  struct guarded values = guarded_make(n);
  for (size_t i = 0; i < n; i++) values.data[i] = positive ? fabsf(value_of(seed, i)) : value_of(seed, i);
  return values;
}

/* Same bits, or both no number. */
static void expect_same(const char *kernel, const char *what, const struct guarded *found,
                        const struct guarded *expected) {
  for (size_t i = 0; i < found->count; i++) {
    if (memcmp(&found->data[i], &expected->data[i], sizeof(float)) == 0) continue;
    if (isnan(found->data[i]) && isnan(expected->data[i]) && !is_poison(found->data[i])) continue;
    fail_msg("%s %s [%zu]: %.9g, reference %.9g", kernel, what, i, found->data[i], expected->data[i]);
  }
  guarded_check(found, 1, found->count, found->count, what);
}

static void check_adamw(const struct kernel *kernel, size_t n) {
  struct guarded p[2], v[2], g = values_of(3, n, false);
  for (int with = 0; with < 2; with++) {
    p[with] = values_of(1, n, false);
    v[with] = values_of(2, n, true);
    const struct kernel *use = with == 0 ? &kernels[0] : kernel;
    for (int step = 1; step <= 3; step++)
      use->adamw(p[with].data, v[with].data, g.data, 5e-3f / (float)step, 0.01f, 0.99f, 1e-8f, 1 - pow(0.99, step), n);
  }
  expect_same(kernel->name, "parameters", &p[1], &p[0]);
  expect_same(kernel->name, "second moment", &v[1], &v[0]);
  guarded_free(&g);
  for (int with = 0; with < 2; with++) {
    guarded_free(&p[with]);
    guarded_free(&v[with]);
  }
}

/* Second moments and squares of gradients all around the smallest normal number, and far below it. */
static void test_denormal(void **state) {
  (void)state;
  enum { N = 20000 };
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    struct guarded p[2], v[2], g = guarded_make(N);
    for (size_t i = 0; i < N; i++) {
      const struct ern_random random = ern_random_at(9, 0, (uint32_t)i, ERN_RNG_INIT);
      const float sign = random.word[0] % 2 ? 1.0f : -1.0f, spread = ern_uniform(random.word[1]);
      g.data[i] = random.word[2] % 3 == 0 ? 0 : sign * powf(10, -16 - 8 * spread);
      if (random.word[2] % 1000 == 1) g.data[i] = sign * powf(10, -30 - 15 * spread);
      if (random.word[2] % 1000 == 4) g.data[i] = odd[random.word[0] % ODD];
    }
    for (int with = 0; with < 2; with++) {
      p[with] = values_of(1, N, false);
      v[with] = guarded_make(N);
      for (size_t i = 0; i < N; i++) {
        const struct ern_random random = ern_random_at(10, 0, (uint32_t)i, ERN_RNG_INIT);
        v[with].data[i] = random.word[0] % 5 == 0 ? 0 : powf(10, -36 - 9 * ern_uniform(random.word[1]));
        if (random.word[2] % 1000 == 1) v[with].data[i] = fabsf(odd[random.word[0] % ODD]);
        if (random.word[2] % 1000 == 2) v[with].data[i] = -1e-40f;
      }
      for (int step = 1; step <= 20; step++)
        (with == 0 ? &kernels[0] : &kernels[k])
            ->adamw(p[with].data, v[with].data, g.data, 5e-3f, 0.01f, step % 2 ? 0.99f : 0.999f,
                    step % 3 ? 1e-8f : 1e-15f, 1 - pow(0.99, step), N);
    }
    expect_same(kernels[k].name, "parameters", &p[1], &p[0]);
    expect_same(kernels[k].name, "second moment", &v[1], &v[0]);
    guarded_free(&g);
    for (int with = 0; with < 2; with++) {
      guarded_free(&p[with]);
      guarded_free(&v[with]);
    }
  }
}

static void check_ema(const struct kernel *kernel, size_t n) {
  struct guarded average[2], p = values_of(4, n, false);
  for (int with = 0; with < 2; with++) {
    average[with] = values_of(5, n, false);
    (with == 0 ? &kernels[0] : kernel)->ema(average[with].data, p.data, 0.95f, n);
  }
  expect_same(kernel->name, "average", &average[1], &average[0]);
  guarded_free(&p);
  for (int with = 0; with < 2; with++) guarded_free(&average[with]);
}

static void test_updates(void **state) {
  (void)state;
  if (KERNELS == 1) skip(); /* built without instruction sets */
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) {
      print_message("%s: not on this machine\n", kernels[k].name);
      continue;
    }
    for (size_t n = 0; n < SIZES; n++) {
      check_adamw(&kernels[k], sizes[n]);
      check_ema(&kernels[k], sizes[n]);
    }
  }
}

/* One value that is not finite anywhere among finite ones, the largest of them too; what lies behind does not count. */
static void test_finite(void **state) {
  (void)state;
  static const float bad[] = {NAN, INFINITY, -INFINITY};
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    for (size_t s = 0; s < SIZES; s++) {
      const size_t n = sizes[s];
      struct guarded values = guarded_make(n); /* a NaN before and behind it */
      for (size_t i = 0; i < n; i++) {
        values.data[i] = i % 5 == 0 ? FLT_MAX : i % 5 == 1 ? -FLT_MAX : i % 5 == 2 ? 1e-45f : value_of(6, i);
        if (!isfinite(values.data[i])) values.data[i] = 0;
      }
      assert_true(kernels[k].finite(values.data, n));
      for (size_t i = 0; i<n; i += n> 1000 ? 37 : 1) {
        const float was = values.data[i];
        values.data[i] = bad[i % 3];
        assert_false(kernels[k].finite(values.data, n));
        assert_true(kernels[k].finite(values.data, i));
        values.data[i] = was;
      }
      guarded_free(&values);
    }
  }
}

/* ---- measure: the parameters of a head, against as many bytes copied ---- */

enum { PARAMETERS = 655360 };

struct bench {
  const struct kernel *kernel;
  struct guarded p, v, g, low, none;
  int what;
  bool sink;
};

static void bench_run(void *user) {
  struct bench *b = user;
  switch (b->what) {
    case 0: b->kernel->adamw(b->p.data, b->v.data, b->g.data, 1e-3f, 0, 0.99f, 1e-8f, 0.5, PARAMETERS); break;
    case 1: b->kernel->ema(b->v.data, b->g.data, 0.95f, PARAMETERS); break;
    case 2:
      memcpy(b->v.data, b->low.data, PARAMETERS * sizeof(float));
      b->kernel->adamw(b->p.data, b->v.data, b->none.data, 1e-3f, 0, 0.99f, 1e-8f, 0.5, PARAMETERS);
      break;
    default: b->sink |= b->kernel->finite(b->g.data, PARAMETERS); break;
  }
}

/* As many bytes as AdamW reads and writes, 5 streams: two copies and a half. */
static void copy_run(void *user) {
  const struct bench *b = user;
  memcpy(b->p.data, b->g.data, PARAMETERS * sizeof(float));
  memcpy(b->v.data, b->g.data, PARAMETERS * sizeof(float));
  memcpy(b->p.data, b->v.data, PARAMETERS / 2 * sizeof(float));
}

static void measure(void) {
  static const char *const name[] = {"adamw", "ema", "adamw of denormal moments", "finite"};
  struct bench bench = {.p = guarded_make(PARAMETERS),
                        .v = guarded_make(PARAMETERS),
                        .g = guarded_make(PARAMETERS),
                        .low = guarded_make(PARAMETERS),
                        .none = guarded_make(PARAMETERS)};
  for (size_t i = 0; i < PARAMETERS; i++) {
    bench.p.data[i] = random_at(1, i, 1);
    bench.v.data[i] = fabsf(random_at(2, i, 1));
    bench.g.data[i] = random_at(3, i, 1e-3f);
    bench.low.data[i] = 1e-42f;
    bench.none.data[i] = 0;
  }
  for (bench.what = 0; bench.what < 4; bench.what++) {
    double first = 0;
    for (size_t k = 0; k < KERNELS; k++) {
      if (!machine_has(kernels[k].isa)) continue;
      bench.kernel = &kernels[k];
      const double seconds = seconds_of(bench_run, &bench);
      if (k == 0) first = seconds;
      printf("%-25s, %d parameters %-6s: %6.3f ms, %.3f ns each, %.1f times ref\n", name[bench.what], PARAMETERS,
             kernels[k].name, seconds * 1e3, seconds * 1e9 / PARAMETERS, first / seconds);
    }
  }
  printf("copying the bytes that adamw reads and writes: %6.3f ms\n", seconds_of(copy_run, &bench) * 1e3);
  guarded_free(&bench.p);
  guarded_free(&bench.v);
  guarded_free(&bench.g);
  guarded_free(&bench.low);
  guarded_free(&bench.none);
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) {
    measure();
    return 0;
  }
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_updates),
      cmocka_unit_test(test_denormal),
      cmocka_unit_test(test_finite),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
