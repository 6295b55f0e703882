/* SPDX-License-Identifier: MIT
 * The fused pass of the torso over a picture against its stages. check_torso.c has more of it, for instruction sets. */
#include "harness.h"

#include "model/parameters.h"

/* How far sums in another order, and a table that is looked up between other neighbours first, may take a colour: a
 * hundred roundings of values of size 1, times the slopes that the encoding's last octave and the table give to the
 * deformation's error. The goal of a rendered pixel is 1e-3. */
static const double torso_tolerance = 2e-5;

static void check_torso(int width, int height, struct ern_torso_place frame, float threshold, bool extras,
                        const char *what) {
  struct ern_parameter_table rows;
  struct ern_field field;
  struct ern_model_config config = {.levels = 2,
                                    .feature_width = 29,
                                    .window_length = 16,
                                    .torso = true,
                                    .torso_gamma = extras,
                                    .codes = extras ? 5 : 0,
                                    .bound = 1};
  static const float pose[16] = {0.1f, -0.99f, -0.03f, 0.19f, 0.06f,  0.04f, -1.02f, 3.04f,
                                 1.0f, 0.09f,  0.07f,  -0.2f, 0.003f, 0.01f, -0.02f, 1.0f};
  support_ok(machines.context, ern_parameters_build(machines.context, &config, &field, &rows));
  float *block = held_memory(field.parameters, sizeof(float)), *cells = held_memory(ERN_TORSO_CELLS, sizeof(float));
  const size_t pixels = (size_t)width * (size_t)height;
  float *planes = held_memory(3 * pixels, sizeof(float));
  ern_parameters_init(block, &rows, true, 7);
  fill_random(block + field.torso_table, 2 * (size_t)field.torso_grid.entries, 8, 0.1f);
  fill_random(cells, ERN_TORSO_CELLS, 10, 1);
  fill_random(planes, 3 * pixels, 9, 1);
  if (extras) block[field.gamma] = 1.25f;
  const struct many parameters = many_reals(block, field.parameters);
  const struct many grid = many_reals(cells, ERN_TORSO_CELLS);
  const struct many opacity = many_room(pixels);
  const struct many_rows pixel = many_strided(planes, 3, pixels, ERN_PER_SAMPLE);
  struct ern_render_torso_args args[MACHINES];
  EACH_MACHINE (k) {
    args[k] = (struct ern_render_torso_args){.pixel = pixel.on[k],
                                             .opacity = opacity.on[k],
                                             .grid = grid.on[k],
                                             .threshold = threshold,
                                             .width = width,
                                             .height = height,
                                             .frame = frame,
                                             .shrink = 0.8f,
                                             .individual = extras ? 3 : 0,
                                             .parameters = parameters.on[k],
                                             .field = &field};
    memcpy(args[k].pose, pose, sizeof pose);
    struct ern_render_prepare_args prepare = {parameters.on[k], &field};
    RUN_ON(k, render_prepare, &prepare);
  }
  RUN(render_torso, args);
  expect_near(what, of_rows(pixel), torso_tolerance, torso_tolerance);
  expect_near(what, opacity, torso_tolerance, torso_tolerance);
  machines_clear();
}

static void test_torso(void **state) {
  (void)state;
  const struct ern_torso_place whole = {0}, within = {9, 0, 17, 15}, beyond = {-20, -3, 40, 70};
  check_torso(17, 33, within, -2, false, "a frame within the picture");
  check_torso(17, 33, beyond, -2, false, "a frame beyond the picture");
  static const int sizes[][2] = {{1, 1}, {3, 7}, {1, 40}, {40, 1}, {16, 32}, {17, 33}, {61, 70}};
  for (size_t s = 0; s < COUNT_OF(sizes); s++) {
    check_torso(sizes[s][0], sizes[s][1], whole, 0.01f, s % 2 == 0, "some pixels");
    check_torso(sizes[s][0], sizes[s][1], whole, -2, s % 2 == 1, "all pixels");
    check_torso(sizes[s][0], sizes[s][1], whole, 2, s % 2 == 1, "no pixel");
  }
}

static const struct CMUnitTest tests[] = {cmocka_unit_test(test_torso)};
NOUN(torso_pass, NULL, .isa = NULL)
