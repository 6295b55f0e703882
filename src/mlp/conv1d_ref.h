/* SPDX-License-Identifier: MIT
 * 1D convolutions with kernel 3, padding 1 and bias, as the audio networks use them. */
#ifndef ERN_CONV1D_REF_H
#define ERN_CONV1D_REF_H

#include "core/types.h"

/* Input value (c, t) at c*channel + t*time; output and its gradient [out][ern_conv1d_length]; W [out][in][3]. */
struct ern_conv1d {
  int out, in;
  int length;           /* of the input, >= 1 */
  int stride;           /* 1 or 2 */
  size_t channel, time; /* strides of the input */
};

/* floor((length + 2 - 3)/stride) + 1 */
static inline int ern_conv1d_length(int length, int stride) { return (length - 1) / stride + 1; }

/* y[o][t] = b[o] + sum over c, k of W[o][c][k] x[c][t*stride + k - 1], zeros outside */
void ERN_REF(ern_conv1d_fwd)(ern_real *y, const ern_real *x, const ern_real *w, const ern_real *b,
                             const struct ern_conv1d *conv);

/* All gradients accumulate; dx has the layout of x, NULL: not wanted. */
void ERN_REF(ern_conv1d_bwd)(ern_real *dx, ern_real *dw, ern_real *db, const ern_real *dy, const ern_real *x,
                             const ern_real *w, const struct ern_conv1d *conv);

#endif
