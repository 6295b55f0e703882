/* SPDX-License-Identifier: MIT
 * Encodings of directions and coordinates. A group works on one row (samples.cl). */

/* ---- directions ---- */

/* Factors of the spherical harmonics. */
constant float c00 = 0.28209479177387814f; /* 1/2 sqrt(1/pi) */
constant float c1 = 0.48860251190291992f;  /* 1/2 sqrt(3/pi) */
constant float c2 = 1.0925484305920792f;   /* 1/2 sqrt(15/pi) */
constant float c20 = 0.31539156525252005f; /* 1/4 sqrt(5/pi) */
constant float c33 = 0.59004358992664352f; /* 1/4 sqrt(35/(2 pi)) */
constant float c32 = 2.8906114426405538f;  /* 1/2 sqrt(105/pi) */
constant float c31 = 0.45704579946446572f; /* 1/4 sqrt(21/(2 pi)) */
constant float c30 = 0.37317633259011546f; /* 1/4 sqrt(7/pi) */

/* Real spherical harmonics Y_l^m, degrees 0..3, of the unit vector d = (x, v, z), in the order (0,0), (1,-1), (1,0),
 * (1,1), (2,-2) ..; sign (-1)^m, as in other NeRF programs. */
KERNEL sh_fwd(ROWS(float, y), ROWS(const float, d), ulong n) {
  OPEN(float, y);
  OPEN(const float, d);
  EACH_SAMPLE(i, get_group_id(0)) {
    const floatw x = loadw_first(d + i, n - i), v = loadw_first(d + d_stride + i, n - i),
               z = loadw_first(d + 2 * d_stride + i, n - i);
    const floatw value[16] = {
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
    for (uint c = 0; c < 16; c++) storew_first(y + c * y_stride + i, value[c], n - i);
  }
}

/* dd_k = sum over c of dy_c dY_c/dd_k */
KERNEL sh_bwd(ROWS(float, dd), ROWS(const float, dy), ROWS(const float, d), ulong n) {
  OPEN(float, dd);
  OPEN(const float, dy);
  OPEN(const float, d);
  EACH_SAMPLE(i, get_group_id(0)) {
    const floatw x = loadw_first(d + i, n - i), v = loadw_first(d + d_stride + i, n - i),
                 z = loadw_first(d + 2 * d_stride + i, n - i);
    floatw g[16];
    for (uint c = 0; c < 16; c++) g[c] = loadw_first(dy + c * dy_stride + i, n - i);
    const floatw in_x = -c1 * g[3] + c2 * (v * g[4] - z * g[7] + x * g[8]) - 6 * c33 * x * v * g[9] +
                        c32 * v * z * g[10] + c31 * (1 - 5 * z * z) * g[13] + c32 * x * z * g[14] +
                        3 * c33 * (v * v - x * x) * g[15];
    const floatw in_v = -c1 * g[1] + c2 * (x * g[4] - z * g[5] - v * g[8]) + 3 * c33 * (v * v - x * x) * g[9] +
                        c32 * x * z * g[10] + c31 * (1 - 5 * z * z) * g[11] - c32 * v * z * g[14] +
                        6 * c33 * x * v * g[15];
    const floatw in_z = c1 * g[2] - c2 * (v * g[5] + x * g[7]) + 6 * c20 * z * g[6] + c32 * x * v * g[10] -
                        10 * c31 * z * (v * g[11] + x * g[13]) + c30 * (15 * z * z - 3) * g[12] +
                        c32 / 2 * (x * x - v * v) * g[14];
    storew_first(dd + i, in_x, n - i);
    storew_first(dd + dd_stride + i, in_v, n - i);
    storew_first(dd + 2 * dd_stride + i, in_z, n - i);
  }
}

/* ---- sines of positions ---- */

#define HALF_PI 1.57079632679489661923f

/* Near 0 the Taylor series is used, accurate to 2^-28. Where one lane of a vector is huge, SLEEF, which PoCL uses for
 * sine and cosine, applies the range reduction of huge values to all lanes, and is wrong by up to 2^-6 for lanes below
 * 2^-7. */
static inline floatw sin_of(floatw x) { return WHERE(fabs(x) < 0x1p-6f, x - x * x * x / 6, sin(x)); }
static inline floatw cos_of(floatw x) { return WHERE(fabs(x) < 0x1p-6f, 1 - x * x / 2, cos(x)); }

/* Rows of y: x (dims), then for octave o: sin(2^o x) (dims), sin(2^o x + pi/2) (dims). group = (k*dims + row of x)*
 * blocks + block, where k = 0 copies x and k > 0 is octave k - 1. */
KERNEL freq_fwd(ROWS(float, y), ROWS(const float, x), uint dims, uint blocks, ulong n) {
  OPEN(float, y);
  OPEN(const float, x);
  const uint row = (uint)get_group_id(0) / blocks, d = row % dims, octave = row / dims;
  const float factor = ldexp(1.0f, (int)octave - 1);
  const ulong sine = dims * (2 * (ulong)octave - 1) + d, cosine = sine + dims;
  EACH_SAMPLE(i, (uint)get_group_id(0) % blocks) {
    const floatw from = loadw_first(x + d * x_stride + i, n - i);
    if (octave == 0) {
      storew_first(y + d * y_stride + i, from, n - i);
    } else {
      storew_first(y + sine * y_stride + i, sin_of(factor * from), n - i);
      storew_first(y + cosine * y_stride + i, sin_of(factor * from + HALF_PI), n - i);
    }
  }
}

/* dx += dy_0 + sum_o 2^o (cos(2^o x) dy_sin - sin(2^o x) dy_cos); group = row of x * blocks + block */
KERNEL freq_bwd(ROWS(float, dx), ROWS(const float, dy), ROWS(const float, x), uint dims, uint octaves, uint blocks,
                ulong n) {
  OPEN(float, dx);
  OPEN(const float, dy);
  OPEN(const float, x);
  const ulong d = (uint)get_group_id(0) / blocks;
  EACH_SAMPLE(i, (uint)get_group_id(0) % blocks) {
    const floatw from = loadw_first(x + d * x_stride + i, n - i);
    floatw sum = loadw_first(dx + d * dx_stride + i, n - i) + loadw_first(dy + d * dy_stride + i, n - i);
    float factor = 1;
    for (uint o = 0; o < octaves; o++, factor *= 2) {
      global const float *dsine = dy + (dims * (1 + 2 * (ulong)o) + d) * dy_stride + i;
      const floatw with = loadw_first(dsine, n - i), against = loadw_first(dsine + dims * dy_stride, n - i);
      sum += factor * (cos_of(factor * from) * with - sin_of(factor * from) * against);
    }
    storew_first(dx + d * dx_stride + i, sum, n - i);
  }
}
