/* SPDX-License-Identifier: MIT
 * Region attention for any instruction set (simd/isa.h). Sums over channels and samples are in double, as in the
 * reference. Sums over channels have its order, so that the forward pass is bit-identical to it. */
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes_double.h"
#include "backend_cpu/simd/lanes_math.h"
#include "model/attention_ops.h"

/* y = factor x, or y += */
LANES_INLINE void scaled(float *y, const float *x, float factor, bool accumulate, size_t n) {
  for (size_t i = 0; i < n; i += LANES) {
    const size_t count = n - i < LANES ? n - i : LANES;
    const vf product = vf_multiply_rounded(vf_all(factor), vf_load_partial(x + i, count));
    vf_store_partial(y + i, accumulate ? vf_load_partial(y + i, count) + product : product, count);
  }
}

/* Independent accumulators, enough to hide the latency of an addition. */
enum { ABREAST = 8 };

LANES_INLINE void attention_block(float *region, float *norm, const float *v, const float *code,
                                  struct ern_attention_shape shape, size_t stride, size_t count) {
  struct vd_pair sum[ABREAST] = {0};
  for (size_t c = 0; c < (size_t)shape.channels; c++) {
    const size_t row = c < (size_t)shape.values ? c : 0;
    for (size_t b = 0; b < ABREAST && b * LANES < count; b++) {
      const size_t at = b * LANES, some = count - at < LANES ? count - at : LANES;
      const vf value = vf_load_partial(v + row * stride + at, some);
      vf_store_partial(region + c * stride + at, value * code[c], some);
      if (row == c) vd_add_product(&sum[b], value, value);
    }
  }
  for (size_t b = 0; b < ABREAST && b * LANES < count; b++) {
    for (int h = 0; h < 2; h++) sum[b].half[h] = vd_root(sum[b].half[h]);
    vf_store_partial(norm + b * LANES, vf_of(sum[b]), count - b * LANES < LANES ? count - b * LANES : LANES);
  }
}

void ERN_ISA(ern_attention_fwd)(float *region, float *norm, float *region_eye, const float *v, const float *code,
                                const float *eye_attention, float eye, struct ern_attention_shape shape, size_t stride,
                                size_t n) {
  size_t i = 0;
  if (shape.values == 0) i = n;
  for (; i + ABREAST * LANES <= n; i += ABREAST * LANES)
    attention_block(region + i, norm + i, v + i, code, shape, stride, ABREAST * LANES);
  if (i < n) attention_block(region + i, norm + i, v + i, code, shape, stride, n - i);
  if (region_eye != NULL && eye_attention != NULL) scaled(region_eye, eye_attention, eye, false, n);
}

/* ---- backward ---- */

/* Samples of a tile, whose 1/norm are stored, and channels, whose sums are stored. */
enum { ATTENTION_TILE = 512, ATTENTION_CHANNELS = 64 };

struct norms {
  float inverse[ATTENTION_TILE], dnorm[ATTENTION_TILE]; /* both 0 where the norm has no gradient */
};

/* False where 1/norm is not an accurate factor: then v is divided by the norm. */
static bool invert_norms(struct norms *norms, const float *norm, const float *dnorm, size_t n) {
  vi poor = {0};
  for (size_t i = 0; i < n; i += LANES) {
    const size_t count = n - i < LANES ? n - i : LANES;
    const vf value = vf_load_partial(norm + i, count);
    const vi there = value > 0;
    vf_store_partial(norms->inverse + i, vf_select(there, 1 / value, (vf){0}), count);
    vf_store_partial(norms->dnorm + i, vf_select(there, vf_load_partial(dnorm + i, count), (vf){0}), count);
    poor |= there & ((value < 0x1p-120f) | (value > 0x1p120f));
  }
  return !vi_any(poor);
}

/* Processes a row of n samples; returns the sum of dregion v. */
LANES_INLINE double attention_row_bwd(float *dv, const float *dregion, const float *dnorm, const float *inverse,
                                      const float *v, float code, size_t n) {
  struct vd_pair sum = {{{0}}};
  for (size_t i = 0; i < n; i += LANES) {
    const size_t count = n - i < LANES ? n - i : LANES;
    const vf value = vf_load_partial(v + i, count);
    vf gradient = {0};
    if (dregion != NULL) {
      const vf reaches = vf_load_partial(dregion + i, count);
      gradient = code * reaches;
      vd_add_product(&sum, reaches, value);
    }
    if (dnorm != NULL) gradient += vf_load_partial(dnorm + i, count) * (value * vf_load_partial(inverse + i, count));
    vf_store_partial(dv + i, gradient, count);
  }
  return vd_total(sum);
}

/* dv += dnorm (v/norm), where 1/norm is not an accurate factor. */
static void add_by_quotient(float *dv, const float *dnorm, const float *v, const float *norm, size_t n) {
  for (size_t i = 0; i < n; i++) {
    if (norm[i] > 0) dv[i] += dnorm[i] * (v[i] / norm[i]);
  }
}

/* All channels of a tile of samples. */
static void attention_tile_bwd(float *dv, double *dcode, const float *dregion, const float *dnorm, const float *v,
                               const float *norm, const float *code, int channels, size_t stride, size_t n) {
  struct norms norms;
  const bool by_inverse = dnorm != NULL && invert_norms(&norms, norm, dnorm, n);
  for (size_t c = 0; c < (size_t)channels; c++) {
    const size_t row = c * stride;
    const float *const reaches = dregion != NULL ? dregion + row : NULL;
    dcode[c] +=
        attention_row_bwd(dv + row, reaches, by_inverse ? norms.dnorm : NULL, norms.inverse, v + row, code[c], n);
    if (dnorm != NULL && !by_inverse) add_by_quotient(dv + row, dnorm, v + row, norm, n);
  }
}

/* The same where all channels share one v: channel by channel, each adding to dv. */
static void attention_one_tile_bwd(float *dv, double *dcode, const float *dregion, const float *v, const float *code,
                                   int channels, size_t stride, size_t n) {
  for (size_t c = 0; c < (size_t)channels; c++) {
    struct vd_pair sum = {{{0}}};
    for (size_t i = 0; i < n; i += LANES) {
      const size_t count = n - i < LANES ? n - i : LANES;
      const vf reaches = vf_load_partial(dregion + c * stride + i, count), old = vf_load_partial(dv + i, count);
      vf_store_partial(dv + i, old + vf_multiply_rounded(vf_all(code[c]), reaches), count);
      vd_add_product(&sum, reaches, vf_load_partial(v + i, count));
    }
    dcode[c] += vd_total(sum);
  }
}

static void add_code(float *dcode, const double *sums, int channels) {
  for (int c = 0; c < channels; c++) dcode[c] += (float)sums[c];
}

static void attention_one_bwd(float *dv, float *dcode, const float *dregion, const float *dnorm, const float *v,
                              const float *norm, const float *code, int channels, size_t stride, size_t n) {
  memset(dv, 0, n * sizeof *dv);
  for (int first = 0; dregion != NULL && first < channels; first += ATTENTION_CHANNELS) {
    const int some = channels - first < ATTENTION_CHANNELS ? channels - first : ATTENTION_CHANNELS;
    double sums[ATTENTION_CHANNELS] = {0};
    for (size_t i = 0; i < n; i += ATTENTION_TILE) {
      const size_t count = n - i < ATTENTION_TILE ? n - i : ATTENTION_TILE;
      attention_one_tile_bwd(dv + i, sums, dregion + (size_t)first * stride + i, v + i, code + first, some, stride,
                             count);
    }
    if (dcode != NULL) add_code(dcode + first, sums, some);
  }
  if (dnorm != NULL) add_by_quotient(dv, dnorm, v, norm, n);
}

void ERN_ISA(ern_attention_bwd)(float *dv, float *dcode, float *deye_attention, const float *dregion,
                                const float *dnorm, const float *dregion_eye, const float *v, const float *norm,
                                const float *code, float eye, struct ern_attention_shape shape, size_t stride,
                                size_t n) {
  const bool one = shape.values == 1 && shape.channels > 1;
  if (one) attention_one_bwd(dv, dcode, dregion, dnorm, v, norm, code, shape.channels, stride, n);
  for (int first = 0; !one && first < shape.channels; first += ATTENTION_CHANNELS) {
    const int some = shape.channels - first < ATTENTION_CHANNELS ? shape.channels - first : ATTENTION_CHANNELS;
    const size_t row = (size_t)first * stride;
    double sums[ATTENTION_CHANNELS] = {0};
    for (size_t i = 0; i < n; i += ATTENTION_TILE) {
      const size_t count = n - i < ATTENTION_TILE ? n - i : ATTENTION_TILE, at = row + i;
      attention_tile_bwd(dv + at, sums, dregion != NULL ? dregion + at : NULL, dnorm != NULL ? dnorm + i : NULL, v + at,
                         norm + i, code + first, some, stride, count);
    }
    if (dcode != NULL) add_code(dcode + first, sums, some);
  }
  if (deye_attention != NULL && dregion_eye != NULL) scaled(deye_attention, dregion_eye, eye, true, n);
}
