/* SPDX-License-Identifier: MIT
 * Compositing at its ends: no light left, all of it left, and gradients through both (docs/numerics.md). */
#include "machines.h"
#include "render/composite_ops.h"

enum { MOST = 4096 };
static const float stop = 1e-4f;

/* Rays of samples, and what came of them. All upstream gradients are 1, the background is white. */
struct light {
  size_t rays, samples;
  int32_t first[MOST + 1];
  float sigma[MOST], dt[MOST];
  struct many pixel, colour, opacity, depth, attention, uncertainty;
  struct many dsigma, drgb, dattention, duncertainty;
};
static struct light light;

static void begin(void) {
  machines_clear();
  light.rays = light.samples = 0;
}
static void add(float sigma, float dt) {
  assert_true(light.samples < MOST);
  light.sigma[light.samples] = sigma;
  light.dt[light.samples++] = dt;
}
static void end_ray(void) { light.first[++light.rays] = (int32_t)light.samples; }

struct inputs {
  struct many first, sigma, dt, distance, attention, uncertainty, rgb, background, ones;
};

static struct inputs inputs_make(const float *colours, const float *ones) {
  const size_t n = light.rays, total = light.samples;
  return (struct inputs){.first = many_int32s(light.first, n + 1),
                         .sigma = many_reals(light.sigma, total),
                         .dt = many_reals(light.dt, total),
                         .distance = many_reals(ones, total),
                         .attention = many_reals(ones, total),
                         .uncertainty = many_reals(ones, total),
                         .rgb = many_reals(colours, 3 * total),
                         .background = many_reals(ones, 3 * n),
                         .ones = many_reals(ones, 3 * n)};
}

static void shine(void) {
  const size_t n = light.rays, total = light.samples;
  static float colours[3 * MOST], ones[3 * MOST];
  for (size_t i = 0; i < 3 * MOST; i++) ones[i] = 1, colours[i] = 0.5f + machines_random(1, i, 0.5f);
  const struct inputs in = inputs_make(colours, ones);
  struct many *const per_ray[] = {&light.opacity, &light.depth, &light.attention, &light.uncertainty};
  struct many *const per_sample[] = {&light.dsigma, &light.dattention, &light.duncertainty};
  for (size_t i = 0; i < COUNT_OF(per_ray); i++) *per_ray[i] = many_empty(n);
  for (size_t i = 0; i < COUNT_OF(per_sample); i++) *per_sample[i] = many_empty(total);
  light.pixel = many_empty(3 * n), light.colour = many_empty(3 * n), light.drgb = many_empty(3 * total);
  struct ern_composite_fwd_args forward[MACHINES];
  for (int k = 0; k < machines.count; k++)
    forward[k] = (struct ern_composite_fwd_args){.pixel = {light.pixel.on[k], n, 3, ERN_PER_RAY},
                                                 .colour = {light.colour.on[k], n, 3, ERN_PER_RAY},
                                                 .opacity = light.opacity.on[k],
                                                 .depth = light.depth.on[k],
                                                 .attention = light.attention.on[k],
                                                 .uncertainty = light.uncertainty.on[k],
                                                 .first = in.first.on[k],
                                                 .sigma = in.sigma.on[k],
                                                 .dt = in.dt.on[k],
                                                 .sample_depth = in.distance.on[k],
                                                 .sample_attention = in.attention.on[k],
                                                 .sample_uncertainty = in.uncertainty.on[k],
                                                 .rgb = {in.rgb.on[k], total, 3, ERN_PER_SAMPLE},
                                                 .background = {in.background.on[k], n, 3, ERN_PER_RAY},
                                                 .transmittance_stop = stop,
                                                 .n = n};
  ON_EACH(composite_fwd, ern_composite_fwd_args, forward[k])
  ON_EACH(composite_bwd, ern_composite_bwd_args,
          {.dsigma = light.dsigma.on[k],
           .drgb = {light.drgb.on[k], total, 3, ERN_PER_SAMPLE},
           .dsample_attention = light.dattention.on[k],
           .dsample_uncertainty = light.duncertainty.on[k],
           .dpixel = {in.ones.on[k], n, 3, ERN_PER_RAY},
           .dopacity = in.ones.on[k],
           .dattention = in.ones.on[k],
           .duncertainty = in.ones.on[k],
           .forward = forward[k]})
}

/* Relative rounding of K samples, as kernelcheck/composite.c derives it: 6 K + 8 roundings; a sum of weights
 * is at most 1 but for as many. What passes the stop elsewhere than in double is at most `stop` of the light. */
static double rounding(size_t samples) { return (6 * (double)samples + 8) * 0x1p-23; }

/* Weights sum to 1 at most; a gradient by sigma is at most dt times the sizes of its upstream gradients: 3 of pixels
 * (of a difference of colours in [-1, 1]), opacity, uncertainty. */
static void expect_sane(size_t most_samples, float most_dt) {
  const double over = rounding(most_samples);
  expect_within("opacity", light.opacity, 0, 1 + over);
  expect_within("depth", light.depth, 0, 1 + over);
  expect_within("colour", light.colour, 0, 1 + over);
  expect_within("pixel", light.pixel, 0, 1);
  expect_within("attention", light.attention, 0, (double)most_samples);
  expect_within("dsigma", light.dsigma, -10 * (double)most_dt, 10 * (double)most_dt);
  expect_within("drgb", light.drgb, 0, 1 + over);
  expect_within("duncertainty", light.duncertainty, 0, 1 + over);
}
static void expect_true_light(size_t most_samples) {
  const double r = rounding(most_samples);
  expect_truth("opacity", light.opacity, r, FLT_MIN);
  expect_truth("colour", light.colour, r, FLT_MIN);
  expect_truth("pixel", light.pixel, r, r);
  expect_truth("depth", light.depth, r, FLT_MIN);
}

/* case: sigma dt from 1e-30 to 1e30 | plain code: `1 - exp(-tau)` is 0 below tau = 6e-8 | here: `-expm1(-tau)` and
 * `exp(-tau)` | bound: 14 x 2^-23 of the value */
/* sigma*dt from 1e-30 to 1e30, each alone on its ray; both small and large factors of it. */
static void test_optical_depth_from_1e_minus_30_to_1e30(void **state) {
  (void)state;
  begin();
  for (int e = -30; e <= 30; e++) {
    add(powf(10, (float)e), 1), end_ray();
    add(powf(10, (float)e - 4 > -37 ? (float)e - 4 : -37), 1e4f), end_ray();
    add(powf(10, (float)e + 4), 1e-4f), end_ray();
  }
  shine();
  expect_sane(1, 1e4f);
  expect_true_light(1);
  expect_at("opacity of 1e-30", light.opacity, 0, 1e-30, 2e-36);
  expect_at("opacity of 1e30", light.opacity, 3 * 60, 1, 0);
}

/* case: sigma to infinity, dt = 1e5 | plain code: `inf * 0` | here: alpha is 1, the rest of the light 0 | bound:
 * exactly 1 */
static void test_density_overflows_the_optical_depth(void **state) {
  (void)state;
  begin();
  const float densities[] = {0, FLT_TRUE_MIN, FLT_MIN, 5.5e34f, FLT_MAX, INFINITY};
  for (size_t i = 0; i < COUNT_OF(densities); i++) add(densities[i], 1e5f), end_ray();
  shine();
  expect_sane(1, 1e5f);
  expect_true_light(1);
  for (size_t i = 3; i < COUNT_OF(densities); i++) expect_at("opacity", light.opacity, i, 1, 0);
  expect_at("opacity of nothing", light.opacity, 0, 0, 0);
}

/* case: the transmittance underflows: 64 samples of tau 90 | plain code: logarithms of 0, 0/0 | here: a product that
 * ends at the stop, no division | bound: opacity 1, 392 x 2^-23 */
/* Products of light that underflow: 1e-4 is passed at once, or never, as each sample lets through just more than it. */
static void test_transmittance_underflows(void **state) {
  (void)state;
  begin();
  for (int ray = 0; ray < 33; ray++) {
    for (int i = 0; i < 64; i++) add(i < ray ? 0.01f : 90.0f + (float)ray, 1);
    end_ray();
  }
  shine();
  expect_sane(64, 1);
  expect_true_light(64);
  for (size_t r = 0; r < 33; r++) expect_at("opacity", light.opacity, r, 1, rounding(64));
}

/* case: alpha rounds to 1, tau 9 to 1000 | plain code: `1/(1 - alpha)` infinite | here: `exp(-tau)` is kept beside
 * alpha | bound: 20 x 2^-23 */
/* exp(-tau) rounds to 0 against 1 from tau = 17.4 on, and to 0 itself from 104 on. */
static void test_alpha_rounds_to_one(void **state) {
  (void)state;
  begin();
  const float depths[] = {9, 16, 17, 17.4f, 18, 30, 87, 88.8f, 103, 104, 110, 1000};
  for (size_t i = 0; i < COUNT_OF(depths); i++) add(depths[i], 1), add(1, 1), end_ray();
  shine();
  expect_sane(2, 1);
  expect_true_light(2);
  for (size_t i = 4; i < COUNT_OF(depths); i++) expect_at("opacity", light.opacity, i, 1, 0x1p-25);
  for (size_t i = 1; i < COUNT_OF(depths); i++) /* the second sample is past the stop and has no gradient */
    expect_at("dsigma behind", light.dsigma, 2 * i + 1, 0, 0);
}

/* case: 1,024 opaque samples, sigma = 5.5e34 | plain code: denormals, 100 times the time | here: ends at T < 1e-4;
 * gradients behind are 0 | bound: opacity exactly 1 */
static void test_ray_of_1024_opaque_samples(void **state) {
  (void)state;
  begin();
  for (int ray = 0; ray < 3; ray++) {
    for (int i = 0; i < 1024; i++) add(ray == 0 ? 5.5e34f : ray == 1 ? 1000 : 20, 0.03f);
    end_ray();
  }
  shine();
  expect_sane(1024, 0.03f);
  expect_true_light(16); /* the light is spent by then: 0.6 a sample of the last ray, 9.2 in all */
  expect_at("opacity", light.opacity, 0, 1, 0);
  expect_at("dsigma behind", light.dsigma, 1023, 0, 0);
}

/* case: a fog of 1,024 samples of tau 1e-9 to 1e-7 | plain code: it vanishes or doubles | here: `expm1` keeps each
 * weight | bound: 6152 x 2^-23 of 1 - exp(-1024 tau) */
/* 1 - exp(-tau) has no digits left below tau = 6e-8: a fog of 1,024 such samples would be nothing, or twice itself. */
static void test_ray_of_1024_thin_samples(void **state) {
  (void)state;
  begin();
  const float depths[] = {1e-9f, 3e-8f, 6e-8f, 1e-7f};
  for (size_t ray = 0; ray < COUNT_OF(depths); ray++) {
    for (int i = 0; i < 1024; i++) add(depths[ray], 1);
    end_ray();
  }
  shine();
  expect_sane(1024, 1);
  expect_true_light(1024);
  for (size_t ray = 0; ray < COUNT_OF(depths); ray++) {
    const double whole = -expm1(-1024 * (double)depths[ray]);
    expect_at("opacity", light.opacity, ray, whole, rounding(1024) * whole);
  }
}

/* case: a ray that ends at a wall, densities over 12 decades | plain code: weights sum to more than 1 | here: to 1 less
 * what the stop leaves out | bound: 554 x 2^-23 + 1e-4 */
/* The weights of a ray are a partition of the light: what goes in is out again. */
static void test_weights_and_rest_are_one(void **state) {
  (void)state;
  begin();
  for (int ray = 0; ray < 40; ray++) {
    for (int i = 0; i < 90; i++) add(powf(10, machines_random(3, (size_t)(90 * ray + i), 6)), 0.02f);
    add(1e6f, 1), end_ray(); /* a wall at the end */
  }
  shine();
  expect_sane(91, 1);
  for (size_t r = 0; r < 40; r++) expect_at("opacity", light.opacity, r, 1, rounding(91) + (double)stop);
}

/* case: gradients through an opaque sample | plain code: `-T/(1 - alpha)` is 0/0 | here: the sum behind is taken from
 * the back | bound: 960 x 2^-23 of dt */
/* (1 - w) in the denominator is 0 behind an opaque sample: ours is a sum from the back. */
static void test_gradient_through_an_opaque_sample(void **state) {
  (void)state;
  begin();
  for (int ray = 0; ray < 20; ray++) {
    for (int i = 0; i < 12; i++) add(i == ray % 12 ? (ray < 12 ? 8.5f : 1e30f) : 1e-3f, 1);
    end_ray();
  }
  shine();
  expect_sane(12, 1);
  /* dt times a sum of 5 terms of size 1 and as many products of them with weights */
  expect_truth("dsigma", light.dsigma, 0, 12 * rounding(12));
  expect_truth("drgb", light.drgb, rounding(12), FLT_MIN);
}

/* case: rays without samples, a batch without rays | plain code: mean over none, sample -1 | here: background, opacity
 * 0 | bound: exact */
static void test_rays_without_samples(void **state) {
  (void)state;
  begin();
  for (int ray = 0; ray < 19; ray++) end_ray();
  add(1, 1), end_ray();
  for (int ray = 0; ray < 18; ray++) end_ray();
  shine();
  expect_sane(1, 1);
  for (size_t r = 0; r < 38; r++) {
    if (r == 19) continue;
    expect_at("opacity", light.opacity, r, 0, 0);
    expect_at("pixel", light.pixel, r, 1, 0); /* the background */
  }
  light.rays = 0, light.samples = 0;
  shine(); /* an empty batch touches nothing, which the guards see */
  expect_within("no ray", light.opacity, 0, 0);
}

/* case: lanes differ: thin, opaque, empty, spent | plain code: an early end stops neighbours | here: each ray has its
 * own end | bound: 146 x 2^-23 */
/* Neighbours in a register differ: thin, opaque, empty, long, spent, and one that is no number. */
static void test_lanes_differ(void **state) {
  (void)state;
  static const float kinds[] = {1e-30f, 1e30f, 0, 1, NAN, 17.4f, FLT_TRUE_MIN, 5.5e34f};
  begin();
  for (size_t ray = 0; ray < 67; ray++) {
    const size_t samples = ray * 7 % 23;
    for (size_t i = 0; i < samples; i++) {
      const float sigma = kinds[(ray + i / 2) % COUNT_OF(kinds)];
      add(isnan(sigma) ? 2 : sigma, 0.5f);
    }
    end_ray();
  }
  shine();
  expect_sane(23, 0.5f);
  expect_true_light(23);
  expect_truth("dsigma", light.dsigma, 0, 12 * rounding(23));
}

/* case: one density is NaN | plain code: spreads by masks of 0 | here: its ray is NaN and no other | bound: exact */
/* One density that is no number: its ray shows it, and no other does. */
static void test_nan_stays_in_its_ray(void **state) {
  (void)state;
  for (size_t bad = 0; bad < 35; bad += 17) {
    begin();
    for (size_t ray = 0; ray < 35; ray++) add(ray == bad ? NAN : 1, 0.5f), add(2, 0.5f), end_ray();
    shine();
    for (size_t ray = 0; ray < 35; ray++) {
      const double whole = ray == bad ? (double)NAN : -expm1(-1.5);
      expect_at("opacity", light.opacity, ray, whole, 4 * 0x1p-23);
      expect_at("pixel, a NaN if there is one", light.pixel, bad, NAN, 0);
    }
    expect_truth("dsigma", light.dsigma, 0, 24 * rounding(2));
    expect_truth("pixel", light.pixel, 0, rounding(2));
  }
}

/* case: sigma dt is denormal | plain code: flushed or not | here: opacity at most that, never negative | bound: 1.2e-38
 */
/* Densities and steps so small that products are denormal: nothing is drawn, nothing is undefined. */
static void test_denormal_optical_depth(void **state) {
  (void)state;
  begin();
  for (int i = 0; i < 50; i++) add(FLT_TRUE_MIN * (float)(1 << i % 20), i % 3 == 0 ? 1 : 1e-3f), end_ray();
  shine();
  expect_sane(1, 1);
  expect_true_light(1);
  expect_within("opacity", light.opacity, 0, FLT_MIN);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_optical_depth_from_1e_minus_30_to_1e30),
      cmocka_unit_test(test_density_overflows_the_optical_depth),
      cmocka_unit_test(test_transmittance_underflows),
      cmocka_unit_test(test_alpha_rounds_to_one),
      cmocka_unit_test(test_ray_of_1024_opaque_samples),
      cmocka_unit_test(test_ray_of_1024_thin_samples),
      cmocka_unit_test(test_weights_and_rest_are_one),
      cmocka_unit_test(test_gradient_through_an_opaque_sample),
      cmocka_unit_test(test_rays_without_samples),
      cmocka_unit_test(test_lanes_differ),
      cmocka_unit_test(test_nan_stays_in_its_ray),
      cmocka_unit_test(test_denormal_optical_depth),
  };
  return cmocka_run_group_tests(tests, open_machines, close_machines);
}
