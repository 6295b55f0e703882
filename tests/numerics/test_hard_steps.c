/* SPDX-License-Identifier: MIT
 * The fused training step of the head, and its densities alone, with networks and tables at their ends: held against
 * the stages in double (docs/numerics.md). */
#include "passes.h"
#include "render/render_ops.h"
#include "train/losses_ops.h"
#include "train/step.h"
#include "train/step_ops.h"

/* ---- a step ---- */

struct stepped {
  struct many gradient;
  double term[MACHINES][ERN_LOSS_TERMS], error[MACHINES];
  size_t samples;
};

struct setting {
  size_t rays;
  bool smooth, empty;
  float eye;
};
static const struct setting usual = {100, true, false, 0.4f};

static double sum_of_terms(const struct stepped *s, int k) {
  double sum = 0;
  for (int t = 0; t < ERN_LOSS_TERMS; t++) sum += s->term[k][t];
  return sum;
}

/* Rows of a step all have the stride of those in scratch. */
static size_t stride_of(size_t rays) { return (rays + 63) / 64 * 64; }

/* Truth, background, face and speech of any values. */
static struct ern_head_step_args batch_on(int k, const struct many *values, const struct many *number,
                                          const struct many *bits, const struct setting *how) {
  const size_t n = how->rays, stride = stride_of(n);
  struct ern_head_step_args args = {
      .field = &passes.field,
      .view = &passes.view,
      .settings = &passes.settings,
      .bits = bits->on[k],
      .pixel_number = number->on[k],
      .truth = {ern_span_part(values->on[k], 0, 3 * stride), stride, 3, ERN_PER_RAY},
      .background = {ern_span_part(values->on[k], 3 * stride, 3 * stride), stride, 3, ERN_PER_RAY},
      .face = ern_span_part(values->on[k], 6 * stride, n),
      .windows = ern_span_part(values->on[k], 7 * stride, PASS_WINDOWS),
      .eye_value = how->eye,
      .individual = 1,
      .weights = {0.5f, 1, 0.5f, 0.5f, 0.1f, 0.1f, 1, true},
      .transmittance_stop = 1e-4f,
      .smooth = how->smooth,
      .seed = 9,
      .step = 4,
      .n = n};
  return args;
}

static struct stepped step(const struct setting *how) {
  static float values[7 * PASS_RAYS + PASS_WINDOWS];
  int32_t number[PASS_RAYS];
  const size_t n = how->rays, count = 7 * stride_of(n) + PASS_WINDOWS;
  for (size_t i = 0; i < count; i++) values[i] = 0.5f + machines_random(6, i, 0.5f);
  for (size_t i = 0; i < n; i++) number[i] = (int32_t)((i * 37 + 7 * 16 + 7) % PASS_RAYS);
  const struct many parameters = many_reals(passes.block, passes.field.parameters), all = many_reals(values, count);
  const struct many at = many_int32s(number, n), jitter = many_zeros(n);
  const struct many bits = many_of(ERN_ELEMENT_BYTE, how->empty ? passes.nothing : passes.ball, ERN_OCCUPANCY_BYTES);
  struct stepped out = {.gradient = many_zeros(passes.field.parameters)};
  for (int k = 0; k < machines.count; k++) {
    struct ern_head_step_args args = batch_on(k, &all, &at, &bits, how);
    args.parameters = parameters.on[k];
    args.dparameters = out.gradient.on[k];
    args.jitter = jitter.on[k];
    support_ok(machines.context, machines.backend[k]->head_step(machines.stream[k], &args));
    support_ok(machines.context, machines.backend[k]->synchronize(machines.stream[k]));
    memcpy(out.term[k], args.terms, sizeof args.terms);
    out.error[k] = args.squared_error;
    if (k == 0) out.samples = args.samples;
    assert_int_equal(args.samples, out.samples);
  }
  return out;
}

/* ---- what is expected ---- */

static double distance(const double *a, const double *b, const struct ern_parameter *row) {
  double sum = 0;
  for (size_t i = 0; i < row->count; i++) {
    const size_t at = MACHINE_GUARD + row->at + i;
    const double by = a[at] - (b != NULL ? b[at] : 0);
    sum += by * by;
  }
  return sqrt(sum);
}

/* All terms and gradients are finite and, tensor by tensor, no further from those in double than a few times what the
 * float reference is off by, whose sums are made in another order (tests/kernelcheck/step.c). */
static void expect_step(const char *what, const struct stepped *s, double floor) {
  double *truth = many_values(0, s->gradient), *plain = many_values(1, s->gradient);
  for (int k = 0; k < machines.count; k++) {
    double *found = many_values(k, s->gradient);
    for (int t = 0; t < ERN_LOSS_TERMS; t++) {
      const double expected = s->term[0][t], usually = fabs(s->term[1][t] - expected);
      if (!isfinite(s->term[k][t]) || !(fabs(s->term[k][t] - expected) <= 6 * usually + floor * fabs(expected) + 1e-30))
        fail_msg("%s: %s: term %d is %.9g, in double %.9g", machines.name[k], what, t, s->term[k][t], expected);
    }
    for (int r = 0; r < passes.table.rows; r++) {
      const struct ern_parameter *row = &passes.table.row[r];
      const double size = distance(truth, NULL, row), off = distance(found, truth, row);
      if (!(off <= 6 * distance(plain, truth, row) + floor * size + 1e-30))
        fail_msg("%s: %s: gradient of %s is off by %.3g of %.3g", machines.name[k], what, row->name, off, size);
    }
    free(found);
  }
  free(truth), free(plain);
}

/* As above, but of the gradients alone that they are finite. */
static void expect_finite_step(const char *what, const struct stepped *s) {
  for (int k = 0; k < machines.count; k++)
    for (int t = 0; t < ERN_LOSS_TERMS; t++)
      if (!isfinite(s->term[k][t])) fail_msg("%s: %s: term %d is %g", machines.name[k], what, t, s->term[k][t]);
  expect_within(what, s->gradient, -FLT_MAX, FLT_MAX);
}

/* The gradient of a layer's rows [first, first + rows) is 0: exactly, or in double what no float is. */
static void expect_no_gradient(const char *what, const struct stepped *s, const struct ern_mlp *net, int layer,
                               int first, int rows) {
  const size_t width = (size_t)net->width[layer], begin = net->weight[layer] + (size_t)first * width;
  for (int k = 0; k < machines.count; k++) {
    double *found = many_values(k, s->gradient);
    for (size_t i = begin; i < begin + (size_t)rows * width; i++) /* below the least float: 0 */
      if (!(fabs(found[MACHINE_GUARD + i]) < (k == 0 ? 1e-100 : 0x1p-149)))
        fail_msg("%s: %s: gradient of weight %zu is %g", machines.name[k], what, i - begin, found[MACHINE_GUARD + i]);
    free(found);
  }
}

static const double FLOOR = 1e-4; /* sums of some thousand terms of either sign; the speech's softmax */

static void set_exponents(float times) { set_row_sign(&passes.field.density, 2, 0, times); }

/* ---- cases ---- */

/* case: a step on ordinary values | plain code: - | here: the others have something to lose | bound: 6 times what `ref`
 * is off by, or 1e-4 */
static void test_step_of_the_usual(void **state) {
  (void)state;
  passes_reset();
  const struct stepped s = step(&usual);
  assert_true(s.samples > 200);
  expect_step("usual", &s, FLOOR);
}

/* case: exponents of +-1e3 to +-1e20 | plain code: `inf * 0` in gradients | here: finite; no gradient behind an opaque
 * sample, nor of its density | bound: exactly 0 */
/* Opaque at once: what is behind, and the density itself, get no gradient at all. Nothing there: a gradient, as the
 * gradient of the density's exponent is clamped. */
static void test_step_exponents_of_200(void **state) {
  (void)state;
  static const float times[] = {1e3f, 1e6f, 1e20f};
  for (size_t i = 0; i < COUNT_OF(times); i++) {
    passes_reset();
    set_exponents(times[i]);
    const struct stepped opaque = step(&usual);
    expect_finite_step("opaque", &opaque);
    expect_no_gradient("opaque", &opaque, &passes.field.density, 2, 0, 1);
    passes_reset();
    set_exponents(-times[i]);
    const struct stepped empty = step(&usual);
    expect_finite_step("empty", &empty);
    for (int k = 0; k < machines.count; k++) /* every pixel is its background */
      assert_true(fabs(empty.error[k] - empty.error[0]) <= 1e-5 * empty.error[0]);
    if (times[i] < 1e5f) expect_step("empty", &empty, FLOOR);
  }
}

/* case: colours driven to both ends | plain code: `s (1 - s)` of a rounded s | here: no gradient | bound: exactly 0 */
static void test_step_of_saturated_colour(void **state) {
  (void)state;
  static const float times[] = {1e4f, 1e10f, 1e30f};
  for (size_t i = 0; i < COUNT_OF(times); i++) {
    passes_reset();
    for (int c = 0; c < 3; c++) set_row_sign(&passes.field.colour, 1, c, c == 1 ? -times[i] : times[i]);
    const struct stepped s = step(&usual);
    expect_finite_step("saturated", &s);
    expect_no_gradient("saturated", &s, &passes.field.colour, 1, 0, 3); /* e^-1000 */
    expect_no_gradient("saturated", &s, &passes.field.colour, 0, 0, passes.field.colour.width[1]);
  }
}

/* case: units off; all parameters 0 | plain code: 0/0 in v/abs(v) | here: no gradient below them | bound: exactly 0 */
static void test_step_of_dead_units(void **state) {
  (void)state;
  const struct ern_field *f = &passes.field;
  passes_reset();
  kill_units(&f->density, 1);
  const struct stepped s = step(&usual);
  expect_step("dead", &s, FLOOR);
  expect_no_gradient("dead", &s, &f->density, 0, 0, f->density.width[1]);
  expect_no_gradient("dead", &s, &f->density, 1, 0, f->density.width[2]);
  expect_no_gradient("dead", &s, &f->density, 2, 0, 1);
  passes_reset();
  for (size_t i = 0; i < f->parameters; i++) passes.block[i] = 0;
  const struct stepped none = step(&usual);
  expect_finite_step("all zero", &none);
  expect_step("all zero", &none, FLOOR);
}

/* case: each layer times 1e12 | plain code: gradients infinite | here: finite | bound: finite */
/* Each layer of each network 1e12 as large. */
static void test_step_with_layers_of_1e12(void **state) {
  (void)state;
  const struct ern_field *f = &passes.field;
  const struct ern_mlp *const nets[] = {&f->attention, &f->eye, &f->density, &f->colour, &f->uncertainty};
  for (size_t n = 0; n < COUNT_OF(nets); n++) {
    for (int layer = 0; layer < nets[n]->layers; layer++) {
      char what[64];
      snprintf(what, sizeof what, "network %zu, layer %d", n, layer);
      passes_reset();
      scale_layer(nets[n], layer, 1e12f);
      const struct stepped s = step(&usual);
      expect_finite_step(what, &s);
    }
  }
}

/* case: all parameters times 1e-20 and 1e-38 | plain code: denormals | here: the losses of zeros | bound: 1e-5 */
static void test_step_of_denormal_values(void **state) {
  (void)state;
  const struct ern_field *f = &passes.field;
  passes_reset();
  for (size_t i = 0; i < f->parameters; i++) passes.block[i] *= i % 2 == 0 ? 1e-20f : 1e-38f;
  const struct stepped s = step(&usual);
  expect_finite_step("denormal", &s);
  for (int k = 0; k < machines.count; k++)
    for (int t = 0; t < ERN_LOSS_TERMS; t++)
      assert_true(fabs(s.term[k][t] - s.term[0][t]) <= 1e-5 * fabs(s.term[0][t]) + 1e-30);
}

/* case: one weight NaN, in each layer | plain code: hidden by ReLU or a sample left out | here: the loss is NaN |
 * bound: exact */
/* A NaN in a network: the loss is NaN, by which the training ends. */
static void test_step_with_a_nan_among_the_weights(void **state) {
  (void)state;
  const struct ern_field *f = &passes.field;
  const struct ern_mlp *const nets[] = {&f->attention, &f->eye, &f->density, &f->colour, &f->uncertainty};
  for (size_t n = 0; n < COUNT_OF(nets); n++) {
    for (int layer = 0; layer < nets[n]->layers; layer++) {
      passes_reset();
      passes.block[nets[n]->weight[layer] + 3] = NAN;
      const struct stepped s = step(&usual);
      for (int k = 0; k < machines.count; k++)
        if (isfinite(sum_of_terms(&s, k)))
          fail_msg("%s: network %zu, layer %d: NaN is hidden", machines.name[k], n, layer);
    }
  }
}

/* case: entries of a table NaN | plain code: the same | here: the loss is NaN where a sample looks at them, else not |
 * bound: exact */
/* The same of one sample: of entries of a table that few samples look at. */
static void test_step_with_a_nan_in_one_sample(void **state) {
  (void)state;
  const struct ern_field *f = &passes.field;
  const struct ern_grid_level *level = &f->encoder.grid[0].level[1];
  size_t seen = 0;
  for (uint32_t at = 0; at < 3; at++) {
    passes_reset();
    for (uint32_t i = at; i < level->size; i += 509) passes.block[f->encoder.table[0] + level->offset + i] = NAN;
    const struct setting once = {200, at == 1, false, 0.4f};
    const struct stepped s = step(&once);
    const bool met = !isfinite(sum_of_terms(&s, 1));
    for (int k = 1; k < machines.count; k++)
      if (isfinite(sum_of_terms(&s, k)) == met) fail_msg("%s: NaN is hidden, or made", machines.name[k]);
    seen += met;
  }
  assert_true(seen > 0);
}

/* case: attention of 0, 1e-35 to 1e25, and its gradient | plain code: dnorm/norm infinite, or 0/0 | here: v/abs(v) of
 * scaled values; 0 at 0 | bound: 6 times what `ref` is off by */
/* |v| of 0, of what has no square, and its gradient v/|v|; the density does not look at v. */
static void test_step_attention_of_zero_tiny_and_huge(void **state) {
  (void)state;
  static const float size[] = {0, 1e-35f, 1e-25f, 1e-18f, 1e12f, 1e20f, 1e25f};
  const struct ern_field *f = &passes.field;
  for (size_t i = 0; i < COUNT_OF(size); i++) {
    char what[64];
    snprintf(what, sizeof what, "attention times %g", (double)size[i]);
    passes_reset();
    set_inputs(&f->density, 0, f->feature_rows, ERN_AUDIO_CODE, 0);
    scale_layer(&f->attention, 1, size[i]);
    const struct setting how = {100, size[i] < 1e10f, false, 0.4f}; /* squares of differences of 1e20 leave float */
    const struct stepped s = step(&how);
    expect_finite_step(what, &s);
    if (size[i] == 0) expect_no_gradient(what, &s, &f->attention, 0, 0, f->attention.width[1]);
    if (size[i] > 1e-30f) expect_step(what, &s, FLOOR);
    if (size[i] > 0) assert_true(s.term[0][ERN_LOSS_AUDIO_AMBIENT] > 0);
  }
}

/* case: eye attention at 0 and 1, uncertainty of 0 and 1e6 | plain code: gradients of a rounded s; `exp` infinite |
 * here: as the stages | bound: 6 times what `ref` is off by */
/* Eye attention at 0 and 1, uncertainties of 0 and 1e10. */
static void test_step_of_saturated_eye_and_uncertainty(void **state) {
  (void)state;
  static const float times[] = {-1e6f, 1e6f};
  for (size_t i = 0; i < COUNT_OF(times); i++) {
    for (int which = 0; which < 2; which++) {
      passes_reset();
      set_row_sign(which == 0 ? &passes.field.eye : &passes.field.uncertainty, 1, 0, times[i]);
      struct setting how = usual;
      how.eye = which == 0 ? (float)i : 0.4f;
      const struct stepped s = step(&how);
      expect_finite_step("saturated", &s);
      expect_step("saturated", &s, FLOOR);
      if (which == 0) expect_no_gradient("eye", &s, &passes.field.eye, 1, 0, 1);
    }
  }
}

/* case: 1 to 129 rays | plain code: rows behind the last sample count | here: zeros count for nothing | bound: 6 times
 * what `ref` is off by */
/* Counts around those of a tile and of a shard; one ray; a batch that meets nothing. */
static void test_step_of_odd_counts(void **state) {
  (void)state;
  static const size_t counts[] = {1, 2, 15, 17, 47, 49, 63, 65, 129};
  for (size_t i = 0; i < COUNT_OF(counts); i++) {
    char what[64];
    snprintf(what, sizeof what, "%zu rays", counts[i]);
    passes_reset();
    const struct setting how = {counts[i], i % 2 == 0, false, 1};
    const struct stepped s = step(&how);
    expect_step(what, &s, FLOOR);
  }
}

/* case: no ray meets anything | plain code: means over none | here: the background's losses, no gradient | bound:
 * exactly 0 */
static void test_step_of_rays_without_samples(void **state) {
  (void)state;
  for (int smooth = 0; smooth < 2; smooth++) {
    passes_reset();
    const struct setting how = {65, smooth == 1, true, 0.4f};
    const struct stepped s = step(&how);
    assert_int_equal(s.samples, 0);
    expect_step("nothing", &s, 1e-6);
    expect_within("gradient", s.gradient, 0, 0);
  }
}

/* ---- densities ---- */

/* case: densities at the cube's ends, beside it, at NaN | plain code: a cell outside the table | here: outside features
 * are 0 | bound: 640 x 2^-23 */
/* Points at the ends of the cube and beside it, of NaN and infinity, as many as fill tiles oddly; exponents of any
 * size. What lies outside has features of 0 and a density all the same. */
static void test_densities_of_odd_points(void **state) {
  (void)state;
  static const float ends[] = {0,
                               -0.0f,
                               1,
                               -1,
                               1 + FLT_EPSILON,
                               -1 - FLT_EPSILON,
                               NAN,
                               INFINITY,
                               -3e38f,
                               FLT_TRUE_MIN,
                               0.5f,
                               1 - FLT_EPSILON / 2};
  static const float times[] = {1, 1e6f, -1e6f, 1e30f};
  enum { ENDS = COUNT_OF(ends), POINTS = ENDS * ENDS + 1 };
  float x[3 * POINTS], code[ERN_AUDIO_CODE];
  for (size_t i = 0; i < POINTS; i++)
    x[i] = ends[i % ENDS], x[POINTS + i] = ends[i / ENDS % ENDS], x[2 * POINTS + i] = ends[(i + i / ENDS) % ENDS];
  for (size_t c = 0; c < ERN_AUDIO_CODE; c++) code[c] = machines_random(5, c, 1);
  for (size_t i = 0; i < COUNT_OF(times); i++) {
    passes_reset();
    set_exponents(times[i]);
    const struct many parameters = many_reals(passes.block, passes.field.parameters), codes = many_reals(code, 32);
    const struct many at = many_reals(x, 3 * POINTS), sigma = many_empty(POINTS);
    ON_EACH(head_density, ern_head_density_args,
            {.sigma = sigma.on[k],
             .x = {at.on[k], POINTS, 3, ERN_PER_SAMPLE},
             .parameters = parameters.on[k],
             .field = &passes.field,
             .code = codes.on[k],
             .eye_value = 0.4f,
             .n = POINTS})
    expect_within("sigma", sigma, 0, 5.6e34);
    expect_truth("sigma", sigma, i == 0 ? 0x1p-16 : 80 * 0x1p-23, 1.2e-38);
  }
}

/* On an OpenCL device a step goes through the stages, each of which has rows of its own; building their kernels for one
 * more model takes a minute. */
static int open_all(void **state) {
  (void)state;
  machines_open_on(getenv("ERNERF_TEST_LONG") != NULL);
  passes_open(true, 2, false);
  return 0;
}
int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_step_of_the_usual),
      cmocka_unit_test(test_step_exponents_of_200),
      cmocka_unit_test(test_step_of_saturated_colour),
      cmocka_unit_test(test_step_of_dead_units),
      cmocka_unit_test(test_step_with_layers_of_1e12),
      cmocka_unit_test(test_step_of_denormal_values),
      cmocka_unit_test(test_step_with_a_nan_among_the_weights),
      cmocka_unit_test(test_step_with_a_nan_in_one_sample),
      cmocka_unit_test(test_step_attention_of_zero_tiny_and_huge),
      cmocka_unit_test(test_step_of_saturated_eye_and_uncertainty),
      cmocka_unit_test(test_step_of_odd_counts),
      cmocka_unit_test(test_step_of_rays_without_samples),
      cmocka_unit_test(test_densities_of_odd_points),
  };
  return cmocka_run_group_tests(tests, open_all, close_passes);
}
