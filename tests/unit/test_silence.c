/* SPDX-License-Identifier: MIT
 * Silence, learnt from one speech and found in another; and a renderer that blends the silence code in. */
#include "../made_speech.h"

#include "ernerf/backend.h"
#include "ernerf/render.h"
#include "model/model.h"
#include "render/render_ops.h"

static const int learnt_from[] = {20, 45, 80, 85, 100, 120, MADE_FRAMES};

static void expect_rest(const ern_silence *silence, struct made_speech *s, const float *expected) {
  assert_int_equal(ern_silence_weights(silence, &s->features, s->weight), ERN_OK);
  for (int t = 0; t < MADE_FRAMES; t++)
    if (fabsf(s->weight[t] - expected[t]) > 1e-6f)
      fail_msg("frame %d has weight %g, expected %g", t, (double)s->weight[t], (double)expected[t]);
}

/* In another speech: half a second of silence eases in and ends at once, its first frames have weight 1 from the start,
 * and a short pause is none; in features of every shape, with loudness or without. */
static void test_found(void **state) {
  (void)state;
  static const int shapes[][2] = {{16, 29}, {16, 44}, {2, 1024}, {1, 40}};
  static const int silent[] = {0, 10, 40, 47, 60, 72, MADE_FRAMES};
  static struct made_speech learnt, other;
  ern_context *context = support_context();
  float expected[MADE_FRAMES] = {0};
  for (int t = 0; t < 10; t++) expected[t] = 1;
  for (int t = 60; t < 72; t++) expected[t] = fminf(1, 0.2f * (float)(t - 59));
  for (size_t i = 0; i < sizeof shapes / sizeof shapes[0]; i++) {
    made_speech(&learnt, shapes[i][0], shapes[i][1], 3, learnt_from);
    made_speech(&other, shapes[i][0], shapes[i][1], 30, silent);
    for (int heard = 0; heard < 2; heard++) {
      ern_silence *silence = NULL;
      if (ern_silence_learn(context, &learnt.features, heard ? learnt.loudness : NULL, &silence) != ERN_OK)
        fail_msg("%d x %d, loudness %d: %s", shapes[i][0], shapes[i][1], heard, ern_last_error(context));
      expect_rest(silence, &other, expected);
      ern_silence_free(&silence);
      assert_null(silence);
    }
    free(learnt.features.data);
    free(other.features.data);
  }
  ern_silence_free(NULL);
  ern_context_free(&context);
}

static void expect_unrecognised(ern_context *context, const struct made_speech *s, const float *loudness,
                                const char *why) {
  ern_silence *silence = NULL;
  support_expect(context, ern_silence_learn(context, &s->features, loudness, &silence), ERN_E_STATE, "silence:", why,
                 NULL);
  assert_null(silence);
}

static void test_unrecognised(void **state) {
  (void)state;
  static const int never[] = {MADE_FRAMES}, briefly[] = {20, 30, MADE_FRAMES};
  static struct made_speech s, wide;
  ern_context *context = support_context();
  made_speech(&s, 16, 29, 3, learnt_from);
  float steady[MADE_FRAMES], moved[MADE_FRAMES];
  for (int t = 0; t < MADE_FRAMES; t++) {
    steady[t] = 50 + made_noise(7, (size_t)t);
    moved[t] = t / 10 % 2 == 0 ? 60.0f : 20.0f; /* nothing to do with what the features say */
  }
  expect_unrecognised(context, &s, steady, "differ by");
  expect_unrecognised(context, &s, moved, "of the frames correctly");
  ern_silence *silence = NULL;
  support_ok(context, ern_silence_learn(context, &s.features, s.loudness, &silence));
  made_speech(&wide, 16, 44, 3, learnt_from);
  support_expect(context, ern_silence_weights(silence, &wide.features, wide.weight), ERN_E_MISMATCH, "44 wide",
                 "expected 29", NULL);
  ern_silence_free(&silence);
  free(s.features.data);
  free(wide.features.data);
  made_speech(&s, 16, 29, 3, briefly);
  expect_unrecognised(context, &s, s.loudness, "8 quiet");
  free(s.features.data);
  made_speech(&s, 16, 29, 3, never);
  expect_unrecognised(context, &s, NULL, "differ by");
  free(s.features.data);
  ern_context_free(&context);
}

static ern_status learn_and_find(ern_context *context) {
  static struct made_speech s;
  ern_silence *silence = NULL;
  made_speech(&s, 2, 8, 3, learnt_from);
  ern_status status = ern_silence_learn(context, &s.features, NULL, &silence);
  if (status == ERN_OK) status = ern_silence_weights(silence, &s.features, s.weight);
  ern_silence_free(&silence);
  free(s.features.data);
  return status;
}

static void test_no_memory(void **state) {
  (void)state;
  support_refuse_each(learn_and_find);
}

/* ---- a renderer -------------------------------------------------------------------------------------------------- */

enum { SIDE = 24, VALUES = SIDE * SIDE * 3, WIDTH = 29, LENGTH = 16, MOMENT = 8 * LENGTH * WIDTH, CODE = 32 };

struct scene {
  ern_context *context;
  ern_backend *backend;
  ern_model *model;
  ern_renderer *renderer;
  float said[MOMENT], unsaid[MOMENT];
};

static void scene_make(struct scene *scene, bool smooth_lips) {
  const struct ern_model_config config = {
      .levels = 4, .feature_width = WIDTH, .window_length = LENGTH, .head = true, .eye = true, .bound = 1};
  ern_backend_config backend = ern_backend_config_default();
  ern_render_options options = ern_render_options_default();
  backend.isa = "auto";
  options.smooth_lips = smooth_lips;
  scene->context = support_context();
  support_ok(scene->context, ern_model_make(&scene->model, scene->context, &config));
  for (size_t i = 0; i < scene->model->field.parameters; i++) scene->model->block[i] = 0.4f * made_noise(9, i);
  memset(scene->model->bits, 255, ERN_OCCUPANCY_BYTES);
  support_ok(scene->context, ern_backend_create(&scene->backend, scene->context, &backend));
  support_ok(scene->context, ern_renderer_create(&scene->renderer, scene->backend, scene->model, &options));
  for (size_t i = 0; i < MOMENT; i++) {
    scene->said[i] = 3 * sinf((float)i);
    scene->unsaid[i] = 3 * cosf(0.3f * (float)i);
  }
}

static void scene_free(struct scene *scene) {
  ern_renderer_free(&scene->renderer);
  ern_model_free(&scene->model);
  ern_backend_free(&scene->backend);
  ern_context_free(&scene->context);
}

static ern_status draw(struct scene *scene, const float *windows, const float *silence_code, float weight, float *rgb) {
  const ern_frame_input input = {.camera = {.pose = {0, -1, 0, 0, 0, 0, -1, 3, 1, 0, 0, 0, 0, 0, 0, 1},
                                            .focal = 3 * SIDE,
                                            .cx = SIDE / 2,
                                            .cy = SIDE / 2,
                                            .width = SIDE,
                                            .height = SIDE},
                                 .windows = windows,
                                 .window_length = LENGTH,
                                 .silence_code = silence_code,
                                 .silence_weight = weight};
  const ern_frame_output output = {.rgb = rgb};
  return ern_renderer_frame(scene->renderer, &input, &output, NULL);
}

static double distance(const float *a, const float *b) {
  double sum = 0;
  for (size_t i = 0; i < VALUES; i++) sum += (double)((a[i] - b[i]) * (a[i] - b[i]));
  return sqrt(sum);
}

/* With weight 1 a frame is that of the windows that the code is of, to the bit; half way it is between; with weight 0
 * it is the speech's. */
static void test_rest(void **state) {
  (void)state;
  static struct scene scene;
  static float said[VALUES], unsaid[VALUES], found[VALUES];
  float code[CODE];
  scene_make(&scene, false);
  support_ok(scene.context, draw(&scene, scene.said, NULL, 0, said));
  support_ok(scene.context, draw(&scene, scene.unsaid, NULL, 0, unsaid));
  support_ok(scene.context, ern_renderer_code(scene.renderer, scene.unsaid, LENGTH, code));
  if (distance(said, unsaid) < 1e-3) fail_msg("the two differ by %g", distance(said, unsaid));
  support_ok(scene.context, draw(&scene, scene.said, code, 0, found));
  assert_memory_equal(found, said, sizeof said);
  support_ok(scene.context, draw(&scene, scene.said, code, 1, found));
  assert_memory_equal(found, unsaid, sizeof unsaid);
  support_ok(scene.context, draw(&scene, scene.said, code, 0.5f, found));
  assert_true(distance(found, said) < distance(said, unsaid) && distance(found, unsaid) < distance(said, unsaid));
  assert_true(distance(found, said) > 0 && distance(found, unsaid) > 0);

  support_expect(scene.context, draw(&scene, scene.said, NULL, 0.5f, found), ERN_E_ARGUMENT, "silence_weight",
                 "without", NULL);
  support_expect(scene.context, draw(&scene, scene.said, code, 1.5f, found), ERN_E_ARGUMENT, "silence_weight is 1.5",
                 NULL);
  support_expect(scene.context, draw(&scene, scene.said, code, NAN, found), ERN_E_ARGUMENT, "silence_weight is", NULL);
  code[5] = NAN;
  support_expect(scene.context, draw(&scene, scene.said, code, 1, found), ERN_E_NONFINITE, "silence_code", "5", NULL);
  support_expect(scene.context, ern_renderer_code(scene.renderer, scene.said, 17, code), ERN_E_ARGUMENT, "17", NULL);
  scene_free(&scene);
}

/* Calm lips are calmed speech: the silence code is not mixed into what the next frame goes on from. */
static void test_smooth_lips(void **state) {
  (void)state;
  static struct scene scene;
  static float rested[VALUES], after[VALUES], unsaid[VALUES], found[VALUES];
  float code[CODE];
  scene_make(&scene, true);
  support_ok(scene.context, draw(&scene, scene.unsaid, NULL, 0, unsaid)); /* the first one: nothing to be calmed by */
  support_ok(scene.context, ern_renderer_code(scene.renderer, scene.unsaid, LENGTH, code));
  support_ok(scene.context, draw(&scene, scene.said, code, 1, rested));
  support_ok(scene.context, draw(&scene, scene.said, NULL, 0, after));
  assert_memory_equal(rested, unsaid, sizeof unsaid);
  scene_free(&scene);
  scene_make(&scene, true);
  support_ok(scene.context, draw(&scene, scene.unsaid, NULL, 0, found));
  support_ok(scene.context, draw(&scene, scene.said, NULL, 0, found));
  support_ok(scene.context, draw(&scene, scene.said, NULL, 0, found));
  assert_memory_equal(found, after, sizeof after);
  scene_free(&scene);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_found), cmocka_unit_test(test_unrecognised),
                                     cmocka_unit_test(test_no_memory), cmocka_unit_test(test_rest),
                                     cmocka_unit_test(test_smooth_lips)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
