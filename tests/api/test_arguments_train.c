/* SPDX-License-Identifier: MIT
 * What training does with NULL, with numbers out of range, with structures that nobody initialised and
 * with callbacks that lie (base.h). */
#include "arguments.h"
#include "made_clip.h"

static struct world {
  ern_context *context;
  ern_backend *backend;
  struct made clip;
  ern_trainer *trainer;
  ern_model *model;
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

CHECK(ern_train_config_fill) { FILLS(ern_train_config, ern_train_config_fill); }
CHECK(ern_ray_sampling_name) {
  assert_string_equal(ern_ray_sampling_name(ERN_RAY_SAMPLING_UNIFORM), "uniform");
  assert_string_equal(ern_ray_sampling_name(ERN_RAY_SAMPLING_REGIONS), "regions");
  assert_string_equal(ern_ray_sampling_name(ERN_RAY_SAMPLING_DUB), "dub");
  assert_null(ern_ray_sampling_name((ern_ray_sampling)3));
  assert_null(ern_ray_sampling_name((ern_ray_sampling)-1));
}
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
  REFUSED_CONFIG(backbone, (ern_backbone)99, "backbone is 99, expected 0 to 3, which are trihash|hash3d|triplane|mlp");
  REFUSED_CONFIG(attention, (ern_attention)99, "attention is 99");
  REFUSED_CONFIG(eye_attention, (ern_eye_attention)99, "eye_attention is 99");
  REFUSED_CONFIG(audio_pad, (ern_audio_pad)99, "audio_pad is 99");
  REFUSED_CONFIG(max_steps, 0, "max_steps is 0");
  REFUSED_CONFIG(output, "x.pth", "x.pth: expected a name that ends in .safetensors");
  REFUSED_CONFIG(lr, NAN, "lr is nan");
  REFUSED_CONFIG(torso, true, "needs the head");
  REFUSED_CONFIG(data_end, 99, "frames 0 to 99");
  REFUSED_CONFIG(refresh_every, 2000000000000, "refresh_every is 2000000000000");
  REFUSED_CONFIG(precision, (ern_precision)9, "precision is 9");
  REFUSED_CONFIG(ray_sampling, (ern_ray_sampling)3, "ray_sampling is 3");
  REFUSED_CONFIG(seconds, -1, "seconds is -1");
  REFUSED_CONFIG(frames_per_step, 0, "frames_per_step is 0, expected 1 to 64");
  REFUSED_CONFIG(frames_per_step, ERN_FRAMES_PER_STEP_MOST + 1, "frames_per_step is 65");
  REFUSED_CONFIG(seconds, NAN, "seconds is nan");
  REFUSED_CONFIG(torso_output, "t.safetensors", "torso_output is set, expected NULL without a head's output");
}

static void check_few_rays(void) {
  ern_train_config config = small_config(3, NULL);
  config.rays = 3;
  config.frames_per_step = 4;
  refuse_config(config, "frames_per_step is 4, expected at most the 3 rays of a step");
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
  REFUSED(w.context, "ern_trainer_create_sized: dataset is NULL", ern_trainer_create(&made, w.backend, NULL, NULL));
  REFUSED(w.context, "ern_trainer_create_sized: trainer is NULL",
          ern_trainer_create(NULL, w.backend, &w.clip.data, NULL));
  check_configs();
  check_few_rays();
  check_datasets();
}
CHECK(ern_trainer_create_sized) {
  ern_train_config config = small_config(3, NULL);
  ern_dataset data = w.clip.data;
  ern_trainer *made = w.trainer;
  REFUSED_ALONE(ern_trainer_create_sized(&made, NULL, &data, sizeof data, &config));
  assert_null(made);
  data.identity = (const char *)(uintptr_t)1; /* past the size */
  config.refresh_every = UINT64_MAX;
  config.size = offsetof(ern_train_config, refresh_every);
  support_ok(w.context, ern_trainer_create_sized(&made, w.backend, &data, offsetof(ern_dataset, identity), &config));
  ern_trainer_free(&made);
  REFUSED(w.context, "lacks frames", ern_trainer_create_sized(&made, w.backend, &data, 0, &config));
  REFUSED_LATER(w.context, ern_dataset, ern_trainer_create_sized(&made, w.backend, &data, sizeof data + 8, &config));
  config.size = sizeof config + 8;
  REFUSED_LATER(w.context, ern_train_config,
                ern_trainer_create_sized(&made, w.backend, &w.clip.data, sizeof data, &config));
}
CHECK(ern_train_setting) {
  assert_non_null(ern_train_setting(0));
  assert_null(ern_train_setting(SIZE_MAX));
}

CHECK(ern_train_state_describe) {
  ern_train_state state;
  ern_model_info model;
  REFUSED_ALONE(ern_train_state_describe(NULL, "none", &state, &model));
  REFUSED(w.context, "output is NULL", ern_train_state_describe(w.context, NULL, &state, &model));
  REFUSED(w.context, "state is NULL", ern_train_state_describe(w.context, "none", NULL, &model));
  REFUSED(w.context, "model is NULL", ern_train_state_describe(w.context, "none", &state, NULL));
}
CHECK(ern_train_state_describe_sized) {
  const ern_train_config config = small_config(2, "sized.safetensors");
  ern_trainer *trainer = NULL;
  ern_train_state state;
  ern_model_info model;
  support_ok(w.context, ern_trainer_create(&trainer, w.backend, &w.clip.data, &config));
  support_ok(w.context, ern_trainer_save(trainer));
  ern_trainer_free(&trainer);
  KEEPS_TO(ern_train_state, support_ok(w.context, ern_train_state_describe_sized(w.context, config.output, it, bytes,
                                                                                 &model, sizeof model)));
  KEEPS_TO(ern_model_info, support_ok(w.context, ern_train_state_describe_sized(w.context, config.output, &state,
                                                                                sizeof state, it, bytes)));
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
CHECK(ern_trainer_describe_sized) {
  ern_trainer_describe_sized(w.trainer, NULL, sizeof(ern_train_report));
  KEEPS_TO(ern_train_report, ern_trainer_describe_sized(w.trainer, it, bytes));
}
CHECK(ern_trainer_step_sized) {
  const ern_train_config config = small_config(9, NULL);
  ern_trainer *trainer = NULL;
  support_ok(w.context, ern_trainer_create(&trainer, w.backend, &w.clip.data, &config));
  KEEPS_TO(ern_train_report, support_ok(w.context, ern_trainer_step_sized(trainer, it, bytes)));
  ern_trainer_free(&trainer);
  REFUSED_ALONE(ern_trainer_step_sized(NULL, &(ern_train_report){0}, sizeof(ern_train_report)));
}
CHECK(ern_trainer_step) {
  ern_train_report report;
  REFUSED_ALONE(ern_trainer_step(NULL, &report));
  REFUSED(w.context, "ern_trainer_step_sized: report is NULL", ern_trainer_step(w.trainer, NULL));
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
static int must_not_tell(void *user, const ern_train_report *report) {
  (void)user, (void)report;
  fail_msg("a hook past the size was called");
  return 0;
}
CHECK(ern_trainer_run_sized) {
  const ern_train_config config = small_config(2, NULL);
  const ern_train_hooks hooks = {.progress = must_not_tell};
  ern_trainer *trainer = NULL;
  support_ok(w.context, ern_trainer_create(&trainer, w.backend, &w.clip.data, &config));
  REFUSED_LATER(w.context, ern_train_hooks, ern_trainer_run_sized(trainer, &hooks, sizeof hooks + 8));
  support_ok(w.context, ern_trainer_run_sized(trainer, &hooks, offsetof(ern_train_hooks, progress)));
  support_ok(w.context, ern_trainer_run_sized(trainer, &hooks, 0));
  ern_trainer_free(&trainer);
  REFUSED_ALONE(ern_trainer_run_sized(NULL, NULL, sizeof hooks));
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

/* ------------------------------------------------------------------------------------------------------------------ */

static const struct arguments_check table[] = {ROW(ern_ray_sampling_name),      ROW(ern_train_config_default),
                                               ROW(ern_train_config_fill),      ROW(ern_trainer_create_sized),
                                               ROW(ern_train_setting),          ROW(ern_train_state_describe_sized),
                                               ROW(ern_trainer_describe_sized), ROW(ern_trainer_step_sized),
                                               ROW(ern_trainer_run_sized),      ROW(ern_trainer_create),
                                               ROW(ern_train_state_describe),   ROW(ern_trainer_free),
                                               ROW(ern_trainer_describe),       ROW(ern_trainer_step),
                                               ROW(ern_trainer_check),          ROW(ern_trainer_run),
                                               ROW(ern_trainer_save),           ROW(ern_trainer_model),
                                               ROW(ern_trainer_folder)};
enum { CHECKS = sizeof table / sizeof *table };

static void test_every_function_has_a_check(void **state) {
  (void)state;
  assert_int_equal(arguments_cover("include/ernerf/train.h", table, CHECKS), CHECKS);
}

static void test_arguments(void **state) {
  (void)state;
  made_open(&w.clip);
  w.context = w.clip.context;
  w.backend = w.clip.backend;
  const ern_train_config config = small_config(1, NULL);
  support_ok(w.context, ern_trainer_create(&w.trainer, w.backend, &w.clip.data, &config));
  support_ok(w.context, ern_trainer_model(w.trainer, &w.model));
  arguments_run(table, CHECKS);
  ern_model_free(&w.model);
  ern_trainer_free(&w.trainer);
  made_close(&w.clip);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_every_function_has_a_check),
                                     cmocka_unit_test(test_arguments)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
