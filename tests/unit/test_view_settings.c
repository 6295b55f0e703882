/* SPDX-License-Identifier: MIT
 * How a model is seen: kept by training, file and conversion, taken by a renderer, and held against by a torso and a
 * resume. */
#include <math.h>

#include "made_clip.h"
#include "train/state_about.h"

static struct made made;
static char reported[SUPPORT_LINES]; /* lines of the log */

static int open_clip(void **state) {
  (void)state;
  made_open(&made);
  ern_backend_free(&made.backend);
  ern_context_free(&made.context);
  ern_context_config config = ern_context_config_default();
  config.log = support_keep_warnings;
  config.user = reported;
  assert_int_equal(ern_context_create(&made.context, &config), ERN_OK);
  support_ok(made.context, ern_backend_create(&made.backend, made.context, NULL));
  return 0;
}

static int close_clip(void **state) {
  (void)state;
  made_close(&made);
  return 0;
}

/* None of them the default. */
static ern_train_config seen_config(uint64_t iters, const char *output) {
  ern_train_config config = small_config(iters, output);
  config.max_steps = 24;
  config.dt_gamma = 0.01f;
  config.audio_pad = ERN_AUDIO_PAD_ZERO;
  made.data.scale = 3;
  return config;
}

static void expect_seen(const char *path, float shrink) {
  ern_model *model = NULL;
  ern_model_info info;
  support_ok(made.context, ern_model_load(&model, made.context, path));
  ern_model_describe(model, &info);
  assert_true(info.has_view_settings);
  assert_int_equal(info.max_steps, 24);
  assert_int_equal(info.audio_pad, ERN_AUDIO_PAD_ZERO);
  assert_true(info.dt_gamma == 0.01f && info.scale == 3 && info.torso_shrink == shrink);
  ern_model_free(&model);
}

static void test_kept_by_files(void **state) {
  (void)state;
  ern_model *head = NULL;
  clear_run("seen"), clear_run("body");
  ern_train_config config = seen_config(3, "seen.safetensors");
  support_ok(made.context, train(&made, &config, NULL));
  expect_seen("seen.safetensors", 0.8f);
  reported[0] = 0;
  support_ok(made.context, ern_file_convert(made.context, "seen.safetensors", "seen.pth"));
  if (strstr(reported, "--scale 3 --dt_gamma 0.01 --max_steps 24") == NULL) fail_msg("the log says \"%s\"", reported);
  support_ok(made.context, ern_file_convert(made.context, "seen.pth", "back.safetensors"));
  expect_seen("seen.pth", 0.8f);
  expect_seen("back.safetensors", 0.8f);
  support_ok(made.context, ern_model_load(&head, made.context, "back.safetensors"));
  ern_train_config torso = seen_config(3, "body.safetensors");
  torso.torso = true;
  torso.torso_shrink = 0.5f;
  torso.head = head;
  support_ok(made.context, train(&made, &torso, NULL));
  expect_seen("body.safetensors", 0.5f);
  ern_model_free(&head);
}

/* A picture of the clip's first frame. */
static void draw(const ern_model *model, const ern_render_options *options, float rgb[SIDE * SIDE * 3]) {
  static float windows[8 * 16 * WIDTH];
  ern_renderer *renderer = NULL;
  ern_dataset_frame frame;
  support_ok(made.context, made_frame(&made, 0, 0, &frame));
  ern_frame_input input = {.camera = {.focal = 48, .cx = SIDE / 2, .cy = SIDE / 2, .width = SIDE, .height = SIDE},
                           .windows = windows,
                           .window_length = 16,
                           .background = made.background};
  ern_camera_pose(input.camera.pose, frame.matrix, 3);
  ern_audio_windows(windows, &made.features, 0, ERN_AUDIO_PAD_ZERO);
  const ern_frame_output output = {.rgb = rgb};
  support_ok(made.context, ern_renderer_create(&renderer, made.backend, model, options));
  support_ok(made.context, ern_renderer_frame(renderer, &input, &output, NULL));
  ern_renderer_free(&renderer);
}

static void test_renderer_takes_the_models(void **state) {
  (void)state;
  static float as_it_is[SIDE * SIDE * 3], asked[SIDE * SIDE * 3], other[SIDE * SIDE * 3];
  ern_model *model = NULL;
  support_ok(made.context, ern_model_load(&model, made.context, "body.safetensors"));
  ern_render_options options = ern_render_options_default();
  draw(model, NULL, as_it_is);
  options.max_steps = 24;
  options.dt_gamma = 0.01f;
  options.torso_shrink = 0.5f;
  draw(model, &options, asked);
  options = ern_render_options_default();
  options.torso_shrink = 0.8f;
  draw(model, &options, other);
  assert_memory_equal(as_it_is, asked, sizeof asked);
  assert_true(memcmp(as_it_is, other, sizeof other) != 0);
  ern_renderer *renderer = NULL;
  options.max_steps = -1;
  support_expect(made.context, ern_renderer_create(&renderer, made.backend, model, &options), ERN_E_ARGUMENT,
                 "max_steps is -1", NULL);
  options = ern_render_options_default();
  options.dt_gamma = NAN;
  support_expect(made.context, ern_renderer_create(&renderer, made.backend, model, &options), ERN_E_ARGUMENT,
                 "dt_gamma", NULL);
  ern_model_free(&model);
}

/* Words of the metadata are replaced by as many bytes. */
static void test_files_that_lie(void **state) {
  (void)state;
  static const struct {
    const char *from, *to, *field;
  } lies[] = {{"max_steps\\\":24", "max_steps\\\":-4", "max_steps is -4, expected 1 to 1024"},
              {"max_steps\\\":24", "max_steps\\\":2.", "\"ernerf\""},
              {"dt_gamma\\\":0.0", "dt_gamma\\\":7.0", "dt_gamma is 7"},
              {"torso_shrink\\\":0.5", "torso_shrink\\\":0.0", "torso_shrink is 0, expected 0.001 to 1"},
              {"scale\\\":3.0", "scale\\\":0.0", "scale is 0, expected 0.001 to 1000"},
              {"scale\\\":3.0", "scalx\\\":3.0", "this version knows no scalx"},
              {"\\\"scale\\\":3.0,", "              ", "field scale"},
              {"clip\\\":\\\"11112222333344445555666677778888aaaabbbbccccddddeeeeffff00009999\\\"",
               "clip\\\":[\\\"112222333344445555666677778888aaaabbbbccccddddeeeeffff00009999\\\"]", "field clip"},
              {"speech\\\":\\\"\\\"", "speech\\\":null", "field speech"},
              {"audio_pad\\\":\\\"zero", "audio_pad\\\":\\\"zerx", "audio_pad is \"zerx\", expected edge or zero"}};
  size_t count = 0;
  char *bytes = read_file("body.safetensors", &count);
  for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
    ern_model *model = NULL;
    const size_t length = strlen(lies[i].from);
    char *at = bytes;
    while (at < bytes + count - length && memcmp(at, lies[i].from, length) != 0) at++;
    assert_memory_equal(at, lies[i].from, length);
    memcpy(at, lies[i].to, length);
    support_write("lie.safetensors", bytes, count);
    memcpy(at, lies[i].from, length);
    support_expect(made.context, ern_model_load(&model, made.context, "lie.safetensors"), ERN_E_FORMAT,
                   "lie.safetensors", lies[i].field, NULL);
  }
  free(bytes);
}

static void expect_torso_refused(const ern_train_config *config, const char *word) {
  ern_trainer *trainer = NULL;
  support_expect(made.context, ern_trainer_create(&trainer, made.backend, &made.data, config), ERN_E_MISMATCH,
                 "the head", word, NULL);
}

static void test_torso_is_as_its_head(void **state) {
  (void)state;
  ern_model *head = NULL;
  clear_run("body2");
  support_ok(made.context, ern_model_load(&head, made.context, "seen.safetensors"));
  ern_train_config config = seen_config(1, "body2.safetensors");
  config.torso = true;
  config.head = head;
  made.data.scale = 4;
  expect_torso_refused(&config, "scale is 3, this training has 4");
  made.data.scale = 3;
  config.max_steps = 16;
  expect_torso_refused(&config, "max_steps is 24, this training has 16");
  config.max_steps = 24;
  config.audio_pad = ERN_AUDIO_PAD_EDGE;
  expect_torso_refused(&config, "audio_pad is zero, this training has edge");
  config.audio_pad = ERN_AUDIO_PAD_ZERO;
  config.dt_gamma = 0;
  expect_torso_refused(&config, "dt_gamma is 0.01, this training has 0");
  head->view = ern_view_settings_default(); /* as of a file of before they were kept */
  support_ok(made.context, train(&made, &config, NULL));
  ern_model_free(&head);
}

static void expect_resume_refused(const ern_train_config *config, const char *word) {
  support_expect(made.context, train(&made, config, NULL), ERN_E_MISMATCH, "again.run/state.safetensors", word, NULL);
}

static void test_resume_mixes_nothing(void **state) {
  (void)state;
  clear_run("again");
  ern_train_config config = seen_config(4, "again.safetensors");
  config.data_end = 3;
  made.data.fingerprint = "of the first";
  support_ok(made.context, train(&made, &config, NULL));
  config.resume = true;
  made.data.fingerprint = "of the first, and more of it"; /* the state is an earlier version's */
  reported[0] = 0;
  support_ok(made.context, train(&made, &config, NULL));
  assert_string_equal(reported, "");
  config.iters = 6;
  ern_train_config changed = config;
  changed.dt_gamma = 0.02f;
  expect_resume_refused(&changed, "dt_gamma is 0.01, this training has 0.02");
  changed = config;
  changed.data_end = 0;
  expect_resume_refused(&changed, "data_end is 3, this training has 4");
  changed = config;
  changed.audio_pad = ERN_AUDIO_PAD_EDGE;
  expect_resume_refused(&changed, "audio_pad is zero, this training has edge");
  made.data.scale = 4;
  expect_resume_refused(&config, "scale is 3, this training has 4");
  made.data.scale = 3;
  made.data.has_torso = false;
  expect_resume_refused(&config, "torso_layer is yes, this training has no");
  made.data.has_torso = true;
  made.speech[0] += 1;
  expect_resume_refused(&config, "speech features");
  made.speech[0] -= 1;
  config.lr = 0.02f;
  config.rays = 90;
  config.max_steps = 20;
  config.refresh_every = 8;
  made.data.fingerprint = "of exchanged pictures";
  reported[0] = 0;
  support_ok(made.context, train(&made, &config, NULL));
  made.data.fingerprint = NULL;
  assert_string_equal(
      reported,
      "again.run/state.safetensors: files of the clip's frames (pictures, masks, landmarks, blinks or torso.npy) "
      "are not those that it began with; going on with those of now\n"
      "again.run/state.safetensors: iters was 4, going on with 6\n"
      "again.run/state.safetensors: rays was 96, going on with 90\n"
      "again.run/state.safetensors: lr was 0.01, going on with 0.02\n"
      "again.run/state.safetensors: max_steps was 24, going on with 20\n"
      "again.run/state.safetensors: refresh_every was 0, going on with 8\n");
}

static void test_state_describes_itself(void **state) {
  (void)state;
  ern_train_state found;
  ern_model_info model;
  support_ok(made.context, ern_train_state_describe(made.context, "again.safetensors", &found, &model));
  assert_true(found.has_settings && !found.torso && found.torso_layer && found.step == 6 && found.iters == 6);
  assert_true(found.rays == 90 && found.lr == 0.02f && found.refresh_every == 8 && found.ema_every == 2);
  assert_true(found.data_begin == 0 && found.data_end == 3 && model.scale == 3 && model.max_steps == 20);
  support_expect(made.context, ern_train_state_describe(made.context, "nobody.safetensors", &found, &model),
                 ERN_E_MISSING, "nobody.run", NULL);
}

/* A state without settings is the public program's. A setting that is missing was added later; a member that is
 * unknown, or nonsense, is refused by its name. */
static void test_states_of_others(void **state) {
  (void)state;
  struct ern_state_about about;
#define STATE "\"torso\":false,\"step\":4,\"ema_updates\":2,\"seconds\":1.5"
#define SETTINGS(settings)                                             \
  "{" STATE ",\"training\":{\"settings\":{\"data_end\":\"3\"" settings \
  "},\"torso_layer\":true,\"features\":\"\","                          \
  "\"fingerprint\":\"\",\"seconds_beside\":0,\"fine_loss\":\"ssim\",\"pruned\":false}}"
  support_ok(made.context, ern_state_about_parse(made.context, "{" STATE "}", "s", &about));
  assert_true(!about.has_settings && about.step == 4);
  support_ok(made.context, ern_state_about_parse(made.context, SETTINGS(",\"lr\":\"0.02\""), "s", &about));
  assert_true(about.has_settings && about.config.lr == 0.02f && about.config.lr_net == 1e-3f &&
              about.fine_from == UINT64_MAX);
  static const char *const wrong[][2] = {{SETTINGS(",\"iters\":\"0\""), "training.iters"},
                                         {SETTINGS(",\"iters\":5"), "training.iters"},
                                         {SETTINGS(",\"of_tomorrow\":\"5\""), "training.of_tomorrow"},
                                         {SETTINGS(",\"threads\":\"5\""), "training.threads"},
                                         {SETTINGS(",\"data_begin\":\"3\""), "training.settings"},
                                         {SETTINGS(",\"patch_size\":\"17\""), "training.settings"},
                                         {"{" STATE ",\"training\":[]}", "training.settings"},
                                         {SETTINGS("},\"of_tomorrow\":{\"a\":\"b\""), "training.of_tomorrow"},
                                         {"{" STATE ",\"of_tomorrow\":1}", "knows no of_tomorrow"}};
  for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++)
    support_expect(made.context, ern_state_about_parse(made.context, wrong[i][0], "s", &about), ERN_E_FORMAT,
                   "s: ", wrong[i][1], NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_kept_by_files),        cmocka_unit_test(test_renderer_takes_the_models),
      cmocka_unit_test(test_files_that_lie),       cmocka_unit_test(test_torso_is_as_its_head),
      cmocka_unit_test(test_resume_mixes_nothing), cmocka_unit_test(test_state_describes_itself),
      cmocka_unit_test(test_states_of_others),
  };
  return cmocka_run_group_tests(tests, open_clip, close_clip);
}
