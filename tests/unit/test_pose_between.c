/* SPDX-License-Identifier: MIT
 * Poses between two poses: ends bit for bit, halves and quarters of a turn, the shorter way, matrices that are no
 * rotations. */
#include <math.h>

#include "ernerf/render.h"
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

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_ends), cmocka_unit_test(test_shares),
                                     cmocka_unit_test(test_halves), cmocka_unit_test(test_no_rotations)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
