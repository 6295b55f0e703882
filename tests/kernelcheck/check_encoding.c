/* SPDX-License-Identifier: MIT
 * The positional encodings of each instruction set against the reference. */
#include "kernelcheck.h"

#include <float.h>

#include "core/kernels.h"
#include "mlp/mlp_tile.h"

struct kernel {
  const char *name;
  machine_isa isa;
  ern_sh_fwd_kernel *sh_fwd;
  ern_freq_fwd_kernel *freq_fwd;
  ern_freq_bwd_kernel *freq_bwd;
};

static const struct kernel kernels[] = {
    {"ref", MACHINE_REF, ern_sh_fwd_ref, ern_freq_fwd_ref, ern_freq_bwd_ref},
#if defined(ERN_X86_KERNELS)
    {"avx2", MACHINE_AVX2, ern_sh_fwd_avx2, ern_freq_fwd_avx2, ern_freq_bwd_avx2},
    {"avx512", MACHINE_AVX512, ern_sh_fwd_avx512, ern_freq_fwd_avx512, ern_freq_bwd_avx512},
#elif defined(ERN_ARM_KERNELS)
    {"neon", MACHINE_NEON, ern_sh_fwd_neon, ern_freq_fwd_neon, ern_freq_bwd_neon},
#endif
};
enum { KERNELS = sizeof kernels / sizeof *kernels };

static const size_t sizes[] = {1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 33, 100, 1000};
enum { SIZES = sizeof sizes / sizeof *sizes };

static void expect_close(const char *kernel, const char *what, size_t at, float found, float expected,
                         double tolerance) {
  if (fabs((double)found - (double)expected) <= tolerance || found == expected) return;
  if (isnan(found) && isnan(expected) && is_poison(found) == is_poison(expected)) return;
  fail_msg("%s %s [%zu]: %.9g, reference %.9g +- %.1e", kernel, what, at, found, expected, tolerance);
}

/* A polynomial of unit vectors: its terms are below 4, four products and two sums, rounded or fused. */
static void test_harmonics(void **state) {
  (void)state;
  if (KERNELS == 1) skip(); /* built without instruction sets */
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) {
      print_message("%s: not on this machine\n", kernels[k].name);
      continue;
    }
    for (size_t s = 0; s < SIZES; s++) {
      const size_t n = sizes[s], stride = n + 3;
      struct guarded d = guarded_make(3 * stride), y[2];
      random_rows(&d, 3, stride, n, 1, s);
      for (size_t i = 0; i < n; i++) {
        const float length = sqrtf(d.data[i] * d.data[i] + d.data[stride + i] * d.data[stride + i] +
                                   d.data[2 * stride + i] * d.data[2 * stride + i]);
        for (size_t c = 0; c < 3; c++)
          d.data[c * stride + i] = i % 7 == 3 ? (float)(i % 3 == c) : d.data[c * stride + i] / length;
      }
      for (int with = 0; with < 2; with++) {
        y[with] = guarded_make(16 * (stride + 1));
        (with == 0 ? &kernels[0] : &kernels[k])->sh_fwd(y[with].data, stride + 1, d.data, stride, n);
      }
      for (size_t i = 0; i < y[0].count; i++)
        expect_close(kernels[k].name, "harmonic", i, y[1].data[i], y[0].data[i], 6 * 4 * 0x1p-24);
      guarded_check(&y[1], 16, stride + 1, n, "harmonics");
      guarded_free(&d);
      for (int with = 0; with < 2; with++) guarded_free(&y[with]);
    }
  }
}

static float position(size_t i) {
  static const float odd[] = {0, -0.0f, NAN, INFINITY, -INFINITY, 1e-45f, 8.5f, -300, 1e5f, 1e30f, FLT_MAX};
  return i % 13 == 5 ? odd[i / 13 % 11] : random_at(3, i, i % 2 ? 1 : 4);
}

/* Of the same argument: 2^-23 for the sine of this side and 2^-24 for libm's. Of the gradient: as much for each octave,
 * times its factor, and the roundings of the sum. */
static void check_freq(const struct kernel *kernel, size_t dims, size_t octaves, size_t n) {
  const size_t rows = dims * (1 + 2 * octaves), xs = n + 1, ys = n + 4;
  struct guarded x = guarded_make(dims * xs), dy = guarded_make(rows * ys), y[2], dx[2];
  for (size_t d = 0; d < dims; d++) {
    for (size_t i = 0; i < n; i++) x.data[d * xs + i] = position(i * (d + 1));
  }
  random_rows(&dy, rows, ys, n, 1, 4);
  for (int with = 0; with < 2; with++) {
    const struct kernel *use = with == 0 ? &kernels[0] : kernel;
    y[with] = guarded_make(rows * ys);
    dx[with] = guarded_make(dims * xs);
    random_rows(&dx[with], dims, xs, n, 1, 5);
    use->freq_fwd(y[with].data, ys, x.data, xs, (int)dims, (int)octaves, n);
    use->freq_bwd(dx[with].data, xs, dy.data, ys, x.data, xs, (int)dims, (int)octaves, n);
  }
  for (size_t row = 0; row < rows; row++) {
    for (size_t i = 0; i < n; i++) {
      const size_t at = row * ys + i;
      if (row < dims && !isnan(y[0].data[at])) assert_true(y[0].data[at] == y[1].data[at]);
      expect_close(kernel->name, "sine", at, y[1].data[at], y[0].data[at], 1.5 * 0x1p-23);
    }
  }
  const double largest = ldexp(1, (int)octaves);
  for (size_t d = 0; d < dims; d++) {
    for (size_t i = 0; i < n; i++)
      expect_close(kernel->name, "dx", d * xs + i, dx[1].data[d * xs + i], dx[0].data[d * xs + i],
                   (double)(4 + octaves) * largest * 0x1p-23);
  }
  guarded_check(&y[1], rows, ys, n, "sines");
  guarded_check(&dx[1], dims, xs, n, "dx");
  guarded_free(&x);
  guarded_free(&dy);
  for (int with = 0; with < 2; with++) {
    guarded_free(&y[with]);
    guarded_free(&dx[with]);
  }
}

static const struct { size_t dims, octaves; } shapes[] = {{2, 8}, {6, 3}, {1, 10}, {3, 0}};
enum { SHAPES = sizeof shapes / sizeof *shapes };

static void test_sines(void **state) {
  (void)state;
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    for (size_t s = 0; s < SIZES * SHAPES; s++)
      check_freq(&kernels[k], shapes[s % SHAPES].dims, shapes[s % SHAPES].octaves, sizes[s / SHAPES]);
  }
}

/* ---- measure ---- */

struct bench {
  const struct kernel *kernel;
  int what;
  struct guarded x, y, dx;
};
enum { N = 2048 };

static void bench_run(void *user) {
  struct bench *b = user;
  switch (b->what) {
    case 0: b->kernel->sh_fwd(b->y.data, N, b->x.data, N, N); break;
    case 1: b->kernel->freq_fwd(b->y.data, N, b->x.data, N, 2, 8, N); break;
    default: b->kernel->freq_bwd(b->dx.data, N, b->y.data, N, b->x.data, N, 2, 8, N); break;
  }
}

static void measure(void) {
  static const char *const name[] = {"harmonics of a direction", "8 octaves of 2 axes", "their gradient"};
  struct bench bench = {.x = guarded_make(3 * N), .y = guarded_make(40 * N), .dx = guarded_make(3 * N)};
  random_rows(&bench.x, 3, N, N, 1, 1);
  random_rows(&bench.y, 40, N, N, 1, 2);
  random_rows(&bench.dx, 3, N, N, 1, 2);
  for (bench.what = 0; bench.what < 3; bench.what++) {
    double first = 0;
    for (size_t k = 0; k < KERNELS; k++) {
      if (!machine_has(kernels[k].isa)) continue;
      bench.kernel = &kernels[k];
      const double seconds = seconds_of(bench_run, &bench);
      if (k == 0) first = seconds;
      printf("%-24s %-6s: %7.2f ns each, %.1f times ref\n", name[bench.what], kernels[k].name, seconds * 1e9 / N,
             first / seconds);
    }
  }
  guarded_free(&bench.x);
  guarded_free(&bench.y);
  guarded_free(&bench.dx);
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) {
    measure();
    return 0;
  }
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_harmonics),
      cmocka_unit_test(test_sines),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
