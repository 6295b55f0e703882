/* SPDX-License-Identifier: MIT
 * Ridge regression of the corrections of the training poses on the poses. */
#include "model/pose_regression.h"

#include <math.h>
#include <string.h>

enum { N = ERN_POSE_NUMBERS, SLOPE = 1, LEAST = SLOPE + N, MOST }; /* rows of a fit */

static const double most_number = 1e30; /* so that it fits into a float */

/* Three numbers of the rotation relative to a camera that looks straight into the face, and the negated position of the
 * scene's origin in the camera's axes: R^T o. */
static void numbers_of(double x[N], const float pose[16]) {
  double turn[3][3];
  for (int r = 0; r < 3; r++) { /* R R_0^T; the columns of R_0 are the scene's z, -x and -y */
    turn[r][0] = -(double)pose[4 * r + 1];
    turn[r][1] = -(double)pose[4 * r + 2];
    turn[r][2] = (double)pose[4 * r];
  }
  for (int r = 0; r < 3; r++) {
    x[r] = (turn[(r + 2) % 3][(r + 1) % 3] - turn[(r + 1) % 3][(r + 2) % 3]) / 2;
    x[3 + r] = 0;
    for (int i = 0; i < 3; i++) x[3 + r] += (double)pose[4 * i + r] * (double)pose[4 * i + 3];
  }
  for (int k = 0; k < N; k++) x[k] = fmax(-most_number, fmin(most_number, x[k]));
}

/* Means and standard deviations of the numbers; the deviation is 0 for a number that hardly changes. */
static void measure(float least[N], float most[N], double mean[N], double deviation[N], const float *pose, size_t n) {
  double x[N], square[N] = {0};
  memset(mean, 0, N * sizeof *mean);
  for (size_t i = 0; i < n; i++) {
    numbers_of(x, pose + 16 * i);
    for (int k = 0; k < N; k++) {
      mean[k] += x[k] / (double)n;
      if (i == 0 || (float)x[k] < least[k]) least[k] = (float)x[k];
      if (i == 0 || (float)x[k] > most[k]) most[k] = (float)x[k];
    }
  }
  for (size_t i = 0; i < n; i++) {
    numbers_of(x, pose + 16 * i);
    for (int k = 0; k < N; k++) square[k] += (x[k] - mean[k]) * (x[k] - mean[k]) / (double)n;
  }
  for (int k = 0; k < N; k++) deviation[k] = square[k] > 1e-10 * (1 + mean[k] * mean[k]) ? sqrt(square[k]) : 0;
}

/* Solves a x = b for symmetric positive definite a (Cholesky), each column of b [N][columns]; b becomes x. */
static void solve(double a[N][N], double b[N][ERN_POSE_MOST_VALUES], size_t columns) {
  for (int c = 0; c < N; c++)
    for (int r = c; r < N; r++) {
      for (int k = 0; k < c; k++) a[r][c] -= a[r][k] * a[c][k];
      a[r][c] = r == c ? sqrt(a[r][c]) : a[r][c] / a[c][c];
    }
  for (size_t column = 0; column < columns; column++) {
    for (int r = 0; r < N; r++) {
      for (int k = 0; k < r; k++) b[r][column] -= a[r][k] * b[k][column];
      b[r][column] /= a[r][r];
    }
    for (int r = N - 1; r >= 0; r--) {
      for (int k = r + 1; k < N; k++) b[r][column] -= a[k][r] * b[k][column];
      b[r][column] /= a[r][r];
    }
  }
}

void ern_pose_regression_fit(float *fit, size_t values, const float *pose, const float *value, size_t n, double ridge) {
  double mean[N], deviation[N], middle[ERN_POSE_MOST_VALUES] = {0}, a[N][N] = {{0}}, b[N][ERN_POSE_MOST_VALUES] = {{0}};
  double x[N];
  memset(fit, 0, ERN_POSE_REGRESSION_ROWS * values * sizeof *fit);
  if (n == 0) return;
  measure(fit + (LEAST * values), fit + (MOST * values), mean, deviation, pose, n);
  for (size_t i = 0; i < values * n; i++) middle[i % values] += (double)value[i] / (double)n;
  for (size_t i = 0; i < n; i++) {
    numbers_of(x, pose + 16 * i);
    for (int k = 0; k < N; k++) x[k] = deviation[k] > 0 ? (x[k] - mean[k]) / deviation[k] : 0;
    for (int r = 0; r < N; r++) {
      for (int c = 0; c < N; c++) a[r][c] += x[r] * x[c] / (double)n;
      for (size_t c = 0; c < values; c++) b[r][c] += x[r] * ((double)value[values * i + c] - middle[c]) / (double)n;
    }
  }
  for (int k = 0; k < N; k++) a[k][k] += ridge;
  solve(a, b, values);
  for (size_t c = 0; c < values; c++) {
    double constant = middle[c];
    for (size_t k = 0; k < N; k++) {
      const double slope = deviation[k] > 0 ? b[k][c] / deviation[k] : 0;
      fit[(SLOPE + k) * values + c] = (float)slope;
      constant -= slope * mean[k];
    }
    fit[c] = (float)constant;
  }
}

void ern_pose_regression_predict(const float *fit, size_t values, const float pose[16], double *value) {
  const float *least = fit + LEAST * values, *most = fit + MOST * values;
  double x[N];
  numbers_of(x, pose);
  for (size_t c = 0; c < values; c++) value[c] = (double)fit[c];
  for (size_t k = 0; k < N; k++) {
    const double inside = fmax((double)least[k], fmin((double)most[k], x[k]));
    for (size_t c = 0; c < values; c++) value[c] += inside * (double)fit[(SLOPE + k) * values + c];
  }
  for (size_t c = 0; c < values; c++) value[c] = fmax(-most_number, fmin(most_number, value[c]));
}
