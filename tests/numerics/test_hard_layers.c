/* SPDX-License-Identifier: MIT
 * Activations and layers at the ends of their range (docs/numerics.md). */
#include "machines.h"
#include "mlp/activation_ops.h"
#include "mlp/mlp_ops.h"

/* ---- activations ---- */

enum { MOST = 64 };
static const double ulp = 0x1p-23; /* of a value of 1; relative for others */

struct activation {
  struct many y, dx;
};
static struct activation activate(ern_activation kind, const float *x, size_t n, float dy) {
  float upstream[MOST];
  for (size_t i = 0; i < MOST; i++) upstream[i] = dy;
  machines_clear();
  const struct many in = many_reals(x, n), by = many_reals(upstream, n);
  const struct activation out = {many_empty(n), many_empty(n)};
  ON_EACH(activate_fwd, ern_activate_fwd_args,
          {.y = {out.y.on[k], n, 1, ERN_PER_SAMPLE}, .x = {in.on[k], n, 1, ERN_PER_SAMPLE}, .kind = kind, .n = n})
  ON_EACH(activate_bwd, ern_activate_bwd_args,
          {.dx = {out.dx.on[k], n, 1, ERN_PER_SAMPLE},
           .dy = {by.on[k], n, 1, ERN_PER_SAMPLE},
           .x = {in.on[k], n, 1, ERN_PER_SAMPLE},
           .kind = kind,
           .n = n})
  return out;
}

/* 19 of them: more than a register, and not a multiple of one. */
static const float ends[] = {-200,  200,      -100,      100, -88.8f,       88.8f,         80,    -80,     15,      -15,
                             1e30f, -FLT_MAX, -INFINITY, 0,   FLT_TRUE_MIN, -FLT_TRUE_MIN, 17.0f, -103.9f, INFINITY};
enum { ENDS = sizeof ends / sizeof *ends };

/* case: density exponents of +-200, +-infinity | plain code: `exp(200)` infinite | here: `exp(min(x, 80))`, at most
 * 5.54e34 | bound: 80 x 2^-23 */
static void test_density_exponents_of_200(void **state) {
  (void)state;
  const struct activation a = activate(ERN_ACT_DENSITY, ends, ENDS, 1);
  expect_within("density", a.y, 0, 5.5407e34);
  expect_truth("density", a.y, 80 * ulp, (double)FLT_MIN); /* exp(80) as float: 80 * 2^-24 of its argument too */
  expect_at("exp(-200)", a.y, 0, 0, (double)FLT_MIN);
  expect_at("exp(min(200, 80))", a.y, 1, exp(80), 80 * ulp * exp(80));
  expect_at("exp(0)", a.y, 13, 1, 0);
  expect_at("exp(-infinity)", a.y, 12, 0, 0);
}

/* case: its gradient beyond +-15, upstream 1e30 | plain code: `exp(200)` again | here: `exp(clamp(x, -15, 15))` |
 * bound: 16 x 2^-23 */
/* exp(200) is no float: the gradient is that of exp(15) beyond 15, and of exp(-15) below. */
static void test_density_gradient_is_clamped(void **state) {
  (void)state;
  const struct activation a = activate(ERN_ACT_DENSITY, ends, ENDS, 1);
  expect_within("gradient", a.dx, exp(-15) * (1 - 8 * ulp), exp(15) * (1 + 8 * ulp));
  expect_truth("gradient", a.dx, 16 * ulp, 0);
  const struct activation huge = activate(ERN_ACT_DENSITY, ends, ENDS, -1e30f);
  expect_within("gradient of -1e30", huge.dx, -4e36, 0);
}

/* case: saturated colours, to +-infinity | plain code: inf/inf | here: `1/(1 + exp(-x))` | bound: in [-0.001, 1.001], 4
 * x 2^-23 */
static void test_saturated_colour(void **state) {
  (void)state;
  const struct activation a = activate(ERN_ACT_COLOUR, ends, ENDS, 1);
  expect_within("colour", a.y, -0.001 - ulp, 1.001 + ulp);
  expect_truth("colour", a.y, 4 * ulp, ulp);
  expect_at("colour of 200", a.y, 1, 1.001, ulp);
  expect_at("colour of -200", a.y, 0, -0.001, ulp);
  expect_within("gradient", a.dx, 0, 0.2505 + ulp);
  expect_truth("gradient", a.dx, 8 * ulp, (double)FLT_MIN);
}

/* case: sigmoids where s rounds to 1 | plain code: `s (1 - s)` is 0 from 17 on | here: `e/(1 + e)^2`, `e =
 * exp(-abs(x))` | bound: 8 x 2^-23 */
/* s (1 - s) is 0 from 17 on, where s rounds to 1; e/(1 + e)^2 is not, down to the denormal numbers. */
static void test_saturated_sigmoid(void **state) {
  (void)state;
  const struct activation a = activate(ERN_ACT_SIGMOID, ends, ENDS, 1);
  expect_within("sigmoid", a.y, 0, 1);
  expect_truth("sigmoid", a.y, 4 * ulp, (double)FLT_MIN);
  expect_at("sigmoid of 200", a.y, 1, 1, 0x1p-24);
  expect_truth("gradient", a.dx, 8 * ulp, (double)FLT_MIN);
  expect_at("gradient at 17", a.dx, 16, exp(-17), 8 * ulp * exp(-17));
  expect_within("gradient", a.dx, 0, 0.25);
}

/* case: softplus of -103 to 1e30 | plain code: infinite from 88, 0 from -17 | here: `max(x, 0) + log1p(exp(-abs(x)))` |
 * bound: 4 x 2^-23 */
/* log(1 + exp(x)) is infinite from 88.8 on and 0 below -17: ours is x there, and exp(x). */
static void test_softplus_without_overflow(void **state) {
  (void)state;
  const struct activation a = activate(ERN_ACT_SOFTPLUS, ends, ENDS - 1, 1); /* without infinity */
  expect_within("softplus", a.y, 0, 1.0001e30);
  expect_truth("softplus", a.y, 4 * ulp, (double)FLT_MIN);
  expect_at("softplus of 200", a.y, 1, 200, 0);
  expect_at("softplus of -80", a.y, 7, exp(-80), 80 * ulp * exp(-80));
  expect_within("gradient", a.dx, 0, 1);
  expect_truth("gradient", a.dx, 4 * ulp, (double)FLT_MIN);
  const float far[1] = {INFINITY};
  expect_at("softplus of infinity", activate(ERN_ACT_SOFTPLUS, far, 1, 1).y, 0, INFINITY, 0);
}

/* case: ReLU at 0, -0, denormals, FLT_MAX | plain code: slope at 0 differs between passes | here: slope 0 at 0 | bound:
 * exact */
static void test_relu_at_zero(void **state) {
  (void)state;
  const float x[] = {0, -0.0f, FLT_TRUE_MIN, -FLT_TRUE_MIN, FLT_MIN, FLT_MAX, -FLT_MAX};
  const struct activation a = activate(ERN_ACT_RELU, x, COUNT_OF(x), 3);
  for (size_t i = 0; i < COUNT_OF(x); i++) {
    if (x[i] == FLT_TRUE_MIN) continue; /* a device may take it for 0 */
    expect_at("relu", a.y, i, x[i] > 0 ? (double)x[i] : 0, (double)FLT_MIN);
    expect_at("gradient", a.dx, i, x[i] > 0 ? 3 : 0, 0);
  }
}

/* case: NaN into each activation, in each lane | plain code: `fmaxf(NaN, 0)` is 0 | here: stays NaN, alone | bound:
 * exact */
/* fmaxf(NaN, 0) is 0: a broken weight would go unnoticed. Here a NaN stays one, in its own lane. */
static void test_activation_of_a_nan(void **state) {
  (void)state;
  for (int kind = ERN_ACT_DENSITY; kind <= ERN_ACT_RELU; kind++) {
    for (size_t bad = 0; bad < 33; bad += 8) {
      float x[33];
      for (size_t i = 0; i < 33; i++) x[i] = i == bad ? NAN : (float)i / 8 - 2;
      const struct activation a = activate((ern_activation)kind, x, 33, 1);
      expect_at("NaN", a.y, bad, (double)NAN, 0);
      expect_truth("its neighbours", a.y, 8 * ulp, ulp);
      expect_truth("their gradients", a.dx, 8 * ulp, ulp);
    }
  }
}

/* case: counts of 0 to 63 | plain code: reads past the end | here: neither read nor written | bound: 8 x 2^-23 */
static void test_activation_of_odd_counts(void **state) {
  (void)state;
  static const size_t counts[] = {0, 1, 2, 7, 8, 9, 15, 16, 17, 31, 33, 63};
  for (size_t c = 0; c < COUNT_OF(counts); c++) {
    float x[MOST];
    for (size_t i = 0; i < MOST; i++) x[i] = ends[i % ENDS];
    const struct activation a = activate(ERN_ACT_SIGMOID, x, counts[c], 1);
    expect_within("sigmoid", a.y, 0, 1); /* and nothing behind it is written, which the guards see */
    expect_truth("gradient", a.dx, 8 * ulp, (double)FLT_MIN);
  }
}

/* ---- layers: 8 -> 16 -> 4 ---- */

enum { INS = 8, HIDDEN = 16, OUTS = 4, WEIGHTS = INS * HIDDEN + HIDDEN * OUTS };
static const struct ern_mlp shape = {2, {INS, HIDDEN, OUTS}, {0, INS *HIDDEN}};

struct layers {
  struct many y, dx, dweights;
};
static struct layers layers(const float *weights, const float *x, const float *dy, size_t n) {
  machines_clear();
  const struct many w = many_reals(weights, WEIGHTS), in = many_reals(x, INS * n), by = many_reals(dy, OUTS * n);
  const struct layers out = {many_empty(OUTS * n), many_zeros(INS * n), many_zeros(WEIGHTS)};
  struct ern_mlp_fwd_args forward[MACHINES];
  for (int k = 0; k < machines.count; k++)
    forward[k] = (struct ern_mlp_fwd_args){.y = {out.y.on[k], n, OUTS, ERN_PER_SAMPLE},
                                           .x = {{in.on[k], n, INS, ERN_PER_SAMPLE}},
                                           .pieces = 1,
                                           .parameters = w.on[k],
                                           .mlp = shape,
                                           .n = n};
  ON_EACH(mlp_fwd, ern_mlp_fwd_args, forward[k])
  ON_EACH(mlp_bwd, ern_mlp_bwd_args,
          {.dx = {{out.dx.on[k], n, INS, ERN_PER_SAMPLE}},
           .dparameters = out.dweights.on[k],
           .dy = {by.on[k], n, OUTS, ERN_PER_SAMPLE},
           .forward = forward[k]})
  return out;
}

static float weights[WEIGHTS], inputs[INS * 1024], upstream[OUTS * 1024];
static void fill(float weight, float input, float gradient) {
  for (size_t i = 0; i < WEIGHTS; i++) weights[i] = machines_random(1, i, weight);
  for (size_t i = 0; i < COUNT_OF(inputs); i++) inputs[i] = machines_random(2, i, input);
  for (size_t i = 0; i < COUNT_OF(upstream); i++) upstream[i] = machines_random(3, i, gradient);
}

/* case: weights and inputs 1e12; inputs 1e30; gradients 1e20 | plain code: squares and norms overflow | here: finite
 * while the sum of sizes is | bound: 32 x 2^-23 of the sum of sizes */
/* Sums of 8 and 16 products, and of 33 samples; the gradient of a weight is relative to its largest terms. */
static void test_layers_of_huge_values(void **state) {
  (void)state;
  static const float scales[][3] = {{1e12f, 1e12f, 1e-12f}, {1e-12f, 1e30f, 1e6f}, {1e6f, 1e-30f, 1e20f}};
  for (size_t s = 0; s < COUNT_OF(scales); s++) {
    const float *c = scales[s];
    fill(c[0], c[1], c[2]);
    const struct layers l = layers(weights, inputs, upstream, 33);
    const double y = (double)c[0] * c[0] * c[1] * INS * HIDDEN, dw = (double)c[0] * c[1] * c[2] * 33 * INS;
    expect_within("y", l.y, -y, y);
    expect_truth("y", l.y, 0, 32 * ulp * y);
    expect_within("dw", l.dweights, -dw, dw);
    expect_truth("dw", l.dweights, 0, 64 * ulp * dw);
    expect_truth("dx", l.dx, 0, 32 * ulp * (double)c[0] * c[0] * c[2] * OUTS * HIDDEN);
  }
}

/* case: weights and inputs of 1e-20 | plain code: 100 times slower, or flushed | here: below 1.2e-38 is nothing |
 * bound: 1.2e-38 */
static void test_layers_of_denormal_values(void **state) {
  (void)state;
  fill(1e-20f, 1e-20f, 1e-20f);
  const struct layers l = layers(weights, inputs, upstream, 17);
  expect_within("y", l.y, -1e-30, 1e-30);
  expect_within("dx", l.dx, -1e-30, 1e-30);
  expect_within("dw", l.dweights, -1e-30, 1e-30);
  expect_truth("y", l.y, 0, (double)FLT_MIN);
}

/* case: one NaN among the weights | plain code: ReLU by maximum hides it | here: all outputs NaN; the training refuses
 * it | bound: exact */
/* A NaN among the weights shows in every sample's result; a unit that hides it behind max(x, 0) would hide a ruined
 * checkpoint. */
static void test_nan_among_the_weights(void **state) {
  (void)state;
  fill(1, 1, 1);
  for (size_t o = 0; o < OUTS; o++)
    for (size_t h = 0; h < HIDDEN; h++) weights[INS * HIDDEN + o * HIDDEN + h] = 1;
  weights[5] = NAN; /* of hidden unit 0 */
  const struct layers l = layers(weights, inputs, upstream, 33);
  for (size_t i = 0; i < (size_t)OUTS * 33; i++) expect_at("y", l.y, i, (double)NAN, 0);
}

/* case: one NaN among the samples | plain code: the tile is NaN | here: its outputs, and the weights' gradient | bound:
 * exact */
/* A NaN in one sample: its own outputs, and the sums over all samples, where the training looks for it. */
static void test_nan_in_one_sample(void **state) {
  (void)state;
  fill(1, 1, 1);
  enum { N = 37, BAD = 16 };
  for (size_t c = 0; c < INS; c++) inputs[c * N + BAD] = NAN;
  const struct layers l = layers(weights, inputs, upstream, N);
  for (size_t o = 0; o < OUTS; o++) {
    expect_at("y", l.y, o * N + BAD, (double)NAN, 0);
    expect_at("dw", l.dweights, o, (double)NAN, 0);
  }
  expect_truth("y of the others", l.y, 0, 32 * ulp * INS * HIDDEN);
  for (int k = 0; k < machines.count; k++) {
    double *dx = many_values(k, l.dx);
    for (size_t i = 0; i < (size_t)INS * N; i++)
      if (i % N != BAD && !isfinite(dx[MACHINE_GUARD + i])) fail_msg("%s: dx %zu is no number", machines.name[k], i);
    free(dx);
  }
}

/* case: all units off, gradients of 1e20 | plain code: 0/0 | here: zeros | bound: exact */
/* Units that no sample turns on: no value, no gradient, and no 0/0. */
static void test_dead_units(void **state) {
  (void)state;
  fill(1, 1, 1e20f);
  for (size_t i = 0; i < INS * HIDDEN; i++) weights[i] = -fabsf(weights[i]);
  for (size_t i = 0; i < COUNT_OF(inputs); i++) inputs[i] = fabsf(inputs[i]) + 0.01f;
  const struct layers l = layers(weights, inputs, upstream, 33);
  expect_within("y", l.y, 0, 0);
  expect_within("dx", l.dx, 0, 0);
  expect_within("dw", l.dweights, 0, 0);
}

/* case: weight gradients over 2^20 samples | plain code: one float sum: 6 % off | here: tiles, then 16 shards: sums of
 * 1,024 | bound: 552 x 2^-23 */
/* The gradient of a weight is a sum over all samples of a batch: by tiles, then by 16 shards, so that no sum in float
 * is longer than a sixteenth of the tiles. One sum over 2^20 terms of 0.1 would be off by up to 6 %. */
static void test_weight_gradients_of_a_million_samples(void **state) {
  (void)state;
  enum { N = 1 << 20 };
  float *x = malloc(INS * N * sizeof *x), *dy = malloc(OUTS * N * sizeof *dy);
  assert_true(x != NULL && dy != NULL);
  for (size_t i = 0; i < INS * N; i++) x[i] = 0.1f;
  for (size_t i = 0; i < OUTS * N; i++) dy[i] = 1;
  for (size_t i = 0; i < WEIGHTS; i++) weights[i] = 0.5f;
  const struct layers l = layers(weights, x, dy, N);
  /* N/64 tiles/16 shards = 1,024 sums, half an ulp each, and those within a tile */
  expect_truth("dw", l.dweights, (1024 + 64 + 16) * ulp / 2, 0);
  expect_at("dw", l.dweights, 0, 0.1 * 2 * N, 0.1 * 2 * N * 7e-5);
  free(x);
  free(dy);
}

/* case: 0, 1, 3 .. 129 samples | plain code: tails twice, or not | here: zeros that count for nothing | bound: 32 x
 * 2^-23 */
static void test_layers_of_odd_counts(void **state) {
  (void)state;
  static const size_t counts[] = {0, 1, 3, 16, 17, 63, 65, 129};
  fill(1, 1, 1);
  for (size_t c = 0; c < COUNT_OF(counts); c++) {
    const struct layers l = layers(weights, inputs, upstream, counts[c]);
    expect_truth("y", l.y, 0, 32 * ulp * INS * HIDDEN);
    expect_truth("dw", l.dweights, 0, 256 * ulp * INS * 129);
    if (counts[c] == 0) expect_within("dw of no sample", l.dweights, 0, 0);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_density_exponents_of_200),
      cmocka_unit_test(test_density_gradient_is_clamped),
      cmocka_unit_test(test_saturated_colour),
      cmocka_unit_test(test_saturated_sigmoid),
      cmocka_unit_test(test_softplus_without_overflow),
      cmocka_unit_test(test_relu_at_zero),
      cmocka_unit_test(test_activation_of_a_nan),
      cmocka_unit_test(test_activation_of_odd_counts),
      cmocka_unit_test(test_layers_of_huge_values),
      cmocka_unit_test(test_layers_of_denormal_values),
      cmocka_unit_test(test_nan_among_the_weights),
      cmocka_unit_test(test_nan_in_one_sample),
      cmocka_unit_test(test_dead_units),
      cmocka_unit_test(test_weight_gradients_of_a_million_samples),
      cmocka_unit_test(test_layers_of_odd_counts),
  };
  return cmocka_run_group_tests(tests, open_hosts, close_machines);
}
