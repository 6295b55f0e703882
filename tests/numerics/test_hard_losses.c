/* SPDX-License-Identifier: MIT
 * The losses at their ends, and sums over very many rays (docs/numerics.md). Values against double, gradients too. */
#include "machines.h"
#include "train/losses_ops.h"

enum { MOST = 65536 };

/* The rays of a batch, and what the head's losses make of them. */
struct batch {
  size_t n;
  float pixel[3 * MOST], truth[3 * MOST], opacity[MOST], attention[MOST], eye[MOST], uncertainty[MOST], face[MOST];
  struct many dpixel, dopacity, dattention, deye, duncertainty;
  double terms[MACHINES][ERN_LOSS_TERMS];
};
static struct batch batch; /* too large for a stack */

static const struct ern_loss_weights all_weights = {0.5f, 1, 1e-3f, 1e-4f, 1e-4f, 1e-4f, 1e-5f, true};

/* A half-opaque, half-certain batch with an error of 1/4; the rows behind n are of a smaller batch too. */
static void usual(size_t n) {
  batch.n = n;
  for (size_t i = 0; i < n; i++) {
    for (size_t c = 0; c < 3; c++) batch.pixel[c * n + i] = 0.5f, batch.truth[c * n + i] = 0.25f;
    batch.opacity[i] = 0.5f, batch.attention[i] = 1, batch.eye[i] = 1, batch.uncertainty[i] = 0.1f;
    batch.face[i] = (float)(i % 2);
  }
}

static void lose_with(struct ern_loss_weights weights) {
  const size_t n = batch.n;
  machines_clear();
  const struct many pixel = many_reals(batch.pixel, 3 * n), truth = many_reals(batch.truth, 3 * n);
  const struct many opacity = many_reals(batch.opacity, n), attention = many_reals(batch.attention, n);
  const struct many eye = many_reals(batch.eye, n), uncertainty = many_reals(batch.uncertainty, n);
  const struct many face = many_reals(batch.face, n);
  batch.dpixel = many_empty(3 * n), batch.dopacity = many_empty(n), batch.dattention = many_empty(n);
  batch.deye = many_empty(n), batch.duncertainty = many_empty(n);
  for (int k = 0; k < machines.count; k++) {
    struct ern_head_loss_args args = {.dpixel = {batch.dpixel.on[k], n, 3, ERN_PER_RAY},
                                      .dopacity = batch.dopacity.on[k],
                                      .dattention = batch.dattention.on[k],
                                      .deye = batch.deye.on[k],
                                      .duncertainty = batch.duncertainty.on[k],
                                      .pixel = {pixel.on[k], n, 3, ERN_PER_RAY},
                                      .truth = {truth.on[k], n, 3, ERN_PER_RAY},
                                      .opacity = opacity.on[k],
                                      .attention = attention.on[k],
                                      .eye = eye.on[k],
                                      .uncertainty = uncertainty.on[k],
                                      .face = face.on[k],
                                      .weights = weights,
                                      .max_steps = 16,
                                      .n = n};
    support_ok(machines.context, machines.backend[k]->head_loss(machines.stream[k], &args));
    support_ok(machines.context, machines.backend[k]->synchronize(machines.stream[k]));
    memcpy(batch.terms[k], args.terms, sizeof args.terms);
  }
}
static void lose(void) { lose_with(all_weights); }

/* Of every machine: finite, and the double's but for `relative`. */
static void expect_term(const char *what, int term, double relative) {
  for (int k = 0; k < machines.count; k++) {
    const double found = batch.terms[k][term], expected = batch.terms[0][term];
    if (!isfinite(found) || fabs(found - expected) > relative * fabs(expected) + 1e-30)
      fail_msg("%s: %s: found %.9g, in double %.9g", machines.name[k], what, found, expected);
  }
}

/* 8 roundings of a ray's term; sums are in double, on a device in float by parts of 65,536/64 rays, 16 to a lane and 6
 * halvings. */
static const double loss_rounding = (8 + 16 + 6) * 0x1p-23;

static void expect_all_terms(void) {
  static const char *const names[] = {"photometric", "uncertainty", "static", "entropy", "audio", "eye"};
  for (int t = ERN_LOSS_PHOTOMETRIC; t <= ERN_LOSS_EYE_AMBIENT; t++) expect_term(names[t], t, loss_rounding);
}
static void expect_all_gradients(void) {
  const double n = (double)batch.n;
  expect_within("dpixel", batch.dpixel, -8.5 / n, 8.5 / n); /* 2/3 of an error of 1, weights up to 8.2 */
  expect_within("dopacity", batch.dopacity, -17e-4 / n, 17e-4 / n);
  expect_within("duncertainty", batch.duncertainty, -2 / n, 2 / n);
  expect_truth("dpixel", batch.dpixel, 64 * 0x1p-23, 1e-12);
  expect_truth("duncertainty", batch.duncertainty, 0, 32 * 0x1p-23 / n);
}

/* The photometric weight of each ray is 0.2 + 0.8 (1 - s + s R softmax): 1 where all are equal. */
static void softmax_of(float each, size_t spike_at, float spike) {
  usual(MOST);
  for (size_t i = 0; i < MOST; i++) batch.uncertainty[i] = i == spike_at ? spike : each;
  lose();
  expect_all_terms();
  expect_all_gradients();
}

/* case: softmax over 65,536 equal values | plain code: the sum loses 2^-8 | here: `exp(u - max)`, sum in double |
 * bound: each weight 1, 30 x 2^-23 */
static void test_softmax_over_65536_equal_values(void **state) {
  (void)state;
  softmax_of(0.1f, MOST, 0);
  for (int k = 0; k < machines.count; k++) {
    const double found = batch.terms[k][ERN_LOSS_PHOTOMETRIC];
    if (fabs(found - 0.0625) > 0.0625 * loss_rounding) fail_msg("%s: found %.9g", machines.name[k], found);
  }
}

/* case: the same of 88, 1e3, 1e30 | plain code: inf/inf | here: `exp(u - max)` is 1 | bound: 30 x 2^-23 */
static void test_softmax_over_65536_huge_values(void **state) {
  (void)state;
  static const float huge[] = {88, 1e3f, 1e10f, 1e30f};
  for (size_t i = 0; i < COUNT_OF(huge); i++) {
    softmax_of(huge[i], MOST, 0);
    for (int k = 0; k < machines.count; k++)
      assert_true(fabs(batch.terms[k][ERN_LOSS_PHOTOMETRIC] - 0.0625) <= 0.0625 * loss_rounding);
  }
}

/* case: a single spike of 200 or 1e30 | plain code: infinite, or a step of weight 65,536 | here: share 1, weight
 * clamped at 8.2, others 0.6 | bound: 16 x 2^-23 */
/* One ray has all of the softmax: its weight is clamped at 0.2 + 0.8 * 10, the others have 0.2 + 0.8 (1 - s). */
static void test_softmax_with_a_single_spike(void **state) {
  (void)state;
  static const size_t places[] = {0, 17, 1023, 40000, MOST - 1};
  for (size_t p = 0; p < COUNT_OF(places); p++) {
    softmax_of(0, places[p], p % 2 == 0 ? 1e30f : 200);
    const double share = 2.0 / 3 * 0.25 / MOST;
    expect_at("dpixel of the spike", batch.dpixel, places[p], 8.2 * share, 16 * 0x1p-23 * share);
    expect_at("dpixel beside it", batch.dpixel, places[p] ^ 1, 0.6 * share, 16 * 0x1p-23 * share);
  }
}

/* case: a batch of one ray, of none | plain code: mean over 0 | here: all terms 0 | bound: exact */
static void test_softmax_of_one_ray_and_of_none(void **state) {
  (void)state;
  usual(1);
  lose();
  expect_all_terms();
  usual(0);
  lose();
  for (int k = 0; k < machines.count; k++)
    for (int t = ERN_LOSS_PHOTOMETRIC; t <= ERN_LOSS_EYE_AMBIENT; t++) assert_true(batch.terms[k][t] == 0);
}

/* case: entropy at 0, -0, 1, denormal, beyond | plain code: `0 log 0` | here: clamped to [1e-5, 1 - 1e-5], no gradient
 * beyond | bound: slope to 16.7, entropy of 1e-5 at the ends */
/* -w log2 w at w = 0 is 0 times infinity; log2((1 - w)/w) is infinite at both ends. */
static void test_entropy_at_0_and_1(void **state) {
  (void)state;
  static const float ends[] = {0,       -0.0f,  1,       FLT_TRUE_MIN, 1e-30f, 1.1e-5f,
                               9.9e-6f, -1e-3f, 1.0001f, 0.9999f,      0.5f,   0.9999999f};
  usual(97);
  for (size_t i = 0; i < batch.n; i++) batch.opacity[i] = ends[i % COUNT_OF(ends)];
  lose();
  expect_all_terms();
  expect_within("dopacity", batch.dopacity, -1e-4 * 16.7 / 97, 1e-4 * 16.7 / 97);
  for (size_t i = 0; i < 3; i++) expect_at("no gradient beyond the clamp", batch.dopacity, i, 0, 0);
  expect_at("at a half", batch.dopacity, 10, 0, 1e-12);
  /* at the clamp's ends 1 - w and 1e-5 have lost 2^-24 of 1e-5 */
  expect_truth("dopacity", batch.dopacity, 0, 1e-4 / 97 * 0.02);
  for (size_t i = 0; i < batch.n; i++) batch.opacity[i] = i % 2 == 0 ? 0 : 1;
  lose();
  for (int k = 0; k < machines.count; k++) /* H(1e-5) = 1.8e-4 bits, not 0 and not NaN */
    assert_true(fabs(batch.terms[k][ERN_LOSS_ENTROPY] / 1e-4 - 1.8052e-4) < 2e-6);
}

/* case: uncertainty of 0 to 1e30 | plain code: beta^3 overflows at 1e13 | here: quotients in turn, `log1p` | bound: 16
 * x 2^-23 */
static void test_uncertainty_of_zero_and_1e30(void **state) {
  (void)state;
  static const float u[] = {0, FLT_TRUE_MIN, 1e-30f, 1e-8f, 1, 1e10f, 1e19f, 1e20f, 1e30f};
  usual(90);
  struct ern_loss_weights weights = all_weights;
  weights.adaptive = false;
  for (size_t i = 0; i < batch.n; i++) batch.uncertainty[i] = u[i % COUNT_OF(u)], batch.face[i] = 1;
  lose_with(weights);
  expect_all_terms();
  expect_within("duncertainty", batch.duncertainty, -1.0 / 90, 1.0 / 90);
  expect_truth("duncertainty", batch.duncertainty, 0, 16 * 0x1p-23 / 90);
}

/* case: an error of exactly 0 | plain code: slope of `sqrt(0)` | here: no gradient through the root | bound: exactly 0
 */
/* sqrt(0) has no gradient; the error itself has no gradient, the squares have one. */
static void test_error_of_zero(void **state) {
  (void)state;
  usual(33);
  for (size_t i = 0; i < 3 * batch.n; i++) batch.truth[i] = batch.pixel[i];
  lose();
  expect_all_terms();
  expect_within("dpixel", batch.dpixel, 0, 0);
  expect_within("duncertainty", batch.duncertainty, -1.0 / 33, 1.0 / 33);
  for (int k = 0; k < machines.count; k++) assert_true(batch.terms[k][ERN_LOSS_PHOTOMETRIC] == 0);
}

/* case: attention of 0 and 1e18 | plain code: sums overflow | here: products of two, sums in double | bound: 30 x 2^-23
 */
static void test_attention_of_zero_and_1e18(void **state) {
  (void)state;
  usual(65);
  for (size_t i = 0; i < batch.n; i++)
    batch.attention[i] = i % 3 == 0 ? 0 : 1e18f, batch.eye[i] = i % 3 == 1 ? 16 : 1e18f;
  lose();
  expect_all_terms();
  expect_within("dattention", batch.dattention, 0, 1e-4);
  expect_within("deye", batch.deye, 0, 1e18);
}

/* ---- sums over many rays ---- */

static double mse_terms[MACHINES];
static struct many mse_gradient;
static void mse_of(const float *pixel, const float *truth, size_t n) {
  machines_clear();
  const struct many p = many_reals(pixel, 3 * n), t = many_reals(truth, 3 * n);
  mse_gradient = many_empty(3 * n);
  for (int k = 0; k < machines.count; k++) {
    struct ern_mse_args args = {.dpixel = {mse_gradient.on[k], n, 3, ERN_PER_RAY},
                                .pixel = {p.on[k], n, 3, ERN_PER_RAY},
                                .truth = {t.on[k], n, 3, ERN_PER_RAY},
                                .n = n};
    support_ok(machines.context, machines.backend[k]->mse(machines.stream[k], &args));
    support_ok(machines.context, machines.backend[k]->synchronize(machines.stream[k]));
    mse_terms[k] = args.term;
  }
}
static void expect_mse(double expected, double relative) {
  for (int k = 0; k < machines.count; k++)
    if (!(fabs(mse_terms[k] - expected) <= relative * expected))
      fail_msg("%s: found %.12g, expected %.12g", machines.name[k], mse_terms[k], expected);
}

/* case: means over 2^22 rays; one large among millions of small | plain code: a float stops at 2^24 terms | here:
 * double; a device 1,024 terms a sum | bound: 3078 x 2^-24, on a CPU 1e-9 */
/* In one float, 12 million squares of 0.01 stop growing at 2^17 * ..; the CPU sums in double, a device in 64 parts of
 * 64 sums each: 2^22/4096 = 1,024 terms a sum, then 6 halvings, then double. */
static void test_mean_over_four_million_rays_long(void **state) {
  (void)state;
  enum { N = 1 << 22 };
  float *pixel = malloc(3 * N * sizeof *pixel), *truth = calloc(3 * N, sizeof *truth);
  assert_true(pixel != NULL && truth != NULL);
  for (size_t i = 0; i < 3 * N; i++) pixel[i] = 0.1f;
  mse_of(pixel, truth, N);
  expect_mse((double)0.1f * (double)0.1f, (3 * 1024 + 6) * 0x1p-24);
  for (int k = 0; k < machines.count; k++)
    if (strncmp(machines.name[k], "opencl", 6) != 0)
      assert_true(fabs(mse_terms[k] / mse_terms[0] - 1) < 3 * N * 0x1p-53);
  for (size_t i = 0; i < 3 * N; i++) pixel[i] = i == 5 ? 1 : 1e-4f; /* one large one among millions of small ones */
  mse_of(pixel, truth, N);
  expect_mse((1 + (3.0 * N - 1) * (double)1e-4f * (double)1e-4f) / (3.0 * N), (3 * 1024 + 6) * 0x1p-24);
  free(pixel);
  free(truth);
}

/* case: squares of 1e-30 and 1e37 | plain code: 0 and infinite | here: double; a device scales them | bound: 64 x 2^-23
 */
static void test_squares_that_leave_float(void **state) {
  (void)state;
  static const float sizes[] = {1e-30f, 1e-22f, 1e15f, 1e25f, 1e37f};
  float pixel[3 * 50], truth[3 * 50] = {0};
  for (size_t s = 0; s < COUNT_OF(sizes); s++) {
    for (size_t i = 0; i < 150; i++) pixel[i] = sizes[s];
    mse_of(pixel, truth, 50);
    expect_mse((double)sizes[s] * (double)sizes[s], 64 * 0x1p-23);
    expect_truth("dpixel", mse_gradient, 4 * 0x1p-23, (double)FLT_MIN);
  }
  mse_of(pixel, truth, 0);
  for (int k = 0; k < machines.count; k++) assert_true(mse_terms[k] == 0);
}

/* case: smoothness of points one ulp and 1e30 apart | plain code: the square is 0 or infinite | here: as above | bound:
 * 64 x 2^-23 */
/* The smoothness of what moved by one ulp, and by 1e30. */
static void test_smoothness_of_hardly_and_far_moved(void **state) {
  (void)state;
  float still[77], moved[77];
  for (int far = 0; far < 2; far++) {
    for (size_t i = 0; i < 77; i++)
      still[i] = (float)(i % 7) / 7, moved[i] = far ? 1e30f * (float)(i % 3) : nextafterf(still[i], 2);
    machines_clear();
    const struct many from = many_reals(still, 77), to = many_reals(moved, 77), gradient = many_empty(77);
    double term[MACHINES] = {0};
    for (int k = 0; k < machines.count; k++) {
      struct ern_smooth_loss_args args = {
          .dmoved = gradient.on[k], .still = from.on[k], .moved = to.on[k], .weight = 1e-5f, .batch = 77, .n = 77};
      support_ok(machines.context, machines.backend[k]->smooth_loss(machines.stream[k], &args));
      support_ok(machines.context, machines.backend[k]->synchronize(machines.stream[k]));
      term[k] = args.term;
      assert_true(isfinite(term[k]) && fabs(term[k] / term[0] - 1) < 64 * 0x1p-23);
    }
    expect_truth("dmoved", gradient, 8 * 0x1p-23, (double)FLT_MIN);
    expect_within("dmoved", gradient, -1e-5, 1e25);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_softmax_over_65536_equal_values),
      cmocka_unit_test(test_softmax_over_65536_huge_values),
      cmocka_unit_test(test_softmax_with_a_single_spike),
      cmocka_unit_test(test_softmax_of_one_ray_and_of_none),
      cmocka_unit_test(test_entropy_at_0_and_1),
      cmocka_unit_test(test_uncertainty_of_zero_and_1e30),
      cmocka_unit_test(test_error_of_zero),
      cmocka_unit_test(test_attention_of_zero_and_1e18),
      cmocka_unit_test(test_mean_over_four_million_rays_long),
      cmocka_unit_test(test_squares_that_leave_float),
      cmocka_unit_test(test_smoothness_of_hardly_and_far_moved),
  };
  return cmocka_run_group_tests(tests, open_hosts, close_machines);
}
