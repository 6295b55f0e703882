/* SPDX-License-Identifier: MIT
 * Volume rendering on an OpenCL device, and its gradient, against the reference. */
#include "twin.h"

#include <float.h>

static ern_context *context;
static struct twin twin;

/* ---- a scene ---- */

typedef enum densities { USUAL, WIDE, DENSE, EXTREME, BROKEN } densities;

/* Values of a sample, and gradients of a ray, by row. */
enum { SIGMA, DT, RED, GREEN, BLUE, DISTANCE, ATTENTION, EYE, UNCERTAINTY, SAMPLE_ROWS };
enum { DPIXEL, DOPACITY = 3, DATTENTION, DEYE, DUNCERTAINTY, DRAY_ROWS };
/* Results of a ray, and of a sample, each a span. */
enum { OF_OPACITY, OF_DEPTH, OF_ATTENTION, OF_EYE, OF_UNCERTAINTY, RAY_SPANS };
enum { D_SIGMA, D_ATTENTION, D_EYE, D_UNCERTAINTY, DSAMPLE_SPANS };

static const float stop = 1e-4f;

struct scene {
  size_t rays, samples;
  bool all; /* with an eye branch and uncertainty */
  int32_t *first;
  float *sample;     /* [SAMPLE_ROWS][samples] */
  float *dray;       /* [DRAY_ROWS][rays] */
  float *background; /* [3][rays] */
};

static void *room(size_t count) {
  void *made = calloc(count + 1, sizeof(float));
  assert_non_null(made);
  return made;
}

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

/* How many samples of a ray count; *close: rounding may decide it otherwise. */
static size_t counted_of(const struct scene *s, size_t r, bool *close) {
  const float *sigma = s->sample + SIGMA * s->samples, *dt = s->sample + DT * s->samples;
  const size_t begin = (size_t)s->first[r], end = (size_t)s->first[r + 1];
  double light = 1;
  size_t i = begin;
  *close = false;
  for (; i < end; i++) {
    if (fabs(light / (double)stop - 1) < 1e-3) *close = true;
    if (light < (double)stop) break;
    light *= exp(-(double)(sigma[i] * dt[i]));
  }
  return i - begin;
}

/* Rays of no samples, of one to four, and of up to `most`. None of them ends where rounding could end it elsewhere. */
static struct scene scene_make(densities kind, size_t rays, size_t most, uint64_t seed, bool all) {
  struct scene s = {.rays = rays, .all = all, .first = room(rays + 1)};
  for (size_t r = 0; r < rays; r++) {
    const uint32_t word = ern_random_at(seed, 1, (uint32_t)r, ERN_RNG_INIT).word[0], kinds = word % 3, more = word / 3;
    const size_t count = kinds == 0 ? 0 : kinds == 1 ? 1 + more % (most < 4 ? most : 4) : 1 + more % most;
    s.first[r + 1] = s.first[r] + (int32_t)(rays < 3 ? most : count);
  }
  s.samples = (size_t)s.first[rays];
  s.sample = room(SAMPLE_ROWS * s.samples);
  s.dray = room(DRAY_ROWS * rays);
  s.background = room(3 * rays);
  for (size_t row = 0; row < SAMPLE_ROWS; row++) {
    for (size_t i = 0; i < s.samples; i++) {
      const struct ern_random random = ern_random_at(seed + row, 2, (uint32_t)i, ERN_RNG_INIT);
      float *to = &s.sample[row * s.samples + i];
      *to = ern_uniform(random.word[2]) * (row == ATTENTION ? 4 : 1);
      if (row == SIGMA) *to = density(kind, &random);
      if (row == DT) *to = 0.01f + 0.02f * ern_uniform(random.word[2]);
    }
  }
  twin_fill(s.background, 3 * rays, seed + 20, 1);
  twin_fill(s.dray, DRAY_ROWS * rays, seed + 30, 1);
  for (size_t r = 0; r < rays; r++) {
    bool close = true;
    for (int times = 0; times < 50 && close; times++) {
      counted_of(&s, r, &close);
      for (int32_t i = s.first[r]; i < s.first[r + 1] && close; i++) s.sample[SIGMA * s.samples + (size_t)i] *= 1.003f;
    }
    assert_false(close);
  }
  return s;
}

static void scene_free(struct scene *s) {
  free(s->first);
  free(s->sample);
  free(s->dray);
  free(s->background);
}

/* ---- the slots on both ---- */

struct pass {
  struct twin_rows pixel, colour, drgb;
  struct twin_span ray[RAY_SPANS], dsample[DSAMPLE_SPANS];
  struct ern_composite_fwd_args forward[2];
  struct ern_composite_bwd_args backward[2];
};

static void pass_make(const struct scene *s, struct pass *p) {
  const size_t n = s->rays, total = s->samples;
  struct twin_span sample[SAMPLE_ROWS], dray[DRAY_ROWS];
  for (size_t row = 0; row < SAMPLE_ROWS; row++)
    if (row < RED || row > BLUE) sample[row] = twin_reals(&twin, s->sample + row * total, total);
  for (size_t row = DOPACITY; row < DRAY_ROWS; row++) dray[row] = twin_reals(&twin, s->dray + row * n, n);
  for (size_t k = 0; k < RAY_SPANS; k++) p->ray[k] = twin_take(&twin, ERN_ELEMENT_REAL, n);
  for (size_t k = 0; k < DSAMPLE_SPANS; k++) p->dsample[k] = twin_take(&twin, ERN_ELEMENT_REAL, total);
  const struct twin_rows rgb = twin_rows_of(&twin, s->sample + RED * total, 3, total, ERN_PER_SAMPLE);
  const struct twin_rows background = twin_rows_of(&twin, s->background, 3, n, ERN_PER_RAY);
  const struct twin_rows dpixel = twin_rows_of(&twin, s->dray, 3, n, ERN_PER_RAY);
  const struct twin_span first = twin_int32s(&twin, s->first, n + 1);
  p->pixel = twin_rows_of(&twin, NULL, 3, n, ERN_PER_RAY);
  p->colour = twin_rows_of(&twin, NULL, 3, n, ERN_PER_RAY);
  p->drgb = twin_rows_of(&twin, NULL, 3, total, ERN_PER_SAMPLE);
  for (int k = 0; k < 2; k++) {
    const ern_span none = {0};
    p->forward[k] = (struct ern_composite_fwd_args){.pixel = p->pixel.on[k],
                                                    .colour = p->colour.on[k],
                                                    .opacity = p->ray[OF_OPACITY].on[k],
                                                    .depth = p->ray[OF_DEPTH].on[k],
                                                    .attention = p->ray[OF_ATTENTION].on[k],
                                                    .eye = s->all ? p->ray[OF_EYE].on[k] : none,
                                                    .uncertainty = s->all ? p->ray[OF_UNCERTAINTY].on[k] : none,
                                                    .first = first.on[k],
                                                    .sigma = sample[SIGMA].on[k],
                                                    .dt = sample[DT].on[k],
                                                    .sample_depth = sample[DISTANCE].on[k],
                                                    .sample_attention = sample[ATTENTION].on[k],
                                                    .sample_eye = s->all ? sample[EYE].on[k] : none,
                                                    .sample_uncertainty = s->all ? sample[UNCERTAINTY].on[k] : none,
                                                    .rgb = rgb.on[k],
                                                    .background = background.on[k],
                                                    .transmittance_stop = stop,
                                                    .n = n};
    p->backward[k] =
        (struct ern_composite_bwd_args){.dsigma = p->dsample[D_SIGMA].on[k],
                                        .drgb = p->drgb.on[k],
                                        .dsample_attention = p->dsample[D_ATTENTION].on[k],
                                        .dsample_eye = s->all ? p->dsample[D_EYE].on[k] : none,
                                        .dsample_uncertainty = s->all ? p->dsample[D_UNCERTAINTY].on[k] : none,
                                        .dpixel = dpixel.on[k],
                                        .dopacity = dray[DOPACITY].on[k],
                                        .dattention = dray[DATTENTION].on[k],
                                        .deye = s->all ? dray[DEYE].on[k] : none,
                                        .duncertainty = s->all ? dray[DUNCERTAINTY].on[k] : none,
                                        .forward = p->forward[k]};
  }
}

/* ---- tolerances ---- */

/* In units of 2^-23 of the sum of the terms' sizes, for K samples that count. A factor exp(-tau): 3 by the device's
 * function (OpenCL's bound), 1 by the reference's, 1/2 each by the products, so 5 K in T; tau is the same in both.
 * alpha: 3 and 1; two products: 1 each; sums of K: K/2 each. */
static double tolerance_of(size_t counted) { return (6 * (double)counted + 8) * 0x1p-23; }

/* Both are no numbers, or near; what is smaller than the smallest normal number is nothing. */
static void expect_near(const char *what, size_t at, float found, float expected, double tolerance) {
  if (found == expected || (isnan(found) && isnan(expected))) return;
  if (fabs((double)found - (double)expected) <= tolerance + 4 * (double)FLT_MIN) return;
  fail_msg("%s [%zu]: device %.9g, reference %.9g +- %.1e", what, at, (double)found, (double)expected, tolerance);
}

/* The values inside the guards, on both; guards are whole and NaN stands where the reference has it. */
struct values {
  float *all[2];
};
static struct values values_of(const char *what, struct twin_span span) {
  twin_same(&twin, what, span, 0, INFINITY);
  return (struct values){{twin_down(&twin, 0, span.on[0]), twin_down(&twin, 1, span.on[1])}};
}
static float value_at(const struct values *v, int k, size_t i) { return v->all[k][TWIN_GUARD + i]; }
static void values_free(struct values *v) {
  free(v->all[0]);
  free(v->all[1]);
}

/* ---- checks ---- */

static void check_fwd(const struct scene *s, struct pass *p) {
  TWIN_RUN(&twin, composite_fwd, p->forward)
  const struct twin_span pixel_span = {{p->pixel.on[0].span, p->pixel.on[1].span}};
  const struct twin_span colour_span = {{p->colour.on[0].span, p->colour.on[1].span}};
  struct values pixel = values_of("pixel", pixel_span), colour = values_of("colour", colour_span);
  struct values opacity = values_of("opacity", p->ray[OF_OPACITY]);
  const size_t stride = p->pixel.on[0].stride;
  for (size_t r = 0; r < s->rays; r++) {
    bool close = false;
    const double tolerance = tolerance_of(counted_of(s, r, &close));
    for (size_t c = 0; c < 3; c++) {
      const size_t at = c * stride + r;
      const float behind = fabsf(s->background[c * s->rays + r]), own = value_at(&colour, 0, at);
      const double size = (double)own + (1 + (double)value_at(&opacity, 0, r)) * (double)behind;
      expect_near("colour", at, value_at(&colour, 1, at), own, tolerance * (double)own);
      expect_near("pixel", at, value_at(&pixel, 1, at), value_at(&pixel, 0, at), tolerance * size);
    }
  }
  values_free(&pixel), values_free(&colour), values_free(&opacity);
  for (size_t k = 0; k < RAY_SPANS; k++) { /* all terms are positive */
    struct values v = values_of("ray", p->ray[k]);
    for (size_t r = 0; r < s->rays; r++) {
      bool close = false;
      const double tolerance = tolerance_of(counted_of(s, r, &close));
      expect_near("ray", k * s->rays + r, value_at(&v, 1, r), value_at(&v, 0, r),
                  tolerance * fabs((double)value_at(&v, 0, r)));
      if (!s->all && k >= OF_EYE) assert_true(value_at(&v, 1, r) == TWIN_POISON);
    }
    values_free(&v);
  }
}

/* Colours and opacities as the reference left them, every third ray at the ends of the range, where gradients pass. */
static void set_forward(const struct scene *s, struct pass *p) {
  const size_t n = s->rays, stride = p->colour.on[0].stride;
  float *colour = twin_down(&twin, 0, p->colour.on[0].span), *opacity = twin_down(&twin, 0, p->ray[OF_OPACITY].on[0]);
  for (size_t r = 0; r < n; r += 3) {
    opacity[TWIN_GUARD + r] = 1;
    for (size_t c = 0; c < 3; c++) colour[TWIN_GUARD + c * stride + r] = (float)((r + c) % 3) * 0.5f;
  }
  for (int k = 0; k < 2; k++) {
    struct ern_backend *backend = twin.backend[k];
    support_ok(context, backend->upload_reals(twin.stream[k], p->ray[OF_OPACITY].on[k], opacity + TWIN_GUARD, n));
    support_ok(context, backend->upload_reals(twin.stream[k], p->colour.on[k].span, colour + TWIN_GUARD,
                                              p->colour.on[k].span.count));
  }
  free(colour);
  free(opacity);
}

/* Sizes of what a ray's dsigma is the sum of, in double: dt (|dw| T_{i+1} + sum_{j>i} |dw_j| w_j). size: [samples] */
static void sizes_of(const struct scene *s, size_t r, size_t counted, double *size) {
  const size_t n = s->rays, total = s->samples, begin = (size_t)s->first[r];
  const float *const x = s->sample;
  double *before = room(2 * (counted + 1)), behind = 0;
  before[0] = 1;
  for (size_t k = 0; k < counted; k++)
    before[k + 1] = before[k] * exp(-(double)(x[SIGMA * total + begin + k] * x[DT * total + begin + k]));
  for (size_t k = counted; k-- > 0;) {
    const size_t i = begin + k;
    double dw = fabs((double)s->dray[DOPACITY * n + r]);
    if (s->all) dw += fabs((double)s->dray[DUNCERTAINTY * n + r] * (double)x[UNCERTAINTY * total + i]);
    for (size_t c = 0; c < 3; c++)
      dw += fabs((double)s->dray[(DPIXEL + c) * n + r]) *
            ((double)x[(RED + c) * total + i] + fabs((double)s->background[c * n + r]));
    size[i] = (double)x[DT * total + i] * (dw * before[k + 1] + behind);
    behind += dw * (before[k] - before[k + 1]);
  }
  free(before);
}

static void check_bwd(const struct scene *s, struct pass *p) {
  const size_t stride = p->drgb.on[0].stride;
  double *size = room(2 * s->samples);
  set_forward(s, p);
  TWIN_RUN(&twin, composite_bwd, p->backward)
  const struct twin_span drgb_span = {{p->drgb.on[0].span, p->drgb.on[1].span}};
  struct values drgb = values_of("drgb", drgb_span), v[DSAMPLE_SPANS];
  for (size_t k = 0; k < DSAMPLE_SPANS; k++) v[k] = values_of("dsample", p->dsample[k]);
  for (size_t r = 0; r < s->rays; r++) {
    bool close = false;
    const size_t counted = counted_of(s, r, &close);
    /* the weight, and the sum over what is behind: each of the 5 terms of dw adds a rounding to both */
    const double tolerance = 2 * tolerance_of(counted) + 12 * 0x1p-23;
    sizes_of(s, r, counted, size);
    for (size_t i = (size_t)s->first[r]; i < (size_t)s->first[r + 1]; i++) {
      const bool counts = i < (size_t)s->first[r] + counted;
      expect_near("dsigma", i, value_at(&v[D_SIGMA], 1, i), value_at(&v[D_SIGMA], 0, i), tolerance * size[i]);
      for (size_t c = 0; c < 3; c++) {
        const float expected = value_at(&drgb, 0, c * stride + i);
        expect_near("drgb", c * stride + i, value_at(&drgb, 1, c * stride + i), expected,
                    tolerance * fabs((double)expected));
      }
      assert_true(value_at(&v[D_ATTENTION], 1, i) == value_at(&v[D_ATTENTION], 0, i));
      assert_true(value_at(&v[D_EYE], 1, i) == value_at(&v[D_EYE], 0, i));
      expect_near("dunc", i, value_at(&v[D_UNCERTAINTY], 1, i), value_at(&v[D_UNCERTAINTY], 0, i),
                  tolerance * fabs((double)value_at(&v[D_UNCERTAINTY], 0, i)));
      for (size_t k = 0; k < (s->all ? DSAMPLE_SPANS : D_EYE) && !counts; k++) assert_true(value_at(&v[k], 1, i) == 0);
    }
  }
  values_free(&drgb);
  for (size_t k = 0; k < DSAMPLE_SPANS; k++) values_free(&v[k]);
  free(size);
}

static void check_scene(densities kind, size_t rays, size_t most, bool all) {
  struct scene s = scene_make(kind, rays, most, 100 * rays + most, all);
  struct pass p;
  pass_make(&s, &p);
  check_fwd(&s, &p);
  check_bwd(&s, &p);
  twin_clear(&twin);
  scene_free(&s);
}

static void check_kind(densities kind) {
  for (size_t k = 0; k < TWIN_SIZES; k++)
    for (size_t most = 1; most <= 256; most *= 16)
      if (most < 256 || (twin_sizes[k] < 300 && !twin_is_small())) check_scene(kind, twin_sizes[k], most, k % 2 == 0);
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

/* The most samples a ray can have, thin enough that they count, and dense. */
static void test_long_rays(void **state) {
  (void)state;
  for (int thin = 0; thin < 2; thin++) {
    struct scene s = scene_make(USUAL, 2, ERN_MAX_STEPS, 5, true);
    struct pass p;
    bool close = false;
    for (size_t i = 0; i < s.samples && thin; i++) s.sample[SIGMA * s.samples + i] *= 0.005f;
    assert_true(s.first[1] == ERN_MAX_STEPS && (counted_of(&s, 0, &close) == ERN_MAX_STEPS) == (thin == 1) && !close);
    pass_make(&s, &p);
    check_fwd(&s, &p);
    check_bwd(&s, &p);
    twin_clear(&twin);
    scene_free(&s);
  }
}

/* A density that is no number, or infinite: what is a number in the reference is one, and the same. 1e-5: rays of 16
 * samples at most, values up to 4. */
static void test_broken(void **state) {
  (void)state;
  struct scene s = scene_make(BROKEN, 700, 16, 7, true);
  struct pass p;
  pass_make(&s, &p);
  TWIN_RUN(&twin, composite_fwd, p.forward)
  twin_same_rows(&twin, "colour", p.colour, 1e-5, 1e-5);
  twin_same_rows(&twin, "pixel", p.pixel, 1e-5, 1e-5);
  for (size_t k = 0; k < RAY_SPANS; k++) twin_same(&twin, "ray", p.ray[k], 1e-5, 1e-5);
  TWIN_RUN(&twin, composite_bwd, p.backward)
  twin_same_rows(&twin, "drgb", p.drgb, 1e-5, 1e-5);
  for (size_t k = 0; k < DSAMPLE_SPANS; k++) twin_same(&twin, "dsample", p.dsample[k], 1e-5, 1e-5);
  twin_clear(&twin);
  scene_free(&s);
}

/* No rays; rays without samples; and only what must be there. */
static void test_little(void **state) {
  (void)state;
  struct scene s = scene_make(USUAL, 65, 16, 11, false);
  struct pass p;
  pass_make(&s, &p);
  for (int k = 0; k < 2; k++) {
    p.forward[k].n = p.backward[k].forward.n = 0;
    p.forward[k].colour = (ern_rows){0};
  }
  TWIN_RUN(&twin, composite_fwd, p.forward)
  TWIN_RUN(&twin, composite_bwd, p.backward)
  twin_same_rows(&twin, "pixel of no rays", p.pixel, 0, 0);
  twin_same(&twin, "dsigma of no rays", p.dsample[D_SIGMA], 0, 0);
  for (int k = 0; k < 2; k++) {
    p.forward[k].n = s.rays;
    p.forward[k].pixel = p.forward[k].background = (ern_rows){0};
    p.forward[k].colour = p.colour.on[k];
    p.forward[k].depth = p.forward[k].sample_depth = p.forward[k].attention = (ern_span){0};
  }
  p.forward[0].background = p.backward[0].forward.background; /* whose stride the reference takes */
  TWIN_RUN(&twin, composite_fwd, p.forward)
  twin_same_rows(&twin, "colour alone", p.colour, 108 * 0x1p-23, 0); /* 16 samples: tolerance_of */
  twin_same_rows(&twin, "no pixel", p.pixel, 0, 0);
  twin_same(&twin, "no depth", p.ray[OF_DEPTH], 0, 0);
  int32_t *none = room(s.rays + 1);
  for (int k = 0; k < 2; k++) {
    p.forward[k] = p.backward[k].forward;
    p.forward[k].n = s.rays;
    support_ok(context, twin.backend[k]->upload_int32(twin.stream[k], p.forward[k].first, none, s.rays + 1));
  }
  TWIN_RUN(&twin, composite_fwd, p.forward)
  twin_same_rows(&twin, "pixel without samples", p.pixel, 0, 0);
  twin_same(&twin, "opacity without samples", p.ray[OF_OPACITY], 0, 0);
  free(none);
  twin_clear(&twin);
  scene_free(&s);
}

static int set_up(void **state) {
  (void)state;
  context = support_context();
  twin_open(&twin, context);
  return 0;
}
static int tear_down(void **state) {
  (void)state;
  twin_close(&twin);
  ern_context_free(&context);
  return 0;
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_usual),     cmocka_unit_test(test_wide),   cmocka_unit_test(test_dense),
      cmocka_unit_test(test_extreme),   cmocka_unit_test(test_broken), cmocka_unit_test(test_little),
      cmocka_unit_test(test_long_rays),
  };
  return cmocka_run_group_tests_name("opencl composite", tests, set_up, tear_down);
}
