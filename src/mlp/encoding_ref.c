/* SPDX-License-Identifier: MIT
 * Reference of the positional encodings: spherical harmonics of directions, sines of positions. */
#include <tgmath.h>

#include "mlp/encoding_ops.h"

/* Factors of the spherical harmonics. */
static const ern_real c00 = (ern_real)0.28209479177387814; /* 1/2 sqrt(1/pi) */
static const ern_real c1 = (ern_real)0.48860251190291992;  /* 1/2 sqrt(3/pi) */
static const ern_real c2 = (ern_real)1.0925484305920792;   /* 1/2 sqrt(15/pi) */
static const ern_real c20 = (ern_real)0.31539156525252005; /* 1/4 sqrt(5/pi) */
static const ern_real c33 = (ern_real)0.59004358992664352; /* 1/4 sqrt(35/(2 pi)) */
static const ern_real c32 = (ern_real)2.8906114426405538;  /* 1/2 sqrt(105/pi) */
static const ern_real c31 = (ern_real)0.45704579946446572; /* 1/4 sqrt(21/(2 pi)) */
static const ern_real c30 = (ern_real)0.37317633259011546; /* 1/4 sqrt(7/pi) */

/* Real spherical harmonics Y_l^m, degrees 0..3, of the unit vector (x, y, z), in the order (0,0), (1,-1), (1,0), (1,1),
 * (2,-2) ..; sign (-1)^m, as NeRF codes have it. */
void ERN_REF(ern_sh_fwd)(ern_real *y, size_t y_stride, const ern_real *d, size_t d_stride, size_t n) {
  for (size_t i = 0; i < n; i++) {
    const ern_real x = d[i], v = d[d_stride + i], z = d[2 * d_stride + i];
    const ern_real value[16] = {
        c00,
        -c1 * v,
        c1 * z,
        -c1 * x,
        c2 * x * v,
        -c2 * v * z,
        c20 * (3 * z * z - 1),
        -c2 * x * z,
        c2 / 2 * (x * x - v * v),
        c33 * v * (v * v - 3 * x * x),
        c32 * x * v * z,
        c31 * v * (1 - 5 * z * z),
        c30 * z * (5 * z * z - 3),
        c31 * x * (1 - 5 * z * z),
        c32 / 2 * z * (x * x - v * v),
        c33 * x * (3 * v * v - x * x),
    };
    for (size_t c = 0; c < 16; c++) y[c * y_stride + i] = value[c];
  }
}

/* dd_k = sum over c of dy_c dY_c/dd_k, of the polynomials above */
void ERN_REF(ern_sh_bwd)(ern_real *dd, size_t dd_stride, const ern_real *dy, size_t dy_stride, const ern_real *d,
                         size_t d_stride, size_t n) {
  for (size_t i = 0; i < n; i++) {
    const ern_real x = d[i], v = d[d_stride + i], z = d[2 * d_stride + i];
    ern_real g[16];
    for (size_t c = 0; c < 16; c++) g[c] = dy[c * dy_stride + i];
    dd[i] = -c1 * g[3] + c2 * (v * g[4] - z * g[7] + x * g[8]) - 6 * c33 * x * v * g[9] + c32 * v * z * g[10] +
            c31 * (1 - 5 * z * z) * g[13] + c32 * x * z * g[14] + 3 * c33 * (v * v - x * x) * g[15];
    dd[dd_stride + i] = -c1 * g[1] + c2 * (x * g[4] - z * g[5] - v * g[8]) + 3 * c33 * (v * v - x * x) * g[9] +
                        c32 * x * z * g[10] + c31 * (1 - 5 * z * z) * g[11] - c32 * v * z * g[14] +
                        6 * c33 * x * v * g[15];
    dd[2 * dd_stride + i] = c1 * g[2] - c2 * (v * g[5] + x * g[7]) + 6 * c20 * z * g[6] + c32 * x * v * g[10] -
                            10 * c31 * z * (v * g[11] + x * g[13]) + c30 * (15 * z * z - 3) * g[12] +
                            c32 / 2 * (x * x - v * v) * g[14];
  }
}

static const double half_pi = 1.57079632679489661923;

/* x, then for each octave o: sin(2^o x), sin(2^o x + pi/2) */
void ERN_REF(ern_freq_fwd)(ern_real *y, size_t y_stride, const ern_real *x, size_t x_stride, int dims, int octaves,
                           size_t n) {
  for (size_t d = 0; d < (size_t)dims; d++) {
    const ern_real *from = x + d * x_stride;
    for (size_t i = 0; i < n; i++) y[d * y_stride + i] = from[i];
    for (int o = 0; o < octaves; o++) {
      const size_t row = (size_t)dims * (1 + 2 * (size_t)o) + d;
      const ern_real factor = (ern_real)ldexp(1.0, o);
      ern_real *sine = y + row * y_stride, *cosine = sine + (size_t)dims * y_stride;
      for (size_t i = 0; i < n; i++) {
        sine[i] = sin(factor * from[i]);
        cosine[i] = sin(factor * from[i] + (ern_real)half_pi);
      }
    }
  }
}

/* dx += dy_0 + sum_o 2^o (cos(2^o x) dy_sin - sin(2^o x) dy_cos) */
void ERN_REF(ern_freq_bwd)(ern_real *dx, size_t dx_stride, const ern_real *dy, size_t dy_stride, const ern_real *x,
                           size_t x_stride, int dims, int octaves, size_t n) {
  for (size_t d = 0; d < (size_t)dims; d++) {
    const ern_real *from = x + d * x_stride;
    ern_real *to = dx + d * dx_stride;
    for (size_t i = 0; i < n; i++) to[i] += dy[d * dy_stride + i];
    for (int o = 0; o < octaves; o++) {
      const size_t row = (size_t)dims * (1 + 2 * (size_t)o) + d;
      const ern_real factor = (ern_real)ldexp(1.0, o);
      const ern_real *dsine = dy + row * dy_stride, *dcosine = dsine + (size_t)dims * dy_stride;
      for (size_t i = 0; i < n; i++) {
        to[i] += factor * (cos(factor * from[i]) * dsine[i] - sin(factor * from[i]) * dcosine[i]);
      }
    }
  }
}
