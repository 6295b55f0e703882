/* SPDX-License-Identifier: MIT
 * The measures of a mouth that moves, on pictures whose figures are known without computing them. */
#include "../support.h"

#include <math.h>

#include "evaluation/mouth_motion.h"

enum { SIDE = 160, FRAMES = 24 };
static const double pi = 3.14159265358979323846;

/* Eyes 60 pixels apart, the mouth in the middle: a crop of 74.4 x 48.3 pixels. */
static ern_clip_frame face(void) {
  ern_clip_frame frame = {.has_landmarks = true};
  for (int i = 0; i < 68; i++) {
    const float x = i < 42 ? 50.0f : i < 48 ? 110.0f : 80.0f, y = i < 48 ? 50.0f : 100.0f;
    frame.landmarks[i][0] = x;
    frame.landmarks[i][1] = y;
  }
  return frame;
}

/* Two patterns that are orthogonal over the crop and sum to 0 in it: bands up and down, and left and right. */
static double pattern(int which, int i, int j) {
  const double x = (i + 0.5 - (80 - 37.2)) / 74.4, y = (j + 0.5 - (100 - 20.4)) / 48.3;
  return which == 0 ? cos(2 * pi * y) : cos(2 * pi * x);
}

/* Coefficients of the patterns in frame k: sums over the frames are 0, and so is their product. */
static double along(int which, int k) { return which == 0 ? sin(2 * pi * k / FRAMES) : cos(2 * pi * k / FRAMES); }

/* truth: 0.5 + 0.2 a0 p0 + 0.1 a1 p1; rendered: 0.4 + gain * the same parts. */
static struct mouth_figures figures(double gain0, double gain1, bool landmarks) {
  struct mouth_motion motion = {0};
  static float truth[SIDE * SIDE];
  static float rendered[SIDE * SIDE];
  ern_clip_frame frame = face();
  frame.has_landmarks = landmarks;
  for (int k = 0; k < FRAMES; k++) {
    for (int j = 0; j < SIDE; j++)
      for (int i = 0; i < SIDE; i++) {
        const double first = 0.2 * along(0, k) * pattern(0, i, j), second = 0.1 * along(1, k) * pattern(1, i, j);
        truth[j * SIDE + i] = (float)(0.5 + first + second);
        rendered[j * SIDE + i] = (float)(0.4 + gain0 * first + gain1 * second);
      }
    assert_true(mouth_motion_add(&motion, &frame, SIDE, SIDE, truth, rendered));
  }
  const struct mouth_figures found = mouth_motion_figures(&motion);
  mouth_motion_free(&motion);
  return found;
}

static void expect(struct mouth_figures found, double explained, double correlation, double amplitude) {
  assert_true(found.known);
  /* the crop's pixels are means over 3 x 3 points between the picture's */
  if (!(fabs(found.explained - explained) < 0.01 && fabs(found.amplitude - amplitude) < 0.01))
    fail_msg("explained %g, amplitude %g, expected %g and %g", found.explained, found.amplitude, explained, amplitude);
  if (isinf(correlation)) return; /* of next to nothing: any */
  if (isnan(correlation) ? !isnan(found.correlation) : !(fabs(found.correlation - correlation) < 0.01))
    fail_msg("correlation %g, expected %g", found.correlation, correlation);
}

/* Variances of the parts are as 0.2^2 to 0.1^2, that is 0.8 and 0.2 of the whole; the first component is p0. */
static void test_known(void **state) {
  (void)state;
  expect(figures(1, 1, true), 1, 1, 1);
  expect(figures(0.5, 0.5, true), 0.75, 1, 0.5);
  expect(figures(-1, -1, true), -3, -1, 1);
  expect(figures(0, 0, true), 0, NAN, 0);
  expect(figures(1, 0, true), 0.8, 1, 1);
  expect(figures(0, 1, true), 0.2, INFINITY, 0);
}

static void test_unknown(void **state) {
  (void)state;
  assert_false(figures(1, 1, false).known);
  assert_false(mouth_motion_figures(&(struct mouth_motion){0}).known);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_known), cmocka_unit_test(test_unknown)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
