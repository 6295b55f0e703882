/* SPDX-License-Identifier: MIT
 * Backward of the compositing against central differences in double: short, long, empty and spent rays, clamped and
 * unclamped pixels. */
#define ERN_DOUBLE
#include "difference.h"
#include "render/composite_ops.h"

enum { RAYS = 40, MOST = 24, SAMPLES = RAYS * MOST };

struct scene {
  int32_t first[RAYS + 1];
  double sigma[SAMPLES], dt[SAMPLES], distance[SAMPLES], attention[SAMPLES], eye[SAMPLES], uncertainty[SAMPLES];
  double rgb[3 * SAMPLES], background[3 * RAYS];
  double pixel[3 * RAYS], colour[3 * RAYS], opacity[RAYS], depth[RAYS], attention_sum[RAYS], eye_sum[RAYS];
  double uncertainty_sum[RAYS];
  double dpixel[3 * RAYS], dopacity[RAYS], dattention[RAYS], deye[RAYS], duncertainty[RAYS];
  double dsigma[SAMPLES], drgb[3 * SAMPLES], dsample_attention[SAMPLES], dsample_eye[SAMPLES];
  double dsample_uncertainty[SAMPLES];
};

static const float stop = 1e-4f;

static struct ern_composite_view view_of(struct scene *s) {
  return (struct ern_composite_view){.pixel = s->pixel,
                                     .colour = s->colour,
                                     .opacity = s->opacity,
                                     .depth = s->depth,
                                     .attention = s->attention_sum,
                                     .eye = s->eye_sum,
                                     .uncertainty = s->uncertainty_sum,
                                     .first = s->first,
                                     .sigma = s->sigma,
                                     .dt = s->dt,
                                     .sample_depth = s->distance,
                                     .sample_attention = s->attention,
                                     .sample_eye = s->eye,
                                     .sample_uncertainty = s->uncertainty,
                                     .rgb = s->rgb,
                                     .background = s->background,
                                     .ray_stride = RAYS,
                                     .rgb_stride = SAMPLES,
                                     .transmittance_stop = stop};
}

/* Samples of a ray from 0 to MOST; densities from thin to solid, so that some rays are spent on the way; colours beyond
 * [0, 1], so that some channels are clamped at either end. */
static void fill(struct scene *s, double colour_reach) {
  memset(s, 0, sizeof *s);
  for (int r = 0; r < RAYS; r++) s->first[r + 1] = s->first[r] + (r * 7) % (MOST + 1);
  for (uint32_t i = 0; i < SAMPLES; i++) {
    s->sigma[i] = exp(4 * difference_random(1, i) + 3);
    s->dt[i] = 0.02 + 0.01 * difference_random(2, i);
    s->distance[i] = 3 + difference_random(3, i);
    s->attention[i] = 2 + difference_random(4, i);
    s->eye[i] = 0.5 + 0.5 * difference_random(5, i);
    s->uncertainty[i] = 1 + difference_random(6, i);
  }
  for (uint32_t i = 0; i < 3 * SAMPLES; i++) s->rgb[i] = 0.5 + colour_reach * difference_random(7, i);
  for (uint32_t i = 0; i < 3 * RAYS; i++) s->background[i] = 0.5 + colour_reach * difference_random(8, i);
  difference_fill(s->dpixel, 3 * RAYS, 1, 9);
  difference_fill(s->dopacity, RAYS, 1, 10);
  difference_fill(s->dattention, RAYS, 1, 11);
  difference_fill(s->deye, RAYS, 1, 12);
  difference_fill(s->duncertainty, RAYS, 1, 13);
}

static double loss_of(void *user) {
  struct scene *s = user;
  const struct ern_composite_view view = view_of(s);
  ern_composite_fwd_ref64(&view, RAYS);
  double loss = 0;
  for (int i = 0; i < 3 * RAYS; i++) loss += s->pixel[i] * s->dpixel[i];
  for (int r = 0; r < RAYS; r++) {
    loss += s->opacity[r] * s->dopacity[r] + s->attention_sum[r] * s->dattention[r] + s->eye_sum[r] * s->deye[r] +
            s->uncertainty_sum[r] * s->duncertainty[r];
  }
  return loss;
}

/* How many samples of each ray count, and on which side of the clamp each channel is, worked out once more. */
static uint64_t piece_of(void *user) {
  const struct scene *s = user;
  uint64_t hash = 0xcbf29ce484222325u;
  for (int r = 0; r < RAYS; r++) {
    double light = 1, pixel[3] = {0, 0, 0};
    int32_t i = s->first[r];
    for (; i < s->first[r + 1] && (i == s->first[r] || light >= (double)stop); i++) {
      const double through = exp(-s->sigma[i] * s->dt[i]);
      for (int c = 0; c < 3; c++) pixel[c] += light * (1 - through) * s->rgb[c * SAMPLES + i];
      light *= through;
    }
    hash = difference_hash(hash, (uint64_t)i);
    for (int c = 0; c < 3; c++) {
      const double value = pixel[c] + light * s->background[c * RAYS + r];
      hash = difference_hash(hash, value < 0 ? 0 : value > 1 ? 2 : 1);
    }
  }
  return hash;
}

static void backward(struct scene *s) {
  loss_of(s);
  const struct ern_composite_bwd_view view = {.dsigma = s->dsigma,
                                              .drgb = s->drgb,
                                              .dsample_attention = s->dsample_attention,
                                              .dsample_eye = s->dsample_eye,
                                              .dsample_uncertainty = s->dsample_uncertainty,
                                              .dpixel = s->dpixel,
                                              .dopacity = s->dopacity,
                                              .dattention = s->dattention,
                                              .deye = s->deye,
                                              .duncertainty = s->duncertainty,
                                              .forward = view_of(s)};
  ern_composite_bwd_ref64(&view, RAYS);
}

static void check_all(double colour_reach) {
  static struct scene s;
  fill(&s, colour_reach);
  /* values that the backward pass has to overwrite */
  difference_fill(s.dsigma, SAMPLES, 1, 20);
  difference_fill(s.drgb, 3 * SAMPLES, 1, 21);
  difference_fill(s.dsample_attention, SAMPLES, 1, 22);
  difference_fill(s.dsample_eye, SAMPLES, 1, 23);
  difference_fill(s.dsample_uncertainty, SAMPLES, 1, 24);
  backward(&s);
  const size_t total = (size_t)s.first[RAYS];
  const struct difference of = {loss_of, piece_of, &s};
  difference_check(&of, "sigma", s.sigma, s.dsigma, total, 1);
  for (size_t c = 0; c < 3; c++) difference_check(&of, "rgb", s.rgb + c * SAMPLES, s.drgb + c * SAMPLES, total, 1);
  difference_check(&of, "attention", s.attention, s.dsample_attention, total, 1);
  difference_check(&of, "eye", s.eye, s.dsample_eye, total, 1);
  difference_check(&of, "uncertainty", s.uncertainty, s.dsample_uncertainty, total, 1);
}

static void test_inside(void **state) {
  (void)state;
  check_all(0.5);
}

static void test_clamped(void **state) {
  (void)state;
  check_all(1.5);
}

/* Samples behind the stop get zeros, written. */
static void test_spent(void **state) {
  (void)state;
  static struct scene s;
  fill(&s, 0.5);
  backward(&s);
  size_t spent = 0;
  for (int r = 0; r < RAYS; r++) {
    double light = 1;
    for (int32_t i = s.first[r]; i < s.first[r + 1]; i++) {
      if (i > s.first[r] && light < (double)stop) {
        spent++;
        assert_true(s.dsigma[i] == 0 && s.drgb[i] == 0 && s.dsample_attention[i] == 0 && s.dsample_eye[i] == 0);
        assert_true(s.dsample_uncertainty[i] == 0);
      } else {
        assert_true(s.drgb[i] != 0 && s.dsample_attention[i] != 0);
      }
      light *= exp(-s.sigma[i] * s.dt[i]);
    }
  }
  assert_true(spent > 20);
}

/* Without the optional quantities the rest is as if they had no weight in the loss. */
static void test_absent(void **state) {
  (void)state;
  static struct scene with, without;
  fill(&with, 0.5);
  memset(with.dopacity, 0, sizeof with.dopacity);
  memset(with.duncertainty, 0, sizeof with.duncertainty);
  without = with;
  backward(&with);
  loss_of(&without);
  struct ern_composite_bwd_view view = {
      .dsigma = without.dsigma, .drgb = without.drgb, .dpixel = without.dpixel, .forward = view_of(&without)};
  view.forward.sample_eye = view.forward.sample_uncertainty = view.forward.sample_attention = NULL;
  ern_composite_bwd_ref64(&view, RAYS);
  assert_memory_equal(with.dsigma, without.dsigma, sizeof with.dsigma);
  assert_memory_equal(with.drgb, without.drgb, sizeof with.drgb);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_inside),
      cmocka_unit_test(test_clamped),
      cmocka_unit_test(test_spent),
      cmocka_unit_test(test_absent),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
