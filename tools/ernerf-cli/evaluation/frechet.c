/* SPDX-License-Identifier: MIT */
#include "evaluation/frechet.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* A matrix [rows][columns]. */
struct matrix {
  double *at;
  size_t rows, columns;
};

/* Householder reflection I - f u u^T that maps v to (*head, 0, ...): replaces v by u, returns f. */
static double reflection(double *v, size_t n, double *head) {
  double square = 0;
  for (size_t i = 0; i < n; i++) square += v[i] * v[i];
  *head = -copysign(sqrt(square), v[0]);
  v[0] -= *head;
  const double norm = 2 * (square + fabs(*head) * (fabs(v[0]) - fabs(*head)));
  return norm > DBL_MIN ? 2 / norm : 0;
}

/* Reflects the rows from k on, so that column k is 0 below row k. Returns its value in row k. */
static double reflect_rows(struct matrix m, size_t k, double *v, double *sums) {
  const size_t n = m.rows - k;
  double head;
  for (size_t i = 0; i < n; i++) v[i] = m.at[(k + i) * m.columns + k];
  const double f = reflection(v, n, &head);
  memset(sums, 0, m.columns * sizeof *sums);
  for (size_t i = 0; i < n; i++)
    for (size_t j = k; j < m.columns; j++) sums[j] += v[i] * m.at[(k + i) * m.columns + j];
  for (size_t i = 0; i < n; i++)
    for (size_t j = k; j < m.columns; j++) m.at[(k + i) * m.columns + j] -= f * v[i] * sums[j];
  return head;
}

/* The same for row k and the columns from k + 1 on. */
static double reflect_columns(struct matrix m, size_t k, double *v) {
  const size_t n = m.columns - k - 1;
  double head;
  memcpy(v, m.at + k * m.columns + k + 1, n * sizeof *v);
  const double f = reflection(v, n, &head);
  for (size_t i = k; i < m.rows; i++) {
    double *row = m.at + i * m.columns + k + 1, sum = 0;
    for (size_t j = 0; j < n; j++) sum += row[j] * v[j];
    for (size_t j = 0; j < n; j++) row[j] -= f * sum * v[j];
  }
  return head;
}

/* Sturm count: number of eigenvalues below x of the symmetric tridiagonal matrix with diagonal 0 and off-diagonal
 * off[count]. */
static size_t count_under(const double *off, size_t count, double x) {
  double pivot = -x;
  size_t under = pivot < 0;
  for (size_t i = 0; i < count; i++) {
    if (fabs(pivot) < DBL_MIN) pivot = -DBL_MIN;
    pivot = -x - off[i] / pivot * off[i];
    under += pivot < 0;
  }
  return under;
}

/* Sum of the singular values of a square matrix, which is overwritten: reflections make it bidiagonal (Golub and Kahan,
 * 1965); its singular values are then the positive eigenvalues of a tridiagonal matrix, found by bisection. */
static double nuclear_norm(struct matrix m, double *off, double *v, double *sums) {
  const size_t n = m.rows, count = 2 * n - 1;
  double most = 0, sum = 0;
  for (size_t k = 0; k < n; k++) {
    off[2 * k] = reflect_rows(m, k, v, sums);
    if (k + 1 < n) off[2 * k + 1] = reflect_columns(m, k, v);
  }
  for (size_t i = 0; i < count; i++) most = fmax(most, fabs(off[i]) + (i > 0 ? fabs(off[i - 1]) : 0));
  most *= 1 + 1e-10;
  for (size_t k = 0; k < n; k++) { /* the value with k others above or equal to it */
    double low = 0, high = most;
    while (high - low > 1e-15 * most) {
      const double middle = 0.5 * (low + high);
      if (middle <= low || middle >= high) break;
      if (2 * n - count_under(off, count, middle) > k)
        low = middle;
      else
        high = middle;
    }
    sum += 0.5 * (low + high);
  }
  return sum;
}

/* Subtracts the mean, which goes to mean[width], and divides by sqrt(rows - 1). Returns the sum of the squares. */
static double centre(struct matrix m, double *mean) {
  double trace = 0;
  memset(mean, 0, m.columns * sizeof *mean);
  for (size_t i = 0; i < m.rows * m.columns; i++) mean[i % m.columns] += m.at[i] / (double)m.rows;
  for (size_t i = 0; i < m.rows * m.columns; i++) {
    m.at[i] = (m.at[i] - mean[i % m.columns]) / sqrt((double)(m.rows - 1));
    trace += m.at[i] * m.at[i];
  }
  return trace;
}

/* Reduces the matrix to at most as many rows as columns with the same covariance: R of its QR decomposition. */
static struct matrix shorten(struct matrix m, double *v, double *sums) {
  if (m.rows <= m.columns) return m;
  for (size_t k = 0; k < m.columns; k++) {
    m.at[k * m.columns + k] = reflect_rows(m, k, v, sums);
    for (size_t i = k + 1; i < m.rows; i++) m.at[i * m.columns + k] = 0;
  }
  return (struct matrix){m.at, m.columns, m.columns};
}

double frechet_distance(double *a, double *b, size_t count, size_t width) {
  const size_t rows = count < width ? count : width, longest = count > width ? count : width;
  double *memory = malloc((rows * rows + 2 * rows + 3 * longest) * sizeof *memory), distance = 0;
  if (memory == NULL) return NAN;
  double *off = memory + rows * rows, *v = off + 2 * rows, *mean = v + longest, *other = mean + longest;
  struct matrix first = {a, count, width}, second = {b, count, width}, product = {memory, rows, rows};
  distance += centre(first, mean) + centre(second, other);
  for (size_t j = 0; j < width; j++) distance += (mean[j] - other[j]) * (mean[j] - other[j]);
  first = shorten(first, v, mean);
  second = shorten(second, v, mean);
  for (size_t i = 0; i < rows; i++)
    for (size_t j = 0; j < rows; j++) {
      double sum = 0;
      for (size_t k = 0; k < width; k++) sum += a[i * width + k] * b[j * width + k];
      product.at[i * rows + j] = sum;
    }
  distance -= 2 * nuclear_norm(product, off, v, mean);
  free(memory);
  return fmax(distance, 0); /* rounding may make it negative for equal sets */
}
