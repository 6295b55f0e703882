/* SPDX-License-Identifier: MIT
 * Region attention (paper eq. 6-8): region_c = v_c code_c, norm = sqrt(sum_c v_c^2), region_eye = eye * eye_attention.
 * Sums over channels and samples are in double in every build: no overflow of the squares, no loss in long sums. */
#include <math.h>

#include "model/model_kernels.h"

void ERN_REF(ern_attention_fwd)(ern_real *region, ern_real *norm, ern_real *region_eye, const ern_real *v,
                                const ern_real *code, const ern_real *eye_attention, ern_real eye, int channels,
                                size_t stride, size_t n) {
  for (size_t i = 0; i < n; i++) {
    double sum = 0;
    for (size_t c = 0; c < (size_t)channels; c++) {
      const ern_real value = v[c * stride + i];
      region[c * stride + i] = value * code[c];
      sum += (double)value * (double)value;
    }
    norm[i] = (ern_real)sqrt(sum);
    if (region_eye && eye_attention) region_eye[i] = eye * eye_attention[i];
  }
}

/* dv_c = code_c dregion_c + dnorm v_c/norm;  dcode_c += sum_i dregion_c v_c;  deye_attention += eye dregion_eye.
 * v/norm is taken as 0 at v = 0, where the norm has no gradient. */
void ERN_REF(ern_attention_bwd)(ern_real *dv, ern_real *dcode, ern_real *deye_attention, const ern_real *dregion,
                                const ern_real *dnorm, const ern_real *dregion_eye, const ern_real *v,
                                const ern_real *norm, const ern_real *code, ern_real eye, int channels, size_t stride,
                                size_t n) {
  for (size_t c = 0; c < (size_t)channels; c++) {
    const size_t row = c * stride;
    double sum = 0;
    for (size_t i = 0; i < n; i++) {
      ern_real gradient = 0;
      if (dregion) {
        gradient += code[c] * dregion[row + i];
        sum += (double)dregion[row + i] * (double)v[row + i];
      }
      if (dnorm && norm[i] > 0) gradient += dnorm[i] * (v[row + i] / norm[i]);
      dv[row + i] = gradient;
    }
    if (dcode) dcode[c] += (ern_real)sum;
  }
  if (deye_attention && dregion_eye) {
    for (size_t i = 0; i < n; i++) deye_attention[i] += eye * dregion_eye[i];
  }
}
