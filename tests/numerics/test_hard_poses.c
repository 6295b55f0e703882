/* SPDX-License-Identifier: MIT
 * Poses refined while training, with gradients and rays at their ends (docs/numerics.md). */
#include "../made_clip.h"
#include "core/backend.h"
#include "machines.h"
#include "model/pose_regression.h"
#include "train/step_ops.h"
#include "train/trainer.h"

enum { SAMPLES = 200 };

/* dpose of every machine, of samples whose gradients are `gradient`, but that of sample `odd` along y, which is
 * `other`.
 */
static void add_up(double dpose[MACHINES][ERN_POSE_PARAMETERS], size_t n, float gradient, size_t odd, float other) {
  static float x[3 * SAMPLES], dx[3 * SAMPLES];
  for (size_t i = 0; i < 3 * SAMPLES; i++) x[i] = machines_random(1, i, 1), dx[i] = gradient;
  if (odd < SAMPLES) dx[SAMPLES + odd] = other;
  machines_clear();
  const struct many at = many_reals(x, 3 * SAMPLES), gradients = many_reals(dx, 3 * SAMPLES);
  for (int k = 0; k < machines.count; k++) {
    struct ern_pose_bwd_args args = {.dpose = {9, 9, 9, 9, 9, 9},
                                     .dx = {gradients.on[k], SAMPLES, 3, ERN_PER_SAMPLE},
                                     .x = {at.on[k], SAMPLES, 3, ERN_PER_SAMPLE},
                                     .n = n};
    support_ok(machines.context, machines.backend[k]->pose_bwd(machines.stream[k], &args));
    support_ok(machines.context, machines.backend[k]->synchronize(machines.stream[k]));
    memcpy(dpose[k], args.dpose, sizeof args.dpose);
  }
}

/* case: a pose's gradient of a batch without a sample | plain code: a sum never set | here: 0 | bound: exact */
static void test_pose_without_a_sample(void **state) {
  (void)state;
  double dpose[MACHINES][ERN_POSE_PARAMETERS];
  add_up(dpose, 0, 1, SAMPLES, 0);
  for (int k = 0; k < machines.count; k++)
    for (int i = 0; i < ERN_POSE_PARAMETERS; i++) assert_true(dpose[k][i] == 0);
}

/* case: gradients of positions of 1e35, 1e30, 1e-30, 1e-42 | plain code: sums in float overflow | here: double on a
 * CPU, 4,096 parts on a device | bound: 22 x 2^-23 of the sizes' sum */
/* Sums of 200 in floats: 2^-23 of the sizes' sum for each of 4 + 16 additions and 2 products. */
static void test_pose_of_huge_and_denormal_gradients(void **state) {
  (void)state;
  static const float sizes[] = {1e35f, 1e30f, 1, 1e-30f, 1e-42f};
  double dpose[MACHINES][ERN_POSE_PARAMETERS];
  for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++) {
    add_up(dpose, SAMPLES, sizes[s], SAMPLES, 0);
    for (int k = 0; k < machines.count; k++)
      for (int i = 0; i < ERN_POSE_PARAMETERS; i++)
        assert_true(fabs(dpose[k][i] - dpose[0][i]) <=
                    22 * 0x1p-23 * 2 * SAMPLES * (double)sizes[s] + 2 * SAMPLES * (double)FLT_MIN);
  }
}

/* case: one gradient is NaN | plain code: passed over by a clamp | here: the sums that it is in are NaN, no others |
 * bound: exact */
static void test_pose_with_a_nan_gradient(void **state) {
  (void)state;
  double dpose[MACHINES][ERN_POSE_PARAMETERS];
  add_up(dpose, SAMPLES, 1, 77, NAN);
  for (int k = 0; k < machines.count; k++) {
    assert_true(isnan(dpose[k][0]) && isnan(dpose[k][2]) && isnan(dpose[k][4])); /* y dz - z dy; x dy - y dx; dy */
    assert_true(isfinite(dpose[k][1]) && isfinite(dpose[k][3]) && isfinite(dpose[k][5]));
  }
}

/* ---- rows of poses ---- */

static ern_trainer *refining(struct made *m) {
  ern_train_config config = small_config(10, NULL);
  ern_trainer *trainer = NULL;
  config.refine_poses = true;
  support_ok(m->context, ern_trainer_create(&trainer, m->backend, &m->data, &config));
  return trainer;
}

/* case: a pose's gradient of 0, 1e-300, 1e300 | plain code: 0/0 | here: the row stays, or moves by three times its rate
 * at most | bound: 1e-6 */
/* A visit moves a row by three times its rate at most, 0.18 degrees and 0.9 mm at 4 units a metre, and a tenth of the
 * way to its neighbours. */
static void test_row_of_huge_and_tiny_gradients(void **state) {
  (void)state;
  static const double sizes[] = {1e300, -1e300, 1, 1e-20, 1e-300, 0};
  struct made m;
  made_open(&m);
  ern_trainer *trainer = refining(&m);
  trainer->shared.step = 1; /* the first that moves a row, and moves it furthest */
  for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++) {
    float before[ERN_POSE_PARAMETERS];
    const float *row = trainer->poses->row + 2 * ERN_POSE_PARAMETERS;
    const double dpose[ERN_POSE_PARAMETERS] = {sizes[s], 0, sizes[s], sizes[s], -sizes[s], 0};
    memcpy(before, row, sizeof before);
    memset(trainer->poses->bend, 0, ERN_POSE_PARAMETERS * FRAMES * sizeof(float)); /* the path does not bend */
    ern_trainer_poses_step(trainer->poses, 2, dpose);
    for (int i = 0; i < ERN_POSE_PARAMETERS; i++) {
      assert_true(isfinite(row[i]));
      assert_true(fabs((double)row[i] - (double)before[i]) <=
                  (i < 3 ? 0.003143 : 0.003601) + 0.1 * fabs((double)before[i]));
    }
  }
  ern_trainer_free(&trainer);
  made_close(&m);
}

static ern_status (*true_step)(struct ern_stream *stream, struct ern_head_step_args *args);
static ern_status broken_step(struct ern_stream *stream, struct ern_head_step_args *args) {
  const ern_status status = true_step(stream, args);
  if (args->dpose != NULL) args->dpose[4] = NAN;
  return status;
}

/* case: a pose's gradient of NaN | plain code: the pose is NaN for good | here: ends the step by the frame, with all
 * values of before | bound: exact */
/* It ends the step before anything of it is kept. */
static void test_gradient_of_a_pose_that_is_no_number(void **state) {
  (void)state;
  struct made m;
  ern_train_report report;
  float before[ERN_POSE_PARAMETERS * FRAMES];
  made_open(&m);
  ern_trainer *trainer = refining(&m);
  for (int step = 0; step < 3; step++) support_ok(m.context, ern_trainer_step(trainer, &report));
  memcpy(before, trainer->poses->row, sizeof before);
  true_step = m.backend->head_step;
  m.backend->head_step = broken_step;
  support_expect(m.context, ern_trainer_step(trainer, &report), ERN_E_NONFINITE, "step 3: the gradient of the pose of",
                 "is not finite", NULL);
  m.backend->head_step = true_step;
  assert_memory_equal(before, trainer->poses->row, sizeof before);
  support_ok(m.context, ern_trainer_step(trainer, &report));
  assert_int_equal(report.step, 4);
  ern_trainer_free(&trainer);
  made_close(&m);
}

/* case: regression of rows on poses from 0 and 1e-42 to 1e38, 1 to 12 frames | plain code: a matrix without an inverse
 * | here: double, numbers limited to 1e30, a ridge | bound: at most 1e30 */
/* Poses of entries from 0 to 1e38, rows to 1e30: what is predicted for each, and for others, is finite. */
static void test_regression_of_extreme_poses(void **state) {
  (void)state;
  enum { MANY = 12 };
  static const float sizes[] = {0, 1e-42f, 1e-20f, 1, 1e18f, 1e38f};
  static float pose[16 * MANY], row[ERN_POSE_CORRECTION * MANY];
  float fit[ERN_POSE_REGRESSION_ROWS * ERN_POSE_CORRECTION];
  double predicted[ERN_POSE_CORRECTION];
  for (size_t of_pose = 0; of_pose < 6; of_pose++)
    for (size_t of_row = 0; of_row < 6; of_row++) {
      for (size_t i = 0; i < 16 * MANY; i++) pose[i] = machines_random(2, i, sizes[of_pose]);
      for (size_t i = 0; i < ERN_POSE_CORRECTION * MANY; i++)
        row[i] = machines_random(3, i, fminf(sizes[of_row], 1e30f));
      for (size_t n = 1; n <= MANY; n++) {
        ern_pose_regression_fit(fit, ERN_POSE_CORRECTION, pose, row, n, 0.3);
        for (size_t i = 0; i < MANY; i++) {
          ern_pose_regression_predict(fit, ERN_POSE_CORRECTION, pose + 16 * i, predicted);
          for (size_t k = 0; k < ERN_POSE_CORRECTION; k++) assert_true(fabs(predicted[k]) <= 1e30);
        }
      }
    }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_pose_without_a_sample),       cmocka_unit_test(test_pose_of_huge_and_denormal_gradients),
      cmocka_unit_test(test_pose_with_a_nan_gradient),    cmocka_unit_test(test_row_of_huge_and_tiny_gradients),
      cmocka_unit_test(test_regression_of_extreme_poses), cmocka_unit_test(test_gradient_of_a_pose_that_is_no_number),
  };
  return cmocka_run_group_tests(tests, open_machines, close_machines);
}
