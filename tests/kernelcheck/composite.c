/* SPDX-License-Identifier: MIT
 * Volume rendering and its gradient: a device against the reference, the CPU against the definition in double. */
#include "harness.h"
#include "render/composite_ops.h"

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
  struct scene s = {.rays = rays, .all = all, .first = held_memory(rays + 1, sizeof(int32_t))};
  for (size_t r = 0; r < rays; r++) {
    const uint32_t word = words_at(seed, 1, r).word[0], kinds = word % 3, more = word / 3;
    const size_t count = kinds == 0 ? 0 : kinds == 1 ? 1 + more % (most < 4 ? most : 4) : 1 + more % most;
    s.first[r + 1] = s.first[r] + (int32_t)(rays < 3 ? most : count);
  }
  s.samples = (size_t)s.first[rays];
  s.sample = floats(SAMPLE_ROWS * s.samples);
  s.dray = floats(DRAY_ROWS * rays);
  s.background = floats(3 * rays);
  for (size_t row = 0; row < SAMPLE_ROWS; row++) {
    for (size_t i = 0; i < s.samples; i++) {
      const struct ern_random random = words_at(seed + row, 2, i);
      float *to = &s.sample[row * s.samples + i];
      *to = ern_uniform(random.word[2]) * (row == ATTENTION ? 4 : 1);
      if (row == SIGMA) *to = density(kind, &random);
      if (row == DT) *to = 0.01f + 0.02f * ern_uniform(random.word[2]);
    }
  }
  fill_random(s.background, 3 * rays, seed + 20, 1);
  fill_random(s.dray, DRAY_ROWS * rays, seed + 30, 1);
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

/* ---- the slots ---- */

struct pass {
  struct many_rows pixel, colour, drgb;
  struct many ray[RAY_SPANS], dsample[DSAMPLE_SPANS];
  struct ern_composite_fwd_args forward[MACHINES];
  struct ern_composite_bwd_args backward[MACHINES];
};

static void pass_make(const struct scene *s, struct pass *p) {
  const size_t n = s->rays, total = s->samples;
  struct many sample[SAMPLE_ROWS], dray[DRAY_ROWS];
  for (size_t row = 0; row < SAMPLE_ROWS; row++)
    if (row < RED || row > BLUE) sample[row] = many_reals(s->sample + row * total, total);
  for (size_t row = DOPACITY; row < DRAY_ROWS; row++) dray[row] = many_reals(s->dray + row * n, n);
  for (size_t k = 0; k < RAY_SPANS; k++) p->ray[k] = many_empty(n);
  for (size_t k = 0; k < DSAMPLE_SPANS; k++) p->dsample[k] = many_empty(total);
  const struct many_rows rgb = many_strided(s->sample + RED * total, 3, total, ERN_PER_SAMPLE);
  const struct many_rows background = many_strided(s->background, 3, n, ERN_PER_RAY);
  const struct many_rows dpixel = many_strided(s->dray, 3, n, ERN_PER_RAY);
  const struct many first = many_int32s(s->first, n + 1);
  p->pixel = many_strided(NULL, 3, n, ERN_PER_RAY);
  p->colour = many_strided(NULL, 3, n, ERN_PER_RAY);
  p->drgb = many_strided(NULL, 3, total, ERN_PER_SAMPLE);
  EACH_MACHINE (k) {
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
static void expect_value_near(int k, const char *what, size_t at, float found, float expected, double tolerance) {
  if (is_near(found, expected, 0, tolerance + 4 * (double)FLT_MIN)) return;
  fail_msg("%s: %s [%zu]: %.9g, reference %.9g +- %.1e", machines.name[k], what, at, (double)found, (double)expected,
           tolerance);
}

/* ---- the definition in double, with what the terms add up to without their signs: for the CPU ---- */

enum { T_PIXEL, T_COLOUR = 3, T_OPACITY = 6, T_DEPTH, T_ATTENTION, T_EYE, T_UNCERTAINTY, T_ROWS };

struct truth {
  double value[T_ROWS], size[T_ROWS];
};

static struct truth truth_of(const struct scene *s, size_t r, size_t counted) {
  struct truth t = {{0}, {0}};
  const float *const x = s->sample;
  const size_t n = s->samples;
  double light = 1;
  for (size_t i = (size_t)s->first[r]; i < (size_t)s->first[r] + counted; i++) {
    const double tau = (double)x[SIGMA * n + i] * (double)x[DT * n + i], w = -expm1(-tau) * light;
    for (size_t c = 0; c < 3; c++) t.value[T_COLOUR + c] += w * (double)x[(RED + c) * n + i];
    t.value[T_OPACITY] += w;
    t.value[T_DEPTH] += w * (double)x[DISTANCE * n + i];
    t.value[T_ATTENTION] += (double)x[ATTENTION * n + i];
    t.value[T_EYE] += (double)x[EYE * n + i];
    t.value[T_UNCERTAINTY] += w * (double)x[UNCERTAINTY * n + i];
    light *= exp(-tau);
  }
  for (size_t row = T_COLOUR; row < T_ROWS; row++) t.size[row] = t.value[row]; /* all terms are positive */
  for (size_t c = 0; c < 3; c++) {
    const double behind = (double)s->background[c * s->rays + r];
    t.value[T_PIXEL + c] = fmin(fmax(t.value[T_COLOUR + c] + (1 - t.value[T_OPACITY]) * behind, 0), 1);
    t.size[T_PIXEL + c] = t.size[T_COLOUR + c] + (1 + t.size[T_OPACITY]) * fabs(behind);
  }
  return t;
}

/* In units of 2^-23 of the sum of the terms' sizes, for K samples. A factor exp(-tau): 1.25 by its function, 1/2 by the
 * product, so 1.75 K in T; the rounding of tau moves all factors together by half the optical depth, 9.3 where the
 * light is spent: 5. alpha: 1.5 and the rounding of tau; the product with T and the value: 1 each; sums: K/2. */
static double cpu_tolerance_of(size_t counted) { return (2.25 * (double)counted + 9) * 0x1p-23; }

static void expect_defined(int k, const char *what, size_t at, float found, double expected, double tolerance) {
  if (fabs((double)found - expected) <= tolerance + 4 * (double)FLT_MIN) return;
  if (isnan(found) && isnan(expected) && !is_poison(found)) return;
  fail_msg("%s: %s [%zu]: %.9g, in double %.12g +- %.1e", machines.name[k], what, at, (double)found, expected,
           tolerance);
}

static void check_fwd_definition(int k, const struct scene *s, const struct pass *p) {
  static const char *const name[] = {"red",     "green", "blue",      "sum of red", "sum of green", "sum of blue",
                                     "opacity", "depth", "attention", "eye",        "uncertainty"};
  const float *found[T_ROWS], *pixel = floats_of(k, of_rows(p->pixel)), *colour = floats_of(k, of_rows(p->colour));
  const size_t stride = p->pixel.on[0].stride;
  for (size_t c = 0; c < 3; c++) found[T_PIXEL + c] = pixel + c * stride, found[T_COLOUR + c] = colour + c * stride;
  for (size_t out = 0; out < RAY_SPANS; out++) found[T_OPACITY + out] = floats_of(k, p->ray[out]);
  for (size_t at = 0; at < 3 * stride; at++)
    if (at % stride >= s->rays) assert_true(is_poison(pixel[at]) && is_poison(colour[at]));
  for (size_t r = 0; r < s->rays; r++) {
    bool close = false; /* never: see scene_make */
    const size_t counted = counted_of(s, r, &close);
    const struct truth t = truth_of(s, r, counted);
    for (size_t row = 0; row < T_ROWS; row++) {
      if (!s->all && row >= T_EYE) {
        assert_true(is_poison(found[row][r]));
      } else {
        expect_defined(k, name[row], r, found[row][r], t.value[row], cpu_tolerance_of(counted) * t.size[row]);
      }
    }
  }
}

/* The gradient of a ray's samples. */
struct gradients {
  const float *drgb, *dsample[DSAMPLE_SPANS], *colour, *opacity;
  size_t stride, ray_stride;
};

static void check_ray_bwd(int k, const struct scene *s, const struct gradients *found, size_t r, size_t counted) {
  const size_t n = s->samples, rays = s->rays, begin = (size_t)s->first[r];
  const float *const x = s->sample, *const dray = s->dray;
  const double tolerance = 2 * cpu_tolerance_of(counted) + 8 * 0x1p-23; /* the weight, and sums over what is behind */
  const double dunc = s->all ? (double)dray[DUNCERTAINTY * rays + r] : 0;
  double dcolour[3], dopacity = (double)dray[DOPACITY * rays + r], size = fabs(dopacity);
  for (size_t c = 0; c < 3; c++) {
    const float back = s->background[c * rays + r], rounded = (1 - found->opacity[r]) * back;
    const float value = found->colour[c * found->ray_stride + r] + rounded;
    dcolour[c] = value >= 0 && value <= 1 ? (double)dray[(DPIXEL + c) * rays + r] : 0;
    dopacity -= dcolour[c] * (double)back;
    size += fabs(dcolour[c] * (double)back);
  }
  static double before[2048];
  double behind = 0, behind_size = 0;
  assert_true(counted < COUNT_OF(before));
  before[0] = 1;
  for (size_t i = 0; i < counted; i++)
    before[i + 1] = before[i] * exp(-(double)x[SIGMA * n + begin + i] * (double)x[DT * n + begin + i]);
  for (size_t step = counted; step-- > 0;) {
    const size_t i = begin + step;
    const double dt = (double)x[DT * n + i], w = -expm1(-(double)x[SIGMA * n + i] * dt) * before[step];
    double dw = dopacity + dunc * (double)x[UNCERTAINTY * n + i];
    double dw_size = size + fabs(dunc * (double)x[UNCERTAINTY * n + i]);
    for (size_t c = 0; c < 3; c++) {
      const double value = (double)x[(RED + c) * n + i];
      dw += dcolour[c] * value;
      dw_size += fabs(dcolour[c] * value);
      expect_defined(k, "drgb", i, found->drgb[c * found->stride + i], dcolour[c] * w,
                     tolerance * fabs(dcolour[c] * w));
    }
    expect_defined(k, "dsigma", i, found->dsample[D_SIGMA][i], dt * (dw * before[step + 1] - behind),
                   tolerance * dt * (dw_size * before[step + 1] + behind_size));
    assert_true(found->dsample[D_ATTENTION][i] == dray[DATTENTION * rays + r]);
    if (s->all) {
      assert_true(found->dsample[D_EYE][i] == dray[DEYE * rays + r]);
      expect_defined(k, "dunc", i, found->dsample[D_UNCERTAINTY][i], dunc * w, tolerance * fabs(dunc * w));
    }
    behind += dw * w;
    behind_size += dw_size * w;
  }
  for (size_t i = begin + counted; i < (size_t)s->first[r + 1]; i++) {
    for (size_t out = 0; out < (s->all ? DSAMPLE_SPANS : D_EYE); out++) assert_true(found->dsample[out][i] == 0);
    for (size_t c = 0; c < 3; c++) assert_true(found->drgb[c * found->stride + i] == 0);
  }
}

static void check_bwd_definition(int k, const struct scene *s, const struct pass *p) {
  struct gradients found = {.drgb = floats_of(k, of_rows(p->drgb)),
                            .colour = floats_of(k, of_rows(p->colour)),
                            .opacity = floats_of(k, p->ray[OF_OPACITY]),
                            .stride = p->drgb.on[0].stride,
                            .ray_stride = p->colour.on[0].stride};
  for (size_t out = 0; out < DSAMPLE_SPANS; out++) found.dsample[out] = floats_of(k, p->dsample[out]);
  for (size_t r = 0; r < s->rays; r++) {
    bool close = false;
    check_ray_bwd(k, s, &found, r, counted_of(s, r, &close));
  }
}

/* ---- checks ---- */

/* The rows of a device against the reference. */
static void check_fwd_on(int k, const struct scene *s, const struct pass *p) {
  const float *pixel[2] = {floats_of(0, of_rows(p->pixel)), floats_of(k, of_rows(p->pixel))},
              *colour[2] = {floats_of(0, of_rows(p->colour)), floats_of(k, of_rows(p->colour))},
              *opacity = floats_of(0, p->ray[OF_OPACITY]);
  const size_t stride = p->pixel.on[0].stride;
  for (size_t at = 0; at < 3 * stride; at++) {
    const size_t r = at % stride, c = at / stride;
    if (r >= s->rays) {
      assert_true(is_poison(pixel[1][at]) && is_poison(colour[1][at]));
      continue;
    }
    bool close = false;
    const double tolerance = tolerance_of(counted_of(s, r, &close)), own = (double)colour[0][at];
    const double size = own + (1 + (double)opacity[r]) * fabs((double)s->background[c * s->rays + r]);
    expect_value_near(k, "colour", at, colour[1][at], colour[0][at], tolerance * own);
    expect_value_near(k, "pixel", at, pixel[1][at], pixel[0][at], tolerance * size);
  }
  for (size_t out = 0; out < RAY_SPANS; out++) { /* all terms are positive */
    const float *expected = floats_of(0, p->ray[out]), *found = floats_of(k, p->ray[out]);
    for (size_t r = 0; r < s->rays; r++) {
      bool close = false;
      const double tolerance = tolerance_of(counted_of(s, r, &close));
      expect_value_near(k, "ray", out * s->rays + r, found[r], expected[r], tolerance * fabs((double)expected[r]));
      if (!s->all && out >= OF_EYE) assert_true(is_poison(found[r]));
    }
  }
}

static void check_fwd(const struct scene *s, struct pass *p) {
  RUN(composite_fwd, p->forward);
  EACH_MACHINE (k) {
    if (is_device(k)) {
      check_fwd_on(k, s, p);
    } else {
      check_fwd_definition(k, s, p);
    }
  }
}

/* Colours and opacities as the reference left them, every third ray at the ends of the range, where gradients pass. */
static void set_forward(const struct scene *s, struct pass *p) {
  const size_t stride = p->colour.on[0].stride;
  float *colour = floats(3 * stride), *opacity = floats(s->rays);
  memcpy(colour, floats_of(0, of_rows(p->colour)), 3 * stride * sizeof *colour);
  memcpy(opacity, floats_of(0, p->ray[OF_OPACITY]), s->rays * sizeof *opacity);
  for (size_t r = 0; r < s->rays; r += 3) {
    opacity[r] = 1;
    for (size_t c = 0; c < 3; c++) colour[c * stride + r] = (float)((r + c) % 3) * 0.5f;
  }
  many_set(p->ray[OF_OPACITY], 0, opacity, s->rays);
  many_set(of_rows(p->colour), 0, colour, 3 * stride);
}

/* Sizes of what a ray's dsigma is the sum of, in double: dt (|dw| T_{i+1} + sum_{j>i} |dw_j| w_j). size: [samples] */
static void sizes_of(const struct scene *s, size_t r, size_t counted, double *size) {
  const size_t n = s->rays, total = s->samples, begin = (size_t)s->first[r];
  const float *const x = s->sample;
  double *before = held_memory(counted + 1, sizeof *before), behind = 0;
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
}

static void check_bwd_on(int k, const struct scene *s, const struct pass *p) {
  const size_t stride = p->drgb.on[0].stride;
  double *size = held_memory(s->samples, sizeof *size);
  const float *drgb[2] = {floats_of(0, of_rows(p->drgb)), floats_of(k, of_rows(p->drgb))};
  const float *expected[DSAMPLE_SPANS], *found[DSAMPLE_SPANS];
  for (size_t out = 0; out < DSAMPLE_SPANS; out++) {
    expected[out] = floats_of(0, p->dsample[out]);
    found[out] = floats_of(k, p->dsample[out]);
  }
  for (size_t r = 0; r < s->rays; r++) {
    bool close = false;
    const size_t counted = counted_of(s, r, &close);
    /* the weight, and the sum over what is behind: each of the 5 terms of dw adds a rounding to both */
    const double tolerance = 2 * tolerance_of(counted) + 12 * 0x1p-23;
    sizes_of(s, r, counted, size);
    for (size_t i = (size_t)s->first[r]; i < (size_t)s->first[r + 1]; i++) {
      const bool counts = i < (size_t)s->first[r] + counted;
      expect_value_near(k, "dsigma", i, found[D_SIGMA][i], expected[D_SIGMA][i], tolerance * size[i]);
      for (size_t at = i; at < 3 * stride; at += stride)
        expect_value_near(k, "drgb", at, drgb[1][at], drgb[0][at], tolerance * fabs((double)drgb[0][at]));
      assert_true(same_bits(found[D_ATTENTION][i], expected[D_ATTENTION][i]));
      assert_true(same_bits(found[D_EYE][i], expected[D_EYE][i]));
      expect_value_near(k, "dunc", i, found[D_UNCERTAINTY][i], expected[D_UNCERTAINTY][i],
                        tolerance * fabs((double)expected[D_UNCERTAINTY][i]));
      for (size_t out = 0; out < (s->all ? DSAMPLE_SPANS : D_EYE) && !counts; out++) assert_true(found[out][i] == 0);
    }
  }
}

static void check_bwd(const struct scene *s, struct pass *p) {
  set_forward(s, p);
  RUN(composite_bwd, p->backward);
  EACH_MACHINE (k) {
    if (is_device(k)) {
      check_bwd_on(k, s, p);
    } else {
      check_bwd_definition(k, s, p);
    }
  }
}

static void check_scene(densities kind, size_t rays, size_t most, bool all) {
  struct scene s = scene_make(kind, rays, most, 100 * rays + most, all);
  struct pass p;
  pass_make(&s, &p);
  check_fwd(&s, &p);
  check_bwd(&s, &p);
  machines_clear();
}

static void check_kind(densities kind) {
  for (size_t k = 0; k < size_count(); k++)
    for (size_t most = 1; most <= 256; most *= 16)
      if (most < 256 || (!is_small() && (test_sizes[k] < 300 || !is_device(machines.count - 1))))
        check_scene(kind, test_sizes[k], most, k % 2 == 0);
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
    machines_clear();
  }
  /* more samples than are taken in hand, which no marcher makes: on the CPU */
  for (size_t most = 1020; most <= 1900 && !is_device(machines.count - 1); most += 440) {
    for (int all = 0; all < 2; all++) {
      struct scene s = scene_make(USUAL, 40, most, most, all == 1);
      struct pass p;
      for (size_t i = 0; i < s.samples; i++) s.sample[SIGMA * s.samples + i] *= 0.01f;
      pass_make(&s, &p);
      check_fwd(&s, &p);
      check_bwd(&s, &p);
      machines_clear();
    }
  }
}

/* A density that is no number, or infinite: what is a number in the reference is one, and the same. 1e-5: rays of 16
 * samples at most, values up to 4. */
static void test_broken(void **state) {
  (void)state;
  struct scene s = scene_make(BROKEN, 700, 16, 7, true);
  struct pass p;
  pass_make(&s, &p);
  RUN(composite_fwd, p.forward);
  expect_near("colour", of_rows(p.colour), 1e-5, 1e-5);
  expect_near("pixel", of_rows(p.pixel), 1e-5, 1e-5);
  for (size_t k = 0; k < RAY_SPANS; k++) expect_near("ray", p.ray[k], 1e-5, 1e-5);
  RUN(composite_bwd, p.backward);
  expect_near("drgb", of_rows(p.drgb), 1e-5, 1e-5);
  for (size_t k = 0; k < DSAMPLE_SPANS; k++) expect_near("dsample", p.dsample[k], 1e-5, 1e-5);
  machines_clear();
}

/* No rays; rays without samples; and only what must be there. */
static void test_little(void **state) {
  (void)state;
  struct scene s = scene_make(USUAL, 65, 16, 11, false);
  struct pass p;
  pass_make(&s, &p);
  EACH_MACHINE (k) {
    p.forward[k].n = p.backward[k].forward.n = 0;
    p.forward[k].colour = (ern_rows){0};
  }
  RUN(composite_fwd, p.forward);
  RUN(composite_bwd, p.backward);
  expect_near("pixel of no rays", of_rows(p.pixel), 0, 0);
  expect_near("dsigma of no rays", p.dsample[D_SIGMA], 0, 0);
  EACH_MACHINE (k) {
    p.forward[k].n = s.rays;
    p.forward[k].pixel = p.forward[k].background = (ern_rows){0};
    p.forward[k].colour = p.colour.on[k];
    p.forward[k].depth = p.forward[k].sample_depth = p.forward[k].attention = (ern_span){0};
  }
  EACH_MACHINE (k)
    if (!is_device(k)) p.forward[k].background = p.backward[k].forward.background; /* whose stride the CPU takes */
  RUN(composite_fwd, p.forward);
  expect_near("colour alone", of_rows(p.colour), 108 * 0x1p-23, 0); /* 16 samples: tolerance_of */
  expect_near("no pixel", of_rows(p.pixel), 0, 0);
  expect_near("no depth", p.ray[OF_DEPTH], 0, 0);
  int32_t *none = held_memory(s.rays + 1, sizeof *none);
  EACH_MACHINE (k) {
    p.forward[k] = p.backward[k].forward;
    p.forward[k].n = s.rays;
    support_ok(machines.context,
               machines.backend[k]->upload_int32(machines.stream[k], p.forward[k].first, none, s.rays + 1));
  }
  RUN(composite_fwd, p.forward);
  expect_near("pixel without samples", of_rows(p.pixel), 0, 0);
  expect_near("opacity without samples", p.ray[OF_OPACITY], 0, 0);
  machines_clear();
}

static void bench(void) {
  const struct scene s = scene_make(USUAL, 65536, 14, 1, true);
  struct pass p;
  pass_make(&s, &p);
  RUN(composite_fwd, p.forward);
  printf("%.2f samples a ray, by sample\n", (double)s.samples / (double)s.rays);
  BENCH("forward", s.samples, composite_fwd, p.forward);
  BENCH("backward", s.samples, composite_bwd, p.backward);
  machines_clear();
}

static const struct CMUnitTest tests[] = {
    cmocka_unit_test(test_usual),     cmocka_unit_test(test_wide),   cmocka_unit_test(test_dense),
    cmocka_unit_test(test_extreme),   cmocka_unit_test(test_broken), cmocka_unit_test(test_little),
    cmocka_unit_test(test_long_rays),
};
NOUN(composite, bench, .isa = NULL)
