/* SPDX-License-Identifier: MIT
 * Leaving out cells that hold next to nothing, through a renderer. */
#include "../support.h"

#include <math.h>

#include "core/rng.h"
#include "ernerf/backend.h"
#include "ernerf/render.h"
#include "model/model.h"
#include "render/morton.h"
#include "render/render_ops.h"

enum { SIDE = 40, PIXELS = SIDE * SIDE, WIDTH = 29, LENGTH = 16, MOMENT = 8 * LENGTH * WIDTH, MOMENTS = 2 };

struct scene {
  ern_context *context;
  ern_backend *backend;
  ern_model *model;
  ern_renderer *renderer;
  float windows[MOMENTS * MOMENT], eyes[MOMENTS];
};

static void fill_ball(uint8_t *bits, float radius) {
  for (uint32_t number = 0; number < ERN_OCCUPANCY_CELLS; number++) {
    const float x = (float)ern_morton_gather(number) / 64 - 1, y = (float)ern_morton_gather(number >> 1) / 64 - 1,
                z = (float)ern_morton_gather(number >> 2) / 64 - 1;
    if (x * x + y * y + z * z <= radius * radius) bits[number >> 3] |= (uint8_t)(1u << (number & 7));
  }
}

static void scene_make(struct scene *scene) {
  const struct ern_model_config config = {
      .levels = 4, .feature_width = WIDTH, .window_length = LENGTH, .head = true, .eye = true, .bound = 1};
  scene->context = support_context();
  support_ok(scene->context, ern_model_make(&scene->model, scene->context, &config));
  ern_parameters_init(scene->model->block, &scene->model->table, false, 5);
  /* tables of +-1 make the density vary from cell to cell */
  for (int plane = 0; plane < ERN_PLANES; plane++)
    for (uint32_t i = 0; i < scene->model->field.encoder.grid[plane].entries; i++)
      scene->model->block[scene->model->field.encoder.table[plane] + i] =
          2 * ern_uniform(ern_random_at(9, 0, i, ERN_RNG_INIT).word[0]) - 1;
  for (size_t i = 0; i < 64; i++) scene->model->block[scene->model->field.density.weight[2] + i] *= 20;
  fill_ball(scene->model->bits, 0.25f);
  ern_backend_config backend = ern_backend_config_default();
  backend.isa = "auto";
  support_ok(scene->context, ern_backend_create(&scene->backend, scene->context, &backend));
  support_ok(scene->context, ern_renderer_create(&scene->renderer, scene->backend, scene->model, NULL));
  for (size_t i = 0; i < MOMENTS * MOMENT; i++) scene->windows[i] = sinf((float)i);
  scene->eyes[1] = 1;
}

static void scene_free(struct scene *scene) {
  ern_renderer_free(&scene->renderer);
  ern_model_free(&scene->model);
  ern_backend_free(&scene->backend);
  ern_context_free(&scene->context);
}

static void draw(struct scene *scene, float *opacity) {
  ern_frame_input input = {.camera = {.pose = {0, -1, 0, 0, 0, 0, -1, 3, 1, 0, 0, 0, 0, 0, 0, 1},
                                      .focal = 4 * SIDE,
                                      .cx = SIDE / 2,
                                      .cy = SIDE / 2,
                                      .width = SIDE,
                                      .height = SIDE},
                           .windows = scene->windows,
                           .window_length = LENGTH};
  const ern_frame_output output = {.opacity = opacity};
  support_ok(scene->context, ern_renderer_frame(scene->renderer, &input, &output, NULL));
}

static ern_status prune_occupancy(struct scene *scene, float density) {
  return ern_renderer_prune_occupancy(scene->renderer, scene->windows, LENGTH, scene->eyes, MOMENTS, density);
}

static double sum(const float *values) {
  double total = 0;
  for (size_t i = 0; i < PIXELS; i++) total += (double)values[i];
  return total;
}

static void test_more_is_left_out_as_the_limit_rises(void **state) {
  (void)state;
  static struct scene scene;
  static float all[PIXELS], some[PIXELS], again[PIXELS];
  scene_make(&scene);
  draw(&scene, all);
  assert_true(sum(all) > 100); /* there is something to leave out */
  double last = sum(all);
  for (float limit = 0.1f; limit < 1000; limit *= 10) {
    support_ok(scene.context, prune_occupancy(&scene, limit));
    draw(&scene, some);
    assert_true(sum(some) <= last);
    last = sum(some);
  }
  assert_true(last < 0.9 * sum(all));
  support_ok(scene.context, prune_occupancy(&scene, 1e37f));
  draw(&scene, some);
  assert_true(sum(some) == 0);
  support_ok(scene.context, prune_occupancy(&scene, 0));
  draw(&scene, again);
  assert_memory_equal(all, again, sizeof all);
  scene_free(&scene);
}

static void test_thin_cells_alone_are_left_out(void **state) {
  (void)state;
  static struct scene scene;
  static float all[PIXELS], some[PIXELS];
  scene_make(&scene);
  /* a cell under the limit at 8 points is not much over it anywhere: 16 steps of 0.027 lose 16*0.027*0.01*8 at most */
  support_ok(scene.context, prune_occupancy(&scene, 0));
  draw(&scene, all);
  support_ok(scene.context, prune_occupancy(&scene, 0.01f));
  draw(&scene, some);
  for (size_t i = 0; i < PIXELS; i++) assert_true(fabsf(all[i] - some[i]) < 16 * 0.027f * 0.01f * 8);
  scene_free(&scene);
}

static void test_bad_arguments(void **state) {
  (void)state;
  static struct scene scene;
  scene_make(&scene);
  support_expect(scene.context, prune_occupancy(&scene, -1), ERN_E_ARGUMENT, "density", "-1", NULL);
  support_expect(scene.context, prune_occupancy(&scene, NAN), ERN_E_ARGUMENT, "density", NULL);
  support_expect(scene.context, ern_renderer_prune_occupancy(scene.renderer, scene.windows, 17, scene.eyes, MOMENTS, 1),
                 ERN_E_ARGUMENT, "window_length", "17", NULL);
  support_ok(scene.context, ern_renderer_prune_occupancy(scene.renderer, NULL, 0, NULL, 0, 0));
  scene.windows[MOMENT + 3] = INFINITY;
  support_expect(scene.context, prune_occupancy(&scene, 1), ERN_E_NONFINITE, "frame 1", "value 3", NULL);
  scene_free(&scene);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_more_is_left_out_as_the_limit_rises),
      cmocka_unit_test(test_thin_cells_alone_are_left_out),
      cmocka_unit_test(test_bad_arguments),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
