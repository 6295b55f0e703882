/* SPDX-License-Identifier: MIT
 * The generic head: where its points are seen, and which of them a line of sight meets. */
#include "prepare_test.h"

static const double focal = 1200, centre = 256;

static struct ern_head_pose turned(uint64_t *state) {
  return made_pose(40 * made_random(state), 25 * made_random(state), 20 * made_random(state), 0.05 * made_random(state),
                   0.05 * made_random(state), 0.6 + 0.2 * made_random(state));
}

/* What a line of sight meets is seen at that line's pixel, lies on the ellipsoid, and turns its front to the camera. */
static void test_meet_and_project(void **state) {
  (void)state;
  uint64_t random = 1;
  size_t met = 0;
  for (int i = 0; i < 2000; i++) {
    const struct ern_head_pose pose = turned(&random);
    const double middle[3] = {0, 0, 0};
    double pixel[2], point[3], again[2];
    assert_true(ern_head_project(&pose, focal, centre, middle, pixel));
    for (int c = 0; c < 2; c++) pixel[c] += 260 * made_random(&random);
    if (!ern_head_intersect(&pose, focal, centre, pixel, false, point)) continue;
    met++;
    assert_true(ern_head_project(&pose, focal, centre, point, again));
    assert_true(hypot(again[0] - pixel[0], again[1] - pixel[1]) < 1e-6);
    const double out[3] = {point[0] / (ERN_HEAD_WIDE * ERN_HEAD_WIDE), point[1] / (ERN_HEAD_TALL * ERN_HEAD_TALL),
                           point[2] / (ERN_HEAD_DEEP * ERN_HEAD_DEEP)};
    assert_true(fabs(out[0] * point[0] + out[1] * point[1] + out[2] * point[2] - 1) < 1e-9);
    double towards = 0; /* of the outward normal, along the way from the point to the camera */
    for (int r = 0; r < 3; r++) {
      double normal = 0, place = pose.translation[r];
      for (int k = 0; k < 3; k++) {
        normal += pose.rotation[r][k] * out[k];
        place += pose.rotation[r][k] * point[k];
      }
      towards -= normal * place;
    }
    assert_true(towards >= -1e-9);
  }
  assert_true(met > 500 && met < 1900);
}

/* With the face the point still lies on the line, and on the face's surface: before the ellipsoid at the nose's tip by
 * 20 mm, and at the forehead. */
static void test_face(void **state) {
  (void)state;
  const struct ern_head_pose pose = made_pose(0, 0, 0, 0, 0, 0.7);
  double nose = 0, forehead = 0;
  for (double u = -60; u <= 60; u += 1)
    for (double v = -140; v <= 60; v += 1) {
      double bare[3], face[3], seen[2];
      const double pixel[2] = {centre + u, centre + v};
      assert_true(ern_head_intersect(&pose, focal, centre, pixel, false, bare));
      assert_true(ern_head_intersect(&pose, focal, centre, pixel, true, face));
      assert_true(ern_head_project(&pose, focal, centre, face, seen));
      assert_true(hypot(seen[0] - pixel[0], seen[1] - pixel[1]) < 1e-6);
      assert_true(face[2] >= bare[2]);
      if (fabs(u) < 15 && fabs(v) < 40) nose = fmax(nose, face[2] - bare[2]);
      if (face[1] > ERN_HEAD_EYES_Y) {
        forehead = fmax(forehead, face[2] - bare[2]);
        assert_true(fabs(face[2] - ern_head_surface(face[0], face[1])) < 1e-9);
      }
    }
  if (!(nose > 0.018 && nose < 0.021)) fail_msg("the nose stands out by %.4f m", nose);
  if (!(forehead > 0.012)) fail_msg("the forehead stands out by %.4f m", forehead);
  assert_true(fabs(ern_head_surface(0, ERN_HEAD_EYES_Y - 0.043) -
                   (ERN_HEAD_DEEP * sqrt(1 - pow((ERN_HEAD_EYES_Y - 0.043) / ERN_HEAD_TALL, 2)) + 0.020)) < 1e-9);
  assert_true(ern_head_surface(ERN_HEAD_WIDE, 0) == 0 && ern_head_surface(0, 2 * ERN_HEAD_TALL) == 0);
}

/* From the brows to the hair a person's forehead is nearly upright. */
static void test_forehead(void **state) {
  (void)state;
  const double brows = ern_head_surface(0, ERN_HEAD_EYES_Y + 0.015),
               hair = ern_head_surface(0, ERN_HEAD_EYES_Y + 0.070);
  const double degrees = atan2(brows - hair, 0.055) * 57.29577951308232;
  if (!(degrees > 1 && degrees < 20)) fail_msg("the forehead falls back by %.1f degrees", degrees);
}

static void test_behind(void **state) {
  (void)state;
  const double point[3] = {0, 0, 0};
  double pixel[2] = {7, 7};
  const struct ern_head_pose behind = made_pose(0, 0, 0, 0, 0, -0.5);
  assert_false(ern_head_project(&behind, focal, centre, point, pixel));
  assert_true(pixel[0] == 7 && pixel[1] == 7);
}

/* Every point of the ellipsoid that is met lies in the box, and the box is met near its four sides. */
static void test_box(void **state) {
  (void)state;
  uint64_t random = 9;
  for (int i = 0; i < 20; i++) {
    const struct ern_head_pose pose = turned(&random);
    double box[4], least[2] = {HUGE_VAL, HUGE_VAL}, most[2] = {-HUGE_VAL, -HUGE_VAL};
    ern_head_box(&pose, focal, centre, box);
    for (int k = 0; k < 200 * 200; k++) {
      const double share[2] = {(k % 200 - 20) / 160.0, (k / 200 - 20) / 160.0};
      const double pixel[2] = {box[0] + share[0] * (box[2] - box[0]), box[1] + share[1] * (box[3] - box[1])};
      double point[3];
      if (!ern_head_intersect(&pose, focal, centre, pixel, false, point)) continue;
      for (int c = 0; c < 2; c++) {
        least[c] = fmin(least[c], pixel[c]);
        most[c] = fmax(most[c], pixel[c]);
      }
    }
    for (int c = 0; c < 2; c++) { /* the box is that of 24 x 13 points: a chord of 15 degrees is within 1 - cos 7.5 */
      const double slack = 0.02 * (box[2 + c] - box[c]);
      assert_true(fabs(least[c] - box[c]) < slack && fabs(most[c] - box[2 + c]) < slack);
    }
  }
}

/* The eyes of the pose that two eyes give are where they were. */
static void test_pose_of_eyes(void **state) {
  (void)state;
  const float eyes[2][2] = {{200, 260}, {310, 240}};
  struct ern_head_pose pose;
  ern_head_pose_of_eyes(eyes, focal, centre, &pose);
  for (int e = 0; e < 2; e++) {
    const double at[3] = {(e == 0 ? -0.5 : 0.5) * ERN_HEAD_EYES, ERN_HEAD_EYES_Y, ERN_HEAD_EYES_Z};
    double pixel[2];
    assert_true(ern_head_project(&pose, focal, centre, at, pixel));
    assert_true(hypot(pixel[0] - (double)eyes[e][0], pixel[1] - (double)eyes[e][1]) < 1e-3);
  }
  const float one[2][2] = {{256, 256}, {256, 256}}; /* no distance: a pose all the same */
  ern_head_pose_of_eyes(one, focal, centre, &pose);
  assert_true(isfinite(pose.translation[2]) && pose.translation[2] < 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_meet_and_project), cmocka_unit_test(test_face), cmocka_unit_test(test_forehead),
      cmocka_unit_test(test_behind),           cmocka_unit_test(test_box),  cmocka_unit_test(test_pose_of_eyes)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
