/* SPDX-License-Identifier: MIT
 * What the engine's functions do with NULL, with numbers out of range and with structures that nobody initialised
 * (base.h). Training, media and the laboratory have files of their own. */
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

static const char *const junk = "no such file";

/* ---- base.h ------------------------------------------------------------------------------------------------------ */

CHECK(ern_status_name) { assert_string_equal(ern_status_name((ern_status)999), "ERN_E_UNKNOWN"); }
CHECK(ern_version) { assert_non_null(ern_version()); }
CHECK(ern_context_config_default) { assert_int_not_equal(ern_context_config_default().cookie, 0); }
CHECK(ern_context_config_fill) { FILLS(ern_context_config, ern_context_config_fill); }
static void must_not_log(void *user, ern_log_level level, const char *line) {
  (void)user, (void)level;
  fail_msg("a hook past the size was called: %s", line);
}
CHECK(ern_context_create) {
  ern_backend *backend = NULL;
  ern_context *made = (ern_context *)(void *)&w;
  ern_context_config config = ern_context_config_default();
  REFUSED_ALONE(ern_context_create(NULL, NULL));
  config.release = NULL;
  REFUSED_ALONE(ern_context_create(&made, &config));
  assert_null(made);
  config = (ern_context_config){0};
  REFUSED_ALONE(ern_context_create(&made, &config));
  config = ern_context_config_default();
  config.size += 8;
  assert_int_equal(ern_context_create(&made, &config), ERN_E_UNSUPPORTED);
  config.size = 4;
  REFUSED_ALONE(ern_context_create(&made, &config));
  config.size = offsetof(ern_context_config, release); /* the rest is as by default */
  config.allocate = NULL;
  config.release = NULL;
  assert_int_equal(ern_context_create(&made, &config), ERN_E_ARGUMENT);
  config = ern_context_config_default();
  config.size = offsetof(ern_context_config, log);
  config.log = must_not_log; /* past the size */
  assert_int_equal(ern_context_create(&made, &config), ERN_OK);
  support_ok(made, ern_backend_create(&backend, made, NULL)); /* which logs its choice */
  ern_backend_free(&backend);
  ern_context_free(&made);
}
CHECK(ern_context_free) {
  ern_context *none = NULL;
  ern_context_free(NULL);
  ern_context_free(&none);
}
CHECK(ern_last_error) { assert_string_equal(ern_last_error(NULL), ""); }
CHECK(ern_last_error_copy) {
  char text[4] = "abc";
  assert_int_equal(ern_last_error_copy(NULL, text, sizeof text), 0);
  assert_string_equal(text, "");
  REFUSED(w.context, "ern_model_load: path is NULL", ern_model_load(&(ern_model *){NULL}, w.context, NULL));
  const size_t length = strlen("ern_model_load: path is NULL");
  assert_int_equal(ern_last_error_copy(w.context, NULL, 0), length);
  assert_int_equal(ern_last_error_copy(w.context, text, 0), length);
  assert_string_equal(text, "");
  assert_int_equal(ern_last_error_copy(w.context, text, sizeof text), length);
  assert_string_equal(text, "ern");
}

/* ---- backend.h --------------------------------------------------------------------------------------------------- */

static void say_device(void *user, const ern_device_info *device) { (void)user, (void)device; }
static void say_tuning(void *user, const ern_tuning *tuning) { (void)user, (void)tuning; }

CHECK(ern_backend_config_default) { assert_int_not_equal(ern_backend_config_default().cookie, 0); }
CHECK(ern_backend_config_fill) { FILLS(ern_backend_config, ern_backend_config_fill); }
CHECK(ern_backend_create) {
  ern_backend *made = w.backend;
  REFUSED_ALONE(ern_backend_create(&made, NULL, NULL));
  assert_null(made);
  REFUSED(w.context, "ern_backend_create: backend is NULL", ern_backend_create(NULL, w.context, NULL));
  REFUSED(w.context, "ern_backend_config_default", ern_backend_create(&made, w.context, &(ern_backend_config){0}));
  ern_backend_config config = ern_backend_config_default();
  config.name = "opencl";
  config.device = -1;
  assert_int_equal(ern_backend_create(&made, w.context, &config), ERN_E_UNSUPPORTED);
  config.size = offsetof(ern_backend_config, name); /* of a time without the rest */
  support_ok(w.context, ern_backend_create(&made, w.context, &config));
  ern_backend_free(&made);
  config.size = sizeof config + 8;
  REFUSED_LATER(w.context, ern_backend_config, ern_backend_create(&made, w.context, &config));
}
CHECK(ern_backend_free) {
  ern_backend *none = NULL;
  ern_backend_free(NULL);
  ern_backend_free(&none);
}
CHECK(ern_backend_describe) {
  ern_backend_info info = {.real_bytes = 7};
  ern_backend_describe(NULL, &info);
  assert_int_equal(info.real_bytes, 0);
  ern_backend_describe(w.backend, NULL);
}
CHECK(ern_backend_describe_sized) {
  ern_backend_describe_sized(w.backend, NULL, sizeof(ern_backend_info));
  KEEPS_TO(ern_backend_info, ern_backend_describe_sized(w.backend, it, bytes));
  KEEPS_TO(ern_backend_info, ern_backend_describe_sized(NULL, it, bytes));
}
CHECK(ern_backend_tuning) {
  ern_backend_tuning(NULL, say_tuning, NULL);
  ern_backend_tuning(w.backend, NULL, NULL);
}
CHECK(ern_devices_list) {
  REFUSED_ALONE(ern_devices_list(NULL, say_device, NULL));
  REFUSED(w.context, "ern_devices_list: say is NULL", ern_devices_list(w.context, NULL, NULL));
}

/* ---- data.h ------------------------------------------------------------------------------------------------------ */

/* A loader of a structure that owns memory, and its free function. */
#define CHECK_LOADER(load, release, type)                                       \
  do {                                                                          \
    type loaded;                                                                \
    memset(&loaded, 1, sizeof loaded);                                          \
    REFUSED_ALONE(load(NULL, junk, &loaded));                                   \
    assert_memory_equal(&loaded, &(type){0}, sizeof loaded);                    \
    memset(&loaded, 1, sizeof loaded);                                          \
    REFUSED(w.context, #load ": path is NULL", load(w.context, NULL, &loaded)); \
    assert_memory_equal(&loaded, &(type){0}, sizeof loaded);                    \
    memset(&loaded, 1, sizeof loaded);                                          \
    assert_int_equal(load(w.context, junk, &loaded), ERN_E_MISSING);            \
    assert_memory_equal(&loaded, &(type){0}, sizeof loaded);                    \
    REFUSED(w.context, "is NULL", load(w.context, junk, NULL));                 \
    release(NULL, &loaded);                                                     \
    release(w.context, NULL);                                                   \
    release(w.context, &loaded);                                                \
  } while (0)

CHECK(ern_features_load) { CHECK_LOADER(ern_features_load, ern_features_free, ern_features); }
CHECK(ern_features_free) {
  float value = 1;
  ern_features features = {&value, 1, 1, 1};
  ern_features_free(NULL, &features);
  assert_ptr_equal(features.data, &value);
}
CHECK(ern_eyes_load) { CHECK_LOADER(ern_eyes_load, ern_eyes_free, ern_eyes); }
CHECK(ern_eyes_free) {
  float value = 1;
  ern_eyes eyes = {&value, 1};
  ern_eyes_free(NULL, &eyes);
  assert_ptr_equal(eyes.data, &value);
}
CHECK(ern_pose_list_load) { CHECK_LOADER(ern_pose_list_load, ern_pose_list_free, ern_pose_list); }
CHECK(ern_pose_list_free) {
  ern_pose pose;
  ern_pose_list list = {.count = 1, .poses = &pose};
  ern_pose_list_free(NULL, &list);
  assert_ptr_equal(list.poses, &pose);
}
CHECK(ern_file_check_output) {
  REFUSED_ALONE(ern_file_check_output(NULL, junk));
  REFUSED(w.context, "ern_file_check_output: path is NULL", ern_file_check_output(w.context, NULL));
}
CHECK(ern_file_save) {
  REFUSED_ALONE(ern_file_save(NULL, "saved", "x", 1));
  REFUSED(w.context, "ern_file_save: path is NULL", ern_file_save(w.context, NULL, "x", 1));
  REFUSED(w.context, "ern_file_save: bytes is NULL", ern_file_save(w.context, "saved", NULL, 1));
  support_ok(w.context, ern_file_save(w.context, "saved", NULL, 0));
}

/* ---- model.h ----------------------------------------------------------------------------------------------------- */

static void say_tensor(void *user, const ern_tensor_info *tensor) { (void)user, (void)tensor; }

CHECK(ern_backbone_name) {
  assert_null(ern_backbone_name((ern_backbone)-1));
  assert_null(ern_backbone_name((ern_backbone)99));
}
CHECK(ern_attention_name) { assert_null(ern_attention_name((ern_attention)99)); }
CHECK(ern_audio_pad_name) { assert_null(ern_audio_pad_name((ern_audio_pad)99)); }
CHECK(ern_eye_attention_name) { assert_null(ern_eye_attention_name((ern_eye_attention)99)); }
CHECK(ern_model_load) {
  ern_model *made = w.model;
  REFUSED_ALONE(ern_model_load(&made, NULL, junk));
  assert_null(made);
  made = w.model;
  REFUSED(w.context, "ern_model_load: path is NULL", ern_model_load(&made, w.context, NULL));
  assert_null(made);
  REFUSED(w.context, "ern_model_load: model is NULL", ern_model_load(NULL, w.context, junk));
}
CHECK(ern_model_free) {
  ern_model *none = NULL;
  ern_model_free(NULL);
  ern_model_free(&none);
}
CHECK(ern_model_save) {
  REFUSED_ALONE(ern_model_save(NULL, junk));
  REFUSED(w.context, "ern_model_save: path is NULL", ern_model_save(w.model, NULL));
}
CHECK(ern_model_describe) {
  ern_model_info info = {.levels = 7};
  ern_model_describe(NULL, &info);
  assert_int_equal(info.levels, 0);
  ern_model_describe(w.model, NULL);
}
CHECK(ern_model_describe_sized) {
  ern_model_describe_sized(w.model, NULL, sizeof(ern_model_info));
  KEEPS_TO(ern_model_info, ern_model_describe_sized(w.model, it, bytes));
}
CHECK(ern_file_tensors) {
  REFUSED_ALONE(ern_file_tensors(NULL, junk, say_tensor, NULL));
  REFUSED(w.context, "ern_file_tensors: path is NULL", ern_file_tensors(w.context, NULL, say_tensor, NULL));
  REFUSED(w.context, "ern_file_tensors: say is NULL", ern_file_tensors(w.context, junk, NULL, NULL));
}
CHECK(ern_file_sha256) {
  char hex[65];
  REFUSED_ALONE(ern_file_sha256(NULL, junk, hex));
  REFUSED(w.context, "ern_file_sha256: path is NULL", ern_file_sha256(w.context, NULL, hex));
  REFUSED(w.context, "ern_file_sha256: hex is NULL", ern_file_sha256(w.context, junk, NULL));
}
CHECK(ern_model_refine) {
  float pose[16] = {3};
  ern_model_refine(NULL, 0, pose);
  ern_model_refine(w.model, 0, NULL);
  ern_model_refine(w.model, SIZE_MAX, pose);
  assert_true(pose[0] == 3);
}
CHECK(ern_file_convert) {
  REFUSED_ALONE(ern_file_convert(NULL, junk, "a.pth"));
  REFUSED(w.context, "ern_file_convert: in is NULL", ern_file_convert(w.context, NULL, "a.pth"));
  REFUSED(w.context, "ern_file_convert: out is NULL", ern_file_convert(w.context, junk, NULL));
}

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
CHECK(ern_pose_index) { assert_int_equal(ern_pose_index(5, 0), 0); }
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
CHECK(ern_silence_rest) {
  enum { COUNT = 400 };
  static float speech[COUNT], loudness[COUNT], rest[COUNT];
  ern_features features = {speech, COUNT, 1, 1};
  ern_silence *silence = NULL;
  for (int i = 0; i < COUNT; i++) {
    loudness[i] = i / 50 % 2 == 0 ? -60.0f - (float)(i % 3) : -20.0f + (float)(i % 3);
    speech[i] = (i / 50 % 2 == 0 ? 0.0f : 1.0f) + 0.01f * (float)(i % 5);
  }
  support_ok(w.context, ern_silence_learn(w.context, &features, loudness, &silence));
  REFUSED_ALONE(ern_silence_rest(NULL, &features, rest));
  REFUSED(w.context, "ern_silence_rest: features is NULL", ern_silence_rest(silence, NULL, rest));
  REFUSED(w.context, "ern_silence_rest: rest is NULL", ern_silence_rest(silence, &features, NULL));
  for (int i = 0; i < 6; i++)
    REFUSED(w.context, "silence: the features", ern_silence_rest(silence, bad_features(i), rest));
  ern_silence_free(&silence);
}

/* ---- render.h: renderer ------------------------------------------------------------------------------------------ */

CHECK(ern_render_options_default) { assert_int_not_equal(ern_render_options_default().cookie, 0); }
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
CHECK(ern_renderer_skip_thin) {
  const float eye = 0.5f;
  REFUSED_ALONE(ern_renderer_skip_thin(NULL, w.windows, 16, &eye, 1, 0.1f));
  REFUSED(w.context, "ern_renderer_skip_thin: windows is NULL",
          ern_renderer_skip_thin(w.renderer, NULL, 16, &eye, 1, 0.1f));
  REFUSED(w.context, "ern_renderer_skip_thin: eyes is NULL",
          ern_renderer_skip_thin(w.renderer, w.windows, 16, NULL, 1, 0.1f));
  REFUSED(w.context, "window_length is -1", ern_renderer_skip_thin(w.renderer, w.windows, -1, &eye, 1, 0.1f));
  REFUSED(w.context, "density", ern_renderer_skip_thin(w.renderer, w.windows, 16, &eye, 1, NAN));
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
CHECK(ern_renderer_keep_still) {
  const float eye = 0.5f;
  REFUSED_ALONE(ern_renderer_keep_still(NULL, w.windows, 16, &eye, 1, 0.1f));
  REFUSED(w.context, "ern_renderer_keep_still: windows is NULL",
          ern_renderer_keep_still(w.renderer, NULL, 16, &eye, 1, 0.1f));
  REFUSED(w.context, "ern_renderer_keep_still: eyes is NULL",
          ern_renderer_keep_still(w.renderer, w.windows, 16, NULL, 1, 0.1f));
  REFUSED(w.context, "bound is", ern_renderer_keep_still(w.renderer, w.windows, 16, &eye, 1, NAN));
  REFUSED(w.context, "window_length is -1", ern_renderer_keep_still(w.renderer, w.windows, -1, &eye, 1, 0.1f));
  support_ok(w.context, ern_renderer_keep_still(w.renderer, NULL, 0, NULL, 0, -1));
}
CHECK(ern_renderer_still_work) { assert_int_equal(ern_renderer_still_work(NULL).frames, 0); }
CHECK(ern_renderer_still_work_sized) {
  ern_renderer_still_work_sized(w.renderer, NULL, sizeof(ern_still_work));
  KEEPS_TO(ern_still_work, ern_renderer_still_work_sized(w.renderer, it, bytes));
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
  input.rest = 1;
  REFUSED(w.context, "rest_code", ern_renderer_frame(w.renderer, &input, &output, NULL));
  input.rest = 0;
  input.camera.width = -1;
  REFUSED(w.context, "size is -1 x", ern_renderer_frame(w.renderer, &input, &output, NULL));
  input.camera.width = SIDE;
  input.individual = SIZE_MAX;
  REFUSED(w.context, "individual code", ern_renderer_frame(w.renderer, &input, &output, NULL));
}

CHECK(ern_renderer_frame_sized) {
  static uint8_t rgba[SIDE * SIDE * 4];
  ern_frame_input input = {.camera = {.focal = 48, .cx = SIDE / 2, .cy = SIDE / 2, .width = SIDE, .height = SIDE},
                           .windows = w.windows,
                           .window_length = 16,
                           .rest = NAN}; /* past the members of the sizes below */
  const ern_frame_output output = {.rgba = rgba, .rgb = (float *)(void *)rgba};
  const size_t in = offsetof(ern_frame_input, rest), out = offsetof(ern_frame_output, rgb);
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

/* ---- render.h: rate, judging ------------------------------------------------------------------------------------- */

CHECK(ern_pace_begin) {
  const double cost = 1;
  ern_pace pace = {.at = 7};
  ern_pace_begin(NULL, &cost, 1, 1);
  ern_pace_begin(&pace, NULL, 1, 1);
  assert_int_equal(pace.at + pace.count, 0);
  pace.at = 7;
  ern_pace_begin(&pace, &cost, 0, 1);
  assert_int_equal(pace.at + pace.count, 0);
}
CHECK(ern_pace_next) {
  const double cost = 1;
  assert_int_equal(ern_pace_next(NULL, 1), 0);
  assert_int_equal(ern_pace_next(&(ern_pace){0}, 1), 0);
  assert_int_equal(ern_pace_next(&(ern_pace){.cost = &cost, .count = 1, .at = 9, .slowness = 1, .budget = 1}, 1), 0);
}
CHECK(ern_pace_holds) {
  assert_false(ern_pace_holds(NULL));
  assert_false(ern_pace_holds(&(ern_pace){.budget = 1}));
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

static const struct arguments_check table[] = {ROW(ern_status_name),
                                               ROW(ern_version),
                                               ROW(ern_context_config_default),
                                               ROW(ern_context_config_fill),
                                               ROW(ern_context_create),
                                               ROW(ern_context_free),
                                               ROW(ern_last_error),
                                               ROW(ern_last_error_copy),
                                               ROW(ern_backend_config_default),
                                               ROW(ern_backend_config_fill),
                                               ROW(ern_backend_create),
                                               ROW(ern_backend_free),
                                               ROW(ern_backend_describe),
                                               ROW(ern_backend_describe_sized),
                                               ROW(ern_backend_tuning),
                                               ROW(ern_devices_list),
                                               ROW(ern_features_load),
                                               ROW(ern_features_free),
                                               ROW(ern_eyes_load),
                                               ROW(ern_eyes_free),
                                               ROW(ern_pose_list_load),
                                               ROW(ern_pose_list_free),
                                               ROW(ern_file_check_output),
                                               ROW(ern_file_save),
                                               ROW(ern_audio_pad_name),
                                               ROW(ern_fit_box),
                                               ROW(ern_camera_fitted),
                                               ROW(ern_pose_interpolate),
                                               ROW(ern_renderer_skip),
                                               ROW(ern_backbone_name),
                                               ROW(ern_attention_name),
                                               ROW(ern_eye_attention_name),
                                               ROW(ern_model_load),
                                               ROW(ern_model_free),
                                               ROW(ern_model_save),
                                               ROW(ern_model_describe),
                                               ROW(ern_model_describe_sized),
                                               ROW(ern_file_tensors),
                                               ROW(ern_file_sha256),
                                               ROW(ern_model_refine),
                                               ROW(ern_file_convert),
                                               ROW(ern_camera_pose),
                                               ROW(ern_pose_turn),
                                               ROW(ern_camera_resized),
                                               ROW(ern_pose_index),
                                               ROW(ern_poses_smooth),
                                               ROW(ern_audio_windows),
                                               ROW(ern_audio_windows_of_rows),
                                               ROW(ern_silence_learn),
                                               ROW(ern_silence_free),
                                               ROW(ern_silence_rest),
                                               ROW(ern_render_options_default),
                                               ROW(ern_render_options_fill),
                                               ROW(ern_renderer_create),
                                               ROW(ern_renderer_free),
                                               ROW(ern_renderer_accepts),
                                               ROW(ern_renderer_skip_thin),
                                               ROW(ern_renderer_code),
                                               ROW(ern_renderer_keep_still),
                                               ROW(ern_renderer_still_work),
                                               ROW(ern_renderer_still_work_sized),
                                               ROW(ern_renderer_frame),
                                               ROW(ern_renderer_frame_sized),
                                               ROW(ern_pace_begin),
                                               ROW(ern_pace_next),
                                               ROW(ern_pace_holds),
                                               ROW(ern_psnr),
                                               ROW(ern_ssim)};
enum { CHECKS = sizeof table / sizeof *table };

/* All headers but those of the other two files, so that a new one is missed here first. */
static void test_every_function_has_a_check(void **state) {
  (void)state;
  char path[1024];
  size_t found = 0;
  snprintf(path, sizeof path, "%s/include/ernerf", getenv("ERNERF_SOURCE"));
  DIR *folder = opendir(path);
  assert_non_null(folder);
  for (struct dirent *entry = readdir(folder); entry != NULL; entry = readdir(folder)) {
    const char *const name = entry->d_name;
    if (strstr(name, ".h") == NULL || strcmp(name, "train.h") == 0 || strcmp(name, "media.h") == 0) continue;
    char header[300];
    snprintf(header, sizeof header, "include/ernerf/%s", name);
    found += arguments_cover(header, table, CHECKS);
  }
  closedir(folder);
  assert_int_equal(found, CHECKS);
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
