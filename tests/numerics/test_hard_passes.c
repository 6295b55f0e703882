/* SPDX-License-Identifier: MIT
 * The fused pass of rendering, from pixel numbers to pixels, with networks and tables at their ends; held against the
 * stages in double (docs/numerics.md). */
#include "passes.h"
#include "render/render_ops.h"

/* ---- a picture ---- */

struct drawn {
  struct many pixel, colour, opacity, depth, attention;
  size_t n;
};

static ern_rows rows_on(struct many span, int k, int rows, size_t n) {
  return (ern_rows){span.on[k], n, rows, ERN_PER_RAY};
}

/* The first n of these pixels, on all machines. */
static struct drawn draw(const int32_t *number, size_t n, const uint8_t *cells) {
  float code[ERN_AUDIO_CODE], background[3 * PASS_RAYS];
  for (size_t i = 0; i < ERN_AUDIO_CODE; i++) code[i] = machines_random(5, i, 1);
  for (size_t i = 0; i < 3 * n; i++) background[i] = 0.25f + 0.5f * (float)(number[i % n] % 7) / 7;
  const struct many parameters = many_reals(passes.block, passes.field.parameters), codes = many_reals(code, 32);
  const struct many bits = many_of(ERN_ELEMENT_BYTE, cells, ERN_OCCUPANCY_BYTES), at = many_int32s(number, n);
  const struct many back = many_reals(background, 3 * n);
  const struct drawn out = {many_empty(3 * n), many_empty(3 * n), many_empty(n), many_empty(n), many_empty(n), n};
  for (int k = 0; k < machines.count; k++) {
    struct ern_render_prepare_args prepare = {parameters.on[k], &passes.field};
    support_ok(machines.context, machines.backend[k]->render_prepare(machines.stream[k], &prepare));
  }
  ON_EACH(render_rays, ern_render_rays_args,
          {.pixel = rows_on(out.pixel, k, 3, n),
           .colour = rows_on(out.colour, k, 3, n),
           .opacity = out.opacity.on[k],
           .depth = out.depth.on[k],
           .attention = out.attention.on[k],
           .pixel_number = at.on[k],
           .view = passes.view,
           .background = rows_on(back, k, 3, n),
           .bits = bits.on[k],
           .parameters = parameters.on[k],
           .field = &passes.field,
           .code = codes.on[k],
           .settings = passes.settings,
           .transmittance_stop = 1e-4f,
           .n = n})
  return out;
}

static struct drawn draw_all(void) {
  int32_t number[PASS_RAYS];
  for (int32_t i = 0; i < PASS_RAYS; i++) number[i] = i;
  return draw(number, PASS_RAYS, passes.ball);
}

static float background_of(size_t ray) { return 0.25f + 0.5f * (float)(ray % 7) / 7; }

/* Finite numbers in their ranges; depths within the box, seen from 3 away. */
static void expect_finite(const struct drawn *d) {
  expect_within("pixel", d->pixel, 0, 1);
  expect_within("opacity", d->opacity, 0, 1 + 0x1p-20);
  expect_within("depth", d->depth, 0, 5);
  expect_within("attention", d->attention, 0, FLT_MAX);
}

/* Which rays meet the ball: those in the middle, and not those in the corners. */
static bool meets(const double *opacity, size_t ray) {
  return opacity[MACHINE_GUARD + ray] > 0 || isnan(opacity[MACHINE_GUARD + ray]);
}

/* The density's exponent is times the sum of positive values, so of one sign, and nothing else changes. */
static void set_exponents(float times) { set_row_sign(&passes.field.density, 2, 0, times); }
/* The density is 1 everywhere: exp(0). */
static void set_density_one(void) { set_exponents(0); }

/* Sums of up to 16 samples of alpha and T with a rounding of 2^-23 each, tau up to 5. */
static const double SUMS = 2 * 16 * 5 * 0x1p-23;
/* bf16: each of the layers' sums is off by 2^-9 of its size, some layers deep. */
static const double ROUGH = 0x1p-6;

/* ---- densities ---- */

/* case: exponents of +-1e5 to +-1e37 | plain code: `inf * 0` | here: opacity exactly 1, or exactly the background |
 * bound: exact */
static void test_fused_exponents_of_200(void **state) {
  (void)state;
  static const float up[] = {1e5f, 1e20f, 1e37f};
  for (size_t i = 0; i < COUNT_OF(up); i++) {
    passes_reset();
    set_exponents(up[i]);
    const struct drawn opaque = draw_all();
    expect_finite(&opaque);
    expect_truth("opacity", opaque.opacity, 0, 0); /* exactly 1 or, beside the ball, 0 */
    expect_truth("depth", opaque.depth, 4 * 0x1p-23, 0);
    expect_near_truth("pixel", opaque.pixel, 64 * 0x1p-23, 0x1p-18, ROUGH);
    double *truth = many_values(0, opaque.opacity);
    size_t full = 0;
    for (size_t r = 0; r < PASS_RAYS; r++) full += truth[MACHINE_GUARD + r] == 1;
    assert_true(full > PASS_RAYS / 8 && full < PASS_RAYS);
    free(truth);
    passes_reset();
    set_exponents(-up[i]);
    const struct drawn empty = draw_all();
    expect_within("opacity", empty.opacity, 0, 0x1p-149);
    for (size_t r = 0; r < PASS_RAYS; r++) expect_at("pixel", empty.pixel, r, (double)background_of(r), 0);
  }
}

/* case: light that ends anywhere, exponents 300 times larger | plain code: weights sum to more than 1 | here: white
 * heads: the colour's sum is 1.001 times the opacity | bound: 32 x 2^-23 */
/* Exponents of 15 times more and less than usual: light ends anywhere, all of it is accounted for. */
static void test_fused_weights_and_rest_are_one(void **state) {
  (void)state;
  static const float times[] = {1, 30, 300, -300};
  for (size_t i = 0; i < COUNT_OF(times); i++) {
    passes_reset();
    scale_layer(&passes.field.density, 2, times[i]);
    for (int c = 0; c < 3; c++) set_row_sign(&passes.field.colour, 1, c, 1e6f); /* all colours are 1.001 */
    const struct drawn d = draw_all();
    expect_finite(&d);
    for (int k = 0; k < machines.count; k++) { /* so the colour's sum is 1.001 times the weights' */
      double *colour = many_values(k, d.colour), *opacity = many_values(k, d.opacity);
      for (size_t r = 0; r < PASS_RAYS; r++) {
        const double sum = colour[MACHINE_GUARD + r], expected = 1.001 * opacity[MACHINE_GUARD + r];
        if (!(fabs(sum - expected) <= 32 * 0x1p-23))
          fail_msg("%s: ray %zu: %.9g, expected %.9g", machines.name[k], r, sum, expected);
      }
      free(colour), free(opacity);
    }
  }
}

/* case: no ray meets anything | plain code: mean over nothing | here: background, zeros | bound: exact */
static void test_fused_rays_without_samples(void **state) {
  (void)state;
  int32_t number[PASS_RAYS];
  for (int32_t i = 0; i < PASS_RAYS; i++) number[i] = i;
  passes_reset();
  const struct drawn d = draw(number, PASS_RAYS, passes.nothing);
  for (size_t r = 0; r < PASS_RAYS; r++) expect_at("pixel", d.pixel, r, (double)background_of(r), 0);
  expect_within("opacity", d.opacity, 0, 0);
  expect_within("colour", d.colour, 0, 0);
  expect_within("depth", d.depth, 0, 0);
  expect_within("attention", d.attention, 0, 0);
}

/* ---- networks ---- */

/* case: colours driven by 1e3 to 1e30 | plain code: `exp(-x)` infinite | here: 1.001, -0.001 and 0.5 over the
 * background | bound: 160 x 2^-23 */
/* Red, green and blue at both ends and in the middle, whatever the ray. */
static void test_fused_saturated_colour(void **state) {
  (void)state;
  static const float times[] = {1e3f, 1e6f, 1e30f};
  for (size_t i = 0; i < COUNT_OF(times); i++) {
    passes_reset();
    set_density_one();
    set_row_sign(&passes.field.colour, 1, 0, times[i]);
    set_row_sign(&passes.field.colour, 1, 1, -times[i]);
    set_row_sign(&passes.field.colour, 1, 2, 0);
    const struct drawn d = draw_all();
    expect_finite(&d);
    expect_truth("colour", d.colour, SUMS, 0x1p-23);
    expect_truth("pixel", d.pixel, SUMS, 0x1p-23);
  }
}

/* case: all units off | plain code: 0/0, -0 from masks | here: density 1, grey | bound: 160 x 2^-23 */
static void test_fused_dead_units(void **state) {
  (void)state;
  const struct ern_field *f = &passes.field;
  for (int which = 0; which < 3; which++) {
    passes_reset();
    if (which == 0) kill_units(&f->density, 1);
    if (which == 1) kill_units(&f->density, 1), scale_layer(&f->colour, 0, 0);
    if (which == 2) scale_layer(&f->density, 0, 0), scale_layer(&f->attention, 0, 0);
    const struct drawn d = draw_all();
    expect_finite(&d);
    expect_truth("opacity", d.opacity, SUMS, 0); /* of a density of exactly 1 */
    expect_near_truth("pixel", d.pixel, SUMS, 0x1p-20, ROUGH);
    if (which == 2) expect_within("attention", d.attention, 0, 0);
    if (which == 1)
      for (size_t r = 0; r < PASS_RAYS; r++) { /* 1.002/2 - 0.001 over the background */
        double *opacity = many_values(0, d.opacity);
        const double alpha = opacity[MACHINE_GUARD + r], back = (double)background_of(r);
        expect_at("red", d.pixel, r, 0.5 * alpha + (1 - alpha) * back, SUMS);
        free(opacity);
      }
  }
}

/* case: each layer times 1e12 | plain code: folded products of 1e24 | here: maps finite | bound: in [0, 1] */
/* A layer of 1e12: what it gives is large, the picture is not. */
static void test_fused_layers_of_1e12(void **state) {
  (void)state;
  const struct ern_mlp *const nets[] = {&passes.field.attention, &passes.field.density, &passes.field.colour};
  for (size_t n = 0; n < COUNT_OF(nets); n++) {
    for (int layer = 0; layer < nets[n]->layers; layer++) {
      passes_reset();
      scale_layer(nets[n], layer, 1e12f);
      const struct drawn d = draw_all();
      expect_finite(&d);
      if (n == 2) expect_near_truth("opacity", d.opacity, SUMS + 0x1p-15, 0, ROUGH);
    }
  }
}

/* case: all parameters times 1e-20 and 1e-38 | plain code: denormals, slow or flushed | here: as zeros | bound: 160 x
 * 2^-23 */
static void test_fused_layers_of_denormal_values(void **state) {
  (void)state;
  const struct ern_field *f = &passes.field;
  passes_reset();
  for (size_t i = 0; i < f->parameters; i++) passes.block[i] *= i % 2 == 0 ? 1e-20f : 1e-38f;
  const struct drawn d = draw_all();
  expect_finite(&d);
  expect_truth("opacity", d.opacity, SUMS, 0);
  expect_truth("pixel", d.pixel, SUMS, 0x1p-23); /* of grey */
  expect_within("attention", d.attention, 0, 1e-30);
}

/* case: attention of norms 0, 1e-35 to 1e37 | plain code: squares leave float | here: such sums are taken again of
 * scaled values | bound: 512 x 2^-23 */
/* Norms from 1e-35 to 1e37, whose squares are no floats; nothing else looks at them. */
static void test_fused_attention_of_zero_tiny_and_huge(void **state) {
  (void)state;
  static const float size[] = {0, 1e-35f, 1e-25f, 1e-18f, 1, 1e18f, 1e25f, 1e35f, 1e37f};
  const struct ern_field *f = &passes.field;
  for (size_t i = 0; i < COUNT_OF(size); i++) {
    passes_reset();
    set_density_one();
    set_inputs(&f->density, 0, f->feature_rows, ERN_AUDIO_CODE, 0);
    scale_layer(&f->attention, 1, size[i]);
    const struct drawn d = draw_all();
    expect_finite(&d);
    /* sums of 64 products of either sign, eight times as large without their signs; below the normal numbers nothing is
     * promised */
    expect_near_truth("attention", d.attention, 8 * 64 * 0x1p-23, 16 * 1.2e-38, ROUGH);
    double *truth = many_values(0, d.attention);
    double most = 0;
    for (size_t r = 0; r < PASS_RAYS; r++) most = fmax(most, truth[MACHINE_GUARD + r]);
    assert_true(most >= 0.5 * (double)size[i]);
    free(truth);
  }
}

/* ---- a NaN ---- */

/* Red of every ray on machine k is NaN where `like` says so, else as in `before`, to the bit. */
static void expect_same_but_nan(int k, const char *what, struct many red, const double *before, const bool *like) {
  double *values = many_values(k, red);
  for (size_t r = 0; r < PASS_RAYS; r++) {
    const double found = values[MACHINE_GUARD + r];
    if (like[r] ? !isnan(found) : found != before[MACHINE_GUARD + r])
      fail_msg("%s: %s: ray %zu is %.9g, before %.9g", machines.name[k], what, r, found, before[MACHINE_GUARD + r]);
  }
  free(values);
}

/* case: one weight NaN, in each layer | plain code: ReLU by maximum hides it | here: rays with a sample are NaN, others
 * keep their bits; the uncertainty's weights touch none | bound: exact */
/* One weight of each layer that the picture hangs on: each ray that has a sample is NaN, the others are as ever. */
static void test_fused_nan_among_the_weights(void **state) {
  (void)state;
  const struct ern_field *f = &passes.field;
  const struct ern_mlp *const nets[] = {&f->attention, &f->density, &f->colour, &f->uncertainty};
  static double *before[MACHINES];
  passes_reset();
  const struct drawn usual = draw_all();
  bool hit[PASS_RAYS], none[PASS_RAYS] = {false};
  double *opacity = many_values(0, usual.opacity);
  for (size_t r = 0; r < PASS_RAYS; r++) hit[r] = meets(opacity, r);
  free(opacity);
  for (int k = 0; k < machines.count; k++) before[k] = many_values(k, usual.pixel);
  for (size_t n = 0; n < COUNT_OF(nets); n++) {
    for (int layer = 0; layer < nets[n]->layers; layer++) {
      passes_reset();
      passes.block[nets[n]->weight[layer] + 3] = NAN;
      const struct drawn d = draw_all();
      for (int k = 0; k < machines.count; k++)
        expect_same_but_nan(k, n < 3 ? "a weight" : "the uncertainty's weight", d.pixel, before[k], n < 3 ? hit : none);
    }
  }
  for (int k = 0; k < machines.count; k++) free(before[k]);
}

/* case: entries of a table NaN | plain code: the tile is NaN | here: the rays that look at them; others keep their bits
 * | bound: exact */
/* One entry of a table: the rays that look at it, as the reference in float finds them, and no other. */
static void test_fused_nan_in_one_sample(void **state) {
  (void)state;
  const struct ern_field *f = &passes.field;
  double *before[MACHINES];
  passes_reset();
  const struct drawn usual = draw_all();
  for (int k = 0; k < machines.count; k++) before[k] = many_values(k, usual.pixel);
  size_t met = 0;
  for (uint32_t at = 0; at < 4; at++) {
    const struct ern_grid_level *level = &f->encoder.grid[at % 3].level[1];
    passes_reset();
    for (uint32_t i = at; i < level->size; i += 61) passes.block[f->encoder.table[at % 3] + level->offset + i] = NAN;
    const struct drawn d = draw_all();
    bool like[PASS_RAYS];
    double *plain = many_values(1, d.pixel);
    for (size_t r = 0; r < PASS_RAYS; r++) like[r] = isnan(plain[MACHINE_GUARD + r]), met += like[r];
    free(plain);
    for (int k = 1; k < machines.count; k++) expect_same_but_nan(k, "an entry", d.pixel, before[k], like);
  }
  if (!(met > 4 && met < PASS_RAYS)) fail_msg("%zu rays met a NaN", met);
  for (int k = 0; k < machines.count; k++) free(before[k]);
}

/* ---- tables, counts, distances ---- */

/* case: tables of 1e38 and 1e-38 | plain code: differences overflow | here: as the stages | bound: 2^-12 */
/* Entries of +-1e38 that the first layers bring down again; of denormal numbers. */
static void test_fused_tables_of_huge_and_denormal_values(void **state) {
  (void)state;
  const struct ern_field *f = &passes.field;
  static const float size[] = {1e38f, 1e30f, 1e-30f, 1e-38f};
  for (size_t i = 0; i < COUNT_OF(size); i++) {
    passes_reset();
    for (int plane = 0; plane < ERN_PLANES; plane++)
      for (uint32_t e = 0; e < f->encoder.grid[plane].entries; e++)
        passes.block[f->encoder.table[plane] + e] *= size[i];
    if (size[i] > 1) scale_layer(&f->attention, 0, 1 / size[i]);
    if (size[i] > 1)
      for (int r = 0; r < f->density.width[1]; r++)
        for (int c = 0; c < f->feature_rows; c++)
          passes.block[f->density.weight[0] + (size_t)(r * f->density.width[0] + c)] /= size[i];
    const struct drawn d = draw_all();
    expect_finite(&d);
    /* a density's exponent is a sum of some hundred products; weights of 1e-38 are no longer whole floats */
    expect_near_truth("opacity", d.opacity, 0x1p-12, 0x1p-20, ROUGH);
    expect_near_truth("pixel", d.pixel, 0x1p-12, 0x1p-14, ROUGH);
  }
}

/* case: 1 to 255 rays in any order | plain code: depends on neighbours in a tile | here: the bits of the whole picture
 * | bound: same bits */
/* Any number of rays, in any order: each is as it is in the whole picture, to the bit, and nothing is written behind
 * the last. */
static void test_fused_odd_counts_of_rays(void **state) {
  (void)state;
  static const size_t counts[] = {1, 2, 7, 15, 16, 17, 31, 47, 48, 49, 95, 97, 255};
  double *before[MACHINES];
  passes_reset();
  const struct drawn usual = draw_all();
  for (int k = 0; k < machines.count; k++) before[k] = many_values(k, usual.pixel);
  for (size_t i = 0; i < COUNT_OF(counts); i++) {
    int32_t number[PASS_RAYS];
    for (size_t r = 0; r < counts[i]; r++) number[r] = (int32_t)((r * 37 + 7 * 16 + 7) % PASS_RAYS);
    machines_clear();
    const struct drawn d = draw(number, counts[i], passes.ball);
    for (int k = 0; k < machines.count; k++) {
      double *values = many_values(k, d.pixel);
      for (size_t r = 0; r < counts[i]; r++) {
        const double found = values[MACHINE_GUARD + r], expected = before[k][MACHINE_GUARD + (size_t)number[r]];
        if (found != expected)
          fail_msg("%s: ray %zu of %zu: %.9g, in the picture %.9g", machines.name[k], r, counts[i], found, expected);
      }
      free(values);
    }
  }
  for (int k = 0; k < machines.count; k++) free(before[k]);
}

/* case: 1, 2 and 1,024 samples a ray, shortest and longest steps | plain code: an array overrun | here: as the stages |
 * bound: 10240 x 2^-23 */
/* One sample a ray and 1,024, steps as long and as short as there are. */
static void test_fused_one_and_1024_samples(void **state) {
  (void)state;
  static const int steps[] = {1, 2, 1024};
  const struct ern_march_settings kept = passes.settings;
  for (size_t i = 0; i < 2 * COUNT_OF(steps); i++) {
    passes_reset();
    set_density_one();
    passes.settings.max_steps = steps[i / 2];
    passes.settings.dt_gamma = i % 2 == 0 ? 0 : 1e30f;
    const struct drawn d = draw_all();
    expect_finite(&d);
    expect_truth("opacity", d.opacity, 64 * SUMS, 0);
    expect_near_truth("pixel", d.pixel, 64 * SUMS, 0x1p-18, ROUGH);
  }
  passes.settings = kept;
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_fused_exponents_of_200),
      cmocka_unit_test(test_fused_weights_and_rest_are_one),
      cmocka_unit_test(test_fused_rays_without_samples),
      cmocka_unit_test(test_fused_saturated_colour),
      cmocka_unit_test(test_fused_dead_units),
      cmocka_unit_test(test_fused_layers_of_1e12),
      cmocka_unit_test(test_fused_layers_of_denormal_values),
      cmocka_unit_test(test_fused_attention_of_zero_tiny_and_huge),
      cmocka_unit_test(test_fused_nan_among_the_weights),
      cmocka_unit_test(test_fused_nan_in_one_sample),
      cmocka_unit_test(test_fused_tables_of_huge_and_denormal_values),
      cmocka_unit_test(test_fused_odd_counts_of_rays),
      cmocka_unit_test(test_fused_one_and_1024_samples),
  };
  return cmocka_run_group_tests(tests, open_passes, close_passes);
}
