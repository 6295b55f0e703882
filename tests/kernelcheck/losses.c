/* SPDX-License-Identifier: MIT
 * The losses: points and differences to the bit, the others against the reference, those of the CPU against the
 * definition in double. */
#include "harness.h"

#include "backend_cpu/cpu_kernels.h"
#include "backend_cpu/cpu_state.h"
#include "model/torso_ops.h"
#include "render/march_ops.h"
#include "train/losses_ops.h"
#include "train/step_ops.h"

enum { STEPS = 16, MANY = 70000 /* several rounds of every group */ };

/* ---- a batch of rays ---- */

enum { PIXEL, TRUTH = 3, OPACITY = 6, ATTENTION, EYE, UNCERTAINTY, FACE, IN_ROWS };
enum { DOPACITY, DATTENTION, DEYE, DUNCERTAINTY, OUT_SPANS };
enum { TERMS = ERN_LOSS_EYE_AMBIENT + 1 };

typedef enum kinds { USUAL, EXTREME, SPIKE, KINDS } kinds;

struct batch {
  size_t n;
  float *in; /* [IN_ROWS][n] */
  struct many_rows dpixel;
  struct many out[OUT_SPANS];
  struct ern_head_loss_args args[MACHINES];
};

/* Uncertainties as a softplus leaves them, from nothing to 3e38, or one that takes the whole softmax; opacities at both
 * ends and just inside. in: [IN_ROWS][n] */
static float *inputs_make(size_t n, kinds kind, uint64_t seed) {
  static const float opacities[] = {0, 1, 1e-5f, 1 - 1e-5f, 9e-6f, 0.9999999f, -1e-3f, 1.0001f};
  static const float uncertainties[] = {0, 1e-45f, 1e-38f, 1e-8f, 88, 1e4f, 1e20f, 3e38f};
  float *in = floats(IN_ROWS * n);
  for (size_t row = 0; row < IN_ROWS; row++) {
    for (size_t r = 0; r < n; r++) {
      const struct ern_random random = words_at(seed, row, r);
      const uint32_t pick = random.word[1] % 8;
      float *to = &in[row * n + r];
      *to = ern_uniform(random.word[0]);
      if (row == FACE) *to = random.word[0] % 3 == 0;
      if (row == ATTENTION || row == UNCERTAINTY) *to *= 4;
      if (kind == EXTREME && row == OPACITY) *to = opacities[pick];
      if (kind == EXTREME && row == UNCERTAINTY && random.word[2] % 2) *to = uncertainties[pick];
      if (kind == EXTREME && row < OPACITY && pick == 0) *to = 0;
      if (kind == SPIKE && row == UNCERTAINTY && r == n / 2) *to = 95;
    }
  }
  return in;
}

static struct batch batch_make(float *in, size_t n, bool adaptive, bool eye) {
  struct batch b = {.n = n, .in = in};
  struct many value[IN_ROWS];
  const struct many_rows pixel = many_strided(in + PIXEL * n, 3, n, ERN_PER_RAY);
  const struct many_rows truth = many_strided(in + TRUTH * n, 3, n, ERN_PER_RAY);
  for (size_t row = OPACITY; row < IN_ROWS; row++) value[row] = many_reals(in + row * n, n);
  for (size_t k = 0; k < OUT_SPANS; k++) b.out[k] = many_empty(n);
  b.dpixel = many_strided(NULL, 3, n, ERN_PER_RAY);
  EACH_MACHINE (k)
    b.args[k] = (struct ern_head_loss_args){.dpixel = b.dpixel.on[k],
                                            .dopacity = b.out[DOPACITY].on[k],
                                            .dattention = b.out[DATTENTION].on[k],
                                            .deye = eye ? b.out[DEYE].on[k] : (ern_span){0},
                                            .duncertainty = b.out[DUNCERTAINTY].on[k],
                                            .terms = {-1, -1, -1, -1, -1, -1, -1, -1},
                                            .pixel = pixel.on[k],
                                            .truth = truth.on[k],
                                            .opacity = value[OPACITY].on[k],
                                            .attention = value[ATTENTION].on[k],
                                            .eye = eye ? value[EYE].on[k] : (ern_span){0},
                                            .uncertainty = value[UNCERTAINTY].on[k],
                                            .face = value[FACE].on[k],
                                            .weights = {0.4f, 1, 1e-3f, 1e-4f, 1e-4f, 1e-4f, 1e-5f, adaptive},
                                            .max_steps = STEPS,
                                            .n = n};
  return b;
}

/* Units of 2^-23 of the sum of the terms' sizes. The longest chain: an exponential or logarithm, 3 on a device and 1 in
 * the reference; the quotient and its square, 5 where division is not correctly rounded; products and sums 0.5 each and
 * in both: less than 24. The softmax has more: in the sum u - most of a part and that from most to most are rounded,
 * half a unit of their sizes, which is an error of as many units of the exponential; by share, so that their mean is
 * below log(n) + 1, 12. Its two exponentials and its additions are 12 more. The sum of a term: a part's share of n in
 * 64 items one after the other. */
static const double units = 24, share_units = 24;
static double sum_units(size_t n) { return 6 + (double)n / (64 * 64) / 2; }

static void expect_figure(int k, const char *what, size_t at, double found, double expected, double tolerance) {
  if (found == expected || fabs(found - expected) <= tolerance + 2 * (double)FLT_MIN) return;
  fail_msg("%s: %s [%zu]: %.9g, reference %.12g +- %.1e", machines.name[k], what, at, found, expected, tolerance);
}

/* What the values of one output are the sum of, without signs. */
static double size_of(const struct batch *b, int out, size_t r) {
  const struct ern_loss_weights *w = &b->args[0].weights;
  const size_t n = b->n;
  const double u = (double)b->in[UNCERTAINTY * n + r], face = (double)b->in[FACE * n + r], beta = u + 1;
  if (out == DUNCERTAINTY) {
    double squares = 0;
    for (size_t c = 0; c < 3; c++) squares += pow((double)(b->in[(PIXEL + c) * n + r] - b->in[(TRUTH + c) * n + r]), 2);
    const double parts = face * (log1p(u) / beta + sqrt(squares) / (beta * beta * beta));
    return (double)w->s * ((double)w->uncertainty * parts + (double)w->static_uncertainty * (1 - face)) / (double)n;
  }
  const float low = 1e-5f, opacity = b->in[OPACITY * n + r];
  const double held = (double)fminf(fmaxf(opacity, low), 1 - low);
  return (double)w->entropy / (double)n * (fabs(log2(held)) + fabs(log2(1 - held)));
}

/* ---- the CPU: the same in double, with what a value is the sum of, without signs ---- */

enum { G_PIXEL, G_OPACITY = 3, G_ATTENTION, G_EYE, G_UNCERTAINTY, GRADIENTS };

struct exact {
  double out[GRADIENTS], size[GRADIENTS], term[ERN_LOSS_EYE_AMBIENT + 1];
};

static struct exact exact_of(const struct batch *b, size_t r, double most, double sum, bool eye) {
  const struct ern_loss_weights *w = &b->args[0].weights;
  const double n = (double)b->n, s = (double)w->s;
  double in[IN_ROWS], squares = 0;
  struct exact e = {.out = {0}};
  for (size_t row = 0; row < IN_ROWS; row++) in[row] = (double)b->in[row * b->n + r];
  const double u = in[UNCERTAINTY], face = in[FACE], beta = u + 1;
  double weight = 1;
  if (w->adaptive) weight = 0.2 + 0.8 * fmin(fmax((1 - s) + s * n * exp(u - most) / sum, 0), 10);
  for (size_t c = 0; c < 3; c++) {
    const double difference = (double)(b->in[(PIXEL + c) * b->n + r] - b->in[(TRUTH + c) * b->n + r]);
    squares += difference * difference;
    e.out[G_PIXEL + c] = 2 / n / 3 * weight * difference;
    e.size[G_PIXEL + c] = fabs(e.out[G_PIXEL + c]);
  }
  const double error = sqrt(squares), log_part = log1p(u) / beta, error_part = error / (beta * beta * beta);
  const double by_unc = (double)w->uncertainty * s / n, by_out = (double)w->static_uncertainty * s / n;
  e.out[G_UNCERTAINTY] = by_unc * face * (log_part - error_part) + by_out * (1 - face);
  e.size[G_UNCERTAINTY] = by_unc * face * (log_part + error_part) + by_out * (1 - face);
  const float low = 1e-5f, high = 1 - low, opacity = b->in[OPACITY * b->n + r];
  const float held = opacity < low ? low : opacity > high ? high : opacity, rest = 1 - held;
  const double own = log2((double)held), other = log2((double)rest);
  if (opacity >= low && opacity <= high) e.out[G_OPACITY] = (double)w->entropy / n * (other - own);
  e.size[G_OPACITY] = (double)w->entropy / n * (fabs(own) + fabs(other));
  e.out[G_ATTENTION] = e.size[G_ATTENTION] = (double)w->audio_ambient * s / n * (1 - face);
  e.out[G_EYE] = e.size[G_EYE] = eye ? (double)w->eye_ambient * s / n / STEPS * in[ATTENTION] * face : 0;
  e.term[ERN_LOSS_PHOTOMETRIC] = weight * squares / 3 / n;
  e.term[ERN_LOSS_UNCERTAINTY] = by_unc * face * (error / (beta * beta) / 2 + log1p(u) * log1p(u) / 2);
  e.term[ERN_LOSS_STATIC_UNCERTAINTY] = by_out * u * (1 - face);
  e.term[ERN_LOSS_ENTROPY] = (double)w->entropy / n * (-(double)held * own - (double)rest * other);
  e.term[ERN_LOSS_AUDIO_AMBIENT] = (double)w->audio_ambient * s / n * in[ATTENTION] * (1 - face);
  e.term[ERN_LOSS_EYE_AMBIENT] = eye ? e.out[G_EYE] * in[EYE] : 0;
  return e;
}

/* Units of 2^-23 of the sum of the terms' sizes. The longest chain: an exponential or logarithm 2.5, the quotient and
 * its square 1.5, products and sums 0.5 each, less than 12. The softmax has more: u - most is rounded, half a unit of
 * its size, which is an error of as many units of the exponential. In the sum of the exponentials these sizes count by
 * share, so that their mean is below log(n) + 1. */
static const double cpu_units = 16, cpu_sum_units = 8;

/* The softmax's own kernel, and the softmax that values are held against. 110: beyond, the exponential is 0. */
static double softmax_of(const struct batch *b, int k, double *most) {
  const float *u = b->in + UNCERTAINTY * b->n;
  double sum = 0;
  *most = -INFINITY;
  for (size_t r = 0; r < b->n; r++) *most = fmax(*most, (double)u[r]);
  for (size_t r = 0; r < b->n; r++) sum += exp((double)u[r] - *most);
  const struct ern_softmax found = kernels_of(k)->head_softmax(u, b->n);
  assert_true((double)found.most == *most);
  expect_figure(k, "softmax", 0, found.sum, sum, (2 + cpu_sum_units) * 0x1p-23 * sum);
  return sum;
}

static void check_exact(const struct batch *b, int k, bool adaptive, bool eye) {
  const size_t n = b->n, stride = b->dpixel.on[0].stride;
  double terms[TERMS] = {0}, most, worst = 0;
  const double sum = softmax_of(b, k, &most);
  const float *found[GRADIENTS], *dpixel = floats_of(k, of_rows(b->dpixel));
  for (size_t c = 0; c < 3; c++) found[G_PIXEL + c] = dpixel + c * stride;
  for (size_t out = 0; out < OUT_SPANS; out++) found[G_OPACITY + out] = floats_of(k, b->out[out]);
  for (size_t r = 0; r < n; r++) {
    const struct exact e = exact_of(b, r, most, sum, eye);
    const double share = adaptive ? fmin(fabs((double)b->in[UNCERTAINTY * n + r] - most), 110) : 0;
    const double of_share = share + cpu_sum_units;
    worst = fmax(worst, of_share);
    for (size_t row = 0; row < GRADIENTS; row++) {
      const double allowed = cpu_units + (row < G_OPACITY && adaptive ? of_share : 0);
      if (row == G_EYE && !eye) {
        assert_true(is_poison(found[row][r]));
      } else {
        expect_figure(k, "gradient", row * n + r, (double)found[row][r], e.out[row], allowed * 0x1p-23 * e.size[row]);
      }
    }
    for (size_t t = 0; t < TERMS; t++) terms[t] += e.term[t];
  }
  for (size_t t = 0; t < TERMS; t++) {
    const double allowed = cpu_units + (t == ERN_LOSS_PHOTOMETRIC && adaptive ? worst : 0);
    expect_figure(k, "term", t, b->args[k].terms[t], terms[t], allowed * 0x1p-23 * terms[t]);
  }
}

static void check_head(size_t n, bool adaptive, kinds kind) {
  const bool eye = n % 2 == 0;
  struct batch b = batch_make(inputs_make(n, kind, n), n, adaptive, eye);
  RUN(head_loss, b.args);
  const double pixel_units = (units + (adaptive ? share_units : 0)) * 0x1p-23;
  EACH_OTHER (k) {
    if (!is_device(k)) continue;
    expect_near_on(k, "dpixel", of_rows(b.dpixel), pixel_units, 2 * (double)FLT_MIN);
    expect_near_on(k, "dattention", b.out[DATTENTION], 0, 0);
    expect_near_on(k, "deye", b.out[DEYE], 0, 0);
    for (int out = DOPACITY; out <= DUNCERTAINTY; out += DUNCERTAINTY - DOPACITY) {
      const float *expected = floats_of(0, b.out[out]), *found = floats_of(k, b.out[out]);
      for (size_t r = 0; r < n; r++)
        expect_figure(k, out == DOPACITY ? "dopacity" : "duncertainty", r, (double)found[r], (double)expected[r],
                      units * 0x1p-23 * size_of(&b, out, r));
    }
    for (size_t t = 0; t < TERMS; t++) { /* sums of what is positive */
      const double allowed = units + sum_units(n) + (t == ERN_LOSS_PHOTOMETRIC && adaptive ? share_units : 0);
      expect_figure(k, "term", t, b.args[k].terms[t], b.args[0].terms[t], allowed * 0x1p-23 * b.args[0].terms[t]);
    }
  }
  EACH_MACHINE (k) {
    assert_true(b.args[k].terms[ERN_LOSS_SMOOTHNESS] == -1 && b.args[k].terms[ERN_LOSS_KEY_POINTS] == -1);
    if (!is_device(k)) check_exact(&b, k, adaptive, eye);
  }
  machines_clear();
}

static void test_head(void **state) {
  (void)state;
  for (int kind = 0; kind < KINDS; kind++) {
    for (int adaptive = 0; adaptive < 2; adaptive++) {
      for (size_t s = 0; s < size_count(); s++) check_head(test_sizes[s], adaptive == 1, (kinds)kind);
      check_head(4097, adaptive == 1, (kinds)kind);
      if (!is_small()) check_head(MANY, adaptive == 1, (kinds)kind);
    }
  }
}

/* s = 1 and one uncertainty far above the others: its weight is 8.2 (the most there is) and theirs 0.2, not a bit more;
 * or all the same, however large: 1 each. */
static void test_softmax(void **state) {
  (void)state;
  for (int spike = 0; spike < 2; spike++) {
    const size_t n = 1000;
    float *in = inputs_make(n, USUAL, 3);
    for (size_t r = 0; r < n; r++) in[UNCERTAINTY * n + r] = spike && r == 777 ? 1e5f : 300;
    struct batch b = batch_make(in, n, true, true);
    EACH_MACHINE (k) b.args[k].weights.s = 1;
    RUN(head_loss, b.args);
    EACH_MACHINE (k) {
      const float *d = floats_of(k, of_rows(b.dpixel));
      for (size_t r = 0; r < n; r++) {
        const float weight = !spike ? 1 : r == 777 ? 8.2f : 0.2f;
        const float plain = (float)(2 / (3 * (double)n)) * weight * (in[PIXEL * n + r] - in[TRUTH * n + r]);
        expect_figure(k, "dpixel", r, (double)d[r], (double)plain, 8 * 0x1p-23 * fabs((double)plain));
      }
    }
    machines_clear();
  }
}

/* Whatever is no number in the reference is none here, and nothing else; nor is anything infinite but there. */
static void test_head_broken(void **state) {
  (void)state;
  static const float odd[] = {NAN, INFINITY, -INFINITY, -1, -3, 1e38f};
  for (size_t row = 0; row < IN_ROWS; row++) {
    for (size_t which = 0; which <= 6; which++) { /* one of them, or all */
      const size_t n = 130;
      float *in = inputs_make(n, USUAL, 5);
      for (size_t i = 0; i < 6; i++)
        if (which == i || which == 6) in[row * n + 20 * i] = odd[i];
      struct batch b = batch_make(in, n, row % 2 == 0 || row == UNCERTAINTY, true);
      RUN(head_loss, b.args);
      EACH_OTHER (k) {
        for (size_t out = 0; out <= OUT_SPANS; out++) {
          const struct many span = out < OUT_SPANS ? b.out[out] : of_rows(b.dpixel);
          const float *expected = floats_of(0, span), *found = floats_of(k, span);
          for (size_t i = 0; i < span.on[0].count; i++)
            if (isnan(found[i]) != isnan(expected[i]) || isfinite(found[i]) != isfinite(expected[i]) ||
                is_poison(found[i]) != is_poison(expected[i]))
              fail_msg("%s: gradient %zu [%zu] of odd input %zu (%zu): %g, reference %g", machines.name[k], out, i, row,
                       which, (double)found[i], (double)expected[i]);
        }
        for (size_t t = 0; t < TERMS; t++)
          if (isfinite(b.args[0].terms[t]) != isfinite(b.args[k].terms[t]))
            fail_msg("%s: term %zu of odd input %zu (%zu): %g, reference %g", machines.name[k], t, row, which,
                     b.args[k].terms[t], b.args[0].terms[t]);
      }
      machines_clear();
    }
  }
}

static void test_nothing(void **state) {
  (void)state;
  struct batch b = batch_make(inputs_make(8, USUAL, 1), 8, true, true);
  struct ern_mse_args mse[MACHINES];
  struct ern_smooth_loss_args smooth[MACHINES];
  struct ern_smooth_points_args points[MACHINES];
  EACH_MACHINE (k) {
    mse[k] = (struct ern_mse_args){.dpixel = b.dpixel.on[k], .term = 3};
    smooth[k] = (struct ern_smooth_loss_args){.dmoved = b.out[0].on[k], .term = 3};
    points[k] = (struct ern_smooth_points_args){.moved = b.dpixel.on[k]};
    b.args[k].n = 0;
  }
  RUN(head_loss, b.args);
  RUN(mse, mse);
  RUN(smooth_loss, smooth);
  RUN(smooth_points, points);
  EACH_MACHINE (k) {
    for (size_t t = 0; t < TERMS; t++) assert_true(b.args[k].terms[t] == 0);
    assert_true(mse[k].term == 0 && smooth[k].term == 0);
    if (kernels_of(k) == NULL) continue;
    const struct ern_softmax softmax = kernels_of(k)->head_softmax(b.in, 0);
    assert_true(softmax.sum == 0 && softmax.most == -INFINITY);
  }
  expect_near("dpixel", of_rows(b.dpixel), 0, 0);
  for (size_t out = 0; out < OUT_SPANS; out++) expect_near("gradient", b.out[out], 0, 0);
  machines_clear();
}

/* ---- squared differences ---- */

/* Usual ones; with a huge one, whose square no float holds; none but tiny ones, whose squares it loses; all sizes. */
static float difference_at(int kind, size_t i) {
  const float usual = random_at(1, i, 1);
  if (kind == 1 && i == 0) return 1e30f;
  if (kind == 2) return usual * 1e-30f;
  if (kind == 3) return usual * powf(10, random_at(2, i, 37));
  return usual;
}

/* Gradients to the bit. Terms in units of 2^-23: a square 1/2, three of them an element, and the additions. */
static double square_units(size_t n) { return 3 * sum_units(n) * 0x1p-23; }

static void check_differences(int kind, size_t n) {
  float *a = floats(3 * n), *b = floats(3 * n);
  for (size_t i = 0; i < 3 * n; i++) b[i] = kind == 0 ? random_at(3, i, 1) : 0, a[i] = difference_at(kind, i);
  const struct many_rows pixel = many_strided(a, 3, n, ERN_PER_RAY);
  const struct many_rows truth = many_strided(b, 3, n, ERN_PER_RAY);
  const struct many_rows dpixel = many_strided(NULL, 3, n, ERN_PER_RAY);
  const struct many moved = many_reals(a, n), still = many_reals(b, n);
  const struct many dmoved = many_empty(n);
  struct ern_mse_args mse[MACHINES];
  struct ern_smooth_loss_args smooth[MACHINES];
  EACH_MACHINE (k) {
    mse[k] = (struct ern_mse_args){dpixel.on[k], -1, pixel.on[k], truth.on[k], n};
    smooth[k] = (struct ern_smooth_loss_args){dmoved.on[k], -1, still.on[k], moved.on[k], 0.3f, n + 9, n};
  }
  RUN(mse, mse);
  RUN(smooth_loss, smooth);
  expect_near("dpixel", of_rows(dpixel), 0, 0);
  expect_near("dmoved", dmoved, 0, 0);
  EACH_OTHER (k) {
    /* on the CPU sums of the same doubles in another order: n roundings of 2^-53 at most, on each side */
    const double allowed = is_device(k) ? square_units(n) : (double)n * 0x1p-52;
    if (fabs(mse[k].term - mse[0].term) > allowed * mse[0].term)
      fail_msg("%s: mse of %zu, kind %d: %.9g, reference %.9g", machines.name[k], n, kind, mse[k].term, mse[0].term);
    if (fabs(smooth[k].term - smooth[0].term) > allowed * smooth[0].term)
      fail_msg("%s: smooth_loss of %zu, kind %d: %.9g, reference %.9g", machines.name[k], n, kind, smooth[k].term,
               smooth[0].term);
  }
  machines_clear();
}

static void test_differences(void **state) {
  (void)state;
  for (int kind = 0; kind < 4; kind++) {
    for (size_t s = 0; s < size_count(); s++) check_differences(kind, test_sizes[s]);
    check_differences(kind, is_small() ? 4097 : MANY);
  }
}

static void test_broken_differences(void **state) {
  (void)state;
  static const float odd[] = {NAN, INFINITY, -INFINITY};
  for (size_t i = 0; i < 3; i++) {
    float a[65] = {0}, b[65] = {0};
    a[64] = odd[i];
    const struct many moved = many_reals(a, 65), still = many_reals(b, 65);
    const struct many dmoved = many_empty(65);
    struct ern_smooth_loss_args smooth[MACHINES];
    EACH_MACHINE (k) smooth[k] = (struct ern_smooth_loss_args){dmoved.on[k], 0, still.on[k], moved.on[k], 1, 65, 65};
    RUN(smooth_loss, smooth);
    expect_near("dmoved", dmoved, 0, 0);
    EACH_MACHINE (k) assert_true(i == 0 ? isnan(smooth[k].term) : smooth[k].term == (double)INFINITY);
    machines_clear();
  }
}

/* To the bit, where division is. Accumulates. */
static void test_key_points(void **state) {
  (void)state;
  for (int kind = 0; kind < 4; kind++) {
    float anchors[12], danchors[12];
    for (size_t i = 0; i < 12; i++) anchors[i] = difference_at(kind, 12 - i) * 3, danchors[i] = random_at(9, i, 1);
    const struct many at = many_reals(anchors, 12), d = many_reals(danchors, 12);
    struct ern_key_points_loss_args args[MACHINES];
    EACH_MACHINE (k) args[k] = (struct ern_key_points_loss_args){d.on[k], -1, at.on[k]};
    RUN(key_points_loss, args);
    EACH_OTHER (k) {
      expect_near_on(k, "danchors", d, divides_exactly(k) ? 0 : 0x1p-21, 0);
      assert_true(args[k].term == args[0].term);
    }
    machines_clear();
  }
}

static void test_points(void **state) {
  (void)state;
  static const uint64_t seeds[] = {0, 1, 0xffffffffffffffffu, 0x123456789abcdef0u};
  for (size_t s = 0; s < size_count(); s++) {
    const size_t n = test_sizes[s];
    float *values = floats(3 * n);
    fill_random(values, 3 * n, s, 1);
    const struct many_rows x = many_strided(values, 3, n, ERN_PER_SAMPLE);
    const struct many_rows moved = many_strided(NULL, 3, n, ERN_PER_SAMPLE);
    struct ern_smooth_points_args args[MACHINES];
    EACH_MACHINE (k)
      args[k] = (struct ern_smooth_points_args){.moved = moved.on[k],
                                                .x = x.on[k],
                                                .reach = 1e-3f,
                                                .seed = seeds[s % 4],
                                                .step = seeds[(s / 4) % 4] + s,
                                                .first = s * 1000 + 5,
                                                .n = n};
    RUN(smooth_points, args);
    expect_near("moved", of_rows(moved), 0, 0);
    machines_clear();
  }
}

/* ---- figures ---- */

/* More figures than there is room for come one after the other, each its own; the same ones on every run. */
static void check_figures(const struct batch *b, int k) {
  enum { CALLS = 100, N = 300 };
  static struct ern_mse_args mse[2][CALLS];
  static struct ern_head_loss_args head[2][CALLS];
  for (int run = 0; run < 2; run++) {
    for (size_t i = 0; i < CALLS; i++) {
      mse[run][i] = (struct ern_mse_args){b->dpixel.on[k], -1, b->args[k].pixel, b->args[k].truth, N - 2 * i};
      head[run][i] = b->args[k];
      head[run][i].n = N - 2 * i;
      support_ok(machines.context, machines.backend[k]->mse(machines.stream[k], &mse[run][i]));
      support_ok(machines.context, machines.backend[k]->head_loss(machines.stream[k], &head[run][i]));
    }
    support_ok(machines.context, machines.backend[k]->synchronize(machines.stream[k]));
  }
  for (size_t i = 0; i < CALLS; i++) {
    struct ern_mse_args expected = {b->dpixel.on[0], -1, b->args[0].pixel, b->args[0].truth, N - 2 * i};
    RUN_ON(0, mse, &expected);
    expect_figure(k, "mse", i, mse[0][i].term, expected.term, square_units(N) * expected.term);
    assert_true(mse[0][i].term == mse[1][i].term);
    assert_memory_equal(head[0][i].terms, head[1][i].terms, sizeof head[0][i].terms);
  }
  machines.checks += 2;
}

static void test_many_figures(void **state) {
  (void)state;
  const struct batch b = batch_make(inputs_make(300, USUAL, 4), 300, true, true);
  EACH_OTHER (k) check_figures(&b, k);
  machines_clear();
}

static ern_status no_select(struct ern_stream *stream, struct ern_torso_select_args *args) {
  (void)stream, (void)args;
  return ERN_E_DEVICE;
}

/* A step that fails leaves no figure behind that would be written to its arguments later: of devices, where it waits.
 */
static void test_failed_step(void **state) {
  (void)state;
  const struct batch b = batch_make(inputs_make(8, USUAL, 1), 8, true, true);
  EACH_OTHER (k) {
    struct ern_backend *backend = machines.backend[k];
    struct ern_mse_args mse = {b.dpixel.on[k], 0, b.args[k].pixel, b.args[k].truth, 8};
    const struct ern_view view = {.width = 8, .height = 8};
    struct ern_torso_step_args step = {.view = &view, .n = 8};
    ern_status (*const select)(struct ern_stream *, struct ern_torso_select_args *) = backend->torso_select;
    if (!is_device(k)) continue;
    support_ok(machines.context, backend->mse(machines.stream[k], &mse));
    mse.term = -5;
    backend->torso_select = no_select;
    assert_int_equal(backend->torso_step(machines.stream[k], &step), ERN_E_DEVICE);
    backend->torso_select = select;
    support_ok(machines.context, backend->synchronize(machines.stream[k]));
    assert_true(mse.term == -5);
    RUN_ON(k, mse, &mse);
    assert_true(mse.term > 0);
  }
  machines_clear();
}

/* Sums of n products of three factors up to 1 in floats, 64 side by side: 2^-23 of the sizes' sum for each of n/64 + 16
 * additions and for the products. */
static void test_pose(void **state) {
  (void)state;
  for (size_t s = 0; s <= size_count(); s++) {
    const size_t n = s < size_count() ? test_sizes[s] : is_small() ? 200 : MANY;
    float *values = floats(3 * n);
    struct many_rows rows[4];
    for (size_t r = 0; r < COUNT_OF(rows); r++) {
      fill_random(values, 3 * n, 4 * s + r, 1);
      rows[r] = many_strided(values, 3, n, ERN_PER_SAMPLE);
    }
    const struct many weight = many_reals(values, n);
    struct ern_pose_bwd_args args[MACHINES];
    EACH_MACHINE (k)
      args[k] = (struct ern_pose_bwd_args){
          .dx = rows[0].on[k], .x = rows[1].on[k], .dd = rows[2].on[k], .d = rows[3].on[k], .n = n};
    for (int directions = 1; directions >= 0; directions--) {
      EACH_MACHINE (k) {
        if (directions == 0) args[k].dd = args[k].d = (ern_rows){0}, args[k].weight = weight.on[k];
        RUN_ON(k, pose_bwd, &args[k]);
      }
      EACH_OTHER (k)
        for (size_t i = 0; i < ERN_POSE_PARAMETERS; i++)
          assert_true(fabs(args[k].dpose[i] - args[0].dpose[i]) <=
                      0x1p-23 * 4 * (double)n * ((double)n / (64 * 64) + 20));
      assert_true(args[0].dpose[0] != 0);
    }
    machines_clear();
  }
}

static void bench(void) {
  enum { N = 4096 };
  const struct batch b = batch_make(inputs_make(N, USUAL, 1), N, true, true);
  const struct many still = many_reals(b.in, N), moved = many_reals(b.in + N, N), dmoved = many_zeros(N);
  struct ern_mse_args mse[MACHINES];
  struct ern_smooth_loss_args smooth[MACHINES];
  struct ern_smooth_points_args points[MACHINES];
  EACH_MACHINE (k) {
    mse[k] = (struct ern_mse_args){b.dpixel.on[k], 0, b.args[k].pixel, b.args[k].truth, N};
    smooth[k] = (struct ern_smooth_loss_args){dmoved.on[k], 0, still.on[k], moved.on[k], 1, N, N};
    points[k] = (struct ern_smooth_points_args){
        .moved = b.dpixel.on[k], .x = b.args[k].pixel, .reach = 1e-3f, .seed = 1, .step = 2, .n = N};
  }
  struct ern_head_loss_args head[MACHINES];
  EACH_MACHINE (k) head[k] = b.args[k];
  BENCH("softmax and head_loss", N, head_loss, head);
  BENCH("mse", N, mse, mse);
  BENCH("smooth_loss", N, smooth_loss, smooth);
  BENCH("smooth_points", N, smooth_points, points);
  machines_clear();
}

static const struct CMUnitTest tests[] = {
    cmocka_unit_test(test_head),        cmocka_unit_test(test_softmax),     cmocka_unit_test(test_head_broken),
    cmocka_unit_test(test_nothing),     cmocka_unit_test(test_differences), cmocka_unit_test(test_broken_differences),
    cmocka_unit_test(test_key_points),  cmocka_unit_test(test_points),      cmocka_unit_test(test_many_figures),
    cmocka_unit_test(test_failed_step), cmocka_unit_test(test_pose),
};
NOUN(losses, bench, .isa = NULL)
