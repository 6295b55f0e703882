/* SPDX-License-Identifier: MIT */
#include "session/statistics.h"

#include <math.h>
#include <stdlib.h>

static int by_value(const void *left, const void *right) {
  const double a = *(const double *)left, b = *(const double *)right;
  return (a > b) - (a < b);
}

static double quantile(const double *sorted, size_t count, double share) {
  const double at = share * (double)(count - 1);
  const size_t below = (size_t)at;
  return below + 1 < count ? sorted[below] + (at - (double)below) * (sorted[below + 1] - sorted[below]) : sorted[below];
}

struct quartiles quartiles_of(double *readings, size_t count) {
  qsort(readings, count, sizeof *readings, by_value);
  return (struct quartiles){quantile(readings, count, 0.25), quantile(readings, count, 0.5),
                            quantile(readings, count, 0.75)};
}

struct mean_and_deviation mean_of(const double *values, size_t count) {
  struct mean_and_deviation found = {0, 0};
  for (size_t i = 0; i < count; i++) found.mean += values[i] / (double)count;
  for (size_t i = 0; i < count && count > 1; i++)
    found.deviation += pow(values[i] - found.mean, 2) / (double)(count - 1);
  found.deviation = sqrt(found.deviation);
  return found;
}
