/* SPDX-License-Identifier: MIT
 * The fine stage of a head's training: where its patches lie, a resume in it, and what it refuses (docs/numerics.md).
 */
#include <limits.h>

#include "made_clip.h"
#include "train/trainer.h"

enum { PATCH = 16, RAYS = 2 * PATCH * PATCH };

static struct made made;

static int open_clip(void **state) {
  (void)state;
  made_open(&made);
  return 0;
}
static int close_clip(void **state) {
  (void)state;
  made_close(&made);
  return 0;
}

static ern_train_config fine_config(uint64_t iters, uint64_t fine) {
  ern_train_config config = small_config(iters, NULL);
  config.rays = RAYS;
  config.fine_steps = fine;
  config.patch_size = PATCH;
  config.overwrite = true;
  return config;
}

/* Whether they are squares inside the picture. */
static void expect_patches(const int32_t *pixel, size_t count) {
  for (size_t p = 0; p < count; p++) {
    const int32_t *patch = pixel + p * PATCH * PATCH;
    const int top = patch[0] / SIDE, left = patch[0] % SIDE;
    assert_in_range(top, 0, SIDE - PATCH);
    assert_in_range(left, 0, SIDE - PATCH);
    for (int i = 0; i < PATCH * PATCH; i++) assert_int_equal(patch[i], (top + i / PATCH) * SIDE + left + i % PATCH);
  }
}

/* case: patches around lips past all borders, of one pixel, upside down | plain code: a pixel outside | here: squares
 * inside the picture; of lips without a pixel: anywhere | bound: exact */
static void test_patch_places(void **state) {
  (void)state;
  enum { MANY = 200 };
  static const ern_box boxes[] = {{0, 0, 0, 0},     {12, 15, 6, 14}, {0, 1, 0, 1},
                                  {19, 20, 19, 20}, {-9, 0, 3, 9},   {INT_MIN, INT_MAX, INT_MIN, INT_MAX},
                                  {20, 40, 0, 9},   {9, 3, 4, 8}};
  static int32_t pixel[MANY * PATCH * PATCH];
  ern_train_config config = fine_config(9, 9);
  ern_trainer *t = NULL;
  support_ok(made.context, ern_trainer_create(&t, made.backend, &made.data, &config));
  for (size_t k = 0; k < 2 * sizeof boxes / sizeof *boxes; k++)
    for (t->shared.step = 0; t->shared.step < 2; t->shared.step++) {
      const size_t b = k / 2;
      const bool dub = k % 2 == 1;
      const ern_dataset_frame about = {.lips = boxes[b], .dubbed = boxes[b]};
      t->shared.config.ray_sampling = dub ? ERN_RAY_SAMPLING_DUB : ERN_RAY_SAMPLING_REGIONS;
      ern_trainer_place_patches(&t->fine, &about, 0, MANY, pixel);
      expect_patches(pixel, MANY);
      /* a box in the last corner: every patch of an odd step, and of a head for dubbing any patch, ends there */
      if (b == 3 && (dub || t->shared.step == 1))
        for (size_t p = 0; p < MANY; p++) assert_int_equal(pixel[p * PATCH * PATCH], 4 * SIDE + 4);
      /* half of them at once or one after the other: the same */
      int32_t second[PATCH * PATCH];
      ern_trainer_place_patches(&t->fine, &about, 7, 1, second);
      assert_memory_equal(second, pixel + 7 * PATCH * PATCH, sizeof second);
    }
  t->shared.step = 0;
  ern_trainer_free(&t);
}

/* case: 612 rays of 4 frames, patches of 256 | plain code: a part of a patch | here: 2 whole patches of 2 frames |
 * bound: exact */
/* A step has whole patches, of as many frames as there are patches for; the coarse steps before it have all rays. */
static void test_rays_of_a_fine_step(void **state) {
  (void)state;
  ern_train_config config = fine_config(6, 4);
  ern_train_report report;
  ern_trainer *t = NULL;
  config.rays = RAYS + 100;
  config.frames_per_step = 4;
  support_ok(made.context, ern_trainer_create(&t, made.backend, &made.data, &config));
  for (int step = 0; step < 6; step++) {
    assert_int_equal(ern_trainer_is_fine(&t->fine), step >= 2);
    assert_int_equal(ern_trainer_step_rays(&t->fine), step < 2 ? RAYS + 100 : RAYS);
    assert_int_equal(ern_trainer_step_frames(&t->fine), step < 2 ? 4 : 2);
    support_ok(made.context, ern_trainer_step(t, &report));
    assert_true(isfinite(report.loss) && report.samples_per_ray > 0);
    if (step >= 2) expect_patches(t->batches.host_pixels, 1); /* of the last frame's part */
  }
  ern_trainer_free(&t);
  config.rays = 100; /* fewer than a patch has: a step has one all the same */
  support_ok(made.context, ern_trainer_create(&t, made.backend, &made.data, &config));
  for (int step = 0; step < 6; step++) {
    assert_int_equal(ern_trainer_step_rays(&t->fine), step < 2 ? 100 : PATCH * PATCH);
    assert_int_equal(ern_trainer_step_frames(&t->fine), step < 2 ? 4 : 1);
    support_ok(made.context, ern_trainer_step(t, &report));
    if (step >= 2) expect_patches(t->batches.host_pixels, 1);
  }
  ern_trainer_free(&t);
}

static void train_on(const char *output, bool resume, uint64_t steps, ern_train_config config) {
  ern_trainer *trainer = NULL;
  ern_train_report report;
  config.output = output;
  config.resume = resume;
  support_ok(made.context, ern_trainer_create(&trainer, made.backend, &made.data, &config));
  for (uint64_t k = 0; k < steps; k++) support_ok(made.context, ern_trainer_step(trainer, &report));
  support_ok(made.context, ern_trainer_save(trainer));
  ern_trainer_free(&trainer);
}

/* case: stopped before, at, after the first fine step; begun by a resume; refined, 1 and 2 threads | plain code: a
 * stage that begins twice | here: as in one go | bound: same bytes */
/* Stopped before, at and after its beginning, with poses refined, for 1 and 2 threads. Whoever goes on need not say
 * that it has begun; a resume with ERN_FINE_ALL lets it begin. */
static void test_resumed_fine_stage_long(void **state) {
  (void)state;
  ern_train_config config = fine_config(12, 6);
  made.lips = (ern_box){12, 15, 6, 14};
  config.frames_per_step = 3;
  config.refine_poses = true;
  config.threads = 1;
  train_on("fine_whole.safetensors", false, 12, config);
  config.threads = 2;
  for (uint64_t stop = 4; stop <= 8; stop += 2) {
    config.fine_steps = 6;
    train_on("fine_resumed.safetensors", false, stop, config);
    if (stop > 6) config.fine_steps = 0;
    train_on("fine_resumed.safetensors", true, 12 - stop, config);
    expect_same("fine_whole.safetensors", "fine_resumed.safetensors");
  }
  config.fine_steps = 0;
  config.iters = 6;
  train_on("fine_resumed.safetensors", false, 6, config);
  config.fine_steps = ERN_FINE_ALL;
  config.iters = 12;
  train_on("fine_resumed.safetensors", true, 6, config);
  expect_same("fine_whole.safetensors", "fine_resumed.safetensors");
  ern_train_state said;
  ern_model_info model;
  support_ok(made.context, ern_train_state_describe(made.context, "fine_resumed.safetensors", &said, &model));
  assert_true(said.fine_steps == 6 && said.patch_size == PATCH && said.fine_weight == config.fine_weight);
  made.lips = (ern_box){0, 0, 0, 0};
}

/* A loss of the program's: the mean of squares, whose calls are counted. */
static ern_status mean_square(void *user, const float *pixel, const float *truth, int side, double *loss,
                              float *dpixel) {
  const int n = 3 * side * side;
  *loss = 0;
  for (int i = 0; i < n; i++) {
    const double apart = (double)pixel[i] - (double)truth[i];
    *loss += apart * apart / n;
    dpixel[i] = (float)(2 * apart / n);
  }
  (*(int *)user)++;
  return *(int *)user < 100 ? ERN_OK : ERN_E_CANCELLED;
}

/* Other weights under the same name. */
static ern_status twice_mean_square(void *user, const float *pixel, const float *truth, int side, double *loss,
                                    float *dpixel) {
  const ern_status status = mean_square(user, pixel, truth, side, loss, dpixel);
  *loss *= 2;
  return status;
}

/* case: a loss of the program's; a resume without it or with other weights; one that gives up | plain code: a step half
 * taken | here: called once a patch; refused by name; the step ends with its status | bound: exact */
/* It is called once before, and once a patch of the fine stage alone. A resume needs it again, also before that stage
 * begins; what it returns ends the step. */
static void test_loss_of_the_program_long(void **state) {
  (void)state;
  int calls = 0;
  const ern_fine_loss loss = {"mean square", mean_square, &calls};
  ern_train_config config = fine_config(12, 6);
  config.fine_loss = &loss;
  train_on("fine_whole.safetensors", false, 12, config);
  assert_int_equal(calls, 1 + 6 * 2);
  train_on("fine_resumed.safetensors", false, 4, config);
  config.output = "fine_resumed.safetensors";
  config.resume = true;
  config.fine_loss = NULL;
  ern_trainer *t = NULL;
  support_expect(made.context, ern_trainer_create(&t, made.backend, &made.data, &config), ERN_E_MISMATCH, "fine_loss",
                 "mean square", "ssim", NULL);
  config.fine_loss = &(ern_fine_loss){"mean square", twice_mean_square, &calls};
  support_expect(made.context, ern_trainer_create(&t, made.backend, &made.data, &config), ERN_E_MISMATCH,
                 "fine_resumed.safetensors", "\"mean square\" had", "other weights", NULL);
  config.fine_loss = &loss;
  train_on("fine_resumed.safetensors", true, 8, config);
  expect_same("fine_whole.safetensors", "fine_resumed.safetensors");
  ern_train_report report;
  config.resume = false;
  support_ok(made.context, ern_trainer_create(&t, made.backend, &made.data, &config));
  for (int step = 0; step < 6; step++) support_ok(made.context, ern_trainer_step(t, &report));
  calls = 99;
  (void)ern_fail(made.context, ERN_E_IO, "an earlier error");
  support_expect(made.context, ern_trainer_step(t, &report), ERN_E_CANCELLED,
                 "\"mean square\" answered ERN_E_CANCELLED", NULL);
  ern_trainer_free(&t);
  (void)ern_fail(made.context, ERN_E_IO, "an earlier error");
  support_expect(made.context, ern_trainer_create(&t, made.backend, &made.data, &config), ERN_E_CANCELLED,
                 "\"mean square\" answered ERN_E_CANCELLED", NULL);
  config.fine_loss = &(ern_fine_loss){.name = "", .compute = mean_square};
  support_expect(made.context, ern_trainer_create(&t, made.backend, &made.data, &config), ERN_E_ARGUMENT, "fine_loss",
                 NULL);
}

/* case: black, grey and white frames, weight 1,000 | plain code: 0/0 of the similarity | here: 8 steps, finite | bound:
 * finite */
/* Flat, saturated and equal pictures: the structural similarity divides by their variances. */
static void test_fine_stage_of_flat_pictures_long(void **state) {
  (void)state;
  static uint8_t kept[sizeof made.truth];
  static const int values[] = {0, 128, 255};
  memcpy(kept, made.truth, sizeof kept);
  for (size_t i = 0; i < sizeof values / sizeof *values; i++) {
    ern_train_config config = fine_config(8, 8);
    ern_train_report report;
    ern_trainer *t = NULL;
    memset(made.truth, values[i], sizeof made.truth);
    config.fine_weight = 1e3f;
    support_ok(made.context, ern_trainer_create(&t, made.backend, &made.data, &config));
    for (int step = 0; step < 8; step++) {
      support_ok(made.context, ern_trainer_step(t, &report));
      assert_true(isfinite(report.loss));
    }
    support_ok(made.context, ern_trainer_check(t));
    ern_trainer_free(&t);
  }
  memcpy(made.truth, kept, sizeof kept);
}

static void refuse(ern_train_config config, const char *words) {
  ern_trainer *t = NULL;
  support_expect(made.context, ern_trainer_create(&t, made.backend, &made.data, &config), ERN_E_ARGUMENT, words, NULL);
  assert_null(t);
}

/* case: patches larger than frames or rays; of 24 pixels; a weight of NaN; with `--time` | plain code: memory overrun |
 * here: refused by name | bound: exact */
static void test_refused_fine_stage(void **state) {
  (void)state;
  ern_train_config config = fine_config(9, 3);
  config.patch_size = 24;
  refuse(config, "patch_size is 24, expected 16, 32, 48 or 64");
  config.patch_size = INT_MAX;
  refuse(config, "patch_size is 2147483647");
  config.patch_size = 32;
  refuse(config, "patch_size is 32, expected at most the 20 x 20 of the frames");
  config = fine_config(9, ERN_FINE_ALL);
  config.seconds = 5;
  refuse(config, "fine_steps is");
  refuse(fine_config(9, 10), "fine_steps is 10, expected at most iters, the number of all steps, 9");
  config = fine_config(9, 3);
  config.fine_weight = NAN;
  refuse(config, "fine_weight is");
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_patch_places),
                                     cmocka_unit_test(test_rays_of_a_fine_step),
                                     cmocka_unit_test(test_resumed_fine_stage_long),
                                     cmocka_unit_test(test_loss_of_the_program_long),
                                     cmocka_unit_test(test_fine_stage_of_flat_pictures_long),
                                     cmocka_unit_test(test_refused_fine_stage)};
  return cmocka_run_group_tests(tests, open_clip, close_clip);
}
