/* SPDX-License-Identifier: MIT
 * Where the body is: a body that is moved, turned and enlarged by known amounts below a head that moves otherwise, and
 * frames that show too little of it. */
#include "prepare/layers/layers.h"
#include "prepare_test.h"

enum { SIDE = 192, WAVES = 40 };

static uint8_t background[SIDE * SIDE * 3], rgba[SIDE * SIDE * 4], parts[SIDE * SIDE];

/* Smooth texture with waves of 8 to 60 pixels, as a function of the place in the body, in half sides. */
static double texture(double row, double column) {
  static double wave[WAVES][3];
  if (wave[0][0] == 0) {
    uint64_t random = 4;
    for (int i = 0; i < WAVES; i++) {
      const double length = (8 + 26 * (1 + made_random(&random))) * 2 / SIDE, angle = 3.14159 * made_random(&random);
      wave[i][0] = 6.2832 / length * cos(angle);
      wave[i][1] = 6.2832 / length * sin(angle);
      wave[i][2] = 3.14159 * made_random(&random);
    }
  }
  double sum = 0;
  for (int i = 0; i < WAVES; i++) sum += sin(wave[i][0] * row + wave[i][1] * column + wave[i][2]);
  return fmin(fmax(128 + 18 * sum, 0), 255);
}

/* A frame whose body is where `motion` says: below row 0.2, and narrower above. */
static void draw(const float motion[6]) {
  for (int i = 0; i < SIDE * SIDE; i++) {
    const double r = (2.0 * (i / SIDE) + 1) / SIDE - 1, c = (2.0 * (i % SIDE) + 1) / SIDE - 1;
    const double row = r + (double)motion[0] * r + (double)motion[1] * c + (double)motion[2];
    const double column = c + (double)motion[3] * r + (double)motion[4] * c + (double)motion[5];
    const bool body = row > 0.2 && fabs(column) < 0.3 + row;
    const uint8_t grey = (uint8_t)lround(texture(row, column));
    parts[i] = body ? ERN_PART_TORSO : r < 0.1 && fabs(c) < 0.3 ? ERN_PART_HEAD : ERN_PART_BACKGROUND;
    for (int k = 0; k < 3; k++) rgba[4 * i + k] = body ? grey : 0;
    rgba[4 * i + 3] = body ? 255 : 0;
  }
}

static void expect_motion(const float found[6], const float truth[6], double pixels) {
  static const double place[][2] = {{0.3, -0.3}, {0.3, 0.3}, {0.95, -0.9}, {0.95, 0.9}, {0.6, 0}};
  for (size_t p = 0; p < sizeof place / sizeof *place; p++)
    for (int k = 0; k < 2; k++) {
      double off = 0;
      for (int i = 0; i < 3; i++)
        off += ((double)found[3 * k + i] - (double)truth[3 * k + i]) * (i < 2 ? place[p][i] : 1);
      if (fabs(off) * SIDE / 2 > pixels) fail_msg("place %zu, axis %d: off by %.2f pixels", p, k, off * SIDE / 2);
    }
}

static void test_moved(void **state) {
  (void)state;
  static const float truth[][6] = {{0, 0, 0, 0, 0, 0},
                                   {0, 0, 0.02f, 0, 0, -0.03f},
                                   {0.03f, 0, -0.04f, 0, 0.03f, 0.01f},
                                   {0, 0.04f, 0.01f, -0.04f, 0, 0.05f},
                                   {-0.02f, 0.01f, 0.05f, 0.03f, 0.02f, -0.06f}};
  enum { FRAMES = sizeof truth / sizeof *truth };
  ern_context *context = support_context();
  struct ern_body_reference *reference = NULL;
  float motion[6];
  bool found = false;
  memset(background, 90, sizeof background);
  draw(truth[0]);
  support_ok(context, ern_body_reference_make(context, SIDE, background, rgba, parts, &reference));
  for (int mean = 0; mean < 2; mean++) { /* compared with the first frame, then with the mean of all */
    for (size_t f = 0; f < FRAMES; f++) {
      draw(truth[f]);
      support_ok(context, ern_body_reference_find(reference, rgba, parts, motion, &found));
      assert_true(found);
      expect_motion(motion, truth[f], 0.5);
      support_ok(context, ern_body_reference_add(reference, rgba, parts));
    }
    support_ok(context, ern_body_reference_mean(reference));
  }
  memset(parts, ERN_PART_HEAD, sizeof parts); /* nothing of the body */
  support_ok(context, ern_body_reference_find(reference, rgba, parts, motion, &found));
  assert_false(found);
  ern_body_reference_free(reference);
  ern_body_reference_free(NULL);
  ern_context_free(&context);
}

/* A body of one colour: no texture says where it is, and it counts as still. */
static void test_plain(void **state) {
  (void)state;
  static const float still[6] = {0};
  ern_context *context = support_context();
  struct ern_body_reference *reference = NULL;
  float motion[6];
  bool found = false;
  draw(still);
  for (int i = 0; i < SIDE * SIDE; i++) memset(rgba + 4 * i, 90, 3);
  memset(background, 90, sizeof background);
  support_ok(context, ern_body_reference_make(context, SIDE, background, rgba, parts, &reference));
  support_ok(context, ern_body_reference_find(reference, rgba, parts, motion, &found));
  if (found) expect_motion(motion, still, 0.5);
  ern_body_reference_free(reference);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_moved), cmocka_unit_test(test_plain)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
