/* SPDX-License-Identifier: MIT
 * What a user hands over in the clip's place: curves of the lids in every form, and heads turned. */
#include "../support.h"

#include <math.h>

#include "ernerf/data.h"
#include "ernerf/render.h"
#include "io/npy.h"

static void expect_eyes(ern_context *context, const char *path, size_t count, const float *expected) {
  ern_eyes eyes = {0};
  support_ok(context, ern_eyes_load(context, path, &eyes));
  assert_int_equal(eyes.count, count);
  for (size_t i = 0; i < count; i++) assert_true(eyes.data[i] == expected[i]);
  ern_eyes_free(context, &eyes);
  assert_null(eyes.data);
}

static void expect_text(ern_context *context, const char *text, size_t count, const float *expected) {
  support_write_text("eyes.csv", text);
  expect_eyes(context, "eyes.csv", count, expected);
}

static void test_forms(void **state) {
  (void)state;
  ern_context *context = support_context();
  const float expected[] = {0, 0.25f, 1};
  expect_text(context, "frame, AU45_r, AU45_c\n1, 0, 9\n2, 0.5, 9\n3, 4.75, 9\n", 3, expected); /* intensities */
  expect_text(context, "0\n0.25\n1\n", 3, expected);
  expect_text(context, " 0 \r\n25e-2\r\n1\r\n\r\n", 3, expected);
  expect_text(context, "1", 1, expected + 2);
  expect_text(context,
              "\xef\xbb\xbf"
              "0\n0.25\n1\n",
              3, expected); /* byte-order mark */
  support_ok(context, ern_npy_write_f32(context, "eyes.npy", expected, 1, (const size_t[]){3}));
  expect_eyes(context, "eyes.npy", 3, expected);
  support_ok(context, ern_npy_write_f32(context, "eyes.npy", expected, 2, (const size_t[]){3, 1}));
  expect_eyes(context, "eyes.npy", 3, expected);
  ern_context_free(&context);
}

static void expect_refused(ern_context *context, const char *path, ern_status status, const char *first,
                           const char *second) {
  ern_eyes eyes = {.count = 9};
  support_expect(context, ern_eyes_load(context, path, &eyes), status, path, first, second, NULL);
  assert_null(eyes.data);
  assert_int_equal(eyes.count, 0);
}

static void test_refused(void **state) {
  (void)state;
  ern_context *context = support_context();
  static const struct {
    const char *text;
    ern_status status;
    const char *words[2];
  } cases[] = {{"", ERN_E_FORMAT, {"is empty", "header"}},
               {"frame, AU01_r\n1, 2\n", ERN_E_MISSING, {"column AU45_r is missing", "found: frame, AU01_r"}},
               {"frame, AU45_r\n", ERN_E_SHAPE, {"no value", "one a frame"}},
               {"frame, AU45_r\n1, 1\n2, 5.01\n", ERN_E_FORMAT, {"line 3 is 5.01", "0 to 5"}},
               {"frame, AU45_r\n1, -0.5\n", ERN_E_FORMAT, {"line 2 is -0.5", "0 to 5"}},
               {"frame, AU45_r\n1, nan\n", ERN_E_FORMAT, {"line 2", "finite number"}},
               {"0.5\n1.5\n", ERN_E_FORMAT, {"line 2 is 1.5", "0 to 1"}},
               {"0.5\n\n0.5\n", ERN_E_FORMAT, {"line 2 is \"\"", "one number"}},
               {"0.5\n0.5, 0.5\n", ERN_E_FORMAT, {"line 2 is \"0.5, 0.5\"", "one number"}},
               {"0.5\nnan\n", ERN_E_FORMAT, {"line 2 is \"nan\"", "one number"}},
               {"1e300\n", ERN_E_FORMAT, {"line 1 is", "0 to 1"}}};
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    support_write_text("bad.csv", cases[i].text);
    expect_refused(context, "bad.csv", cases[i].status, cases[i].words[0], cases[i].words[1]);
  }
  const float wide[] = {0, 0.25f, 1, 1.25f}, hole[] = {0, NAN};
  support_ok(context, ern_npy_write_f32(context, "bad.npy", wide, 2, (const size_t[]){2, 2}));
  expect_refused(context, "bad.npy", ERN_E_SHAPE, "2 dimensions and 4 values", "[T]");
  support_ok(context, ern_npy_write_f32(context, "bad.npy", wide, 1, (const size_t[]){4}));
  expect_refused(context, "bad.npy", ERN_E_FORMAT, "value 3 is 1.25", "0 to 1");
  support_ok(context, ern_npy_write_f32(context, "bad.npy", hole, 1, (const size_t[]){2}));
  expect_refused(context, "bad.npy", ERN_E_FORMAT, "value 1 is nan", "0 to 1");
  support_ok(context, ern_npy_write_f32(context, "bad.npy", wide, 1, (const size_t[]){0}));
  expect_refused(context, "bad.npy", ERN_E_SHAPE, "no value", "one a frame");
  support_write_text("bad.npy", "0.5\n");
  expect_refused(context, "bad.npy", ERN_E_FORMAT, "", "");
  expect_refused(context, "nowhere.csv", ERN_E_MISSING, "", "");
  ern_context_free(&context);
}

/* ---- turned heads ------------------------------------------------------------------------------------------------ */

/* Where a camera before the face, 3 units from the head's centre, sees the tip of the nose, 1 unit out of the face: to
 * the right and up from the picture's middle, both by the depth. */
static void see_nose(double yaw, double pitch, double seen[2], double *distance) {
  float m[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1};
  const double nose[3] = {0, 0, 1};
  double inside[3] = {0};
  ern_pose_turn(m, yaw, pitch);
  for (int axis = 0; axis < 3; axis++) /* transposed rotation times (nose - place) */
    for (int k = 0; k < 3; k++) inside[axis] += (double)m[4 * k + axis] * (nose[k] - (double)m[4 * k + 3]);
  *distance = sqrt((double)(m[3] * m[3] + m[7] * m[7] + m[11] * m[11]));
  seen[0] = inside[0] / -inside[2]; /* a camera of a transforms file looks along its -z, x right, y up */
  seen[1] = inside[1] / -inside[2];
  for (int k = 0; k < 4; k++) assert_true(m[12 + k] == (k == 3));
}

/* By hand: after a turn by a the nose is sin(a) to the side and cos(a) nearer than the centre, 3 - cos(a) away. */
static void test_turn(void **state) {
  (void)state;
  const double a = 3.14159265358979323846 / 6, expected = sin(a) / (3 - cos(a)), rounding = 1e-6;
  const struct {
    double yaw, pitch, right, up;
  } cases[] = {
      {0, 0, 0, 0}, {30, 0, expected, 0}, {-30, 0, -expected, 0}, {0, 30, 0, expected}, {0, -30, 0, -expected}};
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    double seen[2], distance = 0;
    see_nose(cases[i].yaw, cases[i].pitch, seen, &distance);
    if (fabs(seen[0] - cases[i].right) > rounding || fabs(seen[1] - cases[i].up) > rounding)
      fail_msg("yaw %g, pitch %g: the nose is at %g, %g, expected %g, %g", cases[i].yaw, cases[i].pitch, seen[0],
               seen[1], cases[i].right, cases[i].up);
    assert_true(fabs(distance - 3) < rounding);
  }
  float once[16] = {1, 0, 0, 0.25f, 0, 1, 0, 0.5f, 0, 0, 1, 3, 0, 0, 0, 1}, still[16];
  memcpy(still, once, sizeof still);
  ern_pose_turn(once, 0, 0);
  assert_memory_equal(once, still, sizeof still);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_forms), cmocka_unit_test(test_refused),
                                     cmocka_unit_test(test_turn)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
