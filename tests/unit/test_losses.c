/* SPDX-License-Identifier: MIT
 * Losses: worked by hand for two rays, and at the ends of the numbers. */
#include "../support.h"

#include <float.h>
#include <math.h>

#include "core/rng.h"
#include "train/losses_ops.h"

enum { MOST = 65536, STEPS = 16 };

struct batch {
  struct ern_loss_weights weights;
  float pixel[3 * MOST], truth[3 * MOST], opacity[MOST], attention[MOST], eye[MOST], uncertainty[MOST], face[MOST];
  float dpixel[3 * MOST], dopacity[MOST], dattention[MOST], deye[MOST], duncertainty[MOST];
  double terms[ERN_LOSS_TERMS];
};

static const struct ern_loss_weights usual = {0.5f, 1, 1e-3f, 1e-4f, 1e-4f, 1e-4f, 1e-5f, true};

static struct batch *batch_new(void) {
  struct batch *b = calloc(1, sizeof *b);
  assert_non_null(b);
  b->weights = usual;
  return b;
}

static float uniform(uint64_t seed, size_t at) {
  return ern_uniform(ern_random_at(seed, 0, (uint32_t)at, ERN_RNG_INIT).word[0]);
}

static struct ern_head_loss_view view_of(struct batch *b) {
  return (struct ern_head_loss_view){b->dpixel,      b->dopacity, b->dattention, b->deye,      b->duncertainty,
                                     b->pixel,       b->truth,    b->opacity,    b->attention, b->eye,
                                     b->uncertainty, b->face,     MOST};
}

static void run(struct batch *b, size_t n) {
  const struct ern_head_loss_view view = view_of(b);
  const struct ern_softmax softmax = ern_head_softmax_ref(b->uncertainty, n);
  ern_head_loss_ref(b->terms, &view, &b->weights, STEPS, &softmax, n, n);
  for (int k = 0; k < ERN_LOSS_SMOOTHNESS; k++) assert_true(isfinite(b->terms[k]));
  for (size_t r = 0; r < n; r++) {
    assert_true(isfinite(b->dopacity[r]) && isfinite(b->dattention[r]) && isfinite(b->deye[r]));
    assert_true(isfinite(b->duncertainty[r]));
    for (size_t c = 0; c < 3; c++) assert_true(isfinite(b->dpixel[c * MOST + r]));
  }
}

static void near(double found, double expected) {
  if (!(fabs(found - expected) <= 2e-6 * fabs(expected))) fail_msg("%.9g, expected %.9g", found, expected);
}

/* Two rays, the first in the face. u = (0, ln 3): softmax (1/4, 3/4), R softmax (1/2, 3/2). */
static void test_by_hand(void **state) {
  (void)state;
  struct batch *b = batch_new();
  const double u = log(3), s = 0.5;
  b->face[0] = 1;
  b->uncertainty[1] = (float)u;
  b->opacity[0] = 0.25f, b->opacity[1] = 0.5f;
  b->attention[0] = 3, b->attention[1] = 5;
  b->eye[0] = 4, b->eye[1] = 6;
  b->pixel[0] = 0.5f, b->truth[0] = 0.2f;               /* red of ray 0 is 0.3 too much */
  b->pixel[2 * MOST] = 0.1f, b->truth[2 * MOST] = 0.5f; /* blue of ray 0 is 0.4 too little: the error is 0.5 */
  b->pixel[MOST + 1] = 0.6f;                            /* green of ray 1 is 0.6 too much */
  run(b, 2);
  const double weight[2] = {0.2 + 0.8 * (0.5 + 0.5 * 0.5), 0.2 + 0.8 * (0.5 + 0.5 * 1.5)};
  near(b->terms[ERN_LOSS_PHOTOMETRIC], (weight[0] * 0.25 / 3 + weight[1] * 0.36 / 3) / 2);
  near(b->dpixel[0], weight[0] * 2 * 0.3 / 6);
  near(b->dpixel[2 * MOST], weight[0] * -2 * 0.4 / 6);
  near(b->dpixel[MOST + 1], weight[1] * 2 * 0.6 / 6);
  assert_true(b->dpixel[1] == 0 && b->dpixel[MOST] == 0 && b->dpixel[2 * MOST + 1] == 0);
  /* beta = 1: the error over 2, no logarithm */
  near(b->terms[ERN_LOSS_UNCERTAINTY], s * (0.5 / 2) / 2);
  near(b->terms[ERN_LOSS_STATIC_UNCERTAINTY], 1e-3 * s * u / 2);
  near(b->duncertainty[0], -s * 0.5 / 2);
  near(b->duncertainty[1], 1e-3 * s / 2);
  near(b->terms[ERN_LOSS_ENTROPY], 1e-4 * (2 - 0.75 * log2(3) + 1) / 2);
  near(b->dopacity[0], 1e-4 * log2(3) / 2);
  assert_true(b->dopacity[1] == 0);
  near(b->terms[ERN_LOSS_AUDIO_AMBIENT], 1e-4 * s * 5 / 2);
  assert_true(b->dattention[0] == 0);
  near(b->dattention[1], 1e-4 * s / 2);
  near(b->terms[ERN_LOSS_EYE_AMBIENT], 1e-4 * s * 4 / 16 * 3 / 2);
  near(b->deye[0], 1e-4 * s * 3 / 16 / 2);
  assert_true(b->deye[1] == 0);
  /* plain */
  b->weights.adaptive = false;
  run(b, 2);
  near(b->terms[ERN_LOSS_PHOTOMETRIC], (0.25 + 0.36) / 6);
  near(b->dpixel[MOST + 1], 2 * 0.6 / 6);
  free(b);
}

/* At s = 0 only the plain error and the entropy are left; at s = 1 the photometric weight is all softmax. */
static void test_schedule(void **state) {
  (void)state;
  struct batch *b = batch_new();
  for (size_t r = 0; r < 100; r++) {
    b->face[r] = r % 2 ? 1.0f : 0.0f;
    b->uncertainty[r] = 5 * uniform(1, r);
    b->attention[r] = b->eye[r] = 1;
    b->pixel[r] = uniform(2, r);
    b->opacity[r] = uniform(3, r);
  }
  b->weights.s = 0;
  run(b, 100);
  for (int k = 0; k < ERN_LOSS_SMOOTHNESS; k++) {
    assert_true((b->terms[k] > 0) == (k == ERN_LOSS_PHOTOMETRIC || k == ERN_LOSS_ENTROPY));
  }
  for (size_t r = 0; r < 100; r++) {
    near(b->dpixel[r], 2 * (double)b->pixel[r] / 300);
    assert_true(b->duncertainty[r] == 0 && b->dattention[r] == 0 && b->deye[r] == 0);
  }
  b->weights.s = 1;
  run(b, 100);
  double sum = 0;
  for (size_t r = 0; r < 100; r++) sum += exp((double)b->uncertainty[r]);
  for (size_t r = 0; r < 100; r++) {
    const double share = fmin(100 * exp((double)b->uncertainty[r]) / sum, 10);
    near(b->dpixel[r], (0.2 + 0.8 * share) * 2 * (double)b->pixel[r] / 300);
  }
  free(b);
}

/* softmax over 65,536 rays: flat, one that takes all, and numbers whose exponential is infinite or 0. */
static void test_softmax(void **state) {
  (void)state;
  struct batch *b = batch_new();
  const float level[] = {0, 1e-30f, 1, 88.7f, 100, 1e4f, 1e30f, FLT_MAX};
  b->weights.s = 1;
  for (size_t r = 0; r < MOST; r++) b->pixel[r] = 0.5f;
  for (size_t k = 0; k < sizeof level / sizeof *level; k++) {
    for (size_t r = 0; r < MOST; r++) b->uncertainty[r] = level[k];
    run(b, MOST);
    for (size_t r = 0; r < MOST; r++) near(b->dpixel[r], 2 * 0.5 / (3.0 * MOST)); /* every share is 1 */
    for (size_t r = 1; r < MOST; r++) b->uncertainty[r] = 0;
    run(b, MOST);
    if (level[k] < 20) continue;
    near(b->dpixel[0], 8.2 * 2 * 0.5 / (3.0 * MOST)); /* held at 10 */
    for (size_t r = 1; r < MOST; r++) near(b->dpixel[r], 0.2 * 2 * 0.5 / (3.0 * MOST));
  }
  free(b);
}

/* Opacity at and beyond the clamp, errors of 0, uncertainty from 0 to the largest number: all finite. */
static void test_ends(void **state) {
  (void)state;
  static const float opacity[] = {0,        1e-30f,    9.9e-6f, 1e-5f,      1.1e-5f, 0.5f,
                                  0.99998f, 0.999995f, 1,       1.0000001f, 1.01f,   -1e-7f};
  static const float uncertainty[] = {0, 1e-45f, 1e-30f, 1e-7f, 1, 1e5f, 1e19f, 1e30f, FLT_MAX};
  enum { A = sizeof opacity / sizeof *opacity, B = sizeof uncertainty / sizeof *uncertainty };
  struct batch *b = batch_new();
  size_t n = 0;
  for (size_t i = 0; i < A; i++) {
    for (size_t k = 0; k < B; k++) {
      for (int face = 0; face < 2; face++, n++) {
        b->opacity[n] = opacity[i], b->uncertainty[n] = uncertainty[k], b->face[n] = (float)face;
        b->attention[n] = 1024 * 6, b->eye[n] = 1024;
        for (size_t c = 0; c < 3; c++) b->pixel[c * MOST + n] = b->truth[c * MOST + n] = k % 2 ? uniform(1, n + c) : 0;
        if (i % 2) b->pixel[n] = 1;
      }
    }
  }
  run(b, n);
  for (size_t r = 0; r < n; r++) {
    const bool inside = b->opacity[r] >= 1e-5f && b->opacity[r] <= 1 - 1e-5f;
    assert_true((b->dopacity[r] != 0) == (inside && b->opacity[r] != 0.5f));
    if (b->opacity[r] == 1e-5f) near(b->dopacity[r], 1e-4 * log2((1 - 1e-5) / 1e-5) / (double)n);
  }
  /* exactly the truth and certain: nothing to learn */
  memset(b->pixel, 0, sizeof b->pixel), memset(b->truth, 0, sizeof b->truth);
  memset(b->uncertainty, 0, sizeof b->uncertainty);
  for (size_t r = 0; r < n; r++) b->face[r] = 1;
  run(b, n);
  assert_true(b->terms[ERN_LOSS_PHOTOMETRIC] == 0 && b->terms[ERN_LOSS_UNCERTAINTY] == 0);
  for (size_t r = 0; r < n; r++) assert_true(b->dpixel[r] == 0 && b->duncertainty[r] == 0);
  free(b);
}

/* log(beta) of an uncertainty far below the resolution of 1 + u still has its digits. */
static void test_small_uncertainty(void **state) {
  (void)state;
  struct batch *b = batch_new();
  b->weights.s = 1;
  b->face[0] = 1;
  b->uncertainty[0] = 1e-12f;
  run(b, 1);
  near(b->duncertainty[0], 1e-12);
  free(b);
}

/* No rays; one ray; no eye branch; no attention. */
static void test_absent(void **state) {
  (void)state;
  struct batch *b = batch_new();
  run(b, 0);
  for (int k = 0; k < ERN_LOSS_SMOOTHNESS; k++) assert_true(b->terms[k] == 0);
  b->pixel[0] = 1, b->uncertainty[0] = 3, b->eye[0] = 2, b->attention[0] = 4, b->face[0] = 1;
  run(b, 1);
  near(b->dpixel[0], 2.0 / 3); /* its share is 1 */
  assert_true(b->terms[ERN_LOSS_EYE_AMBIENT] > 0);
  struct ern_head_loss_view view = view_of(b);
  view.eye = NULL, view.deye = NULL;
  const struct ern_softmax softmax = ern_head_softmax_ref(b->uncertainty, 1);
  ern_head_loss_ref(b->terms, &view, &b->weights, STEPS, &softmax, 1, 1);
  assert_true(b->terms[ERN_LOSS_EYE_AMBIENT] == 0 && b->terms[ERN_LOSS_PHOTOMETRIC] > 0);
  view.attention = NULL, view.dattention = NULL;
  b->face[0] = 0;
  ern_head_loss_ref(b->terms, &view, &b->weights, STEPS, &softmax, 1, 1);
  assert_true(b->terms[ERN_LOSS_AUDIO_AMBIENT] == 0 && b->terms[ERN_LOSS_STATIC_UNCERTAINTY] > 0);
  free(b);
}

static void test_small_losses(void **state) {
  (void)state;
  const float still[3] = {1, 2, 3}, moved[3] = {1, 2.5f, 1};
  float gradient[9];
  near(ern_smooth_loss_ref(gradient, still, moved, 6, 3, 3), 6 * (0.25 + 4) / 3);
  near(gradient[1], 6 * 2 * 0.5 / 3);
  near(gradient[2], 6 * 2 * -2 / 3.0);
  assert_true(gradient[0] == 0);
  assert_true(ern_smooth_loss_ref(gradient, still, moved, 6, 0, 0) == 0);

  const float pixel[9] = {0, 1, 9, 0.5f, 0, 9, 0.25f, 0, 9}, truth[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
  near(ern_mse_ref(gradient, pixel, truth, 3, 2, 2), (1 + 0.25 + 0.0625) / 6); /* two rays, stride 3 */
  near(gradient[1], 2.0 / 6);
  near(gradient[3], 1.0 / 6);
  assert_true(ern_mse_ref(gradient, pixel, truth, 3, 0, 0) == 0);

  const float anchors[12] = {5, 5, 5, 1, 5, 5, 5, 0.5f, 5, 5, 5, 2};
  float danchors[12] = {0};
  near(ern_key_points_loss_ref(danchors, anchors), (0.25 + 1) / 3);
  near(danchors[7], -2 * 0.5 / 3);
  near(danchors[11], 2 * 1 / 3.0);
  for (int i = 0; i < 12; i++) assert_true(danchors[i] == 0 || i == 7 || i == 11);
}

/* Within reach, the same whatever part of the samples is asked for, other numbers at another step. */
static void test_smooth_points(void **state) {
  (void)state;
  enum { COUNT = 3000, STRIDE = COUNT + 8 };
  static float x[3 * STRIDE], moved[3 * STRIDE], part[3 * STRIDE], later[3 * STRIDE];
  for (size_t i = 0; i < 3 * STRIDE; i++) x[i] = 0.01f * uniform(9, i);
  ern_smooth_points_ref(moved, x, STRIDE, 1e-3f, 5, 16, 0, COUNT);
  ern_smooth_points_ref(part + 700, x + 700, STRIDE, 1e-3f, 5, 16, 700, COUNT - 700);
  ern_smooth_points_ref(later, x, STRIDE, 1e-3f, 5, 32, 0, COUNT);
  double mean = 0, square = 0;
  for (size_t axis = 0; axis < 3; axis++) {
    for (size_t i = 0; i < COUNT; i++) {
      const size_t at = axis * STRIDE + i;
      const double offset = ((double)moved[at] - (double)x[at]) / 1e-3;
      assert_true(fabs(offset) <= 1 + 1e-5);
      if (i >= 700) assert_true(moved[at] == part[at]);
      assert_true(moved[at] != later[at]);
      mean += offset / (3 * COUNT);
      square += offset * offset / (3 * COUNT);
    }
  }
  assert_true(fabs(mean) < 5 * sqrt(1.0 / 3 / (3 * COUNT)));
  assert_true(fabs(square - 1.0 / 3) < 5 * sqrt(4.0 / 45 / (3 * COUNT)));
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_by_hand),      cmocka_unit_test(test_schedule),          cmocka_unit_test(test_softmax),
      cmocka_unit_test(test_ends),         cmocka_unit_test(test_small_uncertainty), cmocka_unit_test(test_absent),
      cmocka_unit_test(test_small_losses), cmocka_unit_test(test_smooth_points),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
