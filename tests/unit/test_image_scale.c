/* SPDX-License-Identifier: MIT
 * A head that is drawn small and enlarged, through a renderer: where it lies, and that the background stays as it is.
 * A head of which only a part is wanted. */
#include "../support.h"

#include <math.h>

#include "core/rng.h"
#include "ernerf/backend.h"
#include "ernerf/render.h"
#include "model/model.h"
#include "render/morton.h"
#include "render/render_ops.h"

enum { ACROSS = 97, DOWN = 74, PIXELS = ACROSS * DOWN, WIDTH = 29, LENGTH = 16, VALUES = 8 * LENGTH * WIDTH };

struct scene {
  ern_context *context;
  ern_backend *backend;
  ern_model *model;
  float windows[VALUES];
  uint8_t background[3 * PIXELS];
  const uint8_t *wanted; /* NULL: all */
};

struct drawn {
  uint8_t rgba[4 * PIXELS];
  float rgb[3 * PIXELS], opacity[PIXELS], depth[PIXELS], attention[PIXELS];
  double samples;
};

/* A smooth dense ball, and a background that is noise. */
static void scene_make(struct scene *scene) {
  const struct ern_model_config config = {
      .levels = 4, .feature_width = WIDTH, .window_length = LENGTH, .head = true, .bound = 1};
  scene->context = support_context();
  support_ok(scene->context, ern_model_make(&scene->model, scene->context, &config));
  ern_parameters_init(scene->model->block, &scene->model->table, false, 5);
  for (uint32_t number = 0; number < ERN_OCCUPANCY_CELLS; number++) {
    const float x = (float)ern_morton_gather(number) / 64 - 1, y = (float)ern_morton_gather(number >> 1) / 64 - 1,
                z = (float)ern_morton_gather(number >> 2) / 64 - 1;
    if (x * x + y * y + z * z <= 0.09f) scene->model->bits[number >> 3] |= (uint8_t)(1u << (number & 7));
  }
  ern_backend_config backend = ern_backend_config_default();
  support_ok(scene->context, ern_backend_create(&scene->backend, scene->context, &backend));
  for (size_t i = 0; i < VALUES; i++) scene->windows[i] = sinf((float)i);
  for (uint32_t i = 0; i < 3 * PIXELS; i++)
    scene->background[i] = (uint8_t)ern_random_at(8, 0, i, ERN_RNG_INIT).word[0];
}

static void scene_free(struct scene *scene) {
  ern_model_free(&scene->model);
  ern_backend_free(&scene->backend);
  ern_context_free(&scene->context);
}

static void draw(struct scene *scene, float scale, bool opaque, struct drawn *drawn) {
  ern_render_options options = ern_render_options_default();
  options.image_scale = scale;
  ern_renderer *renderer = NULL;
  ern_frame_times times;
  support_ok(scene->context, ern_renderer_create(&renderer, scene->backend, scene->model, &options));
  const ern_frame_input input = {.camera = {.pose = {0, -1, 0, 0, 0, 0, -1, 3, 1, 0, 0, 0, 0, 0, 0, 1},
                                            .focal = 3 * DOWN,
                                            .cx = 0.45f * ACROSS,
                                            .cy = 0.55f * DOWN,
                                            .width = ACROSS,
                                            .height = DOWN},
                                 .windows = scene->windows,
                                 .window_length = LENGTH,
                                 .background = opaque ? scene->background : NULL,
                                 .wanted = scene->wanted};
  const ern_frame_output output = {.rgba = drawn->rgba,
                                   .rgb = drawn->rgb,
                                   .opacity = drawn->opacity,
                                   .depth = drawn->depth,
                                   .attention = drawn->attention};
  /* twice: the rooms of the first frame are used again */
  for (int k = 0; k < 2; k++) support_ok(scene->context, ern_renderer_frame(renderer, &input, &output, &times));
  drawn->samples = times.samples;
  ern_renderer_free(&renderer);
}

/* Centre of the opacity, pixels. */
static void centre_of(const float *opacity, double centre[2], double *total) {
  centre[0] = centre[1] = *total = 0;
  for (int i = 0; i < PIXELS; i++) {
    centre[0] += (double)opacity[i] * (i % ACROSS + 0.5);
    centre[1] += (double)opacity[i] * (i / ACROSS + 0.5);
    *total += (double)opacity[i];
  }
  centre[0] /= *total;
  centre[1] /= *total;
}

static void test_it_lies_where_it_should(void **state) {
  (void)state;
  static struct scene scene;
  static struct drawn full, small;
  static const float scales[] = {0.25f, 0.37f, 0.5f, 0.75f, 0.9f};
  double centre[2], other[2], total, other_total;
  scene_make(&scene);
  draw(&scene, 1, true, &full);
  centre_of(full.opacity, centre, &total);
  assert_true(total > 300);
  for (size_t k = 0; k < sizeof scales / sizeof *scales; k++) {
    draw(&scene, scales[k], true, &small);
    centre_of(small.opacity, other, &other_total);
    /* the edge of the ball is some pixels of a picture of few: its middle stays within a tenth of one */
    assert_true(fabs(centre[0] - other[0]) < 0.1 / (double)scales[k]);
    assert_true(fabs(centre[1] - other[1]) < 0.1 / (double)scales[k]);
    assert_true(fabs(total - other_total) < 0.05 * total);
    for (int i = 0; i < PIXELS; i++) {
      assert_true(small.opacity[i] >= 0 && small.opacity[i] <= 1);
      for (int c = 0; c < 3 && small.opacity[i] == 0; c++)
        assert_int_equal(small.rgba[4 * i + c], scene.background[3 * i + c]);
    }
  }
  scene_free(&scene);
}

/* Without a background colours are premultiplied: drawn over one afterwards they are the same picture. */
static void test_over_nothing(void **state) {
  (void)state;
  static struct scene scene;
  static struct drawn over, alone;
  scene_make(&scene);
  draw(&scene, 0.5f, true, &over);
  draw(&scene, 0.5f, false, &alone);
  assert_memory_equal(over.opacity, alone.opacity, sizeof over.opacity);
  assert_memory_equal(over.depth, alone.depth, sizeof over.depth);
  for (int i = 0; i < PIXELS; i++)
    for (int c = 0; c < 3; c++) {
      const float laid = alone.rgb[3 * i + c] + (1 - alone.opacity[i]) * (float)scene.background[3 * i + c] / 255;
      assert_true(alone.rgb[3 * i + c] >= 0 && alone.rgb[3 * i + c] <= alone.opacity[i]);
      assert_true(fabsf(laid - over.rgb[3 * i + c]) < 1e-6f);
    }
  scene_free(&scene);
}

/* What is wanted is as in the whole picture, what is not is that or the background, and the fused passes save its
 * samples. */
static void test_wanted(void **state) {
  (void)state;
  static struct scene scene;
  static struct drawn whole, part;
  static uint8_t wanted[PIXELS];
  ern_backend_info info;
  scene_make(&scene);
  draw(&scene, 1, true, &whole);
  for (int i = 0; i < PIXELS; i++) wanted[i] = i % ACROSS < ACROSS / 2;
  scene.wanted = wanted;
  draw(&scene, 1, true, &part);
  for (size_t i = 0; i < PIXELS; i++) {
    const bool left_out = wanted[i] == 0 && part.opacity[i] == 0;
    assert_true(left_out || part.opacity[i] == whole.opacity[i]);
    assert_memory_equal(part.rgb + 3 * i, whole.rgb + 3 * i, left_out ? 0 : 3 * sizeof *part.rgb);
    for (size_t c = 0; left_out && c < 3; c++) assert_int_equal(part.rgba[4 * i + c], scene.background[3 * i + c]);
  }
  ern_backend_describe(scene.backend, &info);
  if (strncmp(info.isa, "ref", 3) != 0) assert_true(part.samples < 0.8 * whole.samples);
  draw(&scene, 0.5f, true, &part); /* the head is drawn small: whole */
  scene.wanted = NULL;
  draw(&scene, 0.5f, true, &whole);
  assert_memory_equal(part.rgb, whole.rgb, sizeof whole.rgb);
  scene_free(&scene);
}

static void test_bad_arguments(void **state) {
  (void)state;
  static struct scene scene;
  static const float bad[] = {0, 0.2f, 1.01f, -1, NAN};
  ern_renderer *renderer = NULL;
  scene_make(&scene);
  for (size_t k = 0; k < sizeof bad / sizeof *bad; k++) {
    ern_render_options options = ern_render_options_default();
    options.image_scale = bad[k];
    support_expect(scene.context, ern_renderer_create(&renderer, scene.backend, scene.model, &options), ERN_E_ARGUMENT,
                   "image_scale", "0.25 to 1", NULL);
    assert_null(renderer);
  }
  scene_free(&scene);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_it_lies_where_it_should),
      cmocka_unit_test(test_over_nothing),
      cmocka_unit_test(test_wanted),
      cmocka_unit_test(test_bad_arguments),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
