/* SPDX-License-Identifier: MIT
 * Ridge regression: min |A w - b|^2 + lambda n |w|^2, with inputs normalised to mean 0 and standard deviation 1. */
#ifndef ERN_TESTS_RIDGE_H
#define ERN_TESTS_RIDGE_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

struct ridge;
/* x [n][inputs], y [n]; NULL: no solution. */
struct ridge *ridge_fit(const float *x, const double *y, size_t n, size_t inputs, double lambda);
double ridge_value(const struct ridge *ridge, const float *x);
/* weights [inputs]: what an input as it is counts; ridge_value is their sum and a constant. */
void ridge_weights(const struct ridge *ridge, double *weights);
void ridge_free(struct ridge *ridge);

#ifdef __cplusplus
}
#endif

#endif
