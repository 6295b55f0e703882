/* SPDX-License-Identifier: MIT
 * The Frechet distance of two sets of features (Dowson and Landau, 1982), as FID takes it. */
#ifndef ERN_CLI_FRECHET_H
#define ERN_CLI_FRECHET_H

#include <stddef.h>

/* |mu_a - mu_b|^2 + tr(C_a + C_b - 2 (C_a C_b)^(1/2)) of a[count][width] and b[count][width], which are overwritten; mu
 * are the means of the rows, C their covariances over count - 1. At least 2 rows. The last term is the sum of the
 * singular values of A B^T, where A and B are the centred rows over sqrt(count - 1). This avoids the square root of a
 * rank-deficient matrix if there are fewer rows than columns. NaN without memory. */
double frechet_distance(double *a, double *b, size_t count, size_t width);

#endif
