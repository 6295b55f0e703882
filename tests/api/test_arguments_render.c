/* SPDX-License-Identifier: MIT
 * What cameras, speech, renderers, rate and evaluation do with NULL, with numbers out of range and with structures that
 * nobody initialised (base.h). */
#include <math.h>

#include "arguments.h"
#include "made_clip.h"

static struct world {
  ern_context *context;
  ern_backend *backend;
  ern_model *model;
  ern_renderer *renderer;
  struct made clip;
  float windows[8 * 16 * WIDTH];
} w;

/* ---- render.h: camera, speech ------------------------------------------------------------------------------------ */

/* Features whose sizes cannot be theirs. */
static const ern_features *bad_features(int which) {
  static ern_features bad[6];
  for (int i = 0; i < 6; i++) bad[i] = w.clip.features;
  bad[0].data = NULL;
  bad[1].windows = 0;
  bad[2].window_length = -1;
  bad[3].width = 0;
  bad[4].window_length = 17;
  bad[5].windows = SIZE_MAX / 2;
  return which < 6 ? &bad[which] : NULL;
}

CHECK(ern_camera_pose) {
  float pose[16] = {3};
  ern_camera_pose(pose, NULL, 1);
  assert_true(pose[0] == 3);
  ern_camera_pose(NULL, pose, 1);
}
CHECK(ern_pose_turn) { ern_pose_turn(NULL, 1, 1); }
CHECK(ern_camera_resized) {
  assert_int_equal(ern_camera_resized(NULL, 4, 4).width, 0);
  assert_int_equal(ern_camera_resized(&(ern_camera){.width = 3}, 4, 4).width, 0);
}
CHECK(ern_fit_box) {
  const int bad[4][4] = {{0, 1, 1, 1}, {1, -1, 1, 1}, {1, 1, 0, 1}, {1, 1, 1, INT32_MIN}};
  for (int i = 0; i < 4; i++) {
    const ern_box box = ern_fit_box(bad[i][0], bad[i][1], bad[i][2], bad[i][3], ERN_FIT_COVER);
    assert_int_equal(box.right - box.left + box.bottom - box.top, 0);
  }
  const ern_box wide = ern_fit_box(1, INT32_MAX, INT32_MAX, 1, ERN_FIT_COVER);
  assert_true(wide.bottom > wide.top && wide.right > wide.left);
}
CHECK(ern_camera_fitted) {
  const ern_camera camera = {.focal = 1, .width = 4, .height = 4};
  assert_int_equal(ern_camera_fitted(NULL, 4, 4, ERN_FIT_COVER).width, 0);
  assert_int_equal(ern_camera_fitted(&camera, -4, 4, ERN_FIT_COVER).width, 0);
  assert_int_equal(ern_camera_fitted(&camera, 4, 0, (ern_fit)99).width, 0);
}
CHECK(ern_pose_interpolate) {
  float pose[16] = {3};
  ern_pose_interpolate(NULL, pose, pose, 0.5);
  ern_pose_interpolate(pose, NULL, pose, 0.5);
  ern_pose_interpolate(pose, pose, NULL, 0.5);
  assert_true(pose[0] == 3);
}
CHECK(ern_pose_index) {
  assert_int_equal(ern_pose_index(5, 0), 0);
  assert_int_equal(ern_pose_index(5, SIZE_MAX / 2 + 2), 5); /* twice as many, less 2, are 0 in a size_t */
  assert_int_equal(ern_pose_index(SIZE_MAX, SIZE_MAX), SIZE_MAX - 2);
}
CHECK(ern_poses_smooth) {
  ern_pose pose = {0};
  REFUSED_ALONE(ern_poses_smooth(NULL, &pose, 1, 1));
  REFUSED(w.context, "ern_poses_smooth: poses is NULL", ern_poses_smooth(w.context, NULL, 1, 1));
  REFUSED(w.context, "window is -1", ern_poses_smooth(w.context, &pose, 1, -1));
}
CHECK(ern_audio_windows) {
  float one = 3, far[8 * 16 * WIDTH], last[8 * 16 * WIDTH];
  ern_audio_windows(NULL, &w.clip.features, 0, ERN_AUDIO_PAD_EDGE);
  ern_audio_windows(&one, NULL, 0, ERN_AUDIO_PAD_EDGE);
  for (int i = 0; i < 6; i++) ern_audio_windows(&one, bad_features(i), 0, ERN_AUDIO_PAD_EDGE);
  assert_true(one == 3);
  for (int pad = 0; pad < 2; pad++) { /* as the nearest index that is past the ends */
    ern_audio_windows(far, &w.clip.features, INT64_MIN, (ern_audio_pad)pad);
    ern_audio_windows(last, &w.clip.features, -8, (ern_audio_pad)pad);
    assert_memory_equal(far, last, sizeof far);
    ern_audio_windows(far, &w.clip.features, INT64_MAX, (ern_audio_pad)pad);
    ern_audio_windows(last, &w.clip.features, WINDOWS + 4, (ern_audio_pad)pad);
    assert_memory_equal(far, last, sizeof far);
  }
}
CHECK(ern_audio_windows_of_rows) {
  const int64_t rows[] = {INT64_MIN, INT64_MAX};
  float one = 3, far[8 * 16 * WIDTH];
  ern_audio_windows_of_rows(NULL, &w.clip.features, rows, 2, 0);
  ern_audio_windows_of_rows(&one, NULL, rows, 2, 0);
  ern_audio_windows_of_rows(&one, &w.clip.features, NULL, 2, 0);
  for (int i = 0; i < 6; i++) ern_audio_windows_of_rows(&one, bad_features(i), rows, 2, 0);
  assert_true(one == 3);
  ern_audio_windows_of_rows(far, &w.clip.features, rows, 2, 1);
  ern_audio_windows_of_rows(far, &w.clip.features, rows, 2, INT64_MAX);
  ern_audio_windows_of_rows(far, &w.clip.features, rows, 2, INT64_MIN);
  for (size_t i = 0; i < sizeof far / sizeof *far; i++) assert_true(far[i] == 0);
}
CHECK(ern_silence_learn) {
  ern_silence *made = (ern_silence *)(void *)&w;
  REFUSED_ALONE(ern_silence_learn(NULL, &w.clip.features, NULL, &made));
  assert_null(made);
  REFUSED(w.context, "ern_silence_learn: features is NULL", ern_silence_learn(w.context, NULL, NULL, &made));
  REFUSED(w.context, "ern_silence_learn: silence is NULL", ern_silence_learn(w.context, &w.clip.features, NULL, NULL));
  for (int i = 0; i < 6; i++)
    REFUSED(w.context, "silence: the features", ern_silence_learn(w.context, bad_features(i), NULL, &made));
}
CHECK(ern_silence_free) {
  ern_silence *none = NULL;
  ern_silence_free(NULL);
  ern_silence_free(&none);
}
CHECK(ern_silence_weights) {
  enum { COUNT = 400 };
  static float speech[COUNT], loudness[COUNT], weights[COUNT];
  ern_features features = {speech, COUNT, 1, 1};
  ern_silence *silence = NULL;
  for (int i = 0; i < COUNT; i++) {
    loudness[i] = i / 50 % 2 == 0 ? -60.0f - (float)(i % 3) : -20.0f + (float)(i % 3);
    speech[i] = (i / 50 % 2 == 0 ? 0.0f : 1.0f) + 0.01f * (float)(i % 5);
  }
  support_ok(w.context, ern_silence_learn(w.context, &features, loudness, &silence));
  REFUSED_ALONE(ern_silence_weights(NULL, &features, weights));
  REFUSED(w.context, "ern_silence_weights: features is NULL", ern_silence_weights(silence, NULL, weights));
  REFUSED(w.context, "ern_silence_weights: weights is NULL", ern_silence_weights(silence, &features, NULL));
  for (int i = 0; i < 6; i++)
    REFUSED(w.context, "silence: the features", ern_silence_weights(silence, bad_features(i), weights));
  speech[70] = NAN;
  support_expect(w.context, ern_silence_weights(silence, &features, weights), ERN_E_NONFINITE, "value [70, 0, 0]",
                 NULL);
  ern_silence_free(&silence);
  support_expect(w.context, ern_silence_learn(w.context, &features, loudness, &silence), ERN_E_NONFINITE,
                 "value [70, 0, 0]", NULL);
  assert_null(silence);
}

/* ---- render.h: renderer ------------------------------------------------------------------------------------------ */

CHECK(ern_render_options_default) { assert_int_not_equal(ern_render_options_default().cookie, 0); }
CHECK(ern_render_setting) {
  assert_non_null(ern_render_setting(0));
  assert_null(ern_render_setting(SIZE_MAX));
}

CHECK(ern_render_options_fill) { FILLS(ern_render_options, ern_render_options_fill); }
CHECK(ern_renderer_create) {
  ern_renderer *made = w.renderer;
  ern_render_options options = ern_render_options_default();
  REFUSED_ALONE(ern_renderer_create(&made, NULL, w.model, NULL));
  assert_null(made);
  REFUSED(w.context, "ern_renderer_create: model is NULL", ern_renderer_create(&made, w.backend, NULL, NULL));
  REFUSED(w.context, "ern_renderer_create: renderer is NULL", ern_renderer_create(NULL, w.backend, w.model, NULL));
  REFUSED(w.context, "ern_render_options_default",
          ern_renderer_create(&made, w.backend, w.model, &(ern_render_options){.max_steps = 16}));
  for (int i = 0; i < 2; i++) {
    options.threads = i == 0 ? -1 : ERN_THREADS_MOST + 1;
    REFUSED(w.context, "threads is ", ern_renderer_create(&made, w.backend, w.model, &options));
  }
  options.threads = 0;
  options.max_steps = 5000; /* the message says what 0 means */
  REFUSED(w.context, "max_steps is 5000, expected 0 to 1024; 0: as in training",
          ern_renderer_create(&made, w.backend, w.model, &options));
  options.max_steps = 0;
  options.dt_gamma = 2;
  REFUSED(w.context, "dt_gamma is 2, expected -1 to 1; below 0: as in training",
          ern_renderer_create(&made, w.backend, w.model, &options));
  options.dt_gamma = -1;
  options.threads = ERN_THREADS_MOST; /* what the header allows is taken */
  support_ok(w.context, ern_renderer_create(&made, w.backend, w.model, &options));
  ern_renderer_free(&made);
  options.image_scale = -7;
  options.size = offsetof(ern_render_options, image_scale); /* so it is not looked at */
  support_ok(w.context, ern_renderer_create(&made, w.backend, w.model, &options));
  ern_renderer_free(&made);
  options.size = sizeof options + 8;
  REFUSED_LATER(w.context, ern_render_options, ern_renderer_create(&made, w.backend, w.model, &options));
}
CHECK(ern_renderer_free) {
  ern_renderer *none = NULL;
  ern_renderer_free(NULL);
  ern_renderer_free(&none);
}
CHECK(ern_renderer_accepts) {
  REFUSED_ALONE(ern_renderer_accepts(NULL, &w.clip.features, "x"));
  REFUSED(w.context, "ern_renderer_accepts: features is NULL", ern_renderer_accepts(w.renderer, NULL, "x"));
  REFUSED(w.context, "ern_renderer_accepts: name is NULL", ern_renderer_accepts(w.renderer, &w.clip.features, NULL));
  for (int i = 0; i < 6; i++)
    REFUSED(w.context, "x: the features", ern_renderer_accepts(w.renderer, bad_features(i), "x"));
}
CHECK(ern_renderer_prune_occupancy) {
  const float eye = 0.5f;
  REFUSED_ALONE(ern_renderer_prune_occupancy(NULL, w.windows, 16, &eye, 1, 0.1f));
  REFUSED(w.context, "ern_renderer_prune_occupancy: windows is NULL",
          ern_renderer_prune_occupancy(w.renderer, NULL, 16, &eye, 1, 0.1f));
  REFUSED(w.context, "ern_renderer_prune_occupancy: eyes is NULL",
          ern_renderer_prune_occupancy(w.renderer, w.windows, 16, NULL, 1, 0.1f));
  REFUSED(w.context, "window_length is -1", ern_renderer_prune_occupancy(w.renderer, w.windows, -1, &eye, 1, 0.1f));
  REFUSED(w.context, "density", ern_renderer_prune_occupancy(w.renderer, w.windows, 16, &eye, 1, NAN));
}
CHECK(ern_renderer_code) {
  float code[32];
  REFUSED_ALONE(ern_renderer_code(NULL, w.windows, 16, code));
  REFUSED(w.context, "ern_renderer_code: windows is NULL", ern_renderer_code(w.renderer, NULL, 16, code));
  REFUSED(w.context, "ern_renderer_code: code is NULL", ern_renderer_code(w.renderer, w.windows, 16, NULL));
  REFUSED(w.context, "window_length is -1", ern_renderer_code(w.renderer, w.windows, -1, code));
}
CHECK(ern_renderer_skip) {
  REFUSED_ALONE(ern_renderer_skip(NULL, w.windows, 16));
  REFUSED(w.context, "ern_renderer_skip: windows is NULL", ern_renderer_skip(w.renderer, NULL, 16));
  REFUSED(w.context, "window_length is -1", ern_renderer_skip(w.renderer, w.windows, -1));
}
CHECK(ern_renderer_reuse_rays) {
  const float eye = 0.5f;
  REFUSED_ALONE(ern_renderer_reuse_rays(NULL, w.windows, 16, &eye, 1, 0.1f));
  REFUSED(w.context, "ern_renderer_reuse_rays: windows is NULL",
          ern_renderer_reuse_rays(w.renderer, NULL, 16, &eye, 1, 0.1f));
  REFUSED(w.context, "ern_renderer_reuse_rays: eyes is NULL",
          ern_renderer_reuse_rays(w.renderer, w.windows, 16, NULL, 1, 0.1f));
  REFUSED(w.context, "bound is", ern_renderer_reuse_rays(w.renderer, w.windows, 16, &eye, 1, NAN));
  REFUSED(w.context, "window_length is -1", ern_renderer_reuse_rays(w.renderer, w.windows, -1, &eye, 1, 0.1f));
  support_ok(w.context, ern_renderer_reuse_rays(w.renderer, NULL, 0, NULL, 0, -1));
}
CHECK(ern_renderer_ray_reuse_work) { assert_int_equal(ern_renderer_ray_reuse_work(NULL).frames, 0); }
CHECK(ern_renderer_ray_reuse_work_sized) {
  ern_renderer_ray_reuse_work_sized(w.renderer, NULL, sizeof(ern_ray_reuse_work));
  KEEPS_TO(ern_ray_reuse_work, ern_renderer_ray_reuse_work_sized(w.renderer, it, bytes));
}
CHECK(ern_renderer_frame) {
  static uint8_t rgba[SIDE * SIDE * 4];
  ern_frame_input input = {.camera = {.focal = 48, .cx = SIDE / 2, .cy = SIDE / 2, .width = SIDE, .height = SIDE},
                           .windows = w.windows,
                           .window_length = 16};
  const ern_frame_output output = {.rgba = rgba};
  const float matrix[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.8f, 0, 0, 0, 1};
  ern_camera_pose(input.camera.pose, matrix, 4);
  support_ok(w.context, ern_renderer_frame(w.renderer, &input, &output, NULL));
  support_ok(w.context, ern_renderer_frame(w.renderer, &input, &(ern_frame_output){0}, NULL));
  REFUSED_ALONE(ern_renderer_frame(NULL, &input, &output, NULL));
  REFUSED(w.context, "ern_renderer_frame_sized: input is NULL", ern_renderer_frame(w.renderer, NULL, &output, NULL));
  REFUSED(w.context, "ern_renderer_frame_sized: output is NULL", ern_renderer_frame(w.renderer, &input, NULL, NULL));
  input.window_length = -1;
  REFUSED(w.context, "window_length is -1", ern_renderer_frame(w.renderer, &input, &output, NULL));
  input.window_length = 16;
  input.windows = NULL;
  REFUSED(w.context, "windows", ern_renderer_frame(w.renderer, &input, &output, NULL));
  input.windows = w.windows;
  input.silence_weight = 1;
  REFUSED(w.context, "silence_code", ern_renderer_frame(w.renderer, &input, &output, NULL));
  input.silence_weight = 0;
  input.camera.width = -1;
  REFUSED(w.context, "size is -1 x", ern_renderer_frame(w.renderer, &input, &output, NULL));
  input.camera.width = SIDE;
  input.individual = SIZE_MAX - 1;
  REFUSED(w.context, "individual code", ern_renderer_frame(w.renderer, &input, &output, NULL));
}

CHECK(ern_renderer_frame_sized) {
  static uint8_t rgba[SIDE * SIDE * 4];
  ern_frame_input input = {.camera = {.focal = 48, .cx = SIDE / 2, .cy = SIDE / 2, .width = SIDE, .height = SIDE},
                           .windows = w.windows,
                           .window_length = 16,
                           .silence_weight = NAN}; /* past the members of the sizes below */
  const ern_frame_output output = {.rgba = rgba, .rgb = (float *)(void *)rgba};
  const size_t in = offsetof(ern_frame_input, silence_weight), out = offsetof(ern_frame_output, rgb);
  const float matrix[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.8f, 0, 0, 0, 1};
  ern_camera_pose(input.camera.pose, matrix, 4);
  KEEPS_TO(ern_frame_times,
           support_ok(w.context, ern_renderer_frame_sized(w.renderer, &input, in, &output, out, it, bytes)));
  support_ok(w.context, ern_renderer_frame_sized(w.renderer, &input, in, &output, out, NULL, 0));
  memset(rgba, 7, sizeof rgba);
  support_ok(w.context, ern_renderer_frame_sized(w.renderer, &input, in, &output, 0, NULL, 0));
  for (size_t i = 0; i < sizeof rgba; i++) assert_int_equal(rgba[i], 7);
  REFUSED(w.context, "size is 0 x 0", ern_renderer_frame_sized(w.renderer, &input, 0, &output, out, NULL, 0));
  REFUSED_LATER(w.context, ern_frame_input,
                ern_renderer_frame_sized(w.renderer, &input, sizeof input + 8, &output, out, NULL, 0));
  REFUSED_LATER(w.context, ern_frame_output,
                ern_renderer_frame_sized(w.renderer, &input, in, &output, sizeof output + 8, NULL, 0));
}

/* ---- render.h: rate, evaluation -------------------------------------------------------------------------------------
 */

CHECK(ern_rate_controller_begin) {
  const double cost = 1;
  ern_rate_controller pace = {.at = 7};
  ern_rate_controller_begin(NULL, &cost, 1, 1);
  ern_rate_controller_begin(&pace, NULL, 1, 1);
  assert_int_equal(pace.at + pace.count, 0);
  pace.at = 7;
  ern_rate_controller_begin(&pace, &cost, 0, 1);
  assert_int_equal(pace.at + pace.count, 0);
}
CHECK(ern_rate_controller_next) {
  const double cost = 1;
  assert_int_equal(ern_rate_controller_next(NULL, 1), 0);
  assert_int_equal(ern_rate_controller_next(&(ern_rate_controller){0}, 1), 0);
  assert_int_equal(ern_rate_controller_next(
                       &(ern_rate_controller){.cost = &cost, .count = 1, .at = 9, .slowness = 1, .budget = 1}, 1),
                   0);
}
CHECK(ern_rate_controller_holds) {
  assert_false(ern_rate_controller_holds(NULL));
  assert_false(ern_rate_controller_holds(&(ern_rate_controller){.budget = 1}));
}
CHECK(ern_psnr) {
  const float rgb[3] = {0};
  const uint8_t truth[3] = {0};
  assert_true(isnan(ern_psnr(NULL, truth, 1, 1, NULL)));
  assert_true(isnan(ern_psnr(rgb, NULL, 1, 1, NULL)));
  assert_true(isnan(ern_psnr(rgb, truth, -1, -1, NULL)));
  assert_true(ern_psnr(rgb, truth, 1, 1, &(ern_box){-9, 9, -9, 9}) == 100);
}
CHECK(ern_ssim) {
  static float rgb[11 * 11 * 3];
  static uint8_t truth[11 * 11 * 3];
  double ssim;
  REFUSED_ALONE(ern_ssim(NULL, rgb, truth, 11, 11, &ssim));
  REFUSED(w.context, "ern_ssim: rgb is NULL", ern_ssim(w.context, NULL, truth, 11, 11, &ssim));
  REFUSED(w.context, "ern_ssim: truth is NULL", ern_ssim(w.context, rgb, NULL, 11, 11, &ssim));
  REFUSED(w.context, "ern_ssim: ssim is NULL", ern_ssim(w.context, rgb, truth, 11, 11, NULL));
  REFUSED(w.context, "-11 x 11", ern_ssim(w.context, rgb, truth, -11, 11, &ssim));
}

/* ------------------------------------------------------------------------------------------------------------------ */

static const struct arguments_check table[] = {ROW(ern_fit_box),
                                               ROW(ern_camera_fitted),
                                               ROW(ern_pose_interpolate),
                                               ROW(ern_renderer_skip),
                                               ROW(ern_camera_pose),
                                               ROW(ern_pose_turn),
                                               ROW(ern_camera_resized),
                                               ROW(ern_pose_index),
                                               ROW(ern_poses_smooth),
                                               ROW(ern_audio_windows),
                                               ROW(ern_audio_windows_of_rows),
                                               ROW(ern_silence_learn),
                                               ROW(ern_silence_free),
                                               ROW(ern_silence_weights),
                                               ROW(ern_render_options_default),
                                               ROW(ern_render_options_fill),
                                               ROW(ern_render_setting),
                                               ROW(ern_renderer_create),
                                               ROW(ern_renderer_free),
                                               ROW(ern_renderer_accepts),
                                               ROW(ern_renderer_prune_occupancy),
                                               ROW(ern_renderer_code),
                                               ROW(ern_renderer_reuse_rays),
                                               ROW(ern_renderer_ray_reuse_work),
                                               ROW(ern_renderer_ray_reuse_work_sized),
                                               ROW(ern_renderer_frame),
                                               ROW(ern_renderer_frame_sized),
                                               ROW(ern_rate_controller_begin),
                                               ROW(ern_rate_controller_next),
                                               ROW(ern_rate_controller_holds),
                                               ROW(ern_psnr),
                                               ROW(ern_ssim)};
enum { CHECKS = sizeof table / sizeof *table };

static void test_every_function_has_a_check(void **state) {
  (void)state;
  assert_int_equal(arguments_cover("include/ernerf/render.h", table, CHECKS), CHECKS);
}

static void test_arguments(void **state) {
  (void)state;
  ern_trainer *trainer = NULL;
  made_open(&w.clip);
  w.context = w.clip.context;
  w.backend = w.clip.backend;
  const ern_train_config config = small_config(1, NULL);
  support_ok(w.context, ern_trainer_create(&trainer, w.backend, &w.clip.data, &config));
  support_ok(w.context, ern_trainer_model(trainer, &w.model));
  ern_trainer_free(&trainer);
  support_ok(w.context, ern_renderer_create(&w.renderer, w.backend, w.model, NULL));
  ern_audio_windows(w.windows, &w.clip.features, 2, ERN_AUDIO_PAD_EDGE);
  arguments_run(table, CHECKS);
  ern_renderer_free(&w.renderer);
  ern_model_free(&w.model);
  made_close(&w.clip);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_every_function_has_a_check),
                                     cmocka_unit_test(test_arguments)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
