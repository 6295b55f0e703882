/* SPDX-License-Identifier: MIT
 * Encodings of directions and coordinates. */
#ifndef ERN_ENCODING_OPS_H
#define ERN_ENCODING_OPS_H

#include "core/operations.h"
#include "core/types.h"

/* Real spherical harmonics of degrees 0..3 of unit directions; 16 rows. */
struct ern_sh_fwd_args {
  ern_rows y; /* out: [16], per ray or per sample as d is */
  ern_rows d; /* [3] */
  size_t n;
};
#define ERN_COST_sh_fwd(a) ern_cost("ray", (a)->n, 44, 19, 0, 0)
typedef void ern_sh_fwd_kernel(ern_real *y, size_t y_stride, const ern_real *d, size_t d_stride, size_t n);

/* Their gradient by each component of d, which need not have unit length. */
struct ern_sh_bwd_args {
  ern_rows dd; /* overwrites: [3] */
  ern_rows dy; /* [16] */
  ern_rows d;  /* [3] */
  size_t n;
};
#define ERN_COST_sh_bwd(a) ERN_COST_ELSEWHERE
typedef void ern_sh_bwd_kernel(ern_real *dd, size_t dd_stride, const ern_real *dy, size_t dy_stride, const ern_real *d,
                               size_t d_stride, size_t n);

/* Rows: x (dims), then for octave o = 0 .. octaves-1: sin(2^o x) (dims), sin(2^o x + pi/2) (dims). */
struct ern_freq_fwd_args {
  ern_rows y; /* out: [dims*(1 + 2*octaves)] */
  ern_rows x; /* [dims] */
  int octaves;
  size_t n;
};
#define ERN_COST_freq_fwd(a) \
  ern_cost("pixel", (a)->n, 4.0 * (a)->x.rows * (a)->octaves, (a)->x.rows * (2.0 + 2.0 * (a)->octaves), 0, 0)
struct ern_freq_bwd_args {
  ern_rows dx; /* accumulates */
  ern_rows dy, x;
  int octaves;
  size_t n;
};
#define ERN_COST_freq_bwd(a) ERN_COST_ELSEWHERE
typedef void ern_freq_fwd_kernel(ern_real *y, size_t y_stride, const ern_real *x, size_t x_stride, int dims,
                                 int octaves, size_t n);
typedef void ern_freq_bwd_kernel(ern_real *dx, size_t dx_stride, const ern_real *dy, size_t dy_stride,
                                 const ern_real *x, size_t x_stride, int dims, int octaves, size_t n);

ERN_DECLARE_KERNELS(ERN_ENCODING_OPERATIONS)

#endif
