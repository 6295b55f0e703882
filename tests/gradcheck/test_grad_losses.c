/* SPDX-License-Identifier: MIT
 * Gradients of the losses against central differences in double. The terms are written once more here, with the
 * quantities that have no gradient (the weight of the photometric term, the colour error of the uncertainty term, the
 * attention of the eye term) held at their values. */
#define ERN_DOUBLE
#include "difference.h"

#include "train/losses_ops.h"
#include "train/patch_filter.h"
#include "train/patches_ops.h"

enum { RAYS = 60, STRIDE = 64, STEPS = 16 };

struct head {
  struct ern_loss_weights weights;
  double pixel[3 * STRIDE], truth[3 * STRIDE], opacity[RAYS], attention[RAYS], eye[RAYS], uncertainty[RAYS], face[RAYS];
  double dpixel[3 * STRIDE], dopacity[RAYS], dattention[RAYS], deye[RAYS], duncertainty[RAYS];
  double held_weight[RAYS], held_error[RAYS], held_attention[RAYS];
  double terms[ERN_LOSS_TERMS];
};

static double squared(const struct head *h, int r) {
  double sum = 0;
  for (int c = 0; c < 3; c++) sum += pow(h->pixel[c * STRIDE + r] - h->truth[c * STRIDE + r], 2);
  return sum;
}

static void hold(struct head *h) {
  double sum = 0;
  for (int r = 0; r < RAYS; r++) sum += exp(h->uncertainty[r]);
  for (int r = 0; r < RAYS; r++) {
    const double s = (double)h->weights.s, share = RAYS * exp(h->uncertainty[r]) / sum;
    const double weight = 0.2 + 0.8 * fmin(fmax((1 - s) + s * share, 0), 10);
    h->held_weight[r] = h->weights.adaptive ? weight : 1;
    h->held_error[r] = sqrt(squared(h, r));
    h->held_attention[r] = h->attention[r];
  }
}

static void terms_of(const struct head *h, double terms[ERN_LOSS_TERMS]) {
  const struct ern_loss_weights *w = &h->weights;
  for (int k = 0; k < ERN_LOSS_TERMS; k++) terms[k] = 0;
  for (int r = 0; r < RAYS; r++) {
    const double face = h->face[r], u = h->uncertainty[r], beta = 1 + u, p = fmin(fmax(h->opacity[r], 1e-5), 1 - 1e-5);
    terms[ERN_LOSS_PHOTOMETRIC] += h->held_weight[r] * squared(h, r) / 3;
    terms[ERN_LOSS_UNCERTAINTY] += (double)w->uncertainty * (double)w->s * face *
                                   (h->held_error[r] / (2 * beta * beta) + log(beta) * log(beta) / 2);
    terms[ERN_LOSS_STATIC_UNCERTAINTY] += (double)w->static_uncertainty * (double)w->s * u * (1 - face);
    terms[ERN_LOSS_ENTROPY] += (double)w->entropy * (-p * log2(p) - (1 - p) * log2(1 - p));
    terms[ERN_LOSS_AUDIO_AMBIENT] += (double)w->audio_ambient * (double)w->s * h->attention[r] * (1 - face);
    terms[ERN_LOSS_EYE_AMBIENT] +=
        (double)w->eye_ambient * (double)w->s * h->eye[r] / STEPS * h->held_attention[r] * face;
  }
  for (int k = 0; k < ERN_LOSS_TERMS; k++) terms[k] /= RAYS;
}

static double head_loss(void *user) {
  double terms[ERN_LOSS_TERMS], loss = 0;
  terms_of(user, terms);
  for (int k = 0; k < ERN_LOSS_TERMS; k++) loss += terms[k];
  return loss;
}

/* Which side of the entropy's clamp each ray is on. */
static uint64_t head_piece(void *user) {
  const struct head *h = user;
  uint64_t hash = 0;
  for (int r = 0; r < RAYS; r++) {
    hash = difference_hash(hash, h->opacity[r] < 1e-5 ? 0 : h->opacity[r] > 1 - 1e-5 ? 2 : 1);
  }
  return hash;
}

static void head_fill(struct head *h, float s, bool adaptive, double spread) {
  memset(h, 0, sizeof *h);
  h->weights = (struct ern_loss_weights){s, 1, 0.3f, 0.2f, 0.4f, 0.5f, 0, adaptive};
  for (uint32_t r = 0; r < RAYS; r++) {
    h->opacity[r] = r % 10 == 3 ? 0 : r % 10 == 4 ? 1 : 0.5 + 0.45 * difference_random(1, r);
    h->attention[r] = 3 + difference_random(2, r);
    h->eye[r] = 2 + difference_random(3, r);
    h->uncertainty[r] = spread * (1 + difference_random(4, r));
    h->face[r] = r % 3 == 0;
  }
  for (uint32_t i = 0; i < 3 * STRIDE; i++) {
    h->pixel[i] = 0.5 + 0.5 * difference_random(5, i);
    h->truth[i] = 0.5 + 0.5 * difference_random(6, i);
  }
}

static void head_check(float s, bool adaptive, double spread) {
  static struct head h;
  head_fill(&h, s, adaptive, spread);
  const struct ern_head_loss_view view = {h.dpixel,      h.dopacity, h.dattention, h.deye,      h.duncertainty,
                                          h.pixel,       h.truth,    h.opacity,    h.attention, h.eye,
                                          h.uncertainty, h.face,     STRIDE};
  h.terms[ERN_LOSS_SMOOTHNESS] = 7, h.terms[ERN_LOSS_KEY_POINTS] = 8; /* of other operations: left alone */
  const struct ern_softmax softmax = ern_head_softmax_ref64(h.uncertainty, RAYS);
  ern_head_loss_ref64(h.terms, &view, &h.weights, STEPS, &softmax, RAYS, RAYS);
  assert_true(h.terms[ERN_LOSS_SMOOTHNESS] == 7 && h.terms[ERN_LOSS_KEY_POINTS] == 8);
  hold(&h);
  double expected[ERN_LOSS_TERMS];
  terms_of(&h, expected);
  for (int k = 0; k < ERN_LOSS_SMOOTHNESS; k++) {
    assert_true(expected[k] > 0 && fabs(h.terms[k] - expected[k]) <= 1e-12 * expected[k]);
  }
  const struct difference of = {head_loss, head_piece, &h};
  for (size_t c = 0; c < 3; c++) difference_check(&of, "pixel", h.pixel + c * STRIDE, h.dpixel + c * STRIDE, RAYS, 1);
  difference_check(&of, "opacity", h.opacity, h.dopacity, RAYS, 1);
  difference_check(&of, "attention", h.attention, h.dattention, RAYS, 1);
  difference_check(&of, "eye", h.eye, h.deye, RAYS, 1);
  difference_check(&of, "uncertainty", h.uncertainty, h.duncertainty, RAYS, 1);
}

static void test_head(void **state) {
  (void)state;
  head_check(0.5f, true, 1);
  head_check(1, true, 4); /* shares beyond the clamp at 10 */
  head_check(0.25f, false, 1);
}

/* ---- the small ones ---- */

struct pair {
  double moved[3 * STRIDE], still[3 * STRIDE], gradient[3 * STRIDE];
};

static double smooth_loss(void *user) {
  struct pair *p = user;
  double scratch[3 * STRIDE];
  return ern_smooth_loss_ref64(scratch, p->still, p->moved, 0.7f, RAYS, RAYS);
}

static double mse_loss(void *user) {
  struct pair *p = user;
  double scratch[3 * STRIDE];
  return ern_mse_ref64(scratch, p->moved, p->still, STRIDE, RAYS, RAYS);
}

static void test_smooth_and_mse(void **state) {
  (void)state;
  struct pair p;
  memset(&p, 0, sizeof p);
  difference_fill(p.moved, 3 * STRIDE, 1, 1);
  difference_fill(p.still, 3 * STRIDE, 1, 2);
  ern_smooth_loss_ref64(p.gradient, p.still, p.moved, 0.7f, RAYS, RAYS);
  const struct difference smooth = {smooth_loss, NULL, &p}, mse = {mse_loss, NULL, &p};
  difference_check(&smooth, "smoothness", p.moved, p.gradient, RAYS, 1);
  ern_mse_ref64(p.gradient, p.moved, p.still, STRIDE, RAYS, RAYS);
  for (size_t c = 0; c < 3; c++) difference_check(&mse, "mse", p.moved + c * STRIDE, p.gradient + c * STRIDE, RAYS, 1);
}

static double key_points_loss(void *user) {
  double scratch[12];
  return ern_key_points_loss_ref64(scratch, user);
}

static void test_key_points(void **state) {
  (void)state;
  double anchors[12], gradient[12];
  difference_fill(anchors, 12, 2, 1);
  for (int i = 0; i < 12; i++) gradient[i] = 5;
  ern_key_points_loss_ref64(gradient, anchors);
  for (int i = 0; i < 12; i++) gradient[i] -= 5; /* it accumulates */
  const struct difference of = {key_points_loss, NULL, anchors};
  difference_check(&of, "key points", anchors, gradient, 12, 1);
}

/* ---- patches ----------------------------------------------------------------------------------------------------- */

enum { SIDE = 32, PATCH = SIDE * SIDE };

struct patch {
  double x[PATCH], y[PATCH], gradient[PATCH], filter[2 * (PATCH + PATCH / 4 + PATCH / 16)];
};

static double patch_loss(void *user) {
  static double dx[PATCH], scratch[ERN_PATCH_SCRATCH * PATCH];
  struct patch *p = user;
  return ern_patch_pyramid_ref64(ern_patch_scale_ref64, dx, p->x, p->y, p->filter, SIDE, 0.5f, scratch);
}

/* Noise, and a flat truth under a nearly flat picture: where variances are next to nothing the gradient is steep. */
static void test_patches(void **state) {
  (void)state;
  static struct patch p;
  static float filter[sizeof p.filter / sizeof *p.filter];
  static double scratch[ERN_PATCH_SCRATCH * PATCH];
  ern_patch_filter(filter, SIDE);
  for (size_t i = 0; i < sizeof filter / sizeof *filter; i++) p.filter[i] = (double)filter[i];
  for (int kind = 0; kind < 2; kind++) {
    difference_fill(p.x, PATCH, kind == 0 ? 0.5 : 0.01, 31);
    difference_fill(p.y, PATCH, kind == 0 ? 0.5 : 0, 32);
    for (int i = 0; i < PATCH; i++) p.x[i] += 0.5, p.y[i] += 0.5, p.gradient[i] = 3;
    ern_patch_pyramid_ref64(ern_patch_scale_ref64, p.gradient, p.x, p.y, p.filter, SIDE, 0.5f, scratch);
    for (int i = 0; i < PATCH; i++) p.gradient[i] -= 3; /* it accumulates */
    const struct difference of = {patch_loss, NULL, &p};
    difference_check(&of, "patches", p.x, p.gradient, PATCH, 1);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_head),
      cmocka_unit_test(test_smooth_and_mse),
      cmocka_unit_test(test_key_points),
      cmocka_unit_test(test_patches),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
