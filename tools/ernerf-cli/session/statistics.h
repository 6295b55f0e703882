/* SPDX-License-Identifier: MIT
 * Quartiles, means and standard deviations of repeated measurements. */
#ifndef ERN_CLI_STATISTICS_H
#define ERN_CLI_STATISTICS_H

#include <stddef.h>

/* Quartiles of repeated readings, interpolated between neighbours (the median of an even number: the mean of two). */
struct quartiles {
  double low, median, high;
};
/* Sorts the readings; count >= 1. */
struct quartiles quartiles_of(double *readings, size_t count);

/* Mean and standard deviation (of a sample: over count - 1; 0 of one value). */
struct mean_and_deviation {
  double mean, deviation;
};
struct mean_and_deviation mean_of(const double *values, size_t count);

#endif
