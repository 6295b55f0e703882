/* SPDX-License-Identifier: MIT
 * The losses of the head and the torso (docs/maths.md), value and gradient together. Sums are in double in every build.
 */
#include <tgmath.h>

#include "core/rng.h"
#include "train/losses_ops.h"

/* ---- terms of the head ---- */

/* The weights of the photometric term need softmax(u)_r = exp(u_r - max)/sum_k exp(u_k - max). */
struct ern_softmax ERN_REF(ern_head_softmax)(const ern_real *u, size_t n) {
  struct ern_softmax softmax = {n > 0 ? u[0] : -INFINITY, 0};
  for (size_t r = 1; r < n; r++) {
    if (u[r] > softmax.most) softmax.most = u[r];
  }
  for (size_t r = 0; r < n; r++) softmax.sum += exp(u[r] - softmax.most);
  return softmax;
}

/* 0.2 + 0.8 clamp((1 - s) + s R softmax(u), 0, 10); no gradient goes through it. */
static ern_real photometric_weight(ern_real u, const struct ern_softmax *softmax, ern_real s, size_t batch) {
  const ern_real share = (ern_real)((double)batch * (double)exp(u - softmax->most) / softmax->sum);
  const ern_real blend = (1 - s) + s * share;
  return (ern_real)0.2 + (ern_real)0.8 * (blend < 0 ? 0 : blend > 10 ? 10 : blend);
}

/* face (e/(2 beta^2) + log(beta)^2/2) with beta = u + 1 and e = |pixel - truth|_2 without gradient;
 * *du = face (log(beta)/beta - e/beta^3). */
static ern_real uncertainty_term(ern_real *du, ern_real u, ern_real error, ern_real face) {
  const ern_real beta = u + 1, log_beta = log1p(u);
  *du = face * ((log_beta - error / beta / beta) / beta);
  return face * (error / beta / beta / 2 + log_beta * log_beta / 2);
}

/* H(w) = -w log2 w - (1-w) log2(1-w), w = clamp(opacity, 1e-5, 1 - 1e-5); dH/dw = log2((1-w)/w), 0 outside the clamp.
 */
static ern_real entropy_term(ern_real *dopacity, ern_real opacity) {
  const ern_real low = (ern_real)1e-5, high = 1 - low;
  const ern_real w = opacity < low ? low : opacity > high ? high : opacity;
  *dopacity = opacity >= low && opacity <= high ? log2(1 - w) - log2(w) : 0;
  return -w * log2(w) - (1 - w) * log2(1 - w);
}

void ERN_REF(ern_head_loss)(double terms[ERN_LOSS_TERMS], const struct ern_head_loss_view *view,
                            const struct ern_loss_weights *weights, int max_steps, const struct ern_softmax *softmax,
                            size_t batch, size_t n) {
  double photometric = 0, uncertainty = 0, outside = 0, entropy = 0, audio = 0, eye = 0;
  const double mean = batch > 0 ? 1 / (double)batch : 0;
  const ern_real s = weights->s;
  /* factor of each term's gradient: weight, schedule and 1/R */
  const ern_real by_uncertainty = (ern_real)(weights->uncertainty * s * mean);
  const ern_real by_outside = (ern_real)(weights->static_uncertainty * s * mean);
  const ern_real by_entropy = (ern_real)(weights->entropy * mean), by_pixel = (ern_real)(2 * mean / 3);
  const ern_real by_audio = (ern_real)(weights->audio_ambient * s * mean);
  const ern_real by_eye = (ern_real)(weights->eye_ambient * s * mean / max_steps);

  for (size_t r = 0; r < n; r++) {
    const ern_real u = view->uncertainty[r], face = view->face[r];
    const ern_real attention = view->attention ? view->attention[r] : 0;
    const ern_real weight = weights->adaptive ? photometric_weight(u, softmax, s, batch) : 1;
    ern_real squares = 0;
    for (size_t c = 0; c < 3; c++) {
      const size_t at = c * view->stride + r;
      const ern_real difference = view->pixel[at] - view->truth[at];
      squares += difference * difference;
      view->dpixel[at] = by_pixel * weight * difference;
    }
    photometric += weight * (squares / 3);

    ern_real du, dopacity;
    uncertainty += uncertainty_term(&du, u, sqrt(squares), face);
    outside += u * (1 - face);
    view->duncertainty[r] = by_uncertainty * du + by_outside * (1 - face);
    entropy += entropy_term(&dopacity, view->opacity[r]);
    view->dopacity[r] = by_entropy * dopacity;
    audio += attention * (1 - face);
    if (view->dattention) view->dattention[r] = by_audio * (1 - face);
    if (view->eye) eye += view->eye[r] * attention * face;
    if (view->deye) view->deye[r] = by_eye * attention * face; /* no gradient to the attention */
  }
  terms[ERN_LOSS_PHOTOMETRIC] = photometric * mean;
  terms[ERN_LOSS_UNCERTAINTY] = (double)weights->uncertainty * s * uncertainty * mean;
  terms[ERN_LOSS_STATIC_UNCERTAINTY] = (double)weights->static_uncertainty * s * outside * mean;
  terms[ERN_LOSS_ENTROPY] = (double)weights->entropy * entropy * mean;
  terms[ERN_LOSS_AUDIO_AMBIENT] = (double)weights->audio_ambient * s * audio * mean;
  terms[ERN_LOSS_EYE_AMBIENT] = (double)weights->eye_ambient * s * eye * mean / max_steps;
}

/* ---- smoothness ---- */

/* weight mean((moved - still)^2) */
double ERN_REF(ern_smooth_loss)(ern_real *dmoved, const ern_real *still, const ern_real *moved, float weight,
                                size_t batch, size_t n) {
  if (batch == 0) return 0;
  const double factor = (double)weight / (double)batch;
  double sum = 0;
  for (size_t i = 0; i < n; i++) {
    const ern_real difference = moved[i] - still[i];
    sum += (double)difference * (double)difference;
    dmoved[i] = (ern_real)(2 * factor) * difference;
  }
  return factor * sum;
}

/* In float in every build, like all points at which the model is evaluated. */
void ERN_REF(ern_smooth_points)(ern_real *moved, const ern_real *x, size_t stride, float reach, uint64_t seed,
                                uint64_t step, size_t sample_begin, size_t n) {
  for (size_t i = 0; i < n; i++) {
    const struct ern_random random = ern_random_at(seed, step, (uint32_t)(sample_begin + i), ERN_RNG_SMOOTH);
    for (size_t axis = 0; axis < 3; axis++) {
      const float offset = (2 * ern_uniform(random.word[axis]) - 1) * reach;
      moved[axis * stride + i] = (float)x[axis * stride + i] + offset;
    }
  }
}

/* ---- plain error, key points ---- */

double ERN_REF(ern_mse)(ern_real *dpixel, const ern_real *pixel, const ern_real *truth, size_t stride, size_t batch,
                        size_t n) {
  if (batch == 0) return 0;
  const double mean = 1 / (3 * (double)batch);
  double sum = 0;
  for (size_t c = 0; c < 3; c++) {
    for (size_t r = 0; r < n; r++) {
      const size_t at = c * stride + r;
      const ern_real difference = pixel[at] - truth[at];
      sum += (double)difference * (double)difference;
      dpixel[at] = (ern_real)(2 * mean) * difference;
    }
  }
  return sum * mean;
}

enum { POINTS = 3 };

/* mean of (1 - w)^2, w the last of the four coordinates */
double ERN_REF(ern_key_points_loss)(ern_real *danchors, const ern_real *anchors) {
  double sum = 0;
  for (size_t p = 0; p < POINTS; p++) {
    const ern_real short_of = 1 - anchors[4 * p + 3];
    sum += (double)short_of * (double)short_of;
    danchors[4 * p + 3] -= 2 * short_of / POINTS;
  }
  return sum / POINTS;
}

/* sum += u (a cross da), of sample i */
static void add_cross(double sum[3], double u, const ern_real *da, size_t da_stride, const ern_real *a, size_t a_stride,
                      size_t i) {
  const double x = (double)a[i], y = (double)a[a_stride + i], z = (double)a[2 * a_stride + i];
  const double dx = (double)da[i], dy = (double)da[da_stride + i], dz = (double)da[2 * da_stride + i];
  sum[0] += u * (y * dz - z * dy);
  sum[1] += u * (z * dx - x * dz);
  sum[2] += u * (x * dy - y * dx);
}

void ERN_REF(ern_pose_bwd)(double dpose[ERN_POSE_PARAMETERS], const ern_real *dx, size_t dx_stride, const ern_real *x,
                           size_t x_stride, const ern_real *dd, size_t dd_stride, const ern_real *d, size_t d_stride,
                           const ern_real *weight, size_t n) {
  for (size_t i = 0; i < n; i++) {
    const double u = weight != NULL ? (double)weight[i] : 1;
    add_cross(dpose, u, dx, dx_stride, x, x_stride, i);
    if (dd != NULL) add_cross(dpose, u, dd, dd_stride, d, d_stride, i);
    for (size_t axis = 0; axis < 3; axis++) dpose[3 + axis] += u * (double)dx[axis * dx_stride + i];
  }
}
