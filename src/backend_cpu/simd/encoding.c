/* SPDX-License-Identifier: MIT
 * The positional encodings for any instruction set (simd/isa.h). */
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes_math.h"
#include "mlp/encoding_ops.h"

/* ---- spherical harmonics: the reference's polynomials ---- */

LANES_INLINE void sh_partial(float *y, size_t y_stride, vf x, vf v, vf z, size_t count) {
  const float c00 = 0.28209479177387814f, c1 = 0.48860251190291992f, c2 = 1.0925484305920792f;
  const float c20 = 0.31539156525252005f, c33 = 0.59004358992664352f, c32 = 2.8906114426405538f;
  const float c31 = 0.45704579946446572f, c30 = 0.37317633259011546f;
  const vf xx = x * x, vv = v * v, zz = z * z;
  const vf value[16] = {
      vf_all(c00),
      -c1 * v,
      c1 * z,
      -c1 * x,
      c2 * x * v,
      -c2 * v * z,
      c20 * (3 * zz - 1),
      -c2 * x * z,
      c2 / 2 * (xx - vv),
      c33 * v * (vv - 3 * xx),
      c32 * x * v * z,
      c31 * v * (1 - 5 * zz),
      c30 * z * (5 * zz - 3),
      c31 * x * (1 - 5 * zz),
      c32 / 2 * z * (xx - vv),
      c33 * x * (3 * vv - xx),
  };
  for (size_t c = 0; c < 16; c++) vf_store_partial(y + c * y_stride, value[c], count);
}

void ERN_ISA(ern_sh_fwd)(float *y, size_t y_stride, const float *d, size_t d_stride, size_t n) {
  for (size_t i = 0; i < n; i += LANES) {
    const size_t count = n - i < LANES ? n - i : LANES;
    sh_partial(y + i, y_stride, vf_load_partial(d + i, count), vf_load_partial(d + d_stride + i, count),
               vf_load_partial(d + 2 * d_stride + i, count), count);
  }
}

/* ---- sines: of the reference's arguments; a product with 2^o is exact ---- */

static const float half_pi = 1.57079632679489661923f;

void ERN_ISA(ern_freq_fwd)(float *y, size_t y_stride, const float *x, size_t x_stride, int dims, int octaves,
                           size_t n) {
  for (size_t d = 0; d < (size_t)dims; d++) {
    for (size_t i = 0; i < n; i += LANES) {
      const size_t count = n - i < LANES ? n - i : LANES;
      const vf from = vf_load_partial(x + d * x_stride + i, count);
      float *to = y + d * y_stride + i;
      vf_store_partial(to, from, count);
      float factor = 1;
      for (int o = 0; o < octaves; o++, factor *= 2) {
        to += (size_t)dims * y_stride;
        vf_store_partial(to, vf_sine(factor * from), count);
        to += (size_t)dims * y_stride;
        vf_store_partial(to, vf_sine(vf_multiply_rounded(vf_all(factor), from) + half_pi), count);
      }
    }
  }
}

void ERN_ISA(ern_freq_bwd)(float *dx, size_t dx_stride, const float *dy, size_t dy_stride, const float *x,
                           size_t x_stride, int dims, int octaves, size_t n) {
  for (size_t d = 0; d < (size_t)dims; d++) {
    for (size_t i = 0; i < n; i += LANES) {
      const size_t count = n - i < LANES ? n - i : LANES;
      const vf at = vf_load_partial(x + d * x_stride + i, count);
      const float *from = dy + d * dy_stride + i;
      float *to = dx + d * dx_stride + i, factor = 1;
      vf sum = vf_load_partial(to, count) + vf_load_partial(from, count);
      for (int o = 0; o < octaves; o++, factor *= 2) {
        vf cosine = at;
        const vf sine = vf_sine_cosine(factor * at, &cosine);
        const vf dsine = vf_load_partial(from + (size_t)dims * dy_stride, count);
        from += 2 * (size_t)dims * dy_stride;
        sum += factor * (cosine * dsine - sine * vf_load_partial(from, count));
      }
      vf_store_partial(to, sum, count);
    }
  }
}
