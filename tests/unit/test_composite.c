/* SPDX-License-Identifier: MIT
 * Compositing against the definition in long double, and at the ends of the numbers. test_composite64.c runs the same
 * in the double build. */
#include "../support.h"

#include <float.h>
#include <tgmath.h>

#include "core/rng.h"
#include "render/composite_ops.h"

enum { RAYS = 64, SAMPLES = 4096, STRIDE = SAMPLES + 5, RAY_STRIDE = RAYS + 3 };

/* Sums of at most 1,024 terms of one sign: no more than a few hundred roundings in practice. */
static const double tolerance = sizeof(ern_real) == sizeof(float) ? 2e-5 : 1e-13;
static const float stop = 1e-4f;

struct scene {
  int32_t first[RAYS + 1];
  size_t rays;
  ern_real sigma[SAMPLES], dt[SAMPLES], distance[SAMPLES], attention[SAMPLES], eye[SAMPLES], uncertainty[SAMPLES];
  ern_real rgb[3 * STRIDE], background[3 * RAY_STRIDE];
  ern_real pixel[3 * RAY_STRIDE], colour[3 * RAY_STRIDE], opacity[RAYS], depth[RAYS], attention_sum[RAYS];
  ern_real eye_sum[RAYS], uncertainty_sum[RAYS];
  ern_real dpixel[3 * RAY_STRIDE], dopacity[RAYS], dattention[RAYS], deye[RAYS], duncertainty[RAYS];
  ern_real dsigma[SAMPLES], drgb[3 * STRIDE], dsample_attention[SAMPLES], dsample_eye[SAMPLES];
  ern_real dsample_uncertainty[SAMPLES];
};

static ern_real uniform(uint64_t seed, size_t at) {
  return ern_uniform(ern_random_at(seed, 0, (uint32_t)at, ERN_RNG_INIT).word[0]);
}

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
                                     .ray_stride = RAY_STRIDE,
                                     .rgb_stride = STRIDE,
                                     .transmittance_stop = stop};
}

static struct ern_composite_bwd_view bwd_view_of(struct scene *s) {
  return (struct ern_composite_bwd_view){.dsigma = s->dsigma,
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
}

/* Everything but densities and the samples of each ray. */
static struct scene *scene_new(void) {
  struct scene *s = calloc(1, sizeof *s);
  assert_non_null(s);
  s->rays = RAYS;
  for (size_t i = 0; i < SAMPLES; i++) {
    s->dt[i] = (ern_real)0.01 + uniform(1, i) / 50;
    s->distance[i] = 2 + uniform(2, i);
    s->attention[i] = uniform(3, i) * 4;
    s->eye[i] = uniform(4, i);
    s->uncertainty[i] = uniform(5, i);
  }
  for (size_t i = 0; i < 3 * STRIDE; i++) s->rgb[i] = uniform(6, i);
  for (size_t i = 0; i < 3 * RAY_STRIDE; i++) {
    s->background[i] = uniform(7, i);
    s->dpixel[i] = 2 * uniform(8, i) - 1;
  }
  for (size_t r = 0; r < RAYS; r++) {
    s->dopacity[r] = 2 * uniform(9, r) - 1;
    s->dattention[r] = 2 * uniform(10, r) - 1;
    s->deye[r] = 2 * uniform(11, r) - 1;
    s->duncertainty[r] = 2 * uniform(12, r) - 1;
  }
  return s;
}

static void near(ern_real found, long double expected, double absolute) {
  const double error = fabs((double)((long double)found - expected));
  if (!(error <= absolute + tolerance * fabs((double)expected))) {
    fail_msg("%.9g, expected %.9Lg", (double)found, expected);
  }
}

/* One ray by the definition. False where rounding decides how many samples count. */
static bool expect_ray(const struct scene *s, size_t r) {
  long double light = 1, opacity = 0, depth = 0, attention = 0, eye = 0, uncertainty = 0, colour[3] = {0, 0, 0};
  for (int32_t i = s->first[r]; i < s->first[r + 1]; i++) {
    if (i > s->first[r] && fabsl(light / (long double)stop - 1) < 1e-3L) return false;
    if (i > s->first[r] && light < (long double)stop) break;
    const long double alpha = -expm1l(-(long double)s->sigma[i] * (long double)s->dt[i]), w = alpha * light;
    light *= 1 - alpha;
    for (size_t c = 0; c < 3; c++) colour[c] += w * (long double)s->rgb[c * STRIDE + (size_t)i];
    opacity += w;
    depth += w * (long double)s->distance[i];
    attention += (long double)s->attention[i];
    eye += (long double)s->eye[i];
    uncertainty += w * (long double)s->uncertainty[i];
  }
  near(s->opacity[r], opacity, 0);
  near(s->depth[r], depth, 0);
  near(s->attention_sum[r], attention, 0);
  near(s->eye_sum[r], eye, 0);
  near(s->uncertainty_sum[r], uncertainty, 0);
  for (size_t c = 0; c < 3; c++) {
    const size_t at = c * RAY_STRIDE + r;
    const long double value = colour[c] + (1 - opacity) * (long double)s->background[at];
    near(s->colour[at], colour[c], 0);
    near(s->pixel[at], fminl(fmaxl(value, 0), 1), tolerance);
  }
  return true;
}

static void expect_finite(const ern_real *values, size_t count) {
  for (size_t i = 0; i < count; i++) {
    if (!isfinite(values[i])) fail_msg("[%zu] is %g", i, (double)values[i]);
  }
}

/* Forward against the definition, backward finite. */
static void run(struct scene *s) {
  const struct ern_composite_view view = view_of(s);
  const struct ern_composite_bwd_view bwd = bwd_view_of(s);
  const size_t total = (size_t)s->first[s->rays];
  size_t doubtful = 0;
  ERN_REF(ern_composite_fwd)(&view, s->rays);
  for (size_t r = 0; r < s->rays; r++) doubtful += !expect_ray(s, r);
  assert_true(10 * doubtful <= s->rays);
  for (size_t i = 0; i < total; i++) s->dsigma[i] = NAN; /* has to be written */
  ERN_REF(ern_composite_bwd)(&bwd, s->rays);
  expect_finite(s->dsigma, total);
  expect_finite(s->dsample_attention, total);
  expect_finite(s->dsample_eye, total);
  expect_finite(s->dsample_uncertainty, total);
  for (size_t c = 0; c < 3; c++) expect_finite(s->drgb + c * STRIDE, total);
}

static void deal(struct scene *s, size_t each) {
  for (size_t r = 0; r < RAYS; r++) s->first[r + 1] = (int32_t)((r + 1) * each);
}

static void test_definition(void **state) {
  (void)state;
  struct scene *s = scene_new();
  for (size_t i = 0; i < SAMPLES; i++) s->sigma[i] = exp((ern_real)9 * uniform(20, i) - 3);
  for (size_t each = 1; each <= SAMPLES / RAYS; each *= 4) {
    deal(s, each);
    run(s);
  }
  /* rays of every length, also of none */
  for (size_t r = 0; r < RAYS; r++) s->first[r + 1] = s->first[r] + (int32_t)(r * 5 % 17);
  run(s);
  free(s);
}

/* sigma dt from 1e-30 to 1e30, the same along a ray and mixed. */
static void test_range(void **state) {
  (void)state;
  struct scene *s = scene_new();
  deal(s, 61);
  for (size_t i = 0; i < SAMPLES; i++) {
    const size_t exponent = i / 61 < 61 ? i / 61 : i % 61;
    s->sigma[i] = pow((ern_real)10, (ern_real)exponent - 30) / s->dt[i];
  }
  run(s);
  /* thin: opacity is the sum of sigma dt, to the last digits, where 1 - exp(-x) would be 0 */
  near(s->opacity[0], 61e-30L, 0);
  near(s->opacity[10], 61e-20L, 0);
  /* solid: alpha rounds to 1, the first sample takes all and the rest does not count */
  for (size_t r = 33; r < 61; r++) {
    assert_true(s->opacity[r] == 1 && s->depth[r] == s->distance[r * 61]);
    assert_true(s->attention_sum[r] == s->attention[r * 61]);
    for (size_t k = 0; k < 61; k++) {
      assert_true(s->dsigma[r * 61 + k] == 0);
      assert_true(s->dsample_uncertainty[r * 61 + k] == (k == 0 ? s->duncertainty[r] : 0));
    }
  }
  /* the largest numbers there are: sigma dt overflows */
  for (size_t i = 0; i < SAMPLES; i++) {
    s->sigma[i] = sizeof(ern_real) == sizeof(float) ? (ern_real)FLT_MAX : (ern_real)DBL_MAX;
    s->dt[i] = 2;
  }
  run(s);
  for (size_t r = 0; r < RAYS; r++) assert_true(s->opacity[r] == 1);
  /* nothing there at all */
  for (size_t i = 0; i < SAMPLES; i++) s->sigma[i] = 0;
  run(s);
  for (size_t r = 0; r < RAYS; r++) {
    assert_true(s->opacity[r] == 0 && s->attention_sum[r] > 0);
    for (size_t c = 0; c < 3; c++) assert_true(s->pixel[c * RAY_STRIDE + r] == s->background[c * RAY_STRIDE + r]);
  }
  free(s);
}

/* Thin samples have a gradient that does not vanish: dL/dsigma = dt dL/dw. */
static void test_thin_gradient(void **state) {
  (void)state;
  struct scene *s = scene_new();
  deal(s, 16);
  for (size_t i = 0; i < SAMPLES; i++) s->sigma[i] = (ern_real)1e-28;
  run(s);
  for (size_t i = 0; i < 16 * RAYS; i++) {
    const size_t r = i / 16;
    long double dw = (long double)s->dopacity[r] + (long double)s->duncertainty[r] * (long double)s->uncertainty[i];
    long double size = fabsl(dw) + 1;
    for (size_t c = 0; c < 3; c++) {
      const size_t at = c * RAY_STRIDE + r;
      dw += (long double)s->dpixel[at] * ((long double)s->rgb[c * STRIDE + i] - (long double)s->background[at]);
      size += fabsl((long double)s->dpixel[at]);
    }
    near(s->dsigma[i], dw * (long double)s->dt[i], tolerance * (double)(size * (long double)s->dt[i]));
  }
  free(s);
}

/* No samples: the background, no opacity. */
static void test_empty(void **state) {
  (void)state;
  struct scene *s = scene_new();
  run(s);
  for (size_t r = 0; r < RAYS; r++) {
    assert_true(s->opacity[r] == 0 && s->depth[r] == 0 && s->attention_sum[r] == 0 && s->uncertainty_sum[r] == 0);
    for (size_t c = 0; c < 3; c++) assert_true(s->pixel[c * RAY_STRIDE + r] == s->background[c * RAY_STRIDE + r]);
  }
  const struct ern_composite_view view = view_of(s);
  ERN_REF(ern_composite_fwd)(&view, 0);
  free(s);
}

/* A channel outside [0, 1] is clamped and passes no gradient; at the ends it does, as in torch.clamp. */
static void test_clamp(void **state) {
  (void)state;
  static const ern_real value[] = {-1, -(ern_real)1e-6, 0, (ern_real)0.5, 1, 1 + (ern_real)1e-6, 2};
  enum { VALUES = sizeof value / sizeof *value };
  struct scene *s = scene_new();
  deal(s, 1);
  for (size_t r = 0; r < RAYS; r++) {
    s->sigma[r] = (ern_real)1e30; /* the pixel is the sample's colour */
    for (size_t c = 0; c < 3; c++) s->rgb[c * STRIDE + r] = value[(r + c) % VALUES];
  }
  run(s);
  for (size_t r = 0; r < RAYS; r++) {
    for (size_t c = 0; c < 3; c++) {
      const ern_real here = value[(r + c) % VALUES];
      const bool passes = here >= 0 && here <= 1;
      assert_true(s->pixel[c * RAY_STRIDE + r] == (here < 0 ? 0 : here > 1 ? 1 : here));
      assert_true(s->drgb[c * STRIDE + r] == (passes ? s->dpixel[c * RAY_STRIDE + r] : 0));
    }
  }
  /* without samples: the background is clamped too, and nothing else to pass a gradient to */
  memset(s->first, 0, sizeof s->first);
  for (size_t i = 0; i < 3 * RAY_STRIDE; i++) s->background[i] = value[i % VALUES];
  run(s);
  for (size_t r = 0; r < RAYS; r++) assert_in_range((int)(s->pixel[r] * 100), 0, 100);
  free(s);
}

/* Optional outputs and inputs: what remains is the same. */
static void test_absent(void **state) {
  (void)state;
  struct scene *s = scene_new(), *few = scene_new();
  for (size_t i = 0; i < SAMPLES; i++) s->sigma[i] = few->sigma[i] = 10 * uniform(30, i);
  deal(s, 9), deal(few, 9);
  run(s);
  struct ern_composite_view view = view_of(few);
  view.pixel = view.eye = view.uncertainty = view.depth = view.attention = NULL;
  view.sample_depth = view.sample_eye = view.sample_uncertainty = view.sample_attention = view.background = NULL;
  ERN_REF(ern_composite_fwd)(&view, RAYS);
  assert_memory_equal(s->opacity, few->opacity, sizeof s->opacity);
  assert_memory_equal(s->colour, few->colour, sizeof s->colour);
  view = view_of(few);
  view.colour = view.opacity = NULL;
  ERN_REF(ern_composite_fwd)(&view, RAYS);
  assert_memory_equal(s->pixel, few->pixel, sizeof s->pixel);
  free(s), free(few);
}

/* A part of the rays, by pointers that stand at the first of them. */
static void test_parts(void **state) {
  (void)state;
  struct scene *s = scene_new(), *parts = scene_new();
  for (size_t i = 0; i < SAMPLES; i++) s->sigma[i] = parts->sigma[i] = 30 * uniform(31, i);
  deal(s, 7), deal(parts, 7);
  run(s);
  for (size_t begin = 0, n; begin < RAYS; begin += n) {
    n = begin + 23 < RAYS ? 23 : RAYS - begin;
    struct ern_composite_view view = view_of(parts);
    view.pixel += begin, view.colour += begin, view.opacity += begin, view.depth += begin, view.attention += begin;
    view.eye += begin, view.uncertainty += begin, view.first += begin, view.background += begin;
    ERN_REF(ern_composite_fwd)(&view, n);
    struct ern_composite_bwd_view bwd = bwd_view_of(parts);
    bwd.dpixel += begin, bwd.dopacity += begin, bwd.dattention += begin, bwd.deye += begin, bwd.duncertainty += begin;
    bwd.forward = view;
    ERN_REF(ern_composite_bwd)(&bwd, n);
  }
  assert_memory_equal(s->pixel, parts->pixel, sizeof s->pixel);
  assert_memory_equal(s->uncertainty_sum, parts->uncertainty_sum, sizeof s->uncertainty_sum);
  assert_memory_equal(s->dsigma, parts->dsigma, sizeof s->dsigma);
  assert_memory_equal(s->drgb, parts->drgb, sizeof s->drgb);
  assert_memory_equal(s->dsample_eye, parts->dsample_eye, sizeof s->dsample_eye);
  free(s), free(parts);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_definition), cmocka_unit_test(test_range), cmocka_unit_test(test_thin_gradient),
      cmocka_unit_test(test_empty),      cmocka_unit_test(test_clamp), cmocka_unit_test(test_absent),
      cmocka_unit_test(test_parts),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
