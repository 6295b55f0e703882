/* SPDX-License-Identifier: MIT
 * Poses between two poses: ends bit for bit, halves and quarters of a turn, the shorter way, matrices that are no
 * rotations; and the pose of a frame that was not trained on. */
#include <math.h>

#include "core/memory.h"
#include "ernerf/render.h"
#include "model/model.h"
#include "support.h"

static const double degree = 3.14159265358979323846 / 180;

/* A turn by `angle` degrees about (x, y, z), by Rodrigues' formula, at the place (px, py, pz). */
static void turned(float m[16], double x, double y, double z, double angle, const float place[3]) {
  const double length = sqrt(x * x + y * y + z * z), c = cos(angle * degree), s = sin(angle * degree);
  const double axis[3] = {x / length, y / length, z / length};
  const double cross[3][3] = {{0, -axis[2], axis[1]}, {axis[2], 0, -axis[0]}, {-axis[1], axis[0], 0}};
  for (int r = 0; r < 3; r++) {
    for (int k = 0; k < 3; k++)
      m[4 * r + k] = (float)((r == k ? c : 0) + (1 - c) * axis[r] * axis[k] + s * cross[r][k]);
    m[4 * r + 3] = place[r];
  }
  memcpy(m + 12, (const float[]){0, 0, 0, 1}, 4 * sizeof *m);
}

/* 4 units in the last place of 1, plus those of the inputs' own rounding: 1e-6. */
static void expect_near(const float found[16], const float expected[16], const char *what) {
  for (int i = 0; i < 16; i++)
    if (!(fabs((double)found[i] - (double)expected[i]) < 1e-6))
      fail_msg("%s: value %d is %.9g, expected %.9g", what, i, (double)found[i], (double)expected[i]);
}

static void test_ends(void **state) {
  (void)state;
  float a[16], b[16], out[16];
  turned(a, 1, 2, 3, 20, (const float[]){0.1f, 0.2f, 3});
  turned(b, -1, 2, 0.5, 50, (const float[]){0.4f, -0.2f, 3.1f});
  a[0] += 1e-5f; /* as files have them */
  ern_pose_interpolate(out, a, b, 0);
  assert_memory_equal(out, a, sizeof a);
  ern_pose_interpolate(out, a, b, -1);
  assert_memory_equal(out, a, sizeof a);
  ern_pose_interpolate(out, a, b, (double)NAN);
  assert_memory_equal(out, a, sizeof a);
  ern_pose_interpolate(out, a, b, 1);
  assert_memory_equal(out, b, sizeof b);
  for (int i = 0; i <= 10; i++) {
    ern_pose_interpolate(out, a, a, i / 10.0);
    assert_memory_equal(out, a, sizeof a);
  }
  ern_pose_interpolate(out, a, b, 1e-9); /* the end is met, not jumped to */
  expect_near(out, a, "a little after the first");
  ern_pose_interpolate(out, a, b, 1 - 1e-9);
  expect_near(out, b, "a little before the second");
}

/* One axis: angles and places in proportion, from a third of a millidegree up to nearly half a turn. */
static void test_shares(void **state) {
  (void)state;
  static const double spans[] = {3e-4, 0.5, 30, 120, 179};
  const float from[3] = {0.1f, 0.2f, 3}, to[3] = {0.5f, -0.6f, 4};
  for (size_t s = 0; s < sizeof spans / sizeof *spans; s++)
    for (int i = 0; i <= 8; i++) {
      const double share = i / 8.0;
      const float place[3] = {(float)(0.1 + share * 0.4), (float)(0.2 - share * 0.8), (float)(3 + share)};
      float a[16], b[16], out[16], expected[16];
      turned(a, 3, -2, 1, 140, from); /* all of Shepperd's cases come up on the way */
      turned(b, 3, -2, 1, 140 + spans[s], to);
      turned(expected, 3, -2, 1, 140 + share * spans[s], place);
      ern_pose_interpolate(out, a, b, share);
      expect_near(out, expected, "on the way");
      ern_pose_interpolate(b, a, b, share); /* in place */
      assert_memory_equal(b, out, sizeof b);
    }
}

/* Each axis of the head in turn, and both ways: half of the way there is half of the way back. */
static void test_halves(void **state) {
  (void)state;
  static const double axes[][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 0}, {-1, 2, 3}};
  const float place[3] = {0, 0, 3};
  for (size_t k = 0; k < sizeof axes / sizeof *axes; k++)
    for (int angle = -170; angle <= 170; angle += 20) {
      float a[16], b[16], there[16], back[16], expected[16];
      turned(a, axes[k][0], axes[k][1], axes[k][2], 0, place);
      turned(b, axes[k][0], axes[k][1], axes[k][2], angle, place);
      turned(expected, axes[k][0], axes[k][1], axes[k][2], angle / 2.0, place);
      ern_pose_interpolate(there, a, b, 0.5);
      ern_pose_interpolate(back, b, a, 0.5);
      expect_near(there, expected, "there");
      expect_near(back, expected, "back");
    }
}

/* Twice as large, a reflection, a singular matrix: no jump at the ends, and finite in between. */
static void test_no_rotations(void **state) {
  (void)state;
  const float place[3] = {0, 0, 3};
  for (int kind = 0; kind < 3; kind++) {
    float a[16], b[16], out[16];
    turned(a, 1, 0, 0, 10, place);
    turned(b, 0, 1, 0, 20, place);
    for (int i = 0; i < 12; i++) {
      if (kind == 0 && i % 4 < 3) b[i] *= 2;
      if (kind == 1 && i % 4 == 0) b[i] = -b[i];
      if (kind == 2 && i % 4 == 1) b[i] = 0;
    }
    ern_pose_interpolate(out, a, b, 1e-9);
    expect_near(out, a, "the first");
    ern_pose_interpolate(out, a, b, 1 - 1e-9);
    expect_near(out, b, "the second");
    ern_pose_interpolate(out, a, b, 0.5);
    for (int i = 0; i < 16; i++) assert_true(isfinite(out[i]));
  }
}

/* ---- the pose of a frame that was not trained on ---- */

/* By the definition, of moves alone; far away, and without a refinement, nothing. */
static void test_unseen(void **state) {
  (void)state;
  enum { ROWS = 3 };
  const int64_t frames[ROWS] = {4, 6, 9};
  const float moves[ROWS] = {0.3f, -0.6f, 0.9f}, place[3] = {0.1f, 0.2f, 3};
  const struct ern_model_config config = {
      .levels = 2, .feature_width = 5, .window_length = 16, .head = true, .bound = 1};
  ern_context *context = support_context();
  ern_model *model = NULL;
  float pose[16], first[16];
  turned(first, 1, 2, 3, 20, place);
  support_ok(context, ern_model_make(&model, context, &config));
  memcpy(pose, first, sizeof pose);
  ern_model_refine_unseen(model, frames, ROWS, 5, pose);
  assert_memory_equal(pose, first, sizeof pose);
  support_ok(context, ERN_NEW(context, 6 * ROWS, &model->camera));
  model->cameras = ROWS;
  for (size_t i = 0; i < ROWS; i++) model->camera[3 * (ROWS + i) + 1] = moves[i];
  for (int64_t frame = -2; frame < 14; frame++) {
    double total = 1, sum = 0;
    for (size_t i = 0; i < ROWS; i++) {
      const double off = (double)(frames[i] - frame) / 3, weight = exp(-off * off / 2);
      total += weight, sum += weight * (double)moves[i];
    }
    memcpy(pose, first, sizeof pose);
    ern_model_refine_unseen(model, frames, ROWS, frame, pose);
    float expected[16];
    memcpy(expected, first, sizeof expected);
    expected[7] += (float)(sum / total);
    expect_near(pose, expected, "a frame that was not trained on");
  }
  memcpy(pose, first, sizeof pose);
  ern_model_refine_unseen(model, frames, ROWS, INT64_MAX, pose);
  expect_near(pose, first, "a frame far away");
  model->unseen[0][4] = 0.25f; /* what the pose says, by a regression */
  memcpy(pose, first, sizeof pose);
  ern_model_refine_unseen(model, NULL, 0, 5, pose);
  first[7] += 0.25f;
  expect_near(pose, first, "a pose without frames around it");
  ern_model_free(&model);
  ern_context_free(&context);
}

/* ---- the regression of the corrections on the poses (docs/poses.md) ---- */

enum { MANY = 50 };

/* A camera that looks at the origin from `distance` along the scene's y, turned about the scene's x by `angle`. */
static void pose_of(float pose[16], float angle, float distance) {
  const float c = cosf(angle), s = sinf(angle);
  const float rows[16] = {0, -1, 0, 0, s, 0, -c, c * distance, c, 0, s, -s * distance, 0, 0, 0, 1};
  memcpy(pose, rows, sizeof rows);
}

static void fit_to(float *fit, float (*of)(float angle, float distance)) {
  float pose[16 * MANY], row[ERN_POSE_CORRECTION * MANY] = {0};
  for (int i = 0; i < MANY; i++) {
    const float angle = 0.2f * sinf(0.37f * (float)i), distance = 3 + 0.1f * cosf(1.1f * (float)i);
    pose_of(pose + 16 * i, angle, distance);
    row[ERN_POSE_CORRECTION * i + 1] = of(angle, distance);
  }
  ern_pose_regression_fit(fit, ERN_POSE_CORRECTION, pose, row, MANY, 0.3);
}

static double predicted(const float *fit, float angle, float distance) {
  float pose[16];
  double row[ERN_POSE_CORRECTION];
  pose_of(pose, angle, distance);
  ern_pose_regression_predict(fit, ERN_POSE_CORRECTION, pose, row);
  for (int k = 0; k < ERN_POSE_CORRECTION; k++) assert_true(k == 1 || fabs(row[k]) < 1e-6);
  return row[1];
}

static float constant(float angle, float distance) { return (void)angle, (void)distance, 0.7f; }
static float of_angle(float angle, float distance) { return (void)distance, 2 * sinf(angle); }
static float of_distance(float angle, float distance) { return (void)angle, distance - 3; }

static void test_predicted_constant(void **state) {
  (void)state;
  float fit[ERN_POSE_REGRESSION_ROWS * ERN_POSE_CORRECTION];
  fit_to(fit, constant);
  assert_true(fabs(predicted(fit, 0.1f, 3) - 0.7) < 1e-5);
  assert_true(fabs(predicted(fit, -1, 9) - 0.7) < 1e-5);
}

/* One number tells the correction, and hardly depends on the other that changes: a ridge of 0.3 leaves 1/1.3 of its
 * slope. */
static void test_predicted_slope(void **state) {
  (void)state;
  float fit[ERN_POSE_REGRESSION_ROWS * ERN_POSE_CORRECTION];
  for (int kind = 0; kind < 2; kind++) {
    fit_to(fit, kind == 0 ? of_angle : of_distance);
    const double low = kind == 0 ? predicted(fit, -0.1f, 3) : predicted(fit, 0, 2.95f);
    const double high = kind == 0 ? predicted(fit, 0.1f, 3) : predicted(fit, 0, 3.05f);
    const double slope = (high - low) / (kind == 0 ? 4 * sin(0.1) : 0.1);
    if (!(fabs(slope - 1 / 1.3) < 0.02)) fail_msg("kind %d: a slope of %g, expected %g", kind, slope, 1 / 1.3);
  }
}

static void test_beyond_the_trained_poses(void **state) {
  (void)state;
  float fit[ERN_POSE_REGRESSION_ROWS * ERN_POSE_CORRECTION];
  fit_to(fit, of_angle);
  const double border = predicted(fit, 0.2f, 3);
  assert_true(fabs(predicted(fit, 0.9f, 3) - border) < 0.01 * fabs(border));
}

static void test_too_little_to_fit(void **state) {
  (void)state;
  float fit[ERN_POSE_REGRESSION_ROWS * ERN_POSE_CORRECTION];
  float pose[2 * 16], row[2 * ERN_POSE_CORRECTION] = {[1] = 0.5f, [ERN_POSE_CORRECTION + 1] = 0.5f};
  pose_of(pose, 0.1f, 3);
  pose_of(pose + 16, 0.1f, 3);
  ern_pose_regression_fit(fit, ERN_POSE_CORRECTION, pose, row, 0, 0.3);
  assert_true(predicted(fit, 0.3f, 3) == 0);
  for (size_t n = 1; n <= 2; n++) {
    ern_pose_regression_fit(fit, ERN_POSE_CORRECTION, pose, row, n, 0.3);
    assert_true(fabs(predicted(fit, 0.3f, 4) - 0.5) < 1e-6);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_ends),
                                     cmocka_unit_test(test_shares),
                                     cmocka_unit_test(test_halves),
                                     cmocka_unit_test(test_no_rotations),
                                     cmocka_unit_test(test_unseen),
                                     cmocka_unit_test(test_predicted_constant),
                                     cmocka_unit_test(test_predicted_slope),
                                     cmocka_unit_test(test_beyond_the_trained_poses),
                                     cmocka_unit_test(test_too_little_to_fit)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
