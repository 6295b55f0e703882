/* SPDX-License-Identifier: MIT
 * The fused pass of the torso over a whole picture, with networks, tables, key points and occupancy at their ends: held
 * against the stages in double (docs/numerics.md). */
#include "model/torso_ops.h"
#include "passes.h"

struct painted {
  struct many pixel, opacity;
  size_t pixels;
};
struct canvas {
  int width, height;
  float pose[16], grid[2]; /* the occupancy of even and of odd cells */
};
static const struct canvas usual = {19, 18, {0, -1, 0, 0, 0, 0, -1, 3, 1, 0, 0, 0, 0, 0, 0, 1}, {1, 1}};

static float background_of(size_t pixel) { return 0.25f + 0.5f * (float)(pixel % 7) / 7; }

static struct painted paint(const struct canvas *canvas) {
  const size_t n = (size_t)canvas->width * (size_t)canvas->height;
  float *background = malloc(3 * n * sizeof *background), *cells = malloc(ERN_TORSO_CELLS * sizeof *cells);
  assert_true(background != NULL && cells != NULL);
  for (size_t i = 0; i < 3 * n; i++) background[i] = background_of(i % n);
  for (size_t i = 0; i < ERN_TORSO_CELLS; i++) cells[i] = canvas->grid[i % 2];
  const struct many parameters = many_reals(passes.block, passes.field.parameters);
  const struct many grid = many_reals(cells, ERN_TORSO_CELLS);
  const struct painted out = {many_reals(background, 3 * n), many_empty(n), n};
  free(background), free(cells);
  static const float still[ERN_MOTION_VALUES];
  struct ern_render_torso_args args[MACHINES];
  for (int k = 0; k < machines.count; k++) {
    args[k] = (struct ern_render_torso_args){.pixel = {out.pixel.on[k], n, 3, ERN_PER_RAY},
                                             .opacity = out.opacity.on[k],
                                             .grid = grid.on[k],
                                             .threshold = 0.01f,
                                             .width = canvas->width,
                                             .height = canvas->height,
                                             .shrink = 0.8f,
                                             .motion = still,
                                             .parameters = parameters.on[k],
                                             .field = &passes.field};
    memcpy(args[k].pose, canvas->pose, sizeof args[k].pose);
  }
  ON_EACH(render_torso, ern_render_torso_args, args[k])
  return out;
}

/* Pixels [0, 1] over a background in it, where alpha and colours may be 0.001 beyond both. */
static void expect_painted(const struct painted *p) {
  expect_within("pixel", p->pixel, -0.002, 1.003);
  expect_within("opacity", p->opacity, -0.0010001, 1.0010001);
}

/* Networks of 32 units, inputs of sines: some hundred roundings of 2^-23 of numbers of about 1. */
static const double NETS = 256 * 0x1p-23;

/* case: a torso's picture of 1 x 1, 1 x 17, 49 x 33 .. | plain code: writes past an edge | here: as the stages | bound:
 * 256 x 2^-23 */
static void test_painted_odd_sizes_long(void **state) {
  (void)state;
  static const int sides[][2] = {{1, 1}, {1, 17}, {17, 1}, {3, 5}, {4, 4}, {15, 16}, {49, 33}, {97, 2}};
  for (size_t s = 0; s < COUNT_OF(sides); s++) {
    struct canvas canvas = usual;
    canvas.width = sides[s][0], canvas.height = sides[s][1];
    passes_reset();
    const struct painted p = paint(&canvas);
    expect_painted(&p);
    expect_truth("pixel", p.pixel, NETS, NETS);
    expect_truth("opacity", p.opacity, NETS, NETS);
  }
}

/* case: its alpha and colours driven to 1e36 | plain code: `exp(-x)` infinite | here: 1.001 and -0.001 | bound: 2^-22
 */
/* Alpha and colours at both ends. */
static void test_painted_saturated(void **state) {
  (void)state;
  static const float times[] = {1e4f, -1e4f, 1e20f, -1e20f, 1e36f};
  for (size_t i = 0; i < COUNT_OF(times); i++) {
    passes_reset();
    for (int row = 0; row < 4; row++) set_row_sign(&passes.field.torso_net, 2, row, times[i]);
    const struct painted p = paint(&usual);
    const double end = times[i] < 0 ? -0.001 : 1.001;
    expect_painted(&p);
    expect_within("opacity", p.opacity, end - 0x1p-22, end + 0x1p-22);
    for (size_t at = 0; at < p.pixels; at += 7)
      expect_at("pixel", p.pixel, at, end * end + (1 - end) * (double)background_of(at), 4 * 0x1p-23);
  }
}

/* case: deformations of 1e5 to 1e36 | plain code: a cell number of 1e36 | here: end at the border | bound: 256 x 2^-23
 */
/* Deformations of up to 1e37 end at the border of the picture's square, in all directions. */
static void test_painted_deformed_without_end(void **state) {
  (void)state;
  static const float times[] = {1e5f, -1e5f, 1e20f, -1e36f};
  for (size_t i = 0; i < COUNT_OF(times); i++) {
    passes_reset();
    set_row_sign(&passes.field.torso_deform, 2, 0, times[i]);
    set_row_sign(&passes.field.torso_deform, 2, 1, -times[i]);
    const struct painted p = paint(&usual);
    expect_painted(&p);
    expect_truth("pixel", p.pixel, NETS, NETS);
  }
}

/* case: each of its layers times 1e12 | plain code: infinities by folding | here: in [-0.002, 1.003] | bound: bounded
 */
static void test_painted_with_layers_of_1e12(void **state) {
  (void)state;
  const struct ern_mlp *const nets[] = {&passes.field.torso_deform, &passes.field.torso_net};
  for (size_t n = 0; n < 2; n++) {
    for (int layer = 0; layer < 3; layer++) {
      passes_reset();
      scale_layer(nets[n], layer, 1e12f);
      const struct painted p = paint(&usual);
      expect_painted(&p);
    }
  }
}

/* case: its units off; weights of 1e-30 | plain code: -0, denormals | here: alpha and colours of 0.5 | bound: 4 x 2^-23
 */
static void test_painted_with_dead_and_denormal_layers(void **state) {
  (void)state;
  const struct ern_field *f = &passes.field;
  for (int which = 0; which < 2; which++) {
    passes_reset();
    for (int row = 0; which == 0 && row < 32; row++) set_row_sign(&f->torso_net, 1, row, -1);
    for (int layer = 0; which == 1 && layer < 3; layer++)
      scale_layer(&f->torso_net, layer, 1e-30f), scale_layer(&f->torso_deform, layer, 1e-30f);
    const struct painted p = paint(&usual);
    expect_within("opacity", p.opacity, 0.5 - 0x1p-23, 0.5 + 0x1p-23); /* the sigmoid of 0 */
    for (size_t at = 0; at < p.pixels; at++)
      expect_at("pixel", p.pixel, at, 0.25 + 0.5 * (double)background_of(at), 4 * 0x1p-23);
  }
}

/* case: one weight NaN; a place NaN | plain code: a cell of NaN | here: the chosen pixels are NaN; a place of NaN has
 * features of 0 | bound: exact */
/* One weight: all pixels of the torso; occupancy decides which these are. */
static void test_painted_with_a_nan_among_the_weights(void **state) {
  (void)state;
  const struct ern_mlp *const nets[] = {&passes.field.torso_deform, &passes.field.torso_net};
  struct canvas canvas = usual;
  canvas.grid[1] = 0;
  canvas.width = canvas.height = 128; /* a pixel a cell, so that half of them are chosen */
  for (int layer = 0; layer < 3; layer++) {
    passes_reset();
    passes.block[nets[1]->weight[layer] + 2] = NAN;
    const struct painted p = paint(&canvas);
    for (int k = 0; k < machines.count; k++) {
      double *pixel = many_values(k, p.pixel), *opacity = many_values(k, p.opacity);
      size_t spoilt = 0;
      for (size_t i = 0; i < p.pixels; i++) {
        const bool chosen = opacity[MACHINE_GUARD + i] != 0;
        const double red = pixel[MACHINE_GUARD + i];
        spoilt += isnan(red) ? 1 : 0;
        if (chosen ? !isnan(red) : red != (double)background_of(i))
          fail_msg("%s: pixel %zu is %g, opacity %g", machines.name[k], i, red, opacity[MACHINE_GUARD + i]);
      }
      assert_true(spoilt > p.pixels / 3 && spoilt < p.pixels);
      free(pixel), free(opacity);
    }
  }
  /* of a place that is NaN: it has no cell, so features of 0, and what the network makes of them */
  passes_reset();
  passes.block[nets[0]->weight[2] + 2] = NAN;
  const struct painted p = paint(&usual);
  expect_painted(&p);
  expect_truth("pixel", p.pixel, NETS, NETS);
}

/* case: entries of its table NaN | plain code: a block of 16 pixels is NaN | here: the pixels that look at them |
 * bound: exact */
/* Entries of the table: the pixels that look at them, as the float reference finds them, and no other. */
static void test_painted_with_a_nan_in_one_pixel(void **state) {
  (void)state;
  const struct ern_field *f = &passes.field;
  double *before[MACHINES];
  passes_reset();
  const struct painted as_ever = paint(&usual);
  for (int k = 0; k < machines.count; k++) before[k] = many_values(k, as_ever.pixel);
  const struct ern_grid_level *level = &f->torso_grid.level[4];
  passes_reset();
  for (uint32_t i = 0; i < level->size; i += 97)
    passes.block[f->torso_table + 2 * ((size_t)level->offset + i) + i % 2] = NAN;
  const struct painted p = paint(&usual);
  double *plain = many_values(1, p.pixel);
  size_t spoilt = 0;
  for (int k = 1; k < machines.count; k++) {
    double *found = many_values(k, p.pixel);
    for (size_t i = MACHINE_GUARD; i < MACHINE_GUARD + p.pixels; i++) {
      spoilt += isnan(found[i]) ? 1 : 0;
      if (isnan(plain[i]) ? !isnan(found[i]) : found[i] != before[k][i])
        fail_msg("%s: pixel %zu is %g, before %g", machines.name[k], i - MACHINE_GUARD, found[i], before[k][i]);
    }
    free(found);
  }
  assert_true(spoilt > 0 && spoilt < p.pixels * (size_t)(machines.count - 1));
  free(plain);
  for (int k = 0; k < machines.count; k++) free(before[k]);
}

/* case: occupancy of NaN, +-infinity | plain code: comparisons choose by accident | here: the same pixels everywhere;
 * NaN chooses none | bound: 256 x 2^-23 */
/* Cells of NaN are not occupied, nor is what lies between one and another; which pixels are chosen is the same on all.
 */
static void test_painted_occupancy_of_odd_values(void **state) {
  (void)state;
  static const float cells[][2] = {{NAN, NAN}, {INFINITY, INFINITY}, {NAN, 1}, {-INFINITY, -1}, {FLT_TRUE_MIN, 0}};
  for (size_t c = 0; c < COUNT_OF(cells); c++) {
    struct canvas canvas = usual;
    canvas.grid[0] = cells[c][0], canvas.grid[1] = cells[c][1];
    passes_reset();
    const struct painted p = paint(&canvas);
    expect_painted(&p);
    expect_truth("opacity", p.opacity, NETS, NETS);
    if (c == 0 || c >= 3) expect_within("opacity", p.opacity, 0, 0);
  }
}

/* case: camera in the key points' plane, points at infinity and 1e37 | plain code: X/0 | here: held | bound: in
 * [-0.002, 1.003], 0.1 of double's */
/* The camera in the plane of the key points, points at infinity and at 1e37, poses that are no rotations. */
static void test_painted_key_points_without_a_projection(void **state) {
  (void)state;
  static const float at[][4] = {{0, 0, 0, 1}, {0.01f, 0.01f, 0.1f, 0}, {1e37f, -1e37f, 1e37f, 1}, {1, 1, 1, -1e30f}};
  for (size_t i = 0; i < COUNT_OF(at); i++) {
    struct canvas canvas = usual;
    if (i == 0) canvas.pose[3] = canvas.pose[7] = canvas.pose[11] = 0;
    if (i == 3) canvas.pose[1] = 1e3f, canvas.pose[8] = -1e-3f;
    passes_reset();
    for (size_t c = 0; c < 12; c++) passes.block[passes.field.anchors + c] = at[i][c % 4];
    const struct painted p = paint(&canvas);
    expect_painted(&p);
    /* key points of 1e6 have sines off by 2^-23 of their argument, which two networks carry on */
    expect_truth("pixel", p.pixel, 0, 0.1);
  }
}

/* case: its table of 1e38 and 1e-42 | plain code: differences overflow | here: as the stages | bound: 2^-19 */
static void test_painted_tables_of_huge_and_denormal_values(void **state) {
  (void)state;
  const struct ern_field *f = &passes.field;
  static const float size[] = {1e38f, 1e20f, 1e-20f, 1e-42f};
  for (size_t i = 0; i < COUNT_OF(size); i++) {
    passes_reset();
    for (size_t e = 0; e < (size_t)f->torso_grid.entries * 2; e++)
      passes.block[f->torso_table + e] = machines_random(3, e, 1) * size[i];
    for (int r = 0; r < 32; r++) /* brought down again */
      for (int c = 0; size[i] > 1 && c < 2 * f->torso_grid.levels; c++)
        passes.block[f->torso_net.weight[0] + (size_t)(r * f->torso_net.width[0] + c)] /= size[i];
    const struct painted p = paint(&usual);
    expect_painted(&p);
    expect_truth("pixel", p.pixel, NETS, 16 * NETS);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_painted_odd_sizes_long),
      cmocka_unit_test(test_painted_saturated),
      cmocka_unit_test(test_painted_deformed_without_end),
      cmocka_unit_test(test_painted_with_layers_of_1e12),
      cmocka_unit_test(test_painted_with_dead_and_denormal_layers),
      cmocka_unit_test(test_painted_with_a_nan_among_the_weights),
      cmocka_unit_test(test_painted_with_a_nan_in_one_pixel),
      cmocka_unit_test(test_painted_occupancy_of_odd_values),
      cmocka_unit_test(test_painted_key_points_without_a_projection),
      cmocka_unit_test(test_painted_tables_of_huge_and_denormal_values),
  };
  return cmocka_run_group_tests(tests, open_passes, close_passes);
}
