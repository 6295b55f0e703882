/* SPDX-License-Identifier: MIT
 * Volume rendering of the samples of a ray, and its gradient (paper eq. 1-2, docs/maths.md, Compositing).
 *
 * tau_i = sigma_i dt_i, alpha_i = 1 - exp(-tau_i), T_i = exp(-sum_{j<i} tau_j), w_i = alpha_i T_i. A sample counts
 * while the transmittance before it is T_i >= stop; with stop < 1 the first one always does. */
#include <tgmath.h>

#include "render/composite_ops.h"

static ern_real at_or_zero(const ern_real *values, size_t i) { return values ? values[i] : 0; }

static void put(ern_real *values, size_t i, ern_real value) {
  if (values) values[i] = value;
}

/* colour + (1 - opacity) background, before the clamp */
static ern_real blend(ern_real colour, ern_real opacity, ern_real background) {
  return colour + (1 - opacity) * background;
}

static void composite_ray(const struct ern_composite_view *v, size_t r) {
  const size_t begin = (size_t)v->first[r], end = (size_t)v->first[r + 1];
  ern_real transmittance = 1, opacity = 0, depth = 0, attention = 0, eye = 0, uncertainty = 0;
  ern_real colour[3] = {0, 0, 0};
  for (size_t i = begin; i < end; i++) {
    if (transmittance < v->transmittance_stop) break;
    const ern_real tau = v->sigma[i] * v->dt[i];
    const ern_real w = -expm1(-tau) * transmittance; /* expm1: alpha keeps its digits for thin samples */
    for (size_t c = 0; c < 3; c++) colour[c] += w * v->rgb[c * v->rgb_stride + i];
    opacity += w;
    depth += w * at_or_zero(v->sample_depth, i);
    attention += at_or_zero(v->sample_attention, i);
    eye += at_or_zero(v->sample_eye, i);
    uncertainty += w * at_or_zero(v->sample_uncertainty, i);
    transmittance *= exp(-tau); /* = 1 - alpha, and keeps its digits for dense ones */
  }
  put(v->opacity, r, opacity);
  put(v->depth, r, depth);
  put(v->attention, r, attention);
  put(v->eye, r, eye);
  put(v->uncertainty, r, uncertainty);
  for (size_t c = 0; c < 3; c++) {
    const size_t at = c * v->ray_stride + r;
    put(v->colour, at, colour[c]);
    if (v->pixel) {
      const ern_real value = blend(colour[c], opacity, v->background[at]);
      v->pixel[at] = value < 0 ? 0 : value > 1 ? 1 : value;
    }
  }
}

void ERN_REF(ern_composite_fwd)(const struct ern_composite_view *view, size_t n) {
  for (size_t r = 0; r < n; r++) composite_ray(view, r);
}

/* The gradients that samples past the stop get. */
static void clear_samples(const struct ern_composite_bwd_view *v, size_t begin, size_t end) {
  for (size_t i = begin; i < end; i++) {
    v->dsigma[i] = 0;
    for (size_t c = 0; c < 3; c++) v->drgb[c * v->forward.rgb_stride + i] = 0;
    put(v->dsample_attention, i, 0);
    put(v->dsample_eye, i, 0);
    put(v->dsample_uncertainty, i, 0);
  }
}

/* With dw_i = dL/dw_i:  dL/dtau_i = dw_i T_{i+1} - sum_{j>i} dw_j w_j, the sum taken from the back: no division by
 * 1 - alpha, and no difference of large sums. */
static void composite_ray_bwd(const struct ern_composite_bwd_view *v, size_t r) {
  const struct ern_composite_view *f = &v->forward;
  const size_t begin = (size_t)f->first[r], end = (size_t)f->first[r + 1];
  const ern_real dattention = at_or_zero(v->dattention, r), deye = at_or_zero(v->deye, r);
  const ern_real duncertainty = at_or_zero(v->duncertainty, r);
  ern_real dcolour[3], dopacity = at_or_zero(v->dopacity, r);
  for (size_t c = 0; c < 3; c++) {
    const size_t at = c * f->ray_stride + r;
    const ern_real value = blend(f->colour[at], f->opacity[r], f->background[at]);
    dcolour[c] = value >= 0 && value <= 1 ? v->dpixel[at] : 0;
    dopacity -= dcolour[c] * f->background[at];
  }

  /* dsigma[i] holds T_{i+1} until the backward loop */
  ern_real transmittance = 1;
  size_t counted = begin;
  for (; counted < end; counted++) {
    if (transmittance < f->transmittance_stop) break;
    transmittance *= exp(-f->sigma[counted] * f->dt[counted]);
    v->dsigma[counted] = transmittance;
  }
  clear_samples(v, counted, end);

  ern_real behind = 0; /* sum_{j>i} dw_j w_j */
  for (size_t i = counted; i-- > begin;) {
    const ern_real before = i > begin ? v->dsigma[i - 1] : 1, after = v->dsigma[i];
    const ern_real w = -expm1(-f->sigma[i] * f->dt[i]) * before;
    ern_real dw = dopacity + duncertainty * at_or_zero(f->sample_uncertainty, i);
    for (size_t c = 0; c < 3; c++) {
      dw += dcolour[c] * f->rgb[c * f->rgb_stride + i];
      v->drgb[c * f->rgb_stride + i] = dcolour[c] * w;
    }
    v->dsigma[i] = f->dt[i] * (dw * after - behind);
    put(v->dsample_attention, i, dattention);
    put(v->dsample_eye, i, deye);
    put(v->dsample_uncertainty, i, duncertainty * w);
    behind += dw * w;
  }
}

void ERN_REF(ern_composite_bwd)(const struct ern_composite_bwd_view *view, size_t n) {
  for (size_t r = 0; r < n; r++) composite_ray_bwd(view, r);
}
