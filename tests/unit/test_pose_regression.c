/* SPDX-License-Identifier: MIT
 * The regression of the corrections of poses on the poses (docs/maths.md, "Poses"). */
#include "model/pose_regression.h"

#include <math.h>
#include <string.h>

#include "support.h"

enum { MANY = 50 };

/* A camera that looks at the origin from `distance` along the scene's y, turned about the scene's x by `angle`. */
static void pose_of(float pose[16], float angle, float distance) {
  const float c = cosf(angle), s = sinf(angle);
  const float rows[16] = {0, -1, 0, 0, s, 0, -c, c * distance, c, 0, s, -s * distance, 0, 0, 0, 1};
  memcpy(pose, rows, sizeof rows);
}

static void fit_to(struct ern_pose_regression *fit, float (*of)(float angle, float distance)) {
  float pose[16 * MANY], row[ERN_POSE_NUMBERS * MANY] = {0};
  for (int i = 0; i < MANY; i++) {
    const float angle = 0.2f * sinf(0.37f * (float)i), distance = 3 + 0.1f * cosf(1.1f * (float)i);
    pose_of(pose + 16 * i, angle, distance);
    row[ERN_POSE_NUMBERS * i + 1] = of(angle, distance);
  }
  ern_pose_regression_fit(fit, pose, row, MANY);
}

static double predicted(const struct ern_pose_regression *fit, float angle, float distance) {
  float pose[16];
  double row[ERN_POSE_NUMBERS];
  pose_of(pose, angle, distance);
  ern_pose_regression_predict(fit, pose, row);
  for (int k = 0; k < ERN_POSE_NUMBERS; k++) assert_true(k == 1 || fabs(row[k]) < 1e-6);
  return row[1];
}

static float constant(float angle, float distance) { return (void)angle, (void)distance, 0.7f; }
static float of_angle(float angle, float distance) { return (void)distance, 2 * sinf(angle); }
static float of_distance(float angle, float distance) { return (void)angle, distance - 3; }

static void test_constant(void **state) {
  (void)state;
  struct ern_pose_regression fit;
  fit_to(&fit, constant);
  assert_true(fabs(predicted(&fit, 0.1f, 3) - 0.7) < 1e-5);
  assert_true(fabs(predicted(&fit, -1, 9) - 0.7) < 1e-5);
}

/* One number tells the correction, and hardly depends on the other that changes: a ridge of 0.3 leaves 1/1.3 of its
 * slope. */
static void test_slope(void **state) {
  (void)state;
  struct ern_pose_regression fit;
  for (int kind = 0; kind < 2; kind++) {
    fit_to(&fit, kind == 0 ? of_angle : of_distance);
    const double low = kind == 0 ? predicted(&fit, -0.1f, 3) : predicted(&fit, 0, 2.95f);
    const double high = kind == 0 ? predicted(&fit, 0.1f, 3) : predicted(&fit, 0, 3.05f);
    const double slope = (high - low) / (kind == 0 ? 4 * sin(0.1) : 0.1);
    if (!(fabs(slope - 1 / 1.3) < 0.02)) fail_msg("kind %d: a slope of %g, expected %g", kind, slope, 1 / 1.3);
  }
}

static void test_beyond_the_trained_poses(void **state) {
  (void)state;
  struct ern_pose_regression fit;
  fit_to(&fit, of_angle);
  const double border = predicted(&fit, 0.2f, 3);
  assert_true(fabs(predicted(&fit, 0.9f, 3) - border) < 0.01 * fabs(border));
}

static void test_too_little_to_fit(void **state) {
  (void)state;
  struct ern_pose_regression fit;
  float pose[2 * 16], row[2 * ERN_POSE_NUMBERS] = {[1] = 0.5f, [ERN_POSE_NUMBERS + 1] = 0.5f};
  pose_of(pose, 0.1f, 3);
  pose_of(pose + 16, 0.1f, 3);
  ern_pose_regression_fit(&fit, pose, row, 0);
  assert_true(predicted(&fit, 0.3f, 3) == 0);
  for (size_t n = 1; n <= 2; n++) {
    ern_pose_regression_fit(&fit, pose, row, n);
    assert_true(fabs(predicted(&fit, 0.3f, 4) - 0.5) < 1e-6);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_constant), cmocka_unit_test(test_slope),
                                     cmocka_unit_test(test_beyond_the_trained_poses),
                                     cmocka_unit_test(test_too_little_to_fit)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
