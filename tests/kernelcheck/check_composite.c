/* SPDX-License-Identifier: MIT
 * Volume rendering of each instruction set, and its gradient, against the reference in double. */
#include "kernelcheck.h"

#include <float.h>

#include "core/kernels.h"

struct kernel {
  const char *name;
  machine_isa isa;
  ern_composite_fwd_kernel *fwd;
  ern_composite_bwd_kernel *bwd;
};

static const struct kernel kernels[] = {
    {"ref", MACHINE_REF, ern_composite_fwd_ref, ern_composite_bwd_ref},
#if defined(ERN_X86_KERNELS)
    {"avx2", MACHINE_AVX2, ern_composite_fwd_avx2, ern_composite_bwd_avx2},
    {"avx512", MACHINE_AVX512, ern_composite_fwd_avx512, ern_composite_bwd_avx512},
#elif defined(ERN_ARM_KERNELS)
    {"neon", MACHINE_NEON, ern_composite_fwd_neon, ern_composite_bwd_neon},
#endif
};
enum { KERNELS = sizeof kernels / sizeof *kernels };

/* ---- a scene ---- */

/* Values of a sample, of a ray, and gradients of a sample, by row. */
enum { SIGMA, DT, RED, GREEN, BLUE, DISTANCE, ATTENTION, EYE, UNCERTAINTY, SAMPLE_ROWS };
enum { PIXEL, COLOUR = 3, OPACITY = 6, DEPTH, ATTENTION_SUM, EYE_SUM, UNCERTAINTY_SUM, RAY_ROWS };
enum { DPIXEL, DOPACITY = 3, DATTENTION, DEYE, DUNCERTAINTY, DRAY_ROWS };
enum { DSIGMA, DRED, DATTENTIONS = 4, DEYES, DUNCERTAINTIES, DSAMPLE_ROWS };

static const float stop = 1e-4f;

typedef enum densities { USUAL, WIDE, DENSE, EXTREME, BROKEN, KINDS } densities;

struct scene {
  size_t rays, samples, ray_stride, sample_stride;
  int32_t *first;
  struct guarded sample, background, dray, ray, dsample;
};

/* Samples of a ray, as the kind of scene has them. */
static int32_t count_of(uint32_t word, size_t most) {
  if (word % 3 == 0) return 0;
  return (int32_t)(word / 3 % 2 ? 1 + word / 6 % (most < 4 ? most : 4) : 1 + word / 6 % most);
}

/* sigma dt from nothing to more than light can pass. */
static float density(densities kind, const struct ern_random *random) {
  const float u = ern_uniform(random->word[0]), way = ern_uniform(random->word[1]);
  switch (kind) {
    case USUAL: return u * 60;
    case WIDE: return powf(10, u * 12 - 6);
    case DENSE: return 2000 + u * 1e5f;
    case BROKEN:
      if (way < 0.1f) return NAN;
      if (way < 0.2f) return INFINITY;
      return u * 30;
    default:
      if (way < 0.2f) return 0;
      if (way < 0.3f) return 1e-40f * u;
      if (way < 0.5f) return 1e33f * u;
      return powf(10, u * 60 - 30);
  }
}

static struct scene scene_make(densities kind, size_t rays, size_t most, uint64_t seed) {
  struct scene s = {.rays = rays, .ray_stride = rays + 5};
  s.first = calloc(rays + 1, sizeof *s.first);
  assert_non_null(s.first);
  for (size_t r = 0; r < rays; r++)
    s.first[r + 1] = s.first[r] + count_of(ern_random_at(seed, 1, (uint32_t)r, ERN_RNG_INIT).word[0], most);
  s.samples = (size_t)s.first[rays];
  s.sample_stride = s.samples + 3;
  s.sample = guarded_make(SAMPLE_ROWS * s.sample_stride);
  s.background = guarded_make(3 * s.ray_stride);
  s.dray = guarded_make(DRAY_ROWS * s.ray_stride);
  s.ray = guarded_make(RAY_ROWS * s.ray_stride);
  s.dsample = guarded_make(DSAMPLE_ROWS * s.sample_stride);
  for (size_t row = 0; row < SAMPLE_ROWS; row++) {
    for (size_t i = 0; i < s.samples; i++) {
      const struct ern_random random = ern_random_at(seed + row, 2, (uint32_t)i, ERN_RNG_INIT);
      float *to = &s.sample.data[row * s.sample_stride + i];
      *to = ern_uniform(random.word[2]) * (row == ATTENTION ? 4 : 1);
      if (row == SIGMA) *to = density(kind, &random);
      if (row == DT) *to = 0.01f + 0.02f * ern_uniform(random.word[2]);
    }
  }
  random_rows(&s.background, 3, s.ray_stride, rays, 1, seed + 20);
  random_rows(&s.dray, DRAY_ROWS, s.ray_stride, rays, 1, seed + 30);
  return s;
}

static void scene_free(struct scene *s) {
  free(s->first);
  guarded_free(&s->sample);
  guarded_free(&s->background);
  guarded_free(&s->dray);
  guarded_free(&s->ray);
  guarded_free(&s->dsample);
}

static struct ern_composite_view view_of(const struct scene *s, bool all) {
  float *const ray = s->ray.data;
  const float *const sample = s->sample.data;
  const size_t rs = s->ray_stride, ss = s->sample_stride;
  struct ern_composite_view v = {.pixel = ray + PIXEL * rs,
                                 .colour = ray + COLOUR * rs,
                                 .opacity = ray + OPACITY * rs,
                                 .depth = ray + DEPTH * rs,
                                 .attention = ray + ATTENTION_SUM * rs,
                                 .first = s->first,
                                 .sigma = sample + SIGMA * ss,
                                 .dt = sample + DT * ss,
                                 .rgb = sample + RED * ss,
                                 .sample_depth = sample + DISTANCE * ss,
                                 .sample_attention = sample + ATTENTION * ss,
                                 .background = s->background.data,
                                 .ray_stride = rs,
                                 .rgb_stride = ss,
                                 .transmittance_stop = stop};
  if (all) {
    v.eye = ray + EYE_SUM * rs;
    v.uncertainty = ray + UNCERTAINTY_SUM * rs;
    v.sample_eye = sample + EYE * ss;
    v.sample_uncertainty = sample + UNCERTAINTY * ss;
  }
  return v;
}

static struct ern_composite_bwd_view bwd_view_of(const struct scene *s, bool all) {
  float *const dsample = s->dsample.data;
  const float *const dray = s->dray.data;
  const size_t rs = s->ray_stride, ss = s->sample_stride;
  struct ern_composite_bwd_view v = {.dsigma = dsample + DSIGMA * ss,
                                     .drgb = dsample + DRED * ss,
                                     .dsample_attention = dsample + DATTENTIONS * ss,
                                     .dpixel = dray + DPIXEL * rs,
                                     .dopacity = dray + DOPACITY * rs,
                                     .dattention = dray + DATTENTION * rs,
                                     .forward = view_of(s, all)};
  if (all) {
    v.dsample_eye = dsample + DEYES * ss;
    v.dsample_uncertainty = dsample + DUNCERTAINTIES * ss;
    v.deye = dray + DEYE * rs;
    v.duncertainty = dray + DUNCERTAINTY * rs;
  }
  return v;
}

/* ---- the definition in double, with what the terms add up to without their signs ---- */

struct truth {
  double value[RAY_ROWS], size[RAY_ROWS];
};

/* How many samples of a ray count; *close: rounding may decide it otherwise. */
static size_t counted_of(const struct scene *s, size_t r, double slack, bool *close) {
  double light = 1;
  size_t i = (size_t)s->first[r];
  *close = false;
  for (; i < (size_t)s->first[r + 1]; i++) {
    if (fabs(light / (double)stop - 1) < slack) *close = true;
    if (light < (double)stop) break;
    light *=
        exp(-(double)s->sample.data[SIGMA * s->sample_stride + i] * (double)s->sample.data[DT * s->sample_stride + i]);
  }
  return i - (size_t)s->first[r];
}

static struct truth truth_of(const struct scene *s, size_t r, size_t counted) {
  struct truth t = {{0}, {0}};
  const float *const sample = s->sample.data;
  const size_t ss = s->sample_stride;
  double light = 1;
  for (size_t k = 0; k < counted; k++) {
    const size_t i = (size_t)s->first[r] + k;
    const double tau = (double)sample[SIGMA * ss + i] * (double)sample[DT * ss + i], w = -expm1(-tau) * light;
    for (size_t c = 0; c < 3; c++) t.value[COLOUR + c] += w * (double)sample[(RED + c) * ss + i];
    t.value[OPACITY] += w;
    t.value[DEPTH] += w * (double)sample[DISTANCE * ss + i];
    t.value[ATTENTION_SUM] += (double)sample[ATTENTION * ss + i];
    t.value[EYE_SUM] += (double)sample[EYE * ss + i];
    t.value[UNCERTAINTY_SUM] += w * (double)sample[UNCERTAINTY * ss + i];
    light *= exp(-tau);
  }
  for (size_t k = COLOUR; k < RAY_ROWS; k++) t.size[k] = t.value[k]; /* all terms are positive */
  for (size_t c = 0; c < 3; c++) {
    const double behind = (double)s->background.data[c * s->ray_stride + r];
    const double value = t.value[COLOUR + c] + (1 - t.value[OPACITY]) * behind;
    t.value[PIXEL + c] = value < 0 ? 0 : value > 1 ? 1 : value;
    t.size[PIXEL + c] = t.size[COLOUR + c] + (1 + t.size[OPACITY]) * fabs(behind);
  }
  return t;
}

/* In units of 2^-23 of the sum of the terms' sizes, for K samples. A factor exp(-tau): 1.25 by its function, 1/2 by the
 * product, so 1.75 K in T; the rounding of tau moves all factors together by half the optical depth, 9.3 where the
 * light is spent: 5. alpha: 1.5 and the rounding of tau; the product with T and the value: 1 each; sums: K/2. */
static double tolerance_of(size_t counted) { return (2.25 * (double)counted + 9) * 0x1p-23; }

static void expect_close(const char *kernel, const char *what, size_t at, double found, double expected,
                         double tolerance) {
  if (fabs(found - expected) <= tolerance + 4 * (double)FLT_MIN || (isnan(found) && isnan(expected))) return;
  fail_msg("%s %s [%zu]: %.9g, in double %.12g +- %.1e", kernel, what, at, found, expected, tolerance);
}

static bool ray_is_close(const struct scene *s, size_t r, size_t counted, const struct truth *t, bool all) {
  for (size_t k = 0; k < RAY_ROWS; k++) {
    const double found = (double)s->ray.data[k * s->ray_stride + r];
    if (!all && k >= EYE_SUM) continue;
    if (!(fabs(found - t->value[k]) <= tolerance_of(counted) * t->size[k] + 4 * (double)FLT_MIN) &&
        !(isnan(found) && isnan(t->value[k])))
      return false;
  }
  return true;
}

/* ---- checks ---- */

static void check_fwd(struct scene *s, const struct kernel *kernel, bool all) {
  poison(s->ray.data, s->ray.count);
  const struct ern_composite_view view = view_of(s, all);
  kernel->fwd(&view, s->rays);
  guarded_check(&s->ray, all ? RAY_ROWS : EYE_SUM, s->ray_stride, s->rays, "ray");
  for (size_t i = EYE_SUM * s->ray_stride; !all && i < s->ray.count; i++) assert_true(is_poison(s->ray.data[i]));
  for (size_t r = 0; r < s->rays; r++) {
    bool close = false;
    const size_t counted = counted_of(s, r, 64 * tolerance_of(8), &close);
    const struct truth t = truth_of(s, r, counted);
    if (ray_is_close(s, r, counted, &t, all)) continue;
    /* Where the light left is the stop but for rounding, one sample more or less is as good. */
    if (close) {
      const struct truth more = truth_of(s, r, counted + 1), less = truth_of(s, r, counted - 1);
      if (s->first[r] + (int32_t)counted < s->first[r + 1] && ray_is_close(s, r, counted + 1, &more, all)) continue;
      if (ray_is_close(s, r, counted - 1, &less, all)) continue;
    }
    for (size_t k = 0; k < (all ? RAY_ROWS : EYE_SUM); k++)
      expect_close(kernel->name, "ray", k * s->ray_stride + r, (double)s->ray.data[k * s->ray_stride + r], t.value[k],
                   tolerance_of(counted) * t.size[k]);
  }
}

/* dsigma of a ray's samples in double and without signs; 1,024 of them at most. */
static void check_ray_bwd(const struct scene *s, const char *name, size_t r, size_t counted, bool all) {
  const size_t ss = s->sample_stride, rs = s->ray_stride, begin = (size_t)s->first[r];
  const float *const sample = s->sample.data, *const dray = s->dray.data, *const found = s->dsample.data;
  const double tolerance = 2 * tolerance_of(counted) + 8 * 0x1p-23; /* the weight, and sums over what is behind */
  const double dunc = all ? (double)dray[DUNCERTAINTY * rs + r] : 0;
  double dcolour[3], dopacity = (double)dray[DOPACITY * rs + r], size = fabs(dopacity);
  for (size_t c = 0; c < 3; c++) {
    const float back = s->background.data[c * rs + r], rounded = (1 - s->ray.data[OPACITY * rs + r]) * back;
    const float value = s->ray.data[(COLOUR + c) * rs + r] + rounded;
    dcolour[c] = value >= 0 && value <= 1 ? (double)dray[(DPIXEL + c) * rs + r] : 0;
    dopacity -= dcolour[c] * (double)back;
    size += fabs(dcolour[c] * (double)back);
  }
  static double before[2048];
  double light = 1, behind = 0, behind_size = 0;
  assert_true(counted < 2047);
  for (size_t k = 0; k < counted; k++) {
    before[k] = light;
    light *= exp(-(double)sample[SIGMA * ss + begin + k] * (double)sample[DT * ss + begin + k]);
  }
  before[counted] = light;
  for (size_t k = counted; k-- > 0;) {
    const size_t i = begin + k;
    const double dt = (double)sample[DT * ss + i];
    const double w = -expm1(-(double)sample[SIGMA * ss + i] * dt) * before[k];
    double dw = dopacity + dunc * (double)sample[UNCERTAINTY * ss + i];
    double dw_size = size + fabs(dunc * (double)sample[UNCERTAINTY * ss + i]);
    for (size_t c = 0; c < 3; c++) {
      const double value = (double)sample[(RED + c) * ss + i];
      dw += dcolour[c] * value;
      dw_size += fabs(dcolour[c] * value);
      expect_close(name, "drgb", i, (double)found[(DRED + c) * ss + i], dcolour[c] * w,
                   tolerance * fabs(dcolour[c] * w));
    }
    expect_close(name, "dsigma", i, (double)found[DSIGMA * ss + i], dt * (dw * before[k + 1] - behind),
                 tolerance * dt * (dw_size * before[k + 1] + behind_size));
    assert_true(found[DATTENTIONS * ss + i] == dray[DATTENTION * rs + r]);
    if (all) {
      assert_true(found[DEYES * ss + i] == dray[DEYE * rs + r]);
      expect_close(name, "dunc", i, (double)found[DUNCERTAINTIES * ss + i], dunc * w, tolerance * fabs(dunc * w));
    }
    behind += dw * w;
    behind_size += dw_size * w;
  }
  for (size_t i = begin + counted; i < (size_t)s->first[r + 1]; i++) {
    for (size_t row = 0; row < (all ? DSAMPLE_ROWS : DEYES); row++) assert_true(found[row * ss + i] == 0);
  }
}

static void check_bwd(struct scene *s, const struct kernel *kernel, bool all) {
  const struct ern_composite_bwd_view view = bwd_view_of(s, all);
  ern_composite_fwd_ref(&view.forward, s->rays);
  for (size_t r = 0; r < s->rays; r += 3) { /* colours exactly at the ends of their range, where gradients pass */
    s->ray.data[OPACITY * s->ray_stride + r] = 1;
    for (size_t c = 0; c < 3; c++) s->ray.data[(COLOUR + c) * s->ray_stride + r] = (float)((r + c) % 3) * 0.5f;
  }
  poison(s->dsample.data, s->dsample.count);
  kernel->bwd(&view, s->rays);
  guarded_check(&s->dsample, all ? DSAMPLE_ROWS : DEYES, s->sample_stride, s->samples, "dsample");
  for (size_t r = 0; r < s->rays; r++) {
    bool close = false;
    const size_t counted = counted_of(s, r, 64 * tolerance_of(8), &close);
    if (!close) check_ray_bwd(s, kernel->name, r, counted, all);
  }
}

static void check_kind(densities kind) {
  static const size_t sizes[] = {1, 2, 3, 7, 8, 9, 15, 16, 17, 33, 100, 511, 512, 513, 1500};
  if (KERNELS == 1) skip(); /* built without instruction sets */
  for (size_t k = 0; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) {
      print_message("%s: not on this machine\n", kernels[k].name);
      continue;
    }
    for (size_t n = 0; n < sizeof sizes / sizeof *sizes; n++) {
      for (size_t most = 1; most <= 256; most *= 16) {
        struct scene s = scene_make(kind, sizes[n], most, 100 * n + most);
        check_fwd(&s, &kernels[k], n % 2 == 0);
        check_bwd(&s, &kernels[k], n % 2 == 0);
        scene_free(&s);
      }
    }
  }
}

static void test_usual(void **state) {
  (void)state;
  check_kind(USUAL);
}
static void test_wide(void **state) {
  (void)state;
  check_kind(WIDE);
}
static void test_dense(void **state) {
  (void)state;
  check_kind(DENSE);
}
static void test_extreme(void **state) {
  (void)state;
  check_kind(EXTREME);
}

/* A density that is no number, or infinite: the same values are numbers, and those alike. */
static void test_broken(void **state) {
  (void)state;
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    struct scene s[2];
    for (int with = 0; with < 2; with++) {
      s[with] = scene_make(BROKEN, 700, 16, 7);
      const struct kernel *kernel = with == 0 ? &kernels[0] : &kernels[k];
      const struct ern_composite_bwd_view view = bwd_view_of(&s[with], true);
      kernel->fwd(&view.forward, s[with].rays);
      kernel->bwd(&view, s[with].rays);
    }
    for (size_t i = 0; i < s[0].ray.count; i++) {
      if (is_poison(s[0].ray.data[i])) continue;
      assert_true(isnan(s[0].ray.data[i]) == isnan(s[1].ray.data[i]));
      if (!isnan(s[0].ray.data[i])) assert_true(fabsf(s[0].ray.data[i] - s[1].ray.data[i]) <= 1e-5f);
    }
    for (size_t i = 0; i < s[0].dsample.count; i++) {
      if (!is_poison(s[0].dsample.data[i])) assert_true(isnan(s[0].dsample.data[i]) == isnan(s[1].dsample.data[i]));
    }
    for (int with = 0; with < 2; with++) scene_free(&s[with]);
  }
}

/* Rays of more samples than are taken in hand, between others; no rays; none but empty ones. */
static void test_long_rays(void **state) {
  (void)state;
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    for (size_t most = 1020; most <= 1900; most += 440) {
      struct scene s = scene_make(USUAL, 40, most, most);
      for (size_t i = 0; i < s.samples; i++) s.sample.data[SIGMA * s.sample_stride + i] *= 0.01f;
      check_fwd(&s, &kernels[k], true);
      check_bwd(&s, &kernels[k], true);
      check_fwd(&s, &kernels[k], false);
      check_bwd(&s, &kernels[k], false);
      scene_free(&s);
    }
    struct scene none = scene_make(USUAL, 1200, 4, 3);
    memset(none.first, 0, 1201 * sizeof *none.first);
    check_fwd(&none, &kernels[k], true);
    none.rays = 0;
    check_fwd(&none, &kernels[k], true);
    scene_free(&none);
  }
}

/* ---- measure ---- */

struct bench {
  const struct kernel *kernel;
  struct scene scene;
  bool backward;
};

static void bench_run(void *user) {
  const struct bench *bench = user;
  const struct ern_composite_bwd_view view = bwd_view_of(&bench->scene, true);
  if (bench->backward) {
    bench->kernel->bwd(&view, bench->scene.rays);
  } else {
    bench->kernel->fwd(&view.forward, bench->scene.rays);
  }
}

static void measure(void) {
  struct bench bench = {.scene = scene_make(USUAL, 65536, 14, 1)};
  printf("%.2f samples a ray\n", (double)bench.scene.samples / (double)bench.scene.rays);
  for (int backward = 0; backward < 2; backward++) {
    double first = 0;
    bench.backward = backward != 0;
    for (size_t k = 0; k < KERNELS; k++) {
      if (!machine_has(kernels[k].isa)) continue;
      bench.kernel = &kernels[k];
      const double seconds = seconds_of(bench_run, &bench);
      if (k == 0) first = seconds;
      printf("composite %s %-6s: %6.2f ns a sample, %.1f times ref\n", backward ? "backward" : "forward ",
             kernels[k].name, seconds * 1e9 / (double)bench.scene.samples, first / seconds);
    }
  }
  scene_free(&bench.scene);
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) {
    measure();
    return 0;
  }
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_usual),   cmocka_unit_test(test_wide),   cmocka_unit_test(test_dense),
      cmocka_unit_test(test_extreme), cmocka_unit_test(test_broken), cmocka_unit_test(test_long_rays),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
