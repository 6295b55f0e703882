/* SPDX-License-Identifier: MIT
 * Region attention (paper eq. 6-8): region_c = v_c code_c, norm = sqrt(sum_c v_c^2), region_eye = eye * eye_attention.
 * Sums over channels and samples are in double in every build: no overflow of the squares, no loss in long sums. */
#include <math.h>

#include "model/attention_ops.h"

void ERN_REF(ern_attention_fwd)(ern_real *region, ern_real *norm, ern_real *region_eye, const ern_real *v,
                                const ern_real *code, const ern_real *eye_attention, ern_real eye,
                                struct ern_attention_shape shape, size_t stride, size_t n) {
  const size_t channels = (size_t)shape.channels, values = (size_t)shape.values;
  for (size_t i = 0; i < n; i++) {
    double sum = 0;
    for (size_t c = 0; c < values; c++) sum += (double)v[c * stride + i] * (double)v[c * stride + i];
    for (size_t c = 0; values > 0 && c < channels; c++)
      region[c * stride + i] = v[(c < values ? c : 0) * stride + i] * code[c];
    if (values > 0) norm[i] = (ern_real)sqrt(sum);
    if (region_eye && eye_attention) region_eye[i] = eye * eye_attention[i];
  }
}

/* sum_i dregion_i v_i of a channel */
static ern_real code_gradient(const ern_real *dregion, const ern_real *v, size_t n) {
  double sum = 0;
  for (size_t i = 0; i < n; i++) sum += (double)dregion[i] * (double)v[i];
  return (ern_real)sum;
}

/* dv_c = code_c dregion_c + dnorm v_c/norm, or, of one v for all channels, dv = sum_c code_c dregion_c + dnorm v/norm;
 * dcode_c += sum_i dregion_c v_c; deye_attention += eye dregion_eye. v/norm is taken as 0 at v = 0, where the norm has
 * no gradient. */
void ERN_REF(ern_attention_bwd)(ern_real *dv, ern_real *dcode, ern_real *deye_attention, const ern_real *dregion,
                                const ern_real *dnorm, const ern_real *dregion_eye, const ern_real *v,
                                const ern_real *norm, const ern_real *code, ern_real eye,
                                struct ern_attention_shape shape, size_t stride, size_t n) {
  const size_t channels = (size_t)shape.channels, values = (size_t)shape.values;
  for (size_t r = 0; r < values; r++) {
    const size_t first = r, end = values == 1 ? channels : r + 1; /* the channels that this row of v multiplies */
    for (size_t i = 0; i < n; i++) {
      ern_real gradient = 0;
      for (size_t c = first; dregion && c < end; c++) gradient += code[c] * dregion[c * stride + i];
      if (dnorm && norm[i] > 0) gradient += dnorm[i] * (v[r * stride + i] / norm[i]);
      dv[r * stride + i] = gradient;
    }
    for (size_t c = first; dcode && dregion && c < end; c++)
      dcode[c] += code_gradient(dregion + c * stride, v + r * stride, n);
  }
  if (deye_attention && dregion_eye) {
    for (size_t i = 0; i < n; i++) deye_attention[i] += eye * dregion_eye[i];
  }
}

void ERN_REF(ern_attention_fade)(ern_real *v, const ern_real *height, const float fade[2], int rows, size_t stride,
                                 size_t n) {
  for (size_t i = 0; i < n; i++) {
    ern_real t = (height[i] - fade[0]) / (fade[1] - fade[0]);
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    for (size_t c = 0; c < (size_t)rows; c++) v[c * stride + i] *= 1 - t * t * (3 - 2 * t);
  }
}
