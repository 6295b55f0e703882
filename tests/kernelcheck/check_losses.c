/* SPDX-License-Identifier: MIT
 * The losses of each instruction set against the reference in double; points and differences to the bit. */
#include "kernelcheck.h"

#include <float.h>

#include "core/kernels.h"

struct kernel {
  const char *name;
  machine_isa isa;
  ern_head_softmax_kernel *head_softmax;
  ern_head_loss_kernel *head_loss;
  ern_smooth_loss_kernel *smooth_loss;
  ern_smooth_points_kernel *smooth_points;
  ern_mse_kernel *mse;
};
#define KERNEL(isa, machine)                                                                                    \
  {                                                                                                             \
#isa, machine, ern_head_softmax_##isa, ern_head_loss_##isa, ern_smooth_loss_##isa, ern_smooth_points_##isa, \
        ern_mse_##isa                                                                                           \
  }

static const struct kernel kernels[] = {
    KERNEL(ref, MACHINE_REF),
#if defined(ERN_X86_KERNELS)
    KERNEL(avx2, MACHINE_AVX2),
    KERNEL(avx512, MACHINE_AVX512),
#elif defined(ERN_ARM_KERNELS)
    KERNEL(neon, MACHINE_NEON),
#endif
};
enum { KERNELS = sizeof kernels / sizeof *kernels };

static const size_t sizes[] = {1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 33, 100, 1000};
enum { SIZES = sizeof sizes / sizeof *sizes, STEPS = 16 };

/* ---- a batch of rays ---- */

enum { PIXEL, TRUTH = 3, OPACITY = 6, ATTENTION, EYE, UNCERTAINTY, FACE, IN_ROWS };
enum { DPIXEL, DOPACITY = 3, DATTENTION, DEYE, DUNCERTAINTY, OUT_ROWS };

struct batch {
  size_t n, stride;
  struct ern_loss_weights weights;
  struct guarded in, out;
};

/* Uncertainties as a softplus leaves them, from nothing to 3e38; opacities at both ends and just inside. */
static struct batch batch_make(size_t n, bool adaptive, bool extreme, uint64_t seed) {
  static const float opacities[] = {0, 1, 1e-5f, 1 - 1e-5f, 9e-6f, 0.9999999f, -1e-3f, 1.0001f};
  static const float uncertainties[] = {0, 1e-45f, 1e-38f, 1e-8f, 88, 1e4f, 1e20f, 3e38f};
  struct batch b = {.n = n, .stride = n + 5, .weights = {0.4f, 1, 1e-3f, 1e-4f, 1e-4f, 1e-4f, 1e-5f, adaptive}};
  b.in = guarded_make(IN_ROWS * b.stride);
  b.out = guarded_make(OUT_ROWS * b.stride);
  for (size_t row = 0; row < IN_ROWS; row++) {
    for (size_t r = 0; r < n; r++) {
      const struct ern_random random = ern_random_at(seed, row, (uint32_t)r, ERN_RNG_INIT);
      const uint32_t pick = random.word[1] % 8;
      float *to = &b.in.data[row * b.stride + r];
      *to = ern_uniform(random.word[0]);
      if (row == FACE) *to = random.word[0] % 3 == 0;
      if (row == ATTENTION || row == UNCERTAINTY) *to *= 4;
      if (extreme && row == OPACITY) *to = opacities[pick];
      if (extreme && row == UNCERTAINTY && random.word[2] % 2) *to = uncertainties[pick];
      if (extreme && row < TRUTH && pick == 0) *to = b.in.data[row * b.stride + r] = 0;
    }
  }
  return b;
}

static void batch_free(struct batch *b) {
  guarded_free(&b->in);
  guarded_free(&b->out);
}

static struct ern_head_loss_view view_of(const struct batch *b, bool eye, size_t from) {
  const float *const in = b->in.data + from;
  float *const out = b->out.data + from;
  const size_t s = b->stride;
  struct ern_head_loss_view v = {out + DPIXEL * s,
                                 out + DOPACITY * s,
                                 out + DATTENTION * s,
                                 out + DEYE * s,
                                 out + DUNCERTAINTY * s,
                                 in + PIXEL * s,
                                 in + TRUTH * s,
                                 in + OPACITY * s,
                                 in + ATTENTION * s,
                                 in + EYE * s,
                                 in + UNCERTAINTY * s,
                                 in + FACE * s,
                                 s};
  if (!eye) v.eye = NULL, v.deye = NULL;
  return v;
}

/* ---- the same in double, with what a value is the sum of, without signs ---- */

struct exact {
  double out[OUT_ROWS], size[OUT_ROWS], term[ERN_LOSS_EYE_AMBIENT + 1];
};

static struct exact exact_of(const struct batch *b, size_t r, double most, double sum, bool eye) {
  const struct ern_loss_weights *w = &b->weights;
  const double n = (double)b->n, s = (double)w->s;
  double in[IN_ROWS], squares = 0;
  struct exact e = {.out = {0}};
  for (size_t row = 0; row < IN_ROWS; row++) in[row] = (double)b->in.data[row * b->stride + r];
  const double u = in[UNCERTAINTY], face = in[FACE], beta = u + 1;
  double weight = 1;
  if (w->adaptive) weight = 0.2 + 0.8 * fmin(fmax((1 - s) + s * n * exp(u - most) / sum, 0), 10);
  for (size_t c = 0; c < 3; c++) {
    const double difference =
        (double)(b->in.data[(PIXEL + c) * b->stride + r] - b->in.data[(TRUTH + c) * b->stride + r]);
    squares += difference * difference;
    e.out[DPIXEL + c] = 2 / n / 3 * weight * difference;
    e.size[DPIXEL + c] = fabs(e.out[DPIXEL + c]);
  }
  const double error = sqrt(squares), log_part = log1p(u) / beta, error_part = error / (beta * beta * beta);
  const double by_unc = (double)w->uncertainty * s / n, by_out = (double)w->static_uncertainty * s / n;
  e.out[DUNCERTAINTY] = by_unc * face * (log_part - error_part) + by_out * (1 - face);
  e.size[DUNCERTAINTY] = by_unc * face * (log_part + error_part) + by_out * (1 - face);
  const float low = 1e-5f, high = 1 - low, opacity = b->in.data[OPACITY * b->stride + r];
  const float held = opacity < low ? low : opacity > high ? high : opacity, rest = 1 - held;
  const double own = log2((double)held), other = log2((double)rest);
  if (opacity >= low && opacity <= high) e.out[DOPACITY] = (double)w->entropy / n * (other - own);
  e.size[DOPACITY] = (double)w->entropy / n * (fabs(own) + fabs(other));
  e.out[DATTENTION] = e.size[DATTENTION] = (double)w->audio_ambient * s / n * (1 - face);
  e.out[DEYE] = e.size[DEYE] = eye ? (double)w->eye_ambient * s / n / STEPS * in[ATTENTION] * face : 0;
  e.term[ERN_LOSS_PHOTOMETRIC] = weight * squares / 3 / n;
  e.term[ERN_LOSS_UNCERTAINTY] = by_unc * face * (error / (beta * beta) / 2 + log1p(u) * log1p(u) / 2);
  e.term[ERN_LOSS_STATIC_UNCERTAINTY] = by_out * u * (1 - face);
  e.term[ERN_LOSS_ENTROPY] = (double)w->entropy / n * (-(double)held * own - (double)rest * other);
  e.term[ERN_LOSS_AUDIO_AMBIENT] = (double)w->audio_ambient * s / n * in[ATTENTION] * (1 - face);
  e.term[ERN_LOSS_EYE_AMBIENT] = eye ? e.out[DEYE] * in[EYE] : 0;
  return e;
}

/* Units of 2^-23 of the sum of the terms' sizes. The longest chain: an exponential or logarithm 2.5, the quotient and
 * its square 1.5, products and sums 0.5 each, less than 12. The softmax has more: u - most is rounded, half a unit of
 * its size, which is an error of as many units of the exponential. In the sum of the exponentials these sizes count by
 * share, so that their mean is below log(n) + 1. */
static const double units = 16, sum_units = 8;

/* 110: beyond, the exponential is 0. */
static double share_units(const struct batch *b, size_t r, double most) {
  return b->weights.adaptive ? fmin(fabs((double)b->in.data[UNCERTAINTY * b->stride + r] - most), 110) : 0;
}

static void expect_close(const char *kernel, const char *what, size_t at, double found, double expected,
                         double tolerance) {
  if (fabs(found - expected) <= tolerance + 2 * (double)FLT_MIN) return;
  fail_msg("%s %s [%zu]: %.9g, in double %.12g +- %.1e", kernel, what, at, found, expected, tolerance);
}

/* In parts of different lengths, as the pool would have them. */
static void check_head(const struct kernel *kernel, size_t n, bool adaptive, bool extreme) {
  struct batch b = batch_make(n, adaptive, extreme, n);
  const bool eye = n % 2 == 0;
  double terms[ERN_LOSS_TERMS] = {0}, expected[ERN_LOSS_TERMS] = {0}, most = -INFINITY, sum = 0, worst = 0;
  const float *const u = b.in.data + UNCERTAINTY * b.stride;
  for (size_t r = 0; r < n; r++) {
    if ((double)u[r] > most) most = (double)u[r];
  }
  for (size_t r = 0; r < n; r++) sum += exp((double)u[r] - most);
  const struct ern_softmax softmax = kernel->head_softmax(u, n);
  assert_true((double)softmax.most == most);
  expect_close(kernel->name, "softmax", 0, softmax.sum, sum, (2 + sum_units) * 0x1p-23 * sum);
  for (size_t begin = 0, end; begin < n; begin = end) {
    double part[ERN_LOSS_TERMS];
    end = begin + (n - begin + 1) / 2;
    const struct ern_head_loss_view view = view_of(&b, eye, begin);
    kernel->head_loss(part, &view, &b.weights, STEPS, &softmax, n, end - begin);
    for (int t = 0; t <= ERN_LOSS_EYE_AMBIENT; t++) terms[t] += part[t];
  }
  for (size_t r = 0; r < n; r++) {
    const struct exact e = exact_of(&b, r, most, sum, eye);
    const double of_share = share_units(&b, r, most) + sum_units;
    if (of_share > worst) worst = of_share;
    for (size_t row = 0; row < OUT_ROWS; row++) {
      const double allowed = units + (row < DOPACITY && adaptive ? of_share : 0);
      if (row == DEYE && !eye) continue;
      expect_close(kernel->name, "gradient", row * b.stride + r, (double)b.out.data[row * b.stride + r], e.out[row],
                   allowed * 0x1p-23 * e.size[row]);
    }
    for (int t = 0; t <= ERN_LOSS_EYE_AMBIENT; t++) expected[t] += e.term[t];
  }
  for (int t = 0; t <= ERN_LOSS_EYE_AMBIENT; t++) {
    const double allowed = units + (t == ERN_LOSS_PHOTOMETRIC && adaptive ? worst : 0);
    expect_close(kernel->name, "term", (size_t)t, terms[t], expected[t], allowed * 0x1p-23 * expected[t]);
  }
  if (!eye) {
    for (size_t r = 0; r < n; r++) assert_true(is_poison(b.out.data[DEYE * b.stride + r]));
  }
  guarded_check(&b.out, OUT_ROWS, b.stride, n, "gradients");
  batch_free(&b);
}

static void test_head(void **state) {
  (void)state;
  for (size_t k = 0; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    for (size_t n = 0; n < SIZES; n++) {
      for (int kind = 0; kind < 4; kind++) check_head(&kernels[k], sizes[n], kind % 2 == 0, kind >= 2);
    }
  }
}

/* Whatever is no number in the reference is none here, and nothing else. No rays: no terms. */
static void test_head_broken(void **state) {
  (void)state;
  static const float odd[] = {NAN, INFINITY, -INFINITY, -1, -3, 1e38f};
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    for (size_t row = 0; row < IN_ROWS; row++) {
      struct batch b[2];
      double terms[2][ERN_LOSS_TERMS] = {{0}};
      for (int with = 0; with < 2; with++) {
        const struct kernel *kernel = with == 0 ? &kernels[0] : &kernels[k];
        b[with] = batch_make(37, row % 2 == 0, false, 5);
        for (size_t i = 0; i < 6; i++) b[with].in.data[row * b[with].stride + 5 * i] = odd[i];
        const struct ern_head_loss_view view = view_of(&b[with], true, 0);
        const struct ern_softmax softmax = kernel->head_softmax(view.uncertainty, 37);
        kernel->head_loss(terms[with], &view, &b[with].weights, STEPS, &softmax, 37, 37);
      }
      for (size_t i = 0; i < b[0].out.count; i++)
        if (isfinite(b[0].out.data[i]) != isfinite(b[1].out.data[i]))
          fail_msg("%s [%zu] of odd input %zu: %g, reference %g", kernels[k].name, i, row, b[1].out.data[i],
                   b[0].out.data[i]);
      for (int t = 0; t <= ERN_LOSS_EYE_AMBIENT; t++) assert_true(isfinite(terms[0][t]) == isfinite(terms[1][t]));
      for (int with = 0; with < 2; with++) batch_free(&b[with]);
    }
    struct batch none = batch_make(8, true, false, 1);
    const struct ern_head_loss_view view = view_of(&none, true, 0);
    const struct ern_softmax softmax = kernels[k].head_softmax(view.uncertainty, 0);
    double terms[ERN_LOSS_TERMS] = {1, 1, 1, 1, 1, 1};
    assert_true(softmax.sum == 0 && softmax.most == -INFINITY);
    kernels[k].head_loss(terms, &view, &none.weights, STEPS, &softmax, 0, 0);
    for (int t = 0; t <= ERN_LOSS_EYE_AMBIENT; t++) assert_true(terms[t] == 0);
    for (size_t i = 0; i < none.out.count; i++) assert_true(is_poison(none.out.data[i]));
    batch_free(&none);
  }
}

/* Gradients to the bit. The sums are of the same doubles in another order: n roundings of 2^-53 at most. */
static void test_differences(void **state) {
  (void)state;
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    for (size_t s = 0; s < SIZES; s++) {
      const size_t n = sizes[s], stride = n + 3;
      struct guarded a = guarded_make(3 * stride), b = guarded_make(3 * stride), d[2];
      double mse[2], smooth[2];
      random_rows(&a, 3, stride, n, 1, 1);
      random_rows(&b, 3, stride, n, 1, 2);
      a.data[0] = 1e30f;
      if (n > 2) a.data[2] = NAN;
      for (int with = 0; with < 2; with++) {
        const struct kernel *kernel = with == 0 ? &kernels[0] : &kernels[k];
        d[with] = guarded_make(3 * stride);
        mse[with] = kernel->mse(d[with].data, a.data, b.data, stride, n + 4, n);
      }
      for (size_t i = 0; i < a.count; i++)
        assert_true(memcmp(&d[0].data[i], &d[1].data[i], 4) == 0 || isnan(d[0].data[i]));
      guarded_check(&d[1], 3, stride, n, "dpixel");
      assert_true((isnan(mse[0]) && isnan(mse[1])) || fabs(mse[0] - mse[1]) <= (double)n * 0x1p-52 * mse[0]);
      for (int with = 0; with < 2; with++) {
        const struct kernel *kernel = with == 0 ? &kernels[0] : &kernels[k];
        poison(d[with].data, d[with].count);
        smooth[with] = kernel->smooth_loss(d[with].data, a.data + stride, b.data + stride, 0.3f, n + 9, n);
        assert_true(kernel->smooth_loss(NULL, NULL, NULL, 1, 0, 0) == 0);
        assert_true(kernel->mse(NULL, NULL, NULL, 0, 0, 0) == 0);
      }
      assert_memory_equal(d[0].data, d[1].data, d[0].count * sizeof(float));
      assert_true(fabs(smooth[0] - smooth[1]) <= (double)n * 0x1p-52 * smooth[0]);
      guarded_free(&a);
      guarded_free(&b);
      for (int with = 0; with < 2; with++) guarded_free(&d[with]);
    }
  }
}

static void test_points(void **state) {
  (void)state;
  static const uint64_t seeds[] = {0, 1, 0xffffffffffffffffu, 0x123456789abcdef0u};
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    for (size_t s = 0; s < SIZES; s++) {
      const size_t n = sizes[s], stride = n + 3;
      struct guarded x = guarded_make(3 * stride), moved[2];
      random_rows(&x, 3, stride, n, 1, 1);
      for (int with = 0; with < 2; with++) {
        moved[with] = guarded_make(3 * stride);
        (with == 0 ? &kernels[0] : &kernels[k])
            ->smooth_points(moved[with].data, x.data, stride, 1e-3f, seeds[s % 4], seeds[(s / 4) % 4] + s, s * 1000 + 5,
                            n);
      }
      assert_memory_equal(moved[0].data, moved[1].data, moved[0].count * sizeof(float));
      guarded_check(&moved[1], 3, stride, n, "moved");
      guarded_free(&x);
      for (int with = 0; with < 2; with++) guarded_free(&moved[with]);
    }
  }
}

/* ---- measure ---- */

struct bench {
  const struct kernel *kernel;
  struct batch batch;
  int what;
  double sink;
};

static void bench_run(void *user) {
  struct bench *bench = user;
  const struct batch *b = &bench->batch;
  const size_t n = b->n, s = b->stride;
  const float *const in = b->in.data;
  float *const out = b->out.data;
  const struct ern_head_loss_view view = view_of(b, true, 0);
  double terms[ERN_LOSS_TERMS];
  switch (bench->what) {
    case 0: {
      const struct ern_softmax softmax = bench->kernel->head_softmax(view.uncertainty, n);
      bench->kernel->head_loss(terms, &view, &b->weights, STEPS, &softmax, n, n);
      break;
    }
    case 1: bench->sink += bench->kernel->mse(out, in, in + TRUTH * s, s, n, n); break;
    case 2: bench->sink += bench->kernel->smooth_loss(out, in, in + s, 1, n, n); break;
    default: bench->kernel->smooth_points(out, in, s, 1e-3f, 1, 2, 0, n); break;
  }
}

static void measure(void) {
  static const char *const name[] = {"softmax and head_loss", "mse", "smooth_loss", "smooth_points"};
  struct bench bench = {.batch = batch_make(4096, true, false, 1)};
  for (bench.what = 0; bench.what < 4; bench.what++) {
    double first = 0;
    for (size_t k = 0; k < KERNELS; k++) {
      if (!machine_has(kernels[k].isa)) continue;
      bench.kernel = &kernels[k];
      const double seconds = seconds_of(bench_run, &bench);
      if (k == 0) first = seconds;
      printf("%-21s %-6s: %7.2f ns each, %.1f times ref\n", name[bench.what], kernels[k].name,
             seconds * 1e9 / (double)bench.batch.n, first / seconds);
    }
  }
  batch_free(&bench.batch);
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) {
    measure();
    return 0;
  }
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_head),
      cmocka_unit_test(test_head_broken),
      cmocka_unit_test(test_differences),
      cmocka_unit_test(test_points),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
