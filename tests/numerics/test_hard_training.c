/* SPDX-License-Identifier: MIT
 * Whole trainings under settings and data that no one should use (docs/numerics.md): finite to the end, or ended in
 * words with finite parameters. On each instruction set, and on the OpenCL device where a case says so. */
#include "made_clip.h"
#include "model/model.h"

static struct made made;
static const float *own_pose; /* of every frame, where it is not NULL */

static ern_status odd_frame(void *user, int split, size_t index, ern_dataset_frame *frame) {
  const ern_status status = made_frame(user, split, index, frame);
  if (own_pose != NULL && index == 2) memcpy(frame->matrix, own_pose, sizeof frame->matrix);
  return status;
}

static int open_clip(void **state) {
  (void)state;
  made_open(&made);
  ern_backend_free(&made.backend);
  made.data.frame = odd_frame;
  return 0;
}
static int close_clip(void **state) {
  (void)state;
  made_close(&made);
  return 0;
}

/* The next machine, or false: each instruction set, or the one that is chosen unasked; with ERNERF_TEST_LONG each for
 * every case, and the OpenCL device in both forms of its kernels. A refresh of the occupancy takes the reference
 * seconds. */
typedef enum machines { CHOSEN, EACH } machines;
static bool next_machine(int *k, machines which) {
  static const struct {
    const char *backend, *name; /* an instruction set; a form of kernels */
  } machine[] = {{"cpu", "auto"},       {"cpu", "ref"},  {"cpu", "avx2"},   {"cpu", "avx512"},
                 {"cpu", "avx512bf16"}, {"cpu", "neon"}, {"opencl", "cpu"}, {"opencl", "gpu"}};
  const bool all = getenv("ERNERF_TEST_LONG") != NULL;
  ern_backend_free(&made.backend);
  for (; *k < (all ? 8 : which == EACH ? 6 : 1); ++*k) {
    ern_backend_config config = ern_backend_config_default();
    const bool device = strcmp(machine[*k].backend, "opencl") == 0;
    if (*k == 0 && (all || which == EACH)) continue;
    config.name = machine[*k].backend;
    config.isa = device ? NULL : machine[*k].name;
    if (device) setenv("ERNERF_OPENCL_FORM", machine[*k].name, 1);
    const ern_status status = ern_backend_create(&made.backend, made.context, &config);
    unsetenv("ERNERF_OPENCL_FORM");
    if (status != ERN_OK) continue;
    if (all) printf("on %s, %s\n", machine[*k].backend, machine[*k].name);
    ++*k;
    return true;
  }
  return false;
}

static void expect_finite_model(ern_trainer *trainer) {
  ern_model *model = NULL;
  support_ok(made.context, ern_trainer_model(trainer, &model));
  for (size_t i = 0; i < model->field.parameters; i++)
    if (!isfinite(model->block[i])) fail_msg("parameter %zu is %g", i, (double)model->block[i]);
  ern_model_free(&model);
}

/* `steps` of them: each loss is finite, or the training ends in words; either way all parameters are finite. Returns
 * the steps done. */
static uint64_t train_hard(const ern_train_config *config, uint64_t steps) {
  ern_trainer *trainer = NULL;
  ern_train_report report = {0};
  uint64_t done = 0;
  support_ok(made.context, ern_trainer_create(&trainer, made.backend, &made.data, config));
  for (; done < steps; done++) {
    const ern_status status = ern_trainer_step(trainer, &report);
    if (status != ERN_OK) {
      support_expect(made.context, status, ERN_E_NONFINITE, "step", "the parameters are as before", NULL);
      break;
    }
    assert_true(isfinite(report.loss) && isfinite(report.psnr));
  }
  expect_finite_model(trainer);
  ern_trainer_free(&trainer);
  return done;
}

static ern_train_config fast_config(float times) {
  ern_train_config config = small_config(40, NULL);
  config.levels = 2;
  config.lr *= times, config.lr_net *= times, config.lr_att *= times;
  return config;
}

/* case: learning rates 100 times too high | plain code: densities overflow, then NaN | here: steps are bounded,
 * densities and gradients clamped | bound: 20 steps, finite */
/* 100 times: AdamW's steps are bounded by the rate, so nothing leaves float; what is learnt is another matter. */
static void test_learning_rates_100_times_too_high_long(void **state) {
  (void)state;
  const ern_train_config config = fast_config(100);
  for (int k = 0; next_machine(&k, EACH);) assert_int_equal(train_hard(&config, 20), 20);
}

/* case: learning rates of 1,000, the highest allowed | plain code: the same, sooner | here: ended by the name of a loss
 * or gradient, with the parameters of the step before | bound: finite parameters */
/* The highest that are let through, 1,000: within some steps networks of 1e4 leave float, and the training ends. */
static void test_learning_rates_of_1000(void **state) {
  (void)state;
  ern_train_config config = small_config(40, NULL);
  config.levels = 2;
  config.lr = config.lr_net = config.lr_att = 1000;
  for (int k = 0; next_machine(&k, CHOSEN);) {
    const uint64_t done = train_hard(&config, 20);
    assert_true(done >= 1 && done < 20);
  }
}

/* case: a torso at 100 times its rates | plain code: key points cross the camera's plane | here: held off it | bound:
 * 20 steps, finite */
static void test_torso_at_learning_rates_100_times_too_high(void **state) {
  (void)state;
  ern_train_config config = fast_config(1);
  for (int k = 0; next_machine(&k, CHOSEN);) {
    ern_trainer *trainer = NULL;
    ern_model *head = NULL;
    config = fast_config(1);
    support_ok(made.context, ern_trainer_create(&trainer, made.backend, &made.data, &config));
    support_ok(made.context, ern_trainer_model(trainer, &head));
    ern_trainer_free(&trainer);
    config = fast_config(100);
    config.torso = true;
    config.head = head;
    assert_int_equal(train_hard(&config, 20), 20);
    ern_model_free(&head);
  }
}

static void expect_refused(const ern_train_config *config, ern_status status, const char *word, const char *other) {
  for (int k = 0; next_machine(&k, CHOSEN);) {
    ern_trainer *trainer = NULL;
    support_expect(made.context, ern_trainer_create(&trainer, made.backend, &made.data, config), status, word, other,
                   NULL);
    assert_null(trainer);
  }
}

/* case: a pose of NaN, infinity, rank 2; a scale of NaN | plain code: NaN after hours | here: refused before the first
 * step, with the frame | bound: exact */
static void test_training_on_a_pose_that_is_no_pose(void **state) {
  (void)state;
  static const float broken[16] = {1, 0, 0, NAN, 0, 1, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1};
  static const float endless[16] = {1, 0, 0, 0, 0, -INFINITY, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1};
  static const float flat[16] = {1, 0, 0, 0, 0, 1, 0, 0, 1, 1, 0, 3, 0, 0, 0, 1};
  const ern_train_config config = fast_config(1);
  own_pose = broken;
  expect_refused(&config, ERN_E_NONFINITE, "training frame 2", "not finite");
  own_pose = endless;
  expect_refused(&config, ERN_E_NONFINITE, "training frame 2", "not finite");
  own_pose = flat;
  expect_refused(&config, ERN_E_ARGUMENT, "training frame 2", "inverted");
  own_pose = NULL;
  made.data.scale = NAN;
  expect_refused(&config, ERN_E_NONFINITE, "training frame 0", "not finite");
  made.data.scale = 4;
}

/* case: mirrored and stretched poses, 1e20 away, in the middle | plain code: inverse by transposition | here: trained
 * on | bound: 12 steps, finite */
static void test_training_on_mirrored_and_stretched_poses_long(void **state) {
  (void)state;
  static const float poses[][16] = {{-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.8f, 0, 0, 0, 1},
                                    {7, 0, 0, 0, 0, 0.1f, 0, 0, 0, 0, 3, 0.8f, 0, 0, 0, 1},
                                    {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1e20f, 0, 0, 0, 1},
                                    {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}};
  const ern_train_config config = fast_config(1);
  for (size_t p = 0; p < sizeof poses / sizeof *poses; p++) {
    own_pose = poses[p];
    for (int k = 0; next_machine(&k, CHOSEN);) assert_int_equal(train_hard(&config, 12), 12);
  }
  own_pose = NULL;
}

/* case: mirrored and stretched poses, 1e6 away, refined | plain code: a logarithm of no rotation | here: trained on |
 * bound: 12 steps, finite */
static void test_refining_mirrored_and_stretched_poses_long(void **state) {
  (void)state;
  static const float poses[][16] = {{-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.8f, 0, 0, 0, 1},
                                    {7, 0, 0, 0, 0, 0.1f, 0, 0, 0, 0, 3, 0.8f, 0, 0, 0, 1},
                                    {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1e6f, 0, 0, 0, 1},
                                    {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}};
  ern_train_config config = fast_config(1);
  config.refine_poses = true;
  for (size_t p = 0; p < sizeof poses / sizeof *poses; p++) {
    own_pose = poses[p];
    for (int k = 0; next_machine(&k, CHOSEN);) assert_int_equal(train_hard(&config, 12), 12);
  }
  own_pose = NULL;
}

/* case: a feature of NaN or infinity | plain code: as above | here: refused before the first step, with window and
 * place | bound: exact */
static void test_training_on_a_feature_that_is_no_number(void **state) {
  (void)state;
  static const float odd[] = {NAN, INFINITY};
  const ern_train_config config = fast_config(1);
  for (size_t i = 0; i < 2; i++) {
    const float kept = made.speech[3 * 16 * WIDTH + 7];
    made.speech[3 * 16 * WIDTH + 7] = odd[i];
    expect_refused(&config, ERN_E_NONFINITE, "window 3 of the speech: value 7", "not finite");
    made.speech[3 * 16 * WIDTH + 7] = kept;
  }
}

/* case: speech of zeros, 1e4, 1e30, 1e32 | plain code: NaN gradients are applied | here: trained on to 1e30, above
 * refused before the first step | bound: 12 steps, finite */
static void test_training_on_silent_and_huge_speech(void **state) {
  (void)state;
  static const float loud[] = {0, 1e4f, 1e30f, 1e32f};
  const ern_train_config config = fast_config(1);
  float kept[WINDOWS * 16 * WIDTH];
  memcpy(kept, made.speech, sizeof kept);
  for (size_t s = 0; s < sizeof loud / sizeof *loud; s++) {
    for (size_t i = 0; i < WINDOWS * 16 * WIDTH; i++) made.speech[i] = loud[s] * kept[i];
    if (loud[s] > 1e31f) {
      expect_refused(&config, ERN_E_ARGUMENT, "window 0 of the speech: value ", "expected -1e30 to 1e30");
      continue;
    }
    for (int k = 0; next_machine(&k, CHOSEN);) assert_int_equal(train_hard(&config, 12), 12);
  }
  memcpy(made.speech, kept, sizeof kept);
}

/* case: pictures all black, white, background, rates times 10 | plain code: log of an opacity of 0 or 1 | here: clamped
 * before | bound: 18 steps, finite */
/* Black, white, and pictures that are their background: opacities run to 0 and 1. */
static void test_training_on_pictures_of_one_colour_long(void **state) {
  (void)state;
  static uint8_t kept[sizeof made.truth];
  const ern_train_config config = fast_config(10);
  memcpy(kept, made.truth, sizeof kept);
  for (int colour = 0; colour < 3; colour++) {
    for (int f = 0; f < FRAMES; f++) {
      memset(made.truth[f], colour == 0 ? 0 : 255, sizeof made.truth[f]);
      if (colour == 2) memcpy(made.truth[f], made.background, sizeof made.background);
    }
    for (int k = 0; next_machine(&k, CHOSEN);) assert_int_equal(train_hard(&config, 18), 18);
  }
  memcpy(made.truth, kept, sizeof kept);
}

/* case: one ray a step; one and 1,024 samples a ray | plain code: means over none | here: trained on | bound: 12 steps,
 * finite */
/* A batch of one ray, rays of one sample and of 1,024; cameras that see nothing of the box. */
static void test_training_on_one_ray(void **state) {
  (void)state;
  for (int kind = 0; kind < 3; kind++) {
    ern_train_config config = fast_config(1);
    config.rays = kind == 0 ? 1 : 33;
    config.max_steps = kind == 0 ? 16 : kind == 1 ? 1 : 1024;
    for (int k = 0; next_machine(&k, CHOSEN);) assert_int_equal(train_hard(&config, 12), 12);
  }
}
static ern_status frame_that_looks_away(void *user, int split, size_t index, ern_dataset_frame *frame) {
  const ern_status status = made_frame(user, split, index, frame);
  frame->matrix[3] = frame->matrix[7] = frame->matrix[11] = 100;
  return status;
}
/* case: cameras that see nothing | plain code: means over 0 samples | here: trained on | bound: 20 steps, finite */
static void test_training_without_a_sample(void **state) {
  (void)state;
  const ern_train_config config = fast_config(1);
  made.data.frame = frame_that_looks_away;
  for (int k = 0; next_machine(&k, CHOSEN);) assert_int_equal(train_hard(&config, 20), 20);
  made.data.frame = odd_frame;
}

/* case: rates, gamma, shrink, focal of NaN, infinity, -1 | plain code: NaN passes `x < 0` | here: refused by name |
 * bound: exact */
static void test_training_with_settings_that_are_no_numbers(void **state) {
  (void)state;
  ern_train_config config = fast_config(1);
  config.lr = NAN;
  expect_refused(&config, ERN_E_ARGUMENT, "lr", "nan");
  config = fast_config(1), config.lr_net = INFINITY;
  expect_refused(&config, ERN_E_ARGUMENT, "lr_net", "inf");
  config = fast_config(1), config.lr_att = -1;
  expect_refused(&config, ERN_E_ARGUMENT, "lr_att", "-1");
  config = fast_config(1), config.dt_gamma = NAN;
  expect_refused(&config, ERN_E_ARGUMENT, "dt_gamma", "nan");
  config = fast_config(1), config.torso_shrink = 0;
  expect_refused(&config, ERN_E_ARGUMENT, "torso_shrink", "0");
  const double focal = made.data.focal;
  made.data.focal = (double)NAN;
  config = fast_config(1);
  expect_refused(&config, ERN_E_ARGUMENT, "camera", "focal");
  made.data.focal = focal;
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_learning_rates_100_times_too_high_long),
      cmocka_unit_test(test_learning_rates_of_1000),
      cmocka_unit_test(test_torso_at_learning_rates_100_times_too_high),
      cmocka_unit_test(test_training_on_a_pose_that_is_no_pose),
      cmocka_unit_test(test_training_on_mirrored_and_stretched_poses_long),
      cmocka_unit_test(test_refining_mirrored_and_stretched_poses_long),
      cmocka_unit_test(test_training_on_a_feature_that_is_no_number),
      cmocka_unit_test(test_training_on_silent_and_huge_speech),
      cmocka_unit_test(test_training_on_pictures_of_one_colour_long),
      cmocka_unit_test(test_training_on_one_ray),
      cmocka_unit_test(test_training_without_a_sample),
      cmocka_unit_test(test_training_with_settings_that_are_no_numbers),
  };
  return cmocka_run_group_tests(tests, open_clip, close_clip);
}
