/* SPDX-License-Identifier: MIT
 * What training and measurements do with NULL, with numbers out of range, with structures that nobody initialised and
 * with callbacks that lie (base.h). */
#include "arguments.h"
#include "made_clip.h"

static struct world {
  ern_context *context;
  ern_backend *backend;
  struct made clip;
  ern_trainer *trainer;
  ern_model *model;
  ern_bench_scene *scene;
} w;

/* ---- a clip that lies -------------------------------------------------------------------------------------------- */

/* What the callbacks of `lying` do wrong, from step `from` on. */
static struct lie {
  int64_t aud_id;
  float eye, entry;
  bool no_truth, frame_fails, pixels_fail;
} lie;

static ern_status lying_frame(void *user, int split, size_t index, ern_dataset_frame *frame) {
  if (lie.frame_fails) return ERN_E_IO;
  const ern_status status = made_frame(user, split, index, frame);
  if (lie.aud_id != 0) frame->aud_id = lie.aud_id;
  if (lie.eye != 0) frame->eye = lie.eye;
  if (lie.entry != 0) frame->matrix[0] = lie.entry;
  frame->face = (ern_box){INT32_MIN, INT32_MAX, INT32_MIN, INT32_MAX}; /* a box may lie anywhere */
  return status;
}

static ern_status lying_pixels(void *user, int split, size_t index, const uint8_t **truth, const uint8_t **torso) {
  if (lie.pixels_fail) return (ern_status)999;
  const ern_status status = made_pixels(user, split, index, truth, torso);
  if (lie.no_truth) *truth = *torso = NULL;
  return status;
}

static ern_dataset lying_data(void) {
  ern_dataset data = w.clip.data;
  data.frame = lying_frame;
  data.pixels = lying_pixels;
  return data;
}

/* The first step after the lie begins is refused with the words, and one after it is none is taken. */
static void refuse_lie(ern_audio_pad pad, struct lie next, const char *words) {
  const ern_dataset data = lying_data();
  ern_train_config config = small_config(9, NULL);
  ern_trainer *trainer = NULL;
  ern_train_report report;
  config.audio_pad = pad;
  lie = (struct lie){0};
  support_ok(w.context, ern_trainer_create(&trainer, w.backend, &data, &config));
  support_ok(w.context, ern_trainer_step(trainer, &report));
  lie = next;
  REFUSED(w.context, words, ern_trainer_step(trainer, &report));
  lie = (struct lie){0};
  support_ok(w.context, ern_trainer_step(trainer, &report));
  ern_trainer_free(&trainer);
}

static void refuse_failing(struct lie next, ern_status expected, const char *words) {
  const ern_dataset data = lying_data();
  const ern_train_config config = small_config(9, NULL);
  ern_trainer *trainer = NULL;
  ern_train_report report;
  lie = (struct lie){0};
  support_ok(w.context, ern_trainer_create(&trainer, w.backend, &data, &config));
  lie = next;
  support_expect(w.context, ern_trainer_step(trainer, &report), expected, words, "frame", NULL);
  lie = (struct lie){0};
  ern_trainer_free(&trainer);
}

/* ---- train.h ----------------------------------------------------------------------------------------------------- */

CHECK(ern_train_config_default) { assert_int_not_equal(ern_train_config_default().cookie, 0); }

static void refuse_config(ern_train_config config, const char *words) {
  ern_trainer *made = w.trainer;
  REFUSED(w.context, words, ern_trainer_create(&made, w.backend, &w.clip.data, &config));
  assert_null(made);
}

static void refuse_data(ern_dataset data, const char *words) {
  const ern_train_config config = small_config(3, NULL);
  ern_trainer *made = w.trainer;
  REFUSED(w.context, words, ern_trainer_create(&made, w.backend, &data, &config));
  assert_null(made);
}

static void check_configs(void) {
  ern_train_config config = small_config(3, NULL);
  refuse_config((ern_train_config){.iters = 3, .rays = 3}, "ern_train_config_default");
#define REFUSED_CONFIG(member, value, words) \
  do {                                       \
    ern_train_config bad = config;           \
    bad.member = value;                      \
    refuse_config(bad, words);               \
  } while (0)
  REFUSED_CONFIG(rays, -1, "rays is -1");
  REFUSED_CONFIG(threads, -1, "threads is -1");
  REFUSED_CONFIG(threads, ERN_THREADS_MOST + 1, "threads is 257");
  REFUSED_CONFIG(bound, 0.1f, "bound is 0.1, expected 0.125 to 16");
  REFUSED_CONFIG(bound, 17, "bound is 17");
  REFUSED_CONFIG(backbone, (ern_backbone)99, "backbone is of no known kind");
  REFUSED_CONFIG(attention, (ern_attention)99, "attention is of no known kind");
  REFUSED_CONFIG(eye_attention, (ern_eye_attention)99, "eye_attention is of no known kind");
  REFUSED_CONFIG(audio_pad, (ern_audio_pad)99, "audio_pad is 99");
  REFUSED_CONFIG(max_steps, 0, "max_steps is 0");
  REFUSED_CONFIG(lr, NAN, "lr is nan");
  REFUSED_CONFIG(torso, true, "needs the head");
  REFUSED_CONFIG(data_end, 99, "frames 0 to 99");
  REFUSED_CONFIG(refresh_every, 0, "refresh_every is 0");
}

static void check_datasets(void) {
  ern_features features = w.clip.features;
  ern_dataset data = w.clip.data;
#define REFUSED_DATA(member, value, words) \
  do {                                     \
    ern_dataset bad = data;                \
    bad.member = value;                    \
    refuse_data(bad, words);               \
  } while (0)
  REFUSED_DATA(frames[0], 0, "lacks frames");
  REFUSED_DATA(frame, NULL, "a callback");
  REFUSED_DATA(pixels, NULL, "a callback");
  REFUSED_DATA(features, NULL, "features");
  REFUSED_DATA(background, NULL, "a background");
  REFUSED_DATA(width, -1, "camera is -1 x");
  REFUSED_DATA(focal, NAN, "focal nan");
  data.features = &features;
#define REFUSED_FEATURES(member, value) \
  do {                                  \
    features = w.clip.features;         \
    features.member = value;            \
    refuse_data(data, "the features");  \
  } while (0)
  REFUSED_FEATURES(data, NULL);
  REFUSED_FEATURES(windows, 0);
  REFUSED_FEATURES(windows, SIZE_MAX / 3);
  REFUSED_FEATURES(window_length, -1);
  REFUSED_FEATURES(window_length, 17);
  REFUSED_FEATURES(width, -1);
  lie = (struct lie){.aud_id = -1};
  refuse_data(lying_data(), "aud_id is -1, expected 0 or more");
  lie = (struct lie){.entry = 1e9f};
  refuse_data(lying_data(), "pose of training frame 0");
}

CHECK(ern_trainer_create) {
  ern_trainer *made = w.trainer;
  REFUSED_ALONE(ern_trainer_create(&made, NULL, &w.clip.data, NULL));
  assert_null(made);
  REFUSED(w.context, "ern_trainer_create: dataset is NULL", ern_trainer_create(&made, w.backend, NULL, NULL));
  REFUSED(w.context, "ern_trainer_create: trainer is NULL", ern_trainer_create(NULL, w.backend, &w.clip.data, NULL));
  check_configs();
  check_datasets();
}
CHECK(ern_train_state_describe) {
  ern_train_state state;
  REFUSED_ALONE(ern_train_state_describe(NULL, "none", &state));
  REFUSED(w.context, "output is NULL", ern_train_state_describe(w.context, NULL, &state));
  REFUSED(w.context, "state is NULL", ern_train_state_describe(w.context, "none", NULL));
}
CHECK(ern_trainer_free) {
  ern_trainer *none = NULL;
  ern_trainer_free(NULL);
  ern_trainer_free(&none);
}
CHECK(ern_trainer_describe) {
  ern_train_report report = {.iters = 7};
  ern_trainer_describe(NULL, &report);
  assert_int_equal(report.iters, 0);
  ern_trainer_describe(w.trainer, NULL);
}
CHECK(ern_trainer_step) {
  ern_train_report report;
  REFUSED_ALONE(ern_trainer_step(NULL, &report));
  REFUSED(w.context, "ern_trainer_step: report is NULL", ern_trainer_step(w.trainer, NULL));
  for (int pad = 0; pad < 2; pad++) {
    refuse_lie((ern_audio_pad)pad, (struct lie){.aud_id = -1}, "aud_id is -1");
    refuse_lie((ern_audio_pad)pad, (struct lie){.aud_id = INT64_MIN}, "aud_id is -9223372036854775808");
  }
  refuse_lie(ERN_AUDIO_PAD_EDGE, (struct lie){.no_truth = true}, "gives no truth for training frame");
  refuse_lie(ERN_AUDIO_PAD_EDGE, (struct lie){.eye = 2}, "eye is 2");
  refuse_failing((struct lie){.frame_fails = true}, ERN_E_IO, "`frame` answered ERN_E_IO");
  refuse_failing((struct lie){.pixels_fail = true}, (ern_status)999, "`pixels` answered ERN_E_UNKNOWN");
}
CHECK(ern_trainer_check) { REFUSED_ALONE(ern_trainer_check(NULL)); }
CHECK(ern_trainer_run) {
  const ern_dataset data = lying_data();
  const ern_train_config config = small_config(1, NULL);
  ern_trainer *trainer = NULL;
  REFUSED_ALONE(ern_trainer_run(NULL, NULL));
  lie = (struct lie){0};
  support_ok(w.context, ern_trainer_create(&trainer, w.backend, &data, &config));
  lie = (struct lie){.no_truth = true};
  REFUSED(w.context, "gives no truth", ern_trainer_run(trainer, NULL));
  lie = (struct lie){0};
  support_ok(w.context, ern_trainer_run(trainer, &(ern_train_hooks){0}));
  ern_trainer_free(&trainer);
}
CHECK(ern_trainer_save) {
  REFUSED_ALONE(ern_trainer_save(NULL));
  assert_int_equal(ern_trainer_save(w.trainer), ERN_E_STATE);
}
CHECK(ern_trainer_model) {
  ern_model *made = w.model;
  REFUSED_ALONE(ern_trainer_model(NULL, &made));
  assert_null(made);
  REFUSED(w.context, "ern_trainer_model: model is NULL", ern_trainer_model(w.trainer, NULL));
}
CHECK(ern_trainer_folder) { assert_null(ern_trainer_folder(NULL)); }

/* ---- bench.h ----------------------------------------------------------------------------------------------------- */

static int say_kernel(void *user, const ern_bench_kernel *kernel) {
  (void)user, (void)kernel;
  return 0;
}

/* What all measurements take: backends and options. `call` uses backends, count and options. */
#define REFUSED_MEASUREMENT(call)                                \
  do {                                                           \
    ern_backend *some[9] = {w.backend}, *const *backends = NULL; \
    ern_bench_options options = ern_bench_options_default();     \
    size_t count = 1;                                            \
    REFUSED_ALONE(call);                                         \
    backends = some;                                             \
    count = 0;                                                   \
    REFUSED_ALONE(call);                                         \
    count = 9;                                                   \
    REFUSED(w.context, "9 backends, expected 1 to 8", call);     \
    count = 2;                                                   \
    REFUSED(w.context, "backends[k] is NULL", call);             \
    some[0] = NULL;                                              \
    REFUSED_ALONE(call);                                         \
    some[0] = w.backend;                                         \
    count = 1;                                                   \
    options.threads = -1;                                        \
    REFUSED(w.context, "threads is -1", call);                   \
    options.threads = ERN_THREADS_MOST + 1;                      \
    REFUSED(w.context, "threads is 257", call);                  \
    options = (ern_bench_options){.frames = 1, .rays = 1};       \
    REFUSED(w.context, "ern_bench_options_default", call);       \
  } while (0)

CHECK(ern_bench_options_default) { assert_int_not_equal(ern_bench_options_default().cookie, 0); }
CHECK(ern_bench_peaks) {
  ern_bench_machine machine;
  REFUSED_MEASUREMENT(ern_bench_peaks(backends, count, &options, &machine));
  REFUSED(w.context, "ern_bench_peaks: machine is NULL", ern_bench_peaks(&w.backend, 1, NULL, NULL));
}
CHECK(ern_bench_scene_make) {
  ern_bench_scene *made = w.scene;
  REFUSED_ALONE(ern_bench_scene_make(&made, NULL, 4, 4, 0));
  assert_null(made);
  REFUSED(w.context, "ern_bench_scene_make: scene is NULL", ern_bench_scene_make(NULL, w.context, 4, 4, 0));
  REFUSED(w.context, "size is -1 x 4", ern_bench_scene_make(&made, w.context, -1, 4, 0));
}
CHECK(ern_bench_scene_of) {
  static float windows[8 * 16 * WIDTH];
  ern_bench_scene *made = w.scene;
  const uint8_t *truth = w.clip.truth[0];
  ern_frame_input frame = {.camera = {.focal = 48, .cx = SIDE / 2, .cy = SIDE / 2, .width = SIDE, .height = SIDE},
                           .windows = windows,
                           .window_length = 16,
                           .background = w.clip.background};
  const float matrix[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.8f, 0, 0, 0, 1};
  ern_camera_pose(frame.camera.pose, matrix, 4);
  REFUSED_ALONE(ern_bench_scene_of(&made, NULL, w.model, &frame, truth, NULL));
  assert_null(made);
  REFUSED(w.context, "scene is NULL", ern_bench_scene_of(NULL, w.context, w.model, &frame, truth, NULL));
  REFUSED(w.context, "model is NULL", ern_bench_scene_of(&made, w.context, NULL, &frame, truth, NULL));
  REFUSED(w.context, "frame is NULL", ern_bench_scene_of(&made, w.context, w.model, NULL, truth, NULL));
  REFUSED(w.context, "truth is NULL", ern_bench_scene_of(&made, w.context, w.model, &frame, NULL, NULL));
  frame.background = NULL;
  REFUSED(w.context, "background is NULL", ern_bench_scene_of(&made, w.context, w.model, &frame, truth, NULL));
  frame.background = w.clip.background;
  frame.window_length = -1;
  REFUSED(w.context, "window_length is -1", ern_bench_scene_of(&made, w.context, w.model, &frame, truth, NULL));
  frame.window_length = 16;
  support_ok(w.context, ern_bench_scene_of(&made, w.context, w.model, &frame, truth, NULL));
  ern_bench_scene_free(&made);
}
CHECK(ern_bench_scene_free) {
  ern_bench_scene *none = NULL;
  ern_bench_scene_free(NULL);
  ern_bench_scene_free(&none);
}
CHECK(ern_bench_sample_flops) { assert_true(ern_bench_sample_flops(NULL) == 0); }
CHECK(ern_bench_scene_describe) {
  ern_bench_scene_info info;
  REFUSED(w.context, "backend is NULL", ern_bench_scene_describe(w.scene, NULL, 1, &info));
  REFUSED(w.context, "scene is NULL", ern_bench_scene_describe(NULL, w.backend, 1, &info));
  REFUSED(w.context, "info is NULL", ern_bench_scene_describe(w.scene, w.backend, 1, NULL));
  REFUSED(w.context, "found -1", ern_bench_scene_describe(w.scene, w.backend, -1, &info));
}
CHECK(ern_bench_kernels) {
  REFUSED_MEASUREMENT(ern_bench_kernels(backends, count, w.scene, NULL, &options, say_kernel, NULL));
  REFUSED(w.context, "scene is NULL", ern_bench_kernels(&w.backend, 1, NULL, NULL, NULL, say_kernel, NULL));
  REFUSED(w.context, "say is NULL", ern_bench_kernels(&w.backend, 1, w.scene, NULL, NULL, NULL, NULL));
}
CHECK(ern_bench_frame) {
  ern_bench_pass passes[9];
  REFUSED_MEASUREMENT(ern_bench_frame(backends, count, w.scene, NULL, &options, passes));
  REFUSED(w.context, "scene is NULL", ern_bench_frame(&w.backend, 1, NULL, NULL, NULL, passes));
  REFUSED(w.context, "results is NULL", ern_bench_frame(&w.backend, 1, w.scene, NULL, NULL, NULL));
}
CHECK(ern_bench_step) {
  ern_bench_pass passes[9];
  REFUSED_MEASUREMENT(ern_bench_step(backends, count, w.scene, NULL, &options, false, passes));
  REFUSED(w.context, "scene is NULL", ern_bench_step(&w.backend, 1, NULL, NULL, NULL, false, passes));
  REFUSED(w.context, "results is NULL", ern_bench_step(&w.backend, 1, w.scene, NULL, NULL, false, NULL));
}
CHECK(ern_bench_collisions) {
  ern_bench_collision_table out;
  REFUSED_ALONE(ern_bench_collisions(NULL, w.scene, &out));
  REFUSED(w.context, "scene is NULL", ern_bench_collisions(w.backend, NULL, &out));
  REFUSED(w.context, "table is NULL", ern_bench_collisions(w.backend, w.scene, NULL));
}

/* ------------------------------------------------------------------------------------------------------------------ */

static const struct arguments_check table[] = {
    ROW(ern_train_config_default), ROW(ern_trainer_create),     ROW(ern_train_state_describe),
    ROW(ern_trainer_free),         ROW(ern_trainer_describe),   ROW(ern_trainer_step),
    ROW(ern_trainer_check),        ROW(ern_trainer_run),        ROW(ern_trainer_save),
    ROW(ern_trainer_model),        ROW(ern_trainer_folder),     ROW(ern_bench_options_default),
    ROW(ern_bench_peaks),          ROW(ern_bench_scene_make),   ROW(ern_bench_scene_of),
    ROW(ern_bench_scene_free),     ROW(ern_bench_sample_flops), ROW(ern_bench_scene_describe),
    ROW(ern_bench_kernels),        ROW(ern_bench_frame),        ROW(ern_bench_step),
    ROW(ern_bench_collisions)};
enum { CHECKS = sizeof table / sizeof *table };

static void test_every_function_has_a_check(void **state) {
  (void)state;
  assert_int_equal(arguments_cover("train.h", table, CHECKS) + arguments_cover("bench.h", table, CHECKS), CHECKS);
}

static void test_arguments(void **state) {
  (void)state;
  made_open(&w.clip);
  w.context = w.clip.context;
  w.backend = w.clip.backend;
  const ern_train_config config = small_config(1, NULL);
  support_ok(w.context, ern_trainer_create(&w.trainer, w.backend, &w.clip.data, &config));
  support_ok(w.context, ern_trainer_model(w.trainer, &w.model));
  support_ok(w.context, ern_bench_scene_make(&w.scene, w.context, 8, 8, 1));
  arguments_run(table, CHECKS);
  ern_bench_scene_free(&w.scene);
  ern_model_free(&w.model);
  ern_trainer_free(&w.trainer);
  made_close(&w.clip);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_every_function_has_a_check),
                                     cmocka_unit_test(test_arguments)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
