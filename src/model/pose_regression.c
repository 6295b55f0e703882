/* SPDX-License-Identifier: MIT
 * Ridge regression of the corrections of the training poses on the poses. */
#include "model/pose_regression.h"

#include <math.h>
#include <string.h>

enum { N = ERN_POSE_NUMBERS };
_Static_assert(sizeof(struct ern_pose_regression) == ERN_POSE_REGRESSION_ROWS * N * sizeof(float), "a tensor");

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
static void measure(struct ern_pose_regression *fit, double mean[N], double deviation[N], const float *pose, size_t n) {
  double x[N], square[N] = {0};
  memset(mean, 0, N * sizeof *mean);
  for (size_t i = 0; i < n; i++) {
    numbers_of(x, pose + 16 * i);
    for (int k = 0; k < N; k++) {
      mean[k] += x[k] / (double)n;
      if (i == 0 || (float)x[k] < fit->least[k]) fit->least[k] = (float)x[k];
      if (i == 0 || (float)x[k] > fit->most[k]) fit->most[k] = (float)x[k];
    }
  }
  for (size_t i = 0; i < n; i++) {
    numbers_of(x, pose + 16 * i);
    for (int k = 0; k < N; k++) square[k] += (x[k] - mean[k]) * (x[k] - mean[k]) / (double)n;
  }
  for (int k = 0; k < N; k++) deviation[k] = square[k] > 1e-10 * (1 + mean[k] * mean[k]) ? sqrt(square[k]) : 0;
}

/* Solves a x = b for symmetric positive definite a (Cholesky), each column of b; b becomes x. */
static void solve(double a[N][N], double b[N][N]) {
  for (int c = 0; c < N; c++)
    for (int r = c; r < N; r++) {
      for (int k = 0; k < c; k++) a[r][c] -= a[r][k] * a[c][k];
      a[r][c] = r == c ? sqrt(a[r][c]) : a[r][c] / a[c][c];
    }
  for (int column = 0; column < N; column++) {
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

void ern_pose_regression_fit(struct ern_pose_regression *fit, const float *pose, const float *correction, size_t n,
                             double ridge) {
  double mean[N], deviation[N], middle[N] = {0}, a[N][N] = {{0}}, b[N][N] = {{0}}, x[N];
  memset(fit, 0, sizeof *fit);
  if (n == 0) return;
  measure(fit, mean, deviation, pose, n);
  for (size_t i = 0; i < N * n; i++) middle[i % N] += (double)correction[i] / (double)n;
  for (size_t i = 0; i < n; i++) {
    numbers_of(x, pose + 16 * i);
    for (int k = 0; k < N; k++) x[k] = deviation[k] > 0 ? (x[k] - mean[k]) / deviation[k] : 0;
    for (int r = 0; r < N; r++)
      for (int c = 0; c < N; c++) {
        a[r][c] += x[r] * x[c] / (double)n;
        b[r][c] += x[r] * ((double)correction[N * i + (size_t)c] - middle[c]) / (double)n;
      }
  }
  for (int k = 0; k < N; k++) a[k][k] += ridge;
  solve(a, b);
  for (int c = 0; c < N; c++) {
    double constant = middle[c];
    for (int k = 0; k < N; k++) {
      const double slope = deviation[k] > 0 ? b[k][c] / deviation[k] : 0;
      fit->slope[k][c] = (float)slope;
      constant -= slope * mean[k];
    }
    fit->constant[c] = (float)constant;
  }
}

void ern_pose_regression_predict(const struct ern_pose_regression *fit, const float pose[16], double correction[N]) {
  double x[N];
  numbers_of(x, pose);
  for (int c = 0; c < N; c++) correction[c] = (double)fit->constant[c];
  for (int k = 0; k < N; k++) {
    const double inside = fmax((double)fit->least[k], fmin((double)fit->most[k], x[k]));
    for (int c = 0; c < N; c++) correction[c] += inside * (double)fit->slope[k][c];
  }
  for (int c = 0; c < N; c++) correction[c] = fmax(-most_number, fmin(most_number, correction[c]));
}
