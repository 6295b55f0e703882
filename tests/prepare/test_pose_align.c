/* SPDX-License-Identifier: MIT
 * Poses that are refined by the pictures: a textured head with hair beside its ellipsoid, before a background that
 * stays still, from poses that are off by known amounts; a mouth that moves, an occluded face and a picture of nothing.
 */
#include "prepare/pose/pose_align.h"
#include "prepare_test.h"

enum { SIDE = 192, FRAMES = 12 };
static const double focal = 2.4 * SIDE, centre = 0.5 * SIDE;
static uint8_t grey[SIDE * SIDE];

/* Smooth texture with waves of some centimetres, as a function of the place on the head, metres. */
static double texture(const double p[3]) {
  return 128 + 40 * sin(260 * p[0] + 40 * p[1]) + 40 * sin(210 * p[1] - 90 * p[0] + 1) + 20 * sin(150 * p[2]);
}

/* mouth: grey levels by which the lower face is brighter; hidden: a hand before the left half of the face. */
static void draw(const struct ern_head_pose *pose, double mouth, bool hidden) {
  for (int i = 0; i < SIDE * SIDE; i++) {
    const double pixel[2] = {i % SIDE + 0.5, i / SIDE + 0.5};
    double p[3], level = 90 + 25 * sin(0.3 * pixel[0]) * cos(0.2 * pixel[1]);
    if (ern_head_intersect(pose, focal, centre, pixel, true, p) ||
        ern_head_nearest(pose, focal, centre, pixel, p) < 1.2)
      level = texture(p) + (p[1] < ERN_HEAD_EYES_Y - 0.055 ? mouth : 0);
    if (hidden && pixel[0] < centre && pixel[1] > centre) level = 200;
    grey[i] = (uint8_t)lround(fmin(fmax(level, 0), 255));
  }
}

/* The root mean square of how far six points of the face are off, pixels. */
static double off_by(const struct ern_head_pose *a, const struct ern_head_pose *b) {
  static const double points[][3] = {{-0.05, 0.03, 0.07}, {0.05, 0.03, 0.07}, {0, 0.08, 0.08},
                                     {0, 0, 0.11},        {-0.06, 0, 0.05},   {0.06, 0.06, 0.03}};
  double sum = 0;
  for (size_t k = 0; k < sizeof points / sizeof *points; k++) {
    double at[2], other[2];
    assert_true(ern_head_project(a, focal, centre, points[k], at));
    assert_true(ern_head_project(b, focal, centre, points[k], other));
    sum += pow(at[0] - other[0], 2) + pow(at[1] - other[1], 2);
  }
  return sqrt(sum / (double)(sizeof points / sizeof *points));
}

/* Poses of a head that turns and nods a little, and the same as a tracker may find them: the middle of the face in its
 * place, and turned and deeper by something. */
static void make_poses(struct ern_head_pose *truth, struct ern_head_pose *found) {
  uint64_t random = 5;
  for (int i = 0; i < FRAMES; i++) {
    double v[6], e[6];
    for (int k = 0; k < 6; k++) {
      v[k] = i == 0 ? 0 : made_random(&random);
      e[k] = i == 0 ? 0 : made_random(&random);
    }
    const double yaw = 6 * v[0], pitch = 5 * v[1], roll = 4 * v[2], x = 0.02 * v[3], y = 0.02 * v[4],
                 depth = 0.9 + 0.02 * v[5];
    truth[i] = made_pose(yaw, pitch, roll, x, y, depth);
    const double nearer = 1 + 0.02 * e[5];
    found[i] = made_pose(yaw + e[0], pitch + e[1], roll + e[2], nearer * x, nearer * y, nearer * depth);
  }
}

/* The light of the frame: from `dim` of all of it in the first to all of it in the last. */
static void shade(int frame, double dim) {
  const double light = dim + (1 - dim) * frame / (FRAMES - 1);
  for (int i = 0; i < SIDE * SIDE; i++) grey[i] = (uint8_t)lround(light * grey[i]);
}

/* Poses that are off come nearer to the truth, also where the light changes. found[FRAMES]: the poses
 * then. The caller owns the result. */
static struct ern_pose_align *refine(ern_context *context, double dim, struct ern_head_pose *found) {
  struct ern_pose_align *align = NULL;
  struct ern_head_pose truth[FRAMES], tracked[FRAMES];
  double before = 0, after = 0;
  make_poses(truth, found);
  memcpy(tracked, found, sizeof tracked);
  for (int i = 0; i < FRAMES; i++) before += off_by(&truth[i], &found[i]) / FRAMES;
  support_ok(context, ern_pose_align_make(context, SIDE, focal, centre, &found[0], &align));
  for (int round = 0; round < ERN_POSE_ALIGN_ROUNDS; round++) {
    for (int i = 0; i < FRAMES; i++) {
      draw(&truth[i], 15.0 * (i % 5), false);
      shade(i, dim);
      support_ok(context, ern_pose_align_add(align, grey, &found[i]));
    }
    ern_pose_align_mean(align);
    for (int i = 0; i < FRAMES; i++) {
      draw(&truth[i], 15.0 * (i % 5), i == 4);
      shade(i, dim);
      support_ok(context, ern_pose_align_refine(align, grey, &tracked[i], &found[i]));
    }
  }
  for (int i = 0; i < FRAMES; i++) after += off_by(&truth[i], &found[i]) / FRAMES;
  /* the tracks, which are off, hold the middle of the face with as much weight as the picture has */
  if (!(before > 0.6 && after < 0.7 * before))
    fail_msg("light from %g: off by %.3f pixels, and then by %.3f", dim, before, after);
  return align;
}

static void test_refined(void **state) {
  (void)state;
  ern_context *context = support_context();
  struct ern_head_pose found[FRAMES];
  struct ern_pose_align *align = refine(context, 0.5, found);
  ern_pose_align_free(&align);
  align = refine(context, 1, found);
  const struct ern_head_pose kept = found[3];
  memset(grey, 100, sizeof grey); /* nothing to see */
  support_ok(context, ern_pose_align_refine(align, grey, &kept, &found[3]));
  assert_true(off_by(&kept, &found[3]) < 0.01);
  struct ern_head_pose outside = made_pose(0, 0, 0, 5, 0, 0.9);
  support_ok(context, ern_pose_align_refine(align, grey, &kept, &outside));
  assert_true(outside.translation[0] == 5);
  struct ern_head_pose behind = made_pose(0, 0, 0, 0, 0, -0.9);
  support_ok(context, ern_pose_align_refine(align, grey, &kept, &behind));
  assert_true(behind.translation[2] == 0.9);
  ern_pose_align_free(&align);
  ern_pose_align_free(&align);
  ern_pose_align_free(NULL);
  ern_context_free(&context);
}

/* The nearest point of a ray beside the ellipsoid is on the ray, and nearer than others of it. */
static void test_nearest(void **state) {
  (void)state;
  const struct ern_head_pose pose = made_pose(20, -10, 5, 0.05, -0.02, 0.8);
  for (int x = 10; x < SIDE; x += 20)
    for (int y = 10; y < SIDE; y += 20) {
      const double pixel[2] = {x, y};
      double point[3], hit[3], at[2];
      const double nearest = ern_head_nearest(&pose, focal, centre, pixel, point);
      assert_true(ern_head_project(&pose, focal, centre, point, at));
      assert_true(hypot(at[0] - x, at[1] - y) < 1e-6);
      assert_int_equal(nearest < 1, ern_head_intersect(&pose, focal, centre, pixel, false, hit));
    }
}

/* Tracks that drift slowly and a refinement that finds the drift, and noise: the drift is taken, the noise is not. The
 * head itself turns from frame to frame, which stays. */
static void test_smooth(void **state) {
  (void)state;
  enum { MANY = 60 };
  ern_context *context = support_context();
  static struct ern_head_pose tracked[MANY], poses[MANY];
  double trembles = 0, noise = 0;
  uint64_t random = 11;
  for (int i = 0; i < MANY; i++) {
    const double turn = 5 * sin(0.9 * i), drift = 2.0 * i / MANY;
    tracked[i] = made_pose(turn, 3, -4, 0.01, 0.02, 0.9);
    poses[i] = made_pose(turn + drift + made_random(&random), 3, -4, 0.01, 0.02, 0.9);
  }
  support_ok(context, ern_pose_align_smooth(context, tracked, MANY, poses));
  for (int i = 6; i < MANY - 6; i++) {
    const struct ern_head_pose truth = made_pose(5 * sin(0.9 * i) + 2.0 * i / MANY, 3, -4, 0.01, 0.02, 0.9);
    const double off = made_angle((const double(*)[3])truth.rotation, (const double(*)[3])poses[i].rotation);
    trembles += off * off / (MANY - 12);
    noise += 1.0 / 3 / (MANY - 12); /* the variance of numbers from -1 to 1 */
    assert_true(fabs(poses[i].translation[2] - truth.translation[2]) < 1e-9);
  }
  /* a Gaussian of deviation 2 leaves 1/(2 sqrt(pi) 2) = 0.14 of the variance of white noise */
  if (!(trembles < 0.25 * noise)) fail_msg("off by %.3f degrees, with noise of %.3f", sqrt(trembles), sqrt(noise));
  struct ern_head_pose one = poses[0];
  support_ok(context, ern_pose_align_smooth(context, &tracked[0], 1, &one));
  assert_true(made_angle((const double(*)[3])poses[0].rotation, (const double(*)[3])one.rotation) < 1e-4);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_refined), cmocka_unit_test(test_smooth),
                                     cmocka_unit_test(test_nearest)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
