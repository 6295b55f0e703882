/* SPDX-License-Identifier: MIT
 * Positional encodings: harmonics of directions, sines of positions. */
#include "harness.h"
#include "mlp/encoding_ops.h"

/* ---- directions ---- */

/* A device rounds products and sums one by one, in the reference's order: the same bits. Instruction sets: a polynomial
 * of unit vectors, whose terms are below 4, four products and two sums, rounded or fused. */
static const double fused = 6 * 4 * 0x1p-24;

static void test_harmonics(void **state) {
  (void)state;
  for (size_t s = 0; s < size_count(); s++) {
    const size_t n = test_sizes[s];
    static float d[3 * MOST_SIZE];
    fill_random(d, 3 * n, s, 1);
    for (size_t i = 0; i < n; i++) {
      const float length = sqrtf(d[i] * d[i] + d[n + i] * d[n + i] + d[2 * n + i] * d[2 * n + i]);
      for (size_t c = 0; c < 3; c++) d[c * n + i] = i % 7 == 3 ? (float)(i % 3 == c) : d[c * n + i] / length;
    }
    if (n > 20) d[5] = NAN, d[n + 6] = INFINITY, d[2 * n + 7] = -0.0f;
    const struct many_rows from = many_strided(d, 3, n, ERN_PER_RAY), y = many_strided(NULL, 16, n, ERN_PER_RAY);
    struct ern_sh_fwd_args args[MACHINES];
    EACH_MACHINE (k) args[k] = (struct ern_sh_fwd_args){y.on[k], from.on[k], n};
    RUN(sh_fwd, args);
    EACH_OTHER (k) {
      expect_near_on(k, "harmonics", of_rows(y), 0, is_device(k) ? 0 : fused);
    }
    machines_clear();
  }
}

/* Up to 11 terms of at most 5 products of sizes up to 30, rounded or fused, by value. */
static const double fused_gradients = 30 * 16 * 0x1p-24;

static void test_harmonics_bwd(void **state) {
  (void)state;
  for (size_t s = 0; s < size_count(); s++) {
    const size_t n = test_sizes[s];
    static float d[3 * MOST_SIZE], dy[16 * MOST_SIZE];
    fill_random(d, 3 * n, s, 0.57f);
    fill_random(dy, 16 * n, s + 100, 1);
    const struct many_rows from = many_strided(d, 3, n, ERN_PER_SAMPLE),
                           gradient = many_strided(dy, 16, n, ERN_PER_SAMPLE),
                           dd = many_strided(NULL, 3, n, ERN_PER_SAMPLE);
    struct ern_sh_bwd_args args[MACHINES];
    EACH_MACHINE (k) args[k] = (struct ern_sh_bwd_args){dd.on[k], gradient.on[k], from.on[k], n};
    RUN(sh_bwd, args);
    EACH_OTHER (k) expect_near_on(k, "gradients of harmonics", of_rows(dd), 0, fused_gradients);
    machines_clear();
  }
}

/* ---- sines ---- */

static float position(size_t i) {
  static const float odd[] = {0, -0.0f, NAN, INFINITY, -INFINITY, 1e-45f, 8.5f, -300, 1e5f, 1e30f, FLT_MAX};
  return i % 13 == 5 ? odd[i / 13 % 11] : random_at(3, i, i % 3 == 0 ? 0.03f : i % 3 == 1 ? 1 : 4);
}

/* Of the same argument. An instruction set: 2^-23 for its sine and 2^-24 for libm's. Of the gradient: as much for each
 * octave, times its factor, and the roundings of the sum. OpenCL's sine is within 4 units of 2^-23, libm's within 1, of
 * values up to 1. Of the gradient, with |dy| <= 1: two such errors, the roundings of two products, a difference and a
 * sum, for each octave times its factor. */
static void check_freq(size_t dims, int octaves, size_t n) {
  const size_t rows = dims * (1 + 2 * (size_t)octaves);
  float *x = floats(dims * n), *dy = floats(rows * n);
  for (size_t i = 0; i < dims * n; i++) x[i] = position(i);
  fill_random(dy, rows * n, 4, 1);
  const struct many_rows from = many_strided(x, (int)dims, n, ERN_PER_SAMPLE),
                         y = many_strided(NULL, (int)rows, n, ERN_PER_SAMPLE),
                         gradient = many_strided(dy, (int)rows, n, ERN_PER_SAMPLE);
  for (size_t i = 0; i < dims * n; i++) x[i] = random_at(5, i, 1);
  const struct many_rows dx = many_strided(x, (int)dims, n, ERN_PER_SAMPLE);
  struct ern_freq_fwd_args forward[MACHINES];
  struct ern_freq_bwd_args backward[MACHINES];
  EACH_MACHINE (k) {
    forward[k] = (struct ern_freq_fwd_args){y.on[k], from.on[k], octaves, n};
    backward[k] = (struct ern_freq_bwd_args){dx.on[k], gradient.on[k], from.on[k], octaves, n};
  }
  RUN(freq_fwd, forward);
  RUN(freq_bwd, backward);
  const double largest = ldexp(1, octaves);
  EACH_OTHER (k) {
    const bool device = is_device(k);
    expect_near_on(k, "sines", of_rows(y), 0, (device ? 5 : 1.5) * 0x1p-23);
    expect_near_on(k, "dx", of_rows(dx), 0, (device ? 28 : 4 + octaves) * largest * 0x1p-23);
    const float *found = floats_of(k, of_rows(y)), *expected = floats_of(0, of_rows(y));
    for (size_t i = 0; i < dims * y.on[k].stride; i++) /* the position itself */
      if (!same_bits(found[i], expected[i]))
        fail_msg("%s: position [%zu]: %.9g", machines.name[k], i, (double)found[i]);
  }
  machines_clear();
}

static void test_sines(void **state) {
  (void)state;
  static const struct {
    size_t dims;
    int octaves;
  } shapes[] = {{2, 8}, {6, 3}, {1, 10}, {3, 0}};
  enum { SHAPES = COUNT_OF(shapes) };
  for (size_t s = 0; s < size_count() * SHAPES; s++)
    check_freq(shapes[s % SHAPES].dims, shapes[s % SHAPES].octaves, test_sizes[s / SHAPES]);
}

/* No samples: nothing is written. */
static void test_nothing(void **state) {
  (void)state;
  const float x[4] = {1, 2, 3, 4};
  const struct many_rows from = many_strided(x, 3, 1, ERN_PER_SAMPLE), y = many_strided(NULL, 16, 1, ERN_PER_SAMPLE),
                         dx = many_strided(x, 3, 1, ERN_PER_SAMPLE);
  ON_EACH(sh_fwd, ern_sh_fwd_args, {y.on[k], from.on[k], 0})
  ON_EACH(freq_fwd, ern_freq_fwd_args, {y.on[k], from.on[k], 0, 0})
  ON_EACH(freq_bwd, ern_freq_bwd_args, {dx.on[k], y.on[k], from.on[k], 0, 0})
  expect_bits("y", of_rows(y));
  expect_bits("dx", of_rows(dx));
  machines_clear();
}

/* ---- the float reference against the double one ---- */

/* The double build, as mlp.h declares it there. */
void ern_sh_fwd_ref64(double *y, size_t y_stride, const double *d, size_t d_stride, size_t n);
void ern_freq_fwd_ref64(double *y, size_t y_stride, const double *x, size_t x_stride, int dims, int octaves, size_t n);
void ern_freq_bwd_ref64(double *dx, size_t dx_stride, const double *dy, size_t dy_stride, const double *x,
                        size_t x_stride, int dims, int octaves, size_t n);

static double *widened(const float *values, size_t count) {
  double *wide = held_memory(count, sizeof *wide);
  for (size_t i = 0; i < count; i++) wide[i] = (double)values[i];
  return wide;
}

static const size_t double_sizes[] = {1, 2, 7, 64, 301};
enum { DOUBLE_SIZES = COUNT_OF(double_sizes) };

/* Values up to 3; a degree-3 polynomial of rounded factors: 8 roundings of at most 2^-24 of its largest term, 6. */
static void test_harmonics_in_double(void **state) {
  (void)state;
  for (size_t s = 0; s < DOUBLE_SIZES; s++) {
    const size_t n = double_sizes[s], stride = n + 3, d_stride = n + 2;
    float *d = floats(3 * d_stride), *y = floats(16 * stride);
    for (size_t i = 0; i < n; i++) {
      float v[3], norm = 0;
      for (size_t k = 0; k < 3; k++) {
        v[k] = i < 6 ? (i % 3 == k ? (i < 3 ? 1.0f : -1.0f) : 0) : random_at(5, 3 * i + k, 1);
        norm += v[k] * v[k];
      }
      for (size_t k = 0; k < 3; k++) d[k * d_stride + i] = v[k] / sqrtf(norm);
    }
    double *wide_d = widened(d, 3 * d_stride), *wide_y = widened(y, 16 * stride);
    ern_sh_fwd_ref(y, stride, d, d_stride, n);
    ern_sh_fwd_ref64(wide_y, stride, wide_d, d_stride, n);
    for (size_t r = 0; r < 16; r++) {
      for (size_t i = 0; i < n; i++)
        assert_true(fabs((double)y[r * stride + i] - wide_y[r * stride + i]) <= 48 * 0x1p-24);
    }
    machines_clear();
  }
}

/* sin(2^o x + pi/2): the argument, up to 2^7 + 2, is rounded to half a unit in its last place. */
static void test_sines_in_double(void **state) {
  (void)state;
  enum { DIMS = 2, OCTAVES = 8, ROWS = DIMS * (1 + 2 * OCTAVES) };
  for (size_t s = 0; s < DOUBLE_SIZES; s++) {
    const size_t n = double_sizes[s], stride = n + 3, x_stride = n + 2;
    float *x = floats(DIMS * x_stride), *dx = floats(DIMS * x_stride);
    float *y = floats(ROWS * stride), *dy = floats(ROWS * stride);
    fill_random(x, DIMS * x_stride, 1, 1);
    fill_random(dx, DIMS * x_stride, 2, 1);
    fill_random(dy, ROWS * stride, 3, 1);
    double *wide_x = widened(x, DIMS * x_stride), *wide_dx = widened(dx, DIMS * x_stride);
    double *wide_y = widened(y, ROWS * stride), *wide_dy = widened(dy, ROWS * stride);
    ern_freq_fwd_ref(y, stride, x, x_stride, DIMS, OCTAVES, n);
    ern_freq_fwd_ref64(wide_y, stride, wide_x, x_stride, DIMS, OCTAVES, n);
    ern_freq_bwd_ref(dx, x_stride, dy, stride, x, x_stride, DIMS, OCTAVES, n);
    ern_freq_bwd_ref64(wide_dx, x_stride, wide_dy, stride, wide_x, x_stride, DIMS, OCTAVES, n);
    for (size_t i = 0; i < n; i++) {
      for (size_t r = 0; r < ROWS; r++) {
        const double argument = r < DIMS ? 0 : ldexp(1, (int)((r - DIMS) / (2 * DIMS))) + 2;
        assert_true(fabs((double)y[r * stride + i] - wide_y[r * stride + i]) <= (argument + 2) * 0x1p-24);
      }
      for (size_t d = 0; d < DIMS; d++) { /* sum of 17 terms, the largest 2^7 and its partial sums at most 2^9 */
        assert_true(fabs((double)dx[d * x_stride + i] - wide_dx[d * x_stride + i]) <= 17 * 0x1p9 * 0x1p-24);
      }
    }
    machines_clear();
  }
}

static void bench_of(size_t n) {
  float *values = floats(34 * n);
  fill_random(values, 34 * n, 1, 1);
  const struct many_rows d = many_strided(values, 3, n, ERN_PER_RAY), x = many_strided(values, 2, n, ERN_PER_SAMPLE),
                         y = many_strided(values, 34, n, ERN_PER_SAMPLE),
                         dx = many_strided(values, 2, n, ERN_PER_SAMPLE);
  struct ern_sh_fwd_args sh[MACHINES];
  struct ern_freq_fwd_args freq[MACHINES];
  struct ern_freq_bwd_args back[MACHINES];
  EACH_MACHINE (k) {
    sh[k] = (struct ern_sh_fwd_args){ern_rows_part(y.on[k], 0, 16), d.on[k], n};
    freq[k] = (struct ern_freq_fwd_args){y.on[k], x.on[k], 8, n};
    back[k] = (struct ern_freq_bwd_args){dx.on[k], y.on[k], x.on[k], 8, n};
  }
  printf("%zu samples\n", n);
  BENCH("harmonics of a direction", n, sh_fwd, sh);
  BENCH("8 octaves of 2 axes", n, freq_fwd, freq);
  BENCH("their gradient", n, freq_bwd, back);
  machines_clear();
}

static void bench(void) {
  bench_of(2048);
  bench_of(183000);
}

static const struct CMUnitTest tests[] = {cmocka_unit_test(test_harmonics),
                                          cmocka_unit_test(test_harmonics_bwd),
                                          cmocka_unit_test(test_sines),
                                          cmocka_unit_test(test_nothing),
                                          cmocka_unit_test(test_harmonics_in_double),
                                          cmocka_unit_test(test_sines_in_double)};
NOUN(encoding, bench, .isa = NULL)
