/* SPDX-License-Identifier: MIT
 * Bundle adjustment on made-up rigid heads whose poses are known, and on what holds no pose. */
#include <fcntl.h>

#include "prepare/pose/bundle.h"
#include "prepare_test.h"

enum { FRAMES = 60, POINTS = 200, FIXED = FRAMES / 2 };

struct head {
  ern_context *context;
  double truth[POINTS][3], prior[POINTS][3], shape[POINTS][3];
  struct ern_head_pose poses[FRAMES];
  struct ern_bundle_pose bundled[FRAMES];
  struct ern_observation seen[FRAMES * POINTS];
  struct ern_observations shown[FRAMES];
  float weights[POINTS];
  struct ern_bundle bundle;
};

/* Points on the front of the generic head's ellipsoid; the person's differ from it by up to `spread` metres. The poses
 * begin at the fixed one's. */
static void make(struct head *h, double spread, double noise, double outliers) {
  uint64_t random = 5;
  h->context = support_context();
  for (int k = 0; k < POINTS; k++) {
    const double x = 0.9 * ERN_HEAD_WIDE * made_random(&random), y = 0.06 * made_random(&random);
    const double prior[3] = {x, y, ern_head_surface(x, y)};
    for (int c = 0; c < 3; c++) h->truth[k][c] = prior[c] + spread * made_random(&random);
    memcpy(h->prior[k], prior, sizeof prior);
    memcpy(h->shape[k], prior, sizeof prior);
    h->weights[k] = 1;
  }
  for (int i = 0; i < FRAMES; i++) {
    const double t = 6.283185307179586 * (i - FIXED) / FRAMES;
    h->poses[i] =
        made_pose(15 * sin(t), 7 * sin(2 * t), 4 * sin(3 * t), 0.02 * sin(t), 0.01 * sin(2 * t), 0.7 + 0.02 * sin(t));
    for (int k = 0; k < POINTS; k++) {
      double pixel[2];
      float *at = h->seen[i * POINTS + k].at;
      h->seen[i * POINTS + k].point = (uint32_t)k;
      h->seen[i * POINTS + k].share = 1;
      assert_true(ern_head_project(&h->poses[i], 1200, 256, h->truth[k], pixel));
      const bool away = made_random(&random) < 2 * outliers - 1;
      for (int c = 0; c < 2; c++) {
        double normal = 0; /* of variance 1: twelve uniform in -1/2..1/2 */
        for (int n = 0; n < 12; n++) normal += 0.5 * made_random(&random);
        at[c] = (float)(pixel[c] + noise * normal + (away ? 40 * made_random(&random) : 0));
      }
    }
    h->shown[i] = (struct ern_observations){h->seen + i * POINTS, POINTS};
    ern_bundle_pose_from(&h->poses[FIXED], &h->bundled[i]);
  }
  h->bundle = (struct ern_bundle){.context = h->context,
                                  .focal = 1200,
                                  .centre = 256,
                                  .frames = FRAMES,
                                  .points = POINTS,
                                  .seen = h->shown,
                                  .weights = h->weights,
                                  .prior = (const double(*)[3])h->prior,
                                  .shape = h->shape,
                                  .poses = h->bundled};
}

/* Greatest error of a rotation, degrees. All poses start again where the step starts them: at their neighbour's. */
static double adjust(struct head *h, int rounds) {
  size_t chosen[FRAMES], seen = 0;
  double most = 0;
  for (size_t i = 0; i < FRAMES; i++) chosen[i] = i;
  for (size_t i = FIXED + 1; i < FRAMES; i++) {
    h->bundled[i] = h->bundled[i - 1];
    support_ok(h->context, ern_bundle_one(&h->bundle, i, &seen));
    assert_int_equal(seen, POINTS);
  }
  for (size_t i = FIXED; i-- > 0;) {
    h->bundled[i] = h->bundled[i + 1];
    support_ok(h->context, ern_bundle_one(&h->bundle, i, &seen));
  }
  for (int i = 0; i < rounds; i++) support_ok(h->context, ern_bundle_adjust(&h->bundle, chosen, FRAMES, FIXED));
  for (size_t i = 0; i < FRAMES; i++) {
    struct ern_head_pose pose;
    ern_bundle_pose_to(&h->bundled[i], &pose);
    most = fmax(most, made_angle((const double(*)[3])pose.rotation, (const double(*)[3])h->poses[i].rotation));
  }
  return most;
}

static void expect_below(double error, double limit) {
  if (!(error < limit)) fail_msg("a rotation is %.4f degrees off, expected less than %.2f", error, limit);
}

static struct head h;

static void test_known_shape(void **state) {
  (void)state;
  make(&h, 0, 0, 0);
  expect_below(adjust(&h, 0), 0.05);
  ern_context_free(&h.context);
}

/* The shape is found with the poses; what it starts from is off by 4 mm. */
static void test_exact_points(void **state) {
  (void)state;
  make(&h, 0.004, 0, 0);
  expect_below(adjust(&h, 3), 0.05);
  ern_context_free(&h.context);
}

static void test_noise_and_outliers(void **state) {
  (void)state;
  make(&h, 0.004, 0.5, 0.2);
  expect_below(adjust(&h, 3), 0.3);
  ern_context_free(&h.context);
}

/* The head turns little, and errors of flow, alike in all points and frames, make it look turned by less than it is:
 * the generic head's depth holds against them. It does not (0.80 degrees) where every sighting counts in full. */
static void test_little_turn(void **state) {
  (void)state;
  make(&h, 0.002, 0.1, 0);
  for (size_t i = 0; i < FRAMES; i++) {
    const double turn = 8 * sin(6.283185307179586 * ((double)i - FIXED) / FRAMES) / 57.29577951308232;
    h.poses[i] = made_pose(turn * 57.29577951308232, 0, 0, 0, 0, 0.7);
    for (int k = 0; k < POINTS; k++) {
      double pixel[2];
      assert_true(ern_head_project(&h.poses[i], 1200, 256, h.truth[k], pixel));
      /* across, a turn shortens by 1 - cos: half of it is seen */
      h.seen[i * POINTS + (size_t)k].at[0] =
          (float)(pixel[0] + 0.5 * (1 - cos(turn)) * h.truth[k][0] * 1200 / (0.7 - h.truth[k][2]));
      h.seen[i * POINTS + (size_t)k].at[1] = (float)pixel[1];
    }
    ern_bundle_pose_from(&h.poses[FIXED], &h.bundled[i]);
  }
  expect_below(adjust(&h, 3), 0.65);
  ern_context_free(&h.context);
}

/* Every third point is a pixel off: with a share of 0 it moves nothing, with a tenth less than with all of it. */
static void test_share(void **state) {
  (void)state;
  const float shares[3] = {0, 0.1f, 1};
  double errors[3];
  for (int n = 0; n < 3; n++) {
    size_t seen = 0;
    make(&h, 0, 0, 0);
    for (size_t k = 0; k < POINTS; k++) {
      if (k % 3 == 0) h.seen[k].share = shares[n];
      if (k % 3 == 0) h.seen[k].at[0] += 1;
    }
    h.bundled[0] = h.bundled[FIXED];
    support_ok(h.context, ern_bundle_one(&h.bundle, 0, &seen));
    assert_int_equal(seen, n == 0 ? POINTS - (POINTS + 2) / 3 : POINTS);
    struct ern_head_pose pose;
    ern_bundle_pose_to(&h.bundled[0], &pose);
    double off[3];
    for (int i = 0; i < 3; i++) off[i] = pose.translation[i] - h.poses[0].translation[i];
    errors[n] = sqrt(off[0] * off[0] + off[1] * off[1] + off[2] * off[2]);
    ern_context_free(&h.context);
  }
  if (!(errors[0] < 1e-5 && errors[1] > 1e-5 && errors[1] < 0.5 * errors[2]))
    fail_msg("a place is %g, %g and %g m off", errors[0], errors[1], errors[2]);
}

/* A clip that is made again has the same identity, else a training on it is refused. */
static void test_same_bytes(void **state) {
  (void)state;
  static double shape[POINTS][3];
  static struct ern_bundle_pose bundled[FRAMES];
  for (int run = 0; run < 4; run++) {
    make(&h, 0.004, 0.5, 0.2);
    (void)adjust(&h, 1);
    support_ok(h.context, ern_bundle_path(&h.bundle, 0, FRAMES));
    if (run > 0) assert_memory_equal(h.shape, shape, sizeof shape);
    if (run > 0) assert_memory_equal(h.bundled, bundled, sizeof bundled);
    memcpy(shape, h.shape, sizeof shape);
    memcpy(bundled, h.bundled, sizeof bundled);
    ern_context_free(&h.context);
  }
}

static void test_pose_round_trip(void **state) {
  (void)state;
  uint64_t random = 3;
  for (int i = 0; i < 200; i++) {
    const struct ern_head_pose pose =
        made_pose(179 * made_random(&random), 89 * made_random(&random), 179 * made_random(&random), 0.1, -0.2, 0.7);
    struct ern_bundle_pose bundled;
    struct ern_head_pose again;
    ern_bundle_pose_from(&pose, &bundled);
    ern_bundle_pose_to(&bundled, &again);
    assert_true(made_angle((const double(*)[3])pose.rotation, (const double(*)[3])again.rotation) < 1e-5);
    assert_memory_equal(pose.translation, again.translation, sizeof pose.translation);
  }
}

/* A head of fewer points. */
static void keep(struct head *head, size_t points) {
  head->bundle.points = points;
  for (size_t i = 0; i < FRAMES; i++) head->shown[i].count = points;
}

/* What stderr gets goes into said.txt until it is asked for. */
static int listen(void) {
  fflush(stderr);
  const int kept = dup(2), file = open("said.txt", O_WRONLY | O_CREAT | O_TRUNC, 0666);
  assert_true(kept >= 0 && file >= 0 && dup2(file, 2) == 2);
  close(file);
  return kept;
}

static size_t heard(int kept) {
  struct stat about;
  fflush(stderr);
  assert_int_equal(dup2(kept, 2), 2);
  close(kept);
  assert_int_equal(stat("said.txt", &about), 0);
  return (size_t)about.st_size;
}

/* Every call: a status, and poses that stay numbers where it is ERN_OK. Ceres has nothing to say on stderr. */
static void survive(struct head *head, const char *what) {
  size_t chosen[FRAMES], seen = 99;
  ern_status answers[3 + FRAMES];
  size_t count = 0;
  const int kept = listen();
  for (size_t i = 0; i < FRAMES; i++) chosen[i] = i;
  answers[count++] = ern_bundle_adjust(&head->bundle, chosen, FRAMES, FIXED);
  for (size_t i = 0; i < FRAMES; i++) answers[count++] = ern_bundle_one(&head->bundle, i, &seen);
  answers[count++] = ern_bundle_path(&head->bundle, 0, FRAMES / 2);
  answers[count++] = ern_bundle_path(&head->bundle, FRAMES / 2, FRAMES);
  if (heard(kept) > 0) fail_msg("%s: something is on stderr (said.txt)", what);
  bool all = true;
  for (size_t i = 0; i < count; i++) {
    all = all && answers[i] == ERN_OK;
    if (answers[i] != ERN_OK && ern_last_error(head->context)[0] == 0) fail_msg("%s: a failure without words", what);
  }
  for (size_t i = 0; all && i < FRAMES; i++)
    for (int c = 0; c < 6; c++)
      if (!isfinite(head->bundled[i].values[c])) fail_msg("%s: a pose that is no number, and no failure", what);
  ern_context_free(&head->context);
}

static void test_degenerate_long(void **state) {
  (void)state;
  make(&h, 0.004, 0, 0);
  keep(&h, 0);
  survive(&h, "no points");
  make(&h, 0.004, 0, 0);
  keep(&h, 1);
  survive(&h, "one point");
  make(&h, 0, 0, 0);
  for (size_t i = 0; i < FRAMES; i++)
    for (int k = 0; k < POINTS; k++) {
      double pixel[2];
      const double at[3] = {0.0006 * (k - POINTS / 2), 0, 0.1};
      memcpy(h.truth[k], at, sizeof at);
      memcpy(h.prior[k], at, sizeof at);
      memcpy(h.shape[k], at, sizeof at);
      assert_true(ern_head_project(&h.poses[i], 1200, 256, at, pixel));
      for (int c = 0; c < 2; c++) h.seen[i * POINTS + (size_t)k].at[c] = (float)pixel[c];
    }
  survive(&h, "all points on a line");
  make(&h, 0.004, 0, 0);
  for (size_t i = 0; i < FRAMES; i++) memcpy(&h.seen[i * POINTS], &h.seen[FIXED * POINTS], sizeof h.seen / FRAMES);
  survive(&h, "no parallax");
  make(&h, 0.004, 0, 0);
  for (size_t i = 0; i < FRAMES * POINTS; i++) h.seen[i].at[0] = h.seen[i].at[1] = 256;
  survive(&h, "all points in one place");
}

static void test_no_numbers(void **state) {
  (void)state;
  make(&h, 0.004, 0, 0);
  for (size_t i = 0; i < FRAMES; i++) h.shown[i].count = 0;
  survive(&h, "nothing is seen");
  make(&h, 0.004, 0, 0);
  for (size_t i = 0; i < FRAMES * POINTS; i += 3) h.seen[i].at[0] = NAN;
  survive(&h, "x is NaN");
  make(&h, 0.004, 0, 0);
  for (size_t i = 0; i < FRAMES * POINTS; i += 3) h.seen[i].at[1] = NAN;
  survive(&h, "y is NaN");
  make(&h, 0.004, 0, 0);
  for (size_t i = 0; i < FRAMES * POINTS; i += 3) h.seen[i].at[0] = INFINITY;
  survive(&h, "x is infinite");
  make(&h, 0.004, 0, 0);
  for (int k = 0; k < POINTS; k += 2) h.weights[k] = NAN;
  survive(&h, "weights are NaN");
  make(&h, 0.004, 0, 0);
  h.shape[3][1] = NAN;
  survive(&h, "a point of the shape is NaN");
  make(&h, 0.004, 0, 0);
  h.bundled[7].values[2] = NAN;
  survive(&h, "a pose is NaN");
  make(&h, 0.004, 0, 0);
  for (size_t i = 0; i < FRAMES; i++) h.bundled[i].values[5] = 0.5;
  survive(&h, "behind the camera");
}

/* Numbers that are none of a head's, and whose squares are none at all. */
static void test_extremes_long(void **state) {
  (void)state;
  static const double numbers[] = {1e30, 1e150, 1e200, -1e150};
  for (size_t n = 0; n < sizeof numbers / sizeof *numbers; n++)
    for (int c = 0; c < 6; c++) {
      make(&h, 0.004, 0, 0);
      h.bundled[7].values[c] = numbers[n];
      survive(&h, "a pose is far away");
      if (c > 2) continue;
      make(&h, 0.004, 0, 0);
      h.shape[3][c] = numbers[n];
      survive(&h, "a point of the shape is far away");
      make(&h, 0.004, 0, 0);
      for (int i = 0; i < FRAMES; i++) h.seen[i * POINTS + i].at[c % 2] = (float)fmax(fmin(numbers[n], 3e38), -3e38);
      survive(&h, "points are seen far away");
    }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_known_shape),        cmocka_unit_test(test_exact_points),
                                     cmocka_unit_test(test_noise_and_outliers), cmocka_unit_test(test_same_bytes),
                                     cmocka_unit_test(test_little_turn),        cmocka_unit_test(test_share),
                                     cmocka_unit_test(test_pose_round_trip),    cmocka_unit_test(test_degenerate_long),
                                     cmocka_unit_test(test_no_numbers),         cmocka_unit_test(test_extremes_long)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
