/* SPDX-License-Identifier: MIT
 * Frames that keep what the frame before them has, against frames that are rendered from nothing. */
#include "../support.h"

#include <math.h>

#include "core/rng.h"
#include "ernerf/backend.h"
#include "ernerf/render.h"
#include "model/model.h"
#include "render/morton.h"
#include "render/render_ops.h"

enum {
  WIDE = 48,
  HIGH = 40,
  PIXELS = WIDE * HIGH,
  WIDTH = 29,
  LENGTH = 16,
  MOMENT = 8 * LENGTH * WIDTH,
  FRAMES = 40 /* of a speech */
};

static const float half_a_level = 0.5f / 255;

struct scene {
  ern_context *context;
  ern_backend *backend;
  ern_model *model;
  float windows[FRAMES * MOMENT], eyes[FRAMES];
  uint8_t background[2][3 * PIXELS], torso[2][4 * PIXELS];
};

/* What a picture has; all of it. */
struct drawn {
  uint8_t rgba[4 * PIXELS];
  float rgb[3 * PIXELS], alpha[PIXELS], opacity[PIXELS], depth[PIXELS], attention[PIXELS], eye[PIXELS];
};

static uint8_t noise(uint32_t i) { return (uint8_t)ern_random_at(8, 0, i, ERN_RNG_INIT).word[0]; }

/* A ball whose density and colour vary, of weights large enough for speech to show; a speech that goes round, and lids
 * that close and open once. */
static void scene_make(struct scene *scene, const char *kind, const char *isa, bool eye, bool torso) {
  const struct ern_model_config config = {.levels = 4,
                                          .feature_width = WIDTH,
                                          .window_length = LENGTH,
                                          .head = true,
                                          .eye = eye,
                                          .torso = torso,
                                          .codes = torso ? 2 : 0,
                                          .bound = 1};
  scene->context = support_context();
  support_ok(scene->context, ern_model_make(&scene->model, scene->context, &config));
  for (int part = 0; part < 2; part++) ern_parameters_init(scene->model->block, &scene->model->table, part != 0, 5);
  for (int plane = 0; plane < ERN_PLANES; plane++)
    for (uint32_t i = 0; i < scene->model->field.encoder.grid[plane].entries; i++)
      scene->model->block[scene->model->field.encoder.table[plane] + i] =
          2 * ern_uniform(ern_random_at(9, 0, i, ERN_RNG_INIT).word[0]) - 1;
  for (size_t i = 0; i < 64; i++) scene->model->block[scene->model->field.density.weight[2] + i] *= 20;
  for (uint32_t number = 0; number < ERN_OCCUPANCY_CELLS; number++) {
    const float x = (float)ern_morton_gather(number) / 64 - 1, y = (float)ern_morton_gather(number >> 1) / 64 - 1,
                z = (float)ern_morton_gather(number >> 2) / 64 - 1;
    if (x * x + y * y + z * z <= 0.05f) scene->model->bits[number >> 3] |= (uint8_t)(1u << (number & 7));
  }
  for (size_t i = 0; torso && i < 128 * 128; i++) scene->model->torso_grid[i] = i % 128 > 60 ? 1 : 0;
  ern_backend_config backend = ern_backend_config_default();
  backend.name = kind;
  backend.isa = isa;
  support_ok(scene->context, ern_backend_create(&scene->backend, scene->context, &backend));
  for (int t = 0; t < FRAMES; t++) {
    for (int i = 0; i < MOMENT; i++)
      scene->windows[t * MOMENT + i] = sinf((float)i + 0.3f * (float)t) + sinf((float)(i * i % 97) + 0.11f * (float)t);
    scene->eyes[t] = t % 20 < 5 ? (float)(t % 20) / 4 : 0;
  }
  for (uint32_t i = 0; i < 3 * PIXELS; i++)
    for (uint32_t k = 0; k < 2; k++) scene->background[k][i] = noise(2 * i + k);
  for (uint32_t i = 0; i < 4 * PIXELS; i++)
    for (uint32_t k = 0; k < 2; k++) scene->torso[k][i] = noise(2 * i + k + 77777);
}

static void scene_free(struct scene *scene) {
  ern_model_free(&scene->model);
  ern_backend_free(&scene->backend);
  ern_context_free(&scene->context);
}

static ern_renderer *renderer_of(struct scene *scene, const ern_render_options *options) {
  ern_renderer *renderer = NULL;
  support_ok(scene->context, ern_renderer_create(&renderer, scene->backend, scene->model, options));
  return renderer;
}

static void keep(struct scene *scene, ern_renderer *renderer, float bound) {
  support_ok(scene->context,
             ern_renderer_reuse_rays(renderer, scene->windows, LENGTH, scene->eyes, bound > 0 ? FRAMES : 0, bound));
}

/* What changes in the course of a story, frame by frame. */
struct shot {
  int moment, view, background, torso; /* background, torso < 0: none */
  bool tall, all;                      /* turned on its side; all that a frame can give, or the bytes alone */
};

static ern_frame_input input_of(struct scene *scene, const struct shot *shot) {
  const int across = shot->tall ? HIGH : WIDE, down = shot->tall ? WIDE : HIGH;
  const float move = 0.01f * (float)shot->view;
  return (ern_frame_input){.camera = {.pose = {0, -1, 0, move, 0, 0, -1, 3, 1, 0, 0, 0, 0, 0, 0, 1},
                                      .focal = 4 * HIGH,
                                      .cx = 0.5f * (float)across,
                                      .cy = 0.45f * (float)down,
                                      .width = across,
                                      .height = down},
                           .windows = scene->windows + shot->moment * MOMENT,
                           .window_length = LENGTH,
                           .eye = scene->eyes[shot->moment],
                           .background = shot->background < 0 ? NULL : scene->background[shot->background],
                           .torso = shot->torso < 0 ? NULL : scene->torso[shot->torso]};
}

static void draw(struct scene *scene, ern_renderer *renderer, const struct shot *shot, struct drawn *drawn) {
  const ern_frame_input input = input_of(scene, shot);
  const ern_frame_output all = {.rgba = drawn->rgba,
                                .rgb = drawn->rgb,
                                .alpha = drawn->alpha,
                                .opacity = drawn->opacity,
                                .depth = drawn->depth,
                                .attention = drawn->attention,
                                .eye = drawn->eye},
                         bytes = {.rgba = drawn->rgba, .rgb = drawn->rgb};
  memset(drawn, 0, sizeof *drawn);
  support_ok(scene->context, ern_renderer_frame(renderer, &input, shot->all ? &all : &bytes, NULL));
}

static float most_apart(const float *a, const float *b, size_t n) {
  float most = 0;
  for (size_t i = 0; i < n; i++) most = fmaxf(most, fabsf(a[i] - b[i]));
  return most;
}

/* A speech before a camera that stands, then moves, stands, and is turned on its side; backgrounds and torso pictures
 * change in the middle, and so does what is wanted. */
static struct shot shot_at(int t, bool all) {
  return (struct shot){.moment = t % FRAMES,
                       .view = t < 20   ? 0
                               : t < 24 ? t - 19
                                        : 4,
                       .background = t < 8    ? 0
                                     : t < 11 ? -1
                                     : t < 15 ? t % 2
                                              : 1,
                       .torso = t < 6 ? -1 : t % 2,
                       .tall = t >= 34,
                       .all = all && t != 41};
}

enum { STORY = 44 };

static void tell(struct scene *scene, const ern_render_options *options, float bound, float most, bool all) {
  static struct drawn kept, whole;
  ern_renderer *with = renderer_of(scene, options), *without = renderer_of(scene, options);
  keep(scene, with, bound);
  for (int t = 0; t < STORY; t++) {
    const struct shot shot = shot_at(t, all);
    draw(scene, with, &shot, &kept);
    draw(scene, without, &shot, &whole);
    if (most > 0) {
      const float apart = most_apart(kept.rgb, whole.rgb, 3 * PIXELS);
      if (!(apart < most)) fail_msg("frame %d: a pixel is off by %g of 255", t, (double)apart * 255);
      /* over black and over white: twice the bound at most between them */
      assert_true(most_apart(kept.alpha, whole.alpha, PIXELS) < 2 * most);
    } else {
    }
  }
  assert_int_equal(ern_renderer_ray_reuse_work(with).frames, STORY);
  ern_renderer_free(&with);
  ern_renderer_free(&without);
}

static void test_within_the_bound_long(void **state) {
  (void)state;
  static struct scene scene;
  scene_make(&scene, "cpu", "ref", true, false);
  tell(&scene, NULL, half_a_level, half_a_level, true);
  scene_free(&scene);
  scene_make(&scene, "cpu", "auto", false, false); /* no eye branch */
  tell(&scene, NULL, half_a_level, half_a_level, true);
  scene_free(&scene);
}

static void test_something_is_kept(void **state) {
  (void)state;
  enum { WHOLE = 4, STEPS = 16, LONG = 30 };
  static struct scene scene;
  static struct drawn kept;
  scene_make(&scene, "cpu", "auto", true, false);
  ern_renderer *with = renderer_of(&scene, NULL);
  keep(&scene, with, 16 * half_a_level);
  for (int t = 0; t < LONG; t++) {
    const struct shot shot = {.moment = t, .torso = -1};
    draw(&scene, with, &shot, &kept);
  }
  const ern_ray_reuse_work work = ern_renderer_ray_reuse_work(with);
  assert_true(work.rays >= WHOLE + STEPS && work.rays < WHOLE + STEPS + 0.5 * (LONG - WHOLE));
  assert_true(work.samples >= WHOLE + STEPS && work.samples < WHOLE + STEPS + 0.5 * (LONG - WHOLE));
  ern_renderer_free(&with);
  scene_free(&scene);
}

static void test_bound_0_changes_nothing(void **state) {
  (void)state;
  static struct scene scene;
  scene_make(&scene, "cpu", "ref", false, false);
  tell(&scene, NULL, 0, 0, true);
  scene_free(&scene);
  scene_make(&scene, "cpu", "auto", true, true);
  tell(&scene, NULL, 0, 0, true);
  scene_free(&scene);
}

static void test_torso_of_the_model(void **state) {
  (void)state;
  static struct scene scene;
  scene_make(&scene, "cpu", "auto", true, true);
  tell(&scene, NULL, half_a_level, half_a_level, false);
  scene_free(&scene);
}

static void test_with_other_options_long(void **state) {
  (void)state;
  static struct scene scene;
  ern_render_options options = ern_render_options_default();
  scene_make(&scene, "cpu", "auto", true, false);
  options.smooth_lips = true;
  tell(&scene, &options, half_a_level, half_a_level, true);
  options.image_scale = 0.5f;
  tell(&scene, &options, half_a_level, half_a_level, true);
  tell(&scene, &options, 0, 0, true);
  options.max_steps = 40;
  tell(&scene, &options, half_a_level, half_a_level, false);
  scene_free(&scene);
}

static void test_on_a_device_long(void **state) {
  (void)state;
  static struct scene scene;
  ern_context *context = support_context();
  ern_backend_config config = ern_backend_config_default();
  ern_backend *backend = NULL;
  config.name = "opencl";
  const bool there = ern_backend_create(&backend, context, &config) == ERN_OK;
  ern_backend_free(&backend);
  ern_context_free(&context);
  if (!there) skip();
  scene_make(&scene, "opencl", "auto", true, true);
  tell(&scene, NULL, half_a_level, half_a_level, true);
  tell(&scene, NULL, 0, 0, true);
  scene_free(&scene);
}

/* What is asked for twice is there without a ray; other cells, another speech and another bound start again. */
static void test_what_is_forgotten(void **state) {
  (void)state;
  static struct scene scene;
  static struct drawn kept, whole;
  const struct shot shot = {.moment = 3, .torso = -1, .all = true};
  scene_make(&scene, "cpu", "auto", true, false);
  ern_renderer *with = renderer_of(&scene, NULL), *without = renderer_of(&scene, NULL);
  keep(&scene, with, 0);
  for (int k = 0; k < 3; k++) draw(&scene, with, &shot, &kept);
  assert_true(ern_renderer_ray_reuse_work(with).rays == 1);
  for (int k = 0; k < 2; k++) {
    ern_renderer *const both[] = {with, without};
    support_ok(scene.context, ern_renderer_prune_occupancy(both[k], scene.windows, LENGTH, scene.eyes, 2, 30));
  }
  draw(&scene, with, &shot, &kept);
  draw(&scene, without, &shot, &whole);
  assert_memory_equal(&kept, &whole, sizeof kept);
  assert_true(ern_renderer_ray_reuse_work(with).rays == 2);
  keep(&scene, with, half_a_level);
  draw(&scene, with, &shot, &kept);
  assert_memory_equal(&kept, &whole, sizeof kept);
  assert_true(ern_renderer_ray_reuse_work(with).rays == 1);
  keep(&scene, with, -1);
  for (int k = 0; k < 8; k++) draw(&scene, with, &shot, &kept);
  assert_memory_equal(&kept, &whole, sizeof kept);
  assert_int_equal(ern_renderer_ray_reuse_work(with).frames, 0);
  ern_renderer_free(&with);
  ern_renderer_free(&without);
  scene_free(&scene);
}

/* Speech that was not announced: its frames are whole. */
static void test_other_speech(void **state) {
  (void)state;
  static struct scene scene;
  static struct drawn kept, whole;
  scene_make(&scene, "cpu", "auto", true, false);
  ern_renderer *with = renderer_of(&scene, NULL), *without = renderer_of(&scene, NULL);
  support_ok(scene.context, ern_renderer_reuse_rays(with, scene.windows, LENGTH, scene.eyes, 8, half_a_level));
  for (int i = 0; i < MOMENT; i++) scene.windows[30 * MOMENT + i] = 40 * cosf((float)(7 * i));
  for (int t = 0; t < 12; t++) {
    const struct shot shot = {.moment = t == 9 ? 30 : t % 8, .torso = -1};
    draw(&scene, with, &shot, &kept);
    draw(&scene, without, &shot, &whole);
    assert_true(most_apart(kept.rgb, whole.rgb, 3 * PIXELS) < half_a_level);
    if (t == 9) assert_memory_equal(&kept, &whole, sizeof kept);
  }
  ern_renderer_free(&with);
  ern_renderer_free(&without);
  scene_free(&scene);
}

static void test_two_renderers_of_a_model(void **state) {
  (void)state;
  static struct scene scene;
  static struct drawn kept[2], whole;
  scene_make(&scene, "cpu", "auto", true, false);
  ern_renderer *with[2] = {renderer_of(&scene, NULL), renderer_of(&scene, NULL)}, *without = renderer_of(&scene, NULL);
  for (int k = 0; k < 2; k++) keep(&scene, with[k], half_a_level);
  for (int t = 0; t < 12; t++)
    for (int k = 0; k < 2; k++) {
      const struct shot shot = {.moment = t + 9 * k, .view = k, .torso = -1};
      draw(&scene, with[k], &shot, &kept[k]);
      draw(&scene, without, &shot, &whole);
      assert_true(most_apart(kept[k].rgb, whole.rgb, 3 * PIXELS) < half_a_level);
    }
  for (int k = 0; k < 2; k++) ern_renderer_free(&with[k]);
  ern_renderer_free(&without);
  scene_free(&scene);
}

/* Moments of one sound and of lids that move say nothing about other sounds: those frames are rendered whole. */
static void test_speech_after_moments_of_one_sound(void **state) {
  (void)state;
  enum { SAME = 20 };
  static struct scene scene;
  static struct drawn kept;
  static float said[FRAMES * MOMENT];
  double rays = 0;
  scene_make(&scene, "cpu", "auto", true, false);
  memcpy(said, scene.windows, sizeof said);
  for (int t = 1; t < FRAMES; t++) memcpy(scene.windows + t * MOMENT, scene.windows, MOMENT * sizeof(float));
  ern_renderer *with = renderer_of(&scene, NULL);
  keep(&scene, with, half_a_level);
  for (int t = 0; t < FRAMES; t++) {
    const struct shot shot = {.moment = t};
    if (t == SAME) {
      memcpy(scene.windows, said, sizeof said);
      rays = ern_renderer_ray_reuse_work(with).rays;
      assert_true(rays < SAME - 5);
    }
    draw(&scene, with, &shot, &kept);
  }
  assert_true(ern_renderer_ray_reuse_work(with).rays > rays + FRAMES - SAME - 1e-6);
  ern_renderer_free(&with);
  scene_free(&scene);
}

static void test_bad_arguments(void **state) {
  (void)state;
  static struct scene scene;
  scene_make(&scene, "cpu", "auto", true, false);
  ern_renderer *renderer = renderer_of(&scene, NULL);
  support_expect(scene.context, ern_renderer_reuse_rays(renderer, scene.windows, LENGTH, scene.eyes, 1, NAN),
                 ERN_E_ARGUMENT, "bound", NULL);
  support_expect(scene.context, ern_renderer_reuse_rays(renderer, scene.windows, LENGTH, scene.eyes, 1, 1.5f),
                 ERN_E_ARGUMENT, "bound", "1.5", NULL);
  support_expect(scene.context, ern_renderer_reuse_rays(renderer, NULL, LENGTH, NULL, 0, half_a_level), ERN_E_ARGUMENT,
                 "frames of the speech", "none", NULL);
  support_expect(scene.context, ern_renderer_reuse_rays(renderer, scene.windows, 17, scene.eyes, 1, half_a_level),
                 ERN_E_ARGUMENT, "window_length", "17", NULL);
  scene.eyes[2] = 2;
  support_expect(scene.context, ern_renderer_reuse_rays(renderer, scene.windows, LENGTH, scene.eyes, 3, half_a_level),
                 ERN_E_ARGUMENT, "frame 2", "eye", NULL);
  scene.windows[MOMENT + 3] = INFINITY;
  support_expect(scene.context, ern_renderer_reuse_rays(renderer, scene.windows, LENGTH, scene.eyes, 2, half_a_level),
                 ERN_E_NONFINITE, "frame 1", "value 3", NULL);
  ern_renderer_free(&renderer);
  scene_free(&scene);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_within_the_bound_long),
      cmocka_unit_test(test_something_is_kept),
      cmocka_unit_test(test_bound_0_changes_nothing),
      cmocka_unit_test(test_torso_of_the_model),
      cmocka_unit_test(test_with_other_options_long),
      cmocka_unit_test(test_on_a_device_long),
      cmocka_unit_test(test_what_is_forgotten),
      cmocka_unit_test(test_other_speech),
      cmocka_unit_test(test_two_renderers_of_a_model),
      cmocka_unit_test(test_speech_after_moments_of_one_sound),
      cmocka_unit_test(test_bad_arguments),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
