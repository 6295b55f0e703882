/* SPDX-License-Identifier: MIT
 * The losses for any instruction set (simd/isa.h). Sums are in double, one for each lane, which are added at the end.
 */
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes_double.h"
#include "backend_cpu/simd/lanes_math.h"
#include "backend_cpu/simd/lanes_random.h"
#include "train/losses_ops.h"

/* Lanes from `count` on are 0. */
LANES_INLINE vf first_of(vf value, size_t count) {
  return count == LANES ? value : vf_select(vu_from(0) < (uint32_t)count, value, (vf){0});
}

LANES_INLINE vf some_or_zero(const float *at, size_t i, size_t count) {
  return at != NULL ? vf_load_partial(at + i, count) : (vf){0};
}

/* ---- terms of the head ---- */

struct ern_softmax ERN_ISA(ern_head_softmax)(const float *u, size_t n) {
  if (n == 0) return (struct ern_softmax){-INFINITY, 0};
  vf most = vf_all(u[0]);
  for (size_t i = 0; i < n; i += LANES) {
    const size_t count = n - i < LANES ? n - i : LANES, from = count < LANES && n >= LANES ? n - LANES : i;
    const vf value = n >= LANES ? vf_load(u + from) : vf_load_partial(u, n);
    most = vf_select((value > most) & (vu_from(0) < (uint32_t)n), value, most);
  }
  float largest = most[0];
  for (int l = 1; l < LANES; l++) {
    if (most[l] > largest) largest = most[l];
  }
  struct vd_pair sum = {{{0}}};
  for (size_t i = 0; i < n; i += LANES) {
    const size_t count = n - i < LANES ? n - i : LANES;
    vd_add(&sum, first_of(vf_exp(vf_load_partial(u + i, count) - largest), count));
  }
  return (struct ern_softmax){largest, vd_total(sum)};
}

/* Values that the rays of a batch share. */
struct head_scales {
  bool adaptive;
  float s, most, by_uncertainty, by_outside, by_entropy, by_pixel, by_audio, by_eye;
  double shares; /* rays/sum of the softmax */
};

static struct head_scales head_scales(const struct ern_loss_weights *weights, int max_steps,
                                      const struct ern_softmax *softmax, size_t batch) {
  const double mean = batch > 0 ? 1 / (double)batch : 0;
  struct head_scales scales = {.adaptive = weights->adaptive,
                               .s = weights->s,
                               .by_uncertainty = (float)((double)(weights->uncertainty * weights->s) * mean),
                               .by_outside = (float)((double)(weights->static_uncertainty * weights->s) * mean),
                               .by_entropy = (float)((double)weights->entropy * mean),
                               .by_pixel = (float)(2 * mean / 3),
                               .by_audio = (float)((double)(weights->audio_ambient * weights->s) * mean),
                               .by_eye = (float)((double)(weights->eye_ambient * weights->s) * mean / max_steps)};
  if (weights->adaptive) {
    scales.most = softmax->most;
    scales.shares = (double)batch / softmax->sum;
  }
  return scales;
}

/* 0.2 + 0.8 clamp((1 - s) + s R softmax(u), 0, 10) */
LANES_INLINE vf photometric_weight(vf u, const struct head_scales *scales) {
  struct vd_pair share = vd_of(vf_exp(u - scales->most));
  for (int h = 0; h < 2; h++) share.half[h] *= scales->shares;
  return 0.2f + 0.8f * vf_clamp((1 - scales->s) + scales->s * vf_of(share), 0, 10);
}

/* face (e/(2 beta^2) + log(beta)^2/2), beta = u + 1; *du = face (log(beta)/beta - e/beta^3) */
LANES_INLINE vf uncertainty_term(vf *du, vf u, vf error, vf face) {
  const vf inverse = 1 / (u + 1), log_beta = vf_log1p(u), error_part = error * inverse * inverse;
  *du = face * ((log_beta - error_part) * inverse);
  return face * (error_part * 0.5f + log_beta * log_beta * 0.5f);
}

/* -w log2 w - (1-w) log2(1-w), w = clamp(opacity, 1e-5, 1 - 1e-5), and its gradient, 0 outside the clamp */
LANES_INLINE vf entropy_term(vf *dopacity, vf opacity) {
  const float low = 1e-5f, high = 1 - low;
  const vf w = vf_clamp(opacity, low, high), own = vf_log2(w), other = vf_log2(1 - w);
  *dopacity = vf_select((opacity >= low) & (opacity <= high), other - own, (vf){0});
  return -w * own - (1 - w) * other;
}

enum { PHOTOMETRIC, UNCERTAINTY, OUTSIDE, ENTROPY, AUDIO, EYE, HEAD_SUMS };

/* Rays r .. r + count: writes their gradients and adds their terms to the sums. */
LANES_INLINE void head_rays(struct vd_pair sum[HEAD_SUMS], const struct ern_head_loss_view *view,
                            const struct head_scales *scales, size_t r, size_t count) {
  const vf u = vf_load_partial(view->uncertainty + r, count), face = vf_load_partial(view->face + r, count);
  const vf attention = some_or_zero(view->attention, r, count), outside = 1 - face;
  const vf weight = scales->adaptive ? photometric_weight(u, scales) : vf_all(1);
  vf squares = {0}, du, dopacity;
  for (size_t c = 0; c < 3; c++) {
    const size_t at = c * view->stride + r;
    const vf difference = vf_load_partial(view->pixel + at, count) - vf_load_partial(view->truth + at, count);
    squares += difference * difference;
    vf_store_partial(view->dpixel + at, scales->by_pixel * weight * difference, count);
  }
  vd_add(&sum[PHOTOMETRIC], first_of(weight * (squares / 3), count));
  vd_add(&sum[UNCERTAINTY], first_of(uncertainty_term(&du, u, vf_sqrt(squares), face), count));
  vd_add(&sum[OUTSIDE], first_of(u * outside, count));
  vf_store_partial(view->duncertainty + r, scales->by_uncertainty * du + scales->by_outside * outside, count);
  vd_add(&sum[ENTROPY], first_of(entropy_term(&dopacity, vf_load_partial(view->opacity + r, count)), count));
  vf_store_partial(view->dopacity + r, scales->by_entropy * dopacity, count);
  vd_add(&sum[AUDIO], first_of(attention * outside, count));
  if (view->dattention != NULL) vf_store_partial(view->dattention + r, scales->by_audio * outside, count);
  vd_add(&sum[EYE], first_of(some_or_zero(view->eye, r, count) * attention * face, count));
  if (view->deye != NULL) vf_store_partial(view->deye + r, scales->by_eye * attention * face, count);
}

void ERN_ISA(ern_head_loss)(double terms[ERN_LOSS_TERMS], const struct ern_head_loss_view *view,
                            const struct ern_loss_weights *weights, int max_steps, const struct ern_softmax *softmax,
                            size_t batch, size_t n) {
  const struct head_scales scales = head_scales(weights, max_steps, softmax, batch);
  const double mean = batch > 0 ? 1 / (double)batch : 0, s = (double)weights->s;
  struct vd_pair sum[HEAD_SUMS] = {{{{0}}}};
  size_t r = 0;
  for (; r + LANES <= n; r += LANES) head_rays(sum, view, &scales, r, LANES);
  if (r < n) head_rays(sum, view, &scales, r, n - r);
  terms[ERN_LOSS_PHOTOMETRIC] = vd_total(sum[PHOTOMETRIC]) * mean;
  terms[ERN_LOSS_UNCERTAINTY] = (double)weights->uncertainty * s * vd_total(sum[UNCERTAINTY]) * mean;
  terms[ERN_LOSS_STATIC_UNCERTAINTY] = (double)weights->static_uncertainty * s * vd_total(sum[OUTSIDE]) * mean;
  terms[ERN_LOSS_ENTROPY] = (double)weights->entropy * vd_total(sum[ENTROPY]) * mean;
  terms[ERN_LOSS_AUDIO_AMBIENT] = (double)weights->audio_ambient * s * vd_total(sum[AUDIO]) * mean;
  terms[ERN_LOSS_EYE_AMBIENT] = (double)weights->eye_ambient * s * vd_total(sum[EYE]) * mean / max_steps;
}

/* ---- differences of two rows ---- */

/* *gradient = factor (a - b), bit-identical to the reference's; adds the squares to *sum. */
LANES_INLINE void squares_of(struct vd_pair *sum, float *gradient, const float *a, const float *b, float factor,
                             size_t n) {
  for (size_t i = 0; i < n; i += LANES) {
    const size_t count = n - i < LANES ? n - i : LANES;
    const vf difference = vf_load_partial(a + i, count) - vf_load_partial(b + i, count);
    vd_add_product(sum, difference, difference);
    vf_store_partial(gradient + i, factor * difference, count);
  }
}

double ERN_ISA(ern_smooth_loss)(float *dmoved, const float *still, const float *moved, float weight, size_t batch,
                                size_t n) {
  if (batch == 0) return 0;
  const double factor = (double)weight / (double)batch;
  struct vd_pair sum = {{{0}}};
  squares_of(&sum, dmoved, moved, still, (float)(2 * factor), n);
  return factor * vd_total(sum);
}

double ERN_ISA(ern_mse)(float *dpixel, const float *pixel, const float *truth, size_t stride, size_t batch, size_t n) {
  if (batch == 0) return 0;
  const double mean = 1 / (3 * (double)batch);
  struct vd_pair sum = {{{0}}};
  for (size_t c = 0; c < 3; c++)
    squares_of(&sum, dpixel + c * stride, pixel + c * stride, truth + c * stride, (float)(2 * mean), n);
  return vd_total(sum) * mean;
}

/* ---- points of the smoothness term, to the bit ---- */

void ERN_ISA(ern_smooth_points)(float *moved, const float *x, size_t stride, float reach, uint64_t seed, uint64_t step,
                                size_t sample_begin, size_t n) {
  for (size_t i = 0; i < n; i += LANES) {
    const size_t count = n - i < LANES ? n - i : LANES;
    const struct vu_random random = vu_random_at(seed, step, vu_from((uint32_t)(sample_begin + i)), ERN_RNG_SMOOTH);
    for (size_t axis = 0; axis < 3; axis++) {
      const vf offset = vf_multiply_rounded(2 * vu_uniform(random.word[axis]) - 1, vf_all(reach));
      const size_t at = axis * stride + i;
      vf_store_partial(moved + at, vf_load_partial(x + at, count) + offset, count);
    }
  }
}
