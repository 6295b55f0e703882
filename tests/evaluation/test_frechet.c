/* SPDX-License-Identifier: MIT
 * The Frechet distance on sets whose distance is known, and against a computation by eigenvalues of other matrices. */
#include "../support.h"

#include <math.h>

#include "evaluation/frechet.h"

enum { MOST = 4096 };

static double random_of(uint64_t *state) { /* -1..1 */
  *state = *state * 6364136223846793005u + 1442695040888963407u;
  return (double)(*state >> 11) * 0x1p-52 - 1;
}

static void expect(double found, double expected, double apart) {
  if (!(fabs(found - expected) <= apart)) fail_msg("%.12g, expected %.12g to %g", found, expected, apart);
}

/* Rows +- s_j e_j: mean m, diagonal covariance s_j^2 2/(2 width - 1). */
static void fill_diagonal(double *x, size_t width, const double *s, const double *mean) {
  for (size_t i = 0; i < 2 * width; i++)
    for (size_t j = 0; j < width; j++) x[i * width + j] = mean[j] + (i / 2 == j ? (i % 2 != 0 ? s[j] : -s[j]) : 0);
}

/* sum (m - m')^2 + (sigma - sigma')^2; with more rows than columns. */
static void test_diagonal(void **state) {
  (void)state;
  static double a[MOST], b[MOST];
  const double s[2][5] = {{1, 2, 0.5, 3, 1e-3}, {4, 1, 0, 3, 2}}, mean[2][5] = {{1, 2, 3, 4, 5}, {1, 0, 3, 4, 7}};
  double expected = 0;
  for (size_t j = 0; j < 5; j++) expected += pow(mean[0][j] - mean[1][j], 2) + pow(s[0][j] - s[1][j], 2) * 2 / 9;
  fill_diagonal(a, 5, s[0], mean[0]);
  fill_diagonal(b, 5, s[1], mean[1]);
  expect(frechet_distance(a, b, 10, 5), expected, 1e-12);
}

/* Eigenvalues of a symmetric matrix by Jacobi's rotations, in place on the diagonal. */
static void eigenvalues(double *m, size_t n) {
  for (int sweep = 0; sweep < 60; sweep++)
    for (size_t p = 0; p < n; p++)
      for (size_t q = p + 1; q < n; q++) {
        if (fabs(m[p * n + q]) < 1e-300) continue;
        const double theta = 0.5 * atan2(2 * m[p * n + q], m[q * n + q] - m[p * n + p]), c = cos(theta), s = sin(theta);
        for (size_t k = 0; k < n; k++) {
          const double u = m[k * n + p], v = m[k * n + q];
          m[k * n + p] = c * u - s * v;
          m[k * n + q] = s * u + c * v;
        }
        for (size_t k = 0; k < n; k++) {
          const double u = m[p * n + k], v = m[q * n + k];
          m[p * n + k] = c * u - s * v;
          m[q * n + k] = s * u + c * v;
        }
      }
}

/* tr (C_a C_b)^(1/2) by the roots of the eigenvalues of (A B^T)^T (A B^T). */
static double by_eigenvalues(const double *a, const double *b, size_t count, size_t width) {
  static double centred[2][MOST], product[MOST], square[MOST];
  const double *const from[2] = {a, b};
  double distance = 0, mean[2][64] = {{0}};
  for (int t = 0; t < 2; t++) {
    for (size_t i = 0; i < count * width; i++) mean[t][i % width] += from[t][i] / (double)count;
    for (size_t i = 0; i < count * width; i++) {
      centred[t][i] = from[t][i] - mean[t][i % width];
      distance += centred[t][i] * centred[t][i] / (double)(count - 1);
    }
  }
  for (size_t j = 0; j < width; j++) distance += pow(mean[0][j] - mean[1][j], 2);
  for (size_t i = 0; i < count; i++)
    for (size_t j = 0; j < count; j++) {
      product[i * count + j] = 0;
      for (size_t k = 0; k < width; k++)
        product[i * count + j] += centred[0][i * width + k] * centred[1][j * width + k] / (double)(count - 1);
    }
  for (size_t i = 0; i < count; i++)
    for (size_t j = 0; j < count; j++) {
      square[i * count + j] = 0;
      for (size_t k = 0; k < count; k++) square[i * count + j] += product[k * count + i] * product[k * count + j];
    }
  eigenvalues(square, count);
  for (size_t i = 0; i < count; i++) distance -= 2 * sqrt(fmax(square[i * count + i], 0));
  return distance;
}

static void fill(double *x, size_t count, size_t width, double scale, uint64_t seed) {
  for (size_t i = 0; i < count * width; i++)
    x[i] = scale * random_of(&seed) * (double)(1 + i % width % 7) + (double)(i % width);
}

/* Fewer rows than columns, as many, more. */
static void test_random(void **state) {
  (void)state;
  static const size_t sizes[][2] = {{2, 40}, {12, 40}, {25, 25}, {40, 9}, {30, 1}};
  static double a[MOST], b[MOST];
  for (size_t k = 0; k < sizeof sizes / sizeof *sizes; k++) {
    const size_t count = sizes[k][0], width = sizes[k][1];
    fill(a, count, width, 1, 3 + k);
    fill(b, count, width, 1.7, 90 + k);
    const double expected = by_eigenvalues(a, b, count, width);
    assert_true(expected > 0.01);
    /* squares of singular values are exact to 1e-16 of the largest, of which roots are taken: 1e-8 a value */
    expect(frechet_distance(a, b, count, width), expected, 1e-8 * (double)count * expected + 1e-6);
  }
}

static void test_equal(void **state) {
  (void)state;
  static double a[MOST], b[MOST];
  fill(a, 20, 50, 1, 5);
  memcpy(b, a, sizeof a);
  expect(frechet_distance(a, b, 20, 50), 0, 1e-10);
  fill(a, 20, 50, 1, 5); /* the order of the rows does not count */
  for (size_t i = 0; i < 20; i++) memcpy(b + 50 * i, a + 50 * (19 - i), 50 * sizeof *a);
  expect(frechet_distance(a, b, 20, 50), 0, 1e-10);
  fill(a, 20, 50, 1, 5); /* a shift alone */
  for (size_t i = 0; i < 1000; i++) b[i] = a[i] + 2;
  expect(frechet_distance(a, b, 20, 50), 200, 1e-9);
  memset(a, 0, sizeof a); /* nothing moves */
  memset(b, 0, sizeof b);
  expect(frechet_distance(a, b, 20, 50), 0, 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_diagonal), cmocka_unit_test(test_random),
                                     cmocka_unit_test(test_equal)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
