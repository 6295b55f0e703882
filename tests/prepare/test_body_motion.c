/* SPDX-License-Identifier: MIT
 * Where the body is: a body that is moved, turned, enlarged and bent by known amounts below a head that moves
 * otherwise, and frames that show too little of it. */
#include "prepare/layers/layers.h"
#include "prepare_test.h"

enum { SIDE = 192, WAVES = 40 };

static uint8_t background[SIDE * SIDE * 3], rgba[SIDE * SIDE * 4], parts[SIDE * SIDE];

/* What the body shows: smooth texture with waves of 8 to 60 pixels; or plain cloth with some faint edges, and noise. */
static bool plain_cloth;

/* Grey level, as a function of the place in the body, in half sides. */
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
  const int waves = plain_cloth ? 6 : WAVES;
  for (int i = 0; i < waves; i++) sum += sin(wave[i][0] * row + wave[i][1] * column + wave[i][2]);
  if (plain_cloth) return 128 + 15 * tanh(2 * sum);
  return fmin(fmax(128 + 18 * sum, 0), 255);
}

struct truth {
  double affine[6], bend;
};

/* The displacement of a point, half sides: by a_0 r + a_1 c + a_2 and a_3 r + a_4 c + a_5, and a shoulder that is
 * lifted. */
static void displacement(double by[2], const struct truth *t, double r, double c) {
  const double *a = t->affine;
  by[0] = a[0] * r + a[1] * c + a[2] + t->bend * sin(2.5 * c);
  by[1] = a[3] * r + a[4] * c + a[5];
}

/* A frame whose body is where `truth` says: below row 0.2, and narrower above. */
static void draw(const struct truth *truth) {
  static uint64_t random = 9;
  const double noise = plain_cloth ? 4 : 0; /* uniform from -noise to noise */
  for (int i = 0; i < SIDE * SIDE; i++) {
    const double r = (2.0 * (i / SIDE) + 1) / SIDE - 1, c = (2.0 * (i % SIDE) + 1) / SIDE - 1;
    double by[2];
    displacement(by, truth, r, c);
    const double row = r + by[0], column = c + by[1];
    const bool body = row > 0.2 && fabs(column) < 0.3 + row;
    const uint8_t grey = (uint8_t)lround(texture(row, column) + noise * made_random(&random));
    parts[i] = body ? ERN_PART_TORSO : r < 0.1 && fabs(c) < 0.3 ? ERN_PART_HEAD : ERN_PART_BACKGROUND;
    for (int k = 0; k < 3; k++) rgba[4 * i + k] = body ? grey : 0;
    rgba[4 * i + 3] = body ? 255 : 0;
  }
}

/* pixels: the most that a control point may be off by along an axis. Returns its mean square. */
static double expect_motion(const float found[ERN_MOTION_VALUES], const struct truth *truth, double pixels) {
  double squares = 0;
  enum { LAST = ERN_MOTION_SIDE - 1 };
  static const int place[][2] = {{10, 5}, {10, 10}, {14, 2}, {14, 13}, {12, 7}, {11, 4}, {13, 10}}; /* control points */
  for (size_t p = 0; p < sizeof place / sizeof *place; p++)
    for (int k = 0; k < 2; k++) {
      double by[2];
      displacement(by, truth, 2.0 * place[p][0] / LAST - 1, 2.0 * place[p][1] / LAST - 1);
      const size_t at = (size_t)((k * ERN_MOTION_SIDE + place[p][0]) * ERN_MOTION_SIDE + place[p][1]);
      const double off = ((double)found[at] - by[k]) * SIDE / 2;
      if (!(fabs(off) <= pixels)) fail_msg("place %zu, axis %d: off by %.2f pixels", p, k, off);
      squares += off * off;
    }
  return squares / (double)(2 * sizeof place / sizeof *place);
}

static const struct truth truths[] = {{{0, 0, 0, 0, 0, 0}, 0},
                                      {{0, 0, 0.02, 0, 0, -0.03}, 0},
                                      {{0.03, 0, -0.04, 0, 0.03, 0.01}, 0},
                                      {{0, 0.04, 0.01, -0.04, 0, 0.05}, 0},
                                      {{-0.02, 0.01, 0.05, 0.03, 0.02, -0.06}, 0},
                                      {{0, 0, 0.01, 0, 0, 0.01}, 0.03}};
enum { FRAMES = sizeof truths / sizeof *truths };

/* A frame with its light: from `dim` of all of it in the first to all of it in the last. */
static void draw_frame(size_t frame, double dim) {
  const double light = dim + (1 - dim) * (double)frame / (FRAMES - 1);
  draw(&truths[frame]);
  for (int i = 0; i < 4 * SIDE * SIDE; i++)
    if (i % 4 < 3) rgba[i] = (uint8_t)lround(light * rgba[i]);
}

/* The root mean square of how far control points are off, pixels: compared with the first frame, then with the mean of
 * all. */
static double moved(ern_context *context, double pixels, double dim) {
  struct ern_body_reference *reference = NULL;
  float motion[ERN_MOTION_VALUES];
  double squares = 0;
  bool found = false;
  memset(background, 90, sizeof background);
  draw_frame(0, dim);
  support_ok(context, ern_body_reference_make(context, SIDE, background, rgba, parts, &reference));
  for (int mean = 0; mean < 2; mean++) {
    for (size_t f = 0; f < FRAMES; f++) {
      draw_frame(f, dim);
      support_ok(context, ern_body_reference_find(reference, rgba, parts, motion, &found));
      assert_true(found);
      squares += expect_motion(motion, &truths[f], pixels);
      support_ok(context, ern_body_reference_add(reference, rgba, parts));
    }
    support_ok(context, ern_body_reference_mean(reference));
  }
  memset(parts, ERN_PART_HEAD, sizeof parts); /* nothing of the body */
  support_ok(context, ern_body_reference_find(reference, rgba, parts, motion, &found));
  assert_false(found);
  ern_body_reference_free(reference);
  ern_body_reference_free(NULL);
  return sqrt(squares / (2 * FRAMES));
}

static void test_moved(void **state) {
  (void)state;
  ern_context *context = support_context();
  assert_true(moved(context, 0.5, 1) <= 0.1);
  ern_context_free(&context);
}

/* Light that changes is no motion. */
static void test_light(void **state) {
  (void)state;
  ern_context *context = support_context();
  const double off = moved(context, 1, 0.6);
  if (!(off <= 0.1)) fail_msg("off by %.3f pixels", off);
  ern_context_free(&context);
}

/* Flow alone finds this body to 0.24 pixels: it knows little of plain cloth, and does not weigh what its edges tell. */
static void test_plain_cloth(void **state) {
  (void)state;
  ern_context *context = support_context();
  plain_cloth = true;
  const double off = moved(context, 1.5, 1);
  plain_cloth = false;
  if (!(off <= 0.18)) fail_msg("off by %.3f pixels", off);
  ern_context_free(&context);
}

/* A body of one colour: no texture says where it is, and it counts as still. */
static void test_plain(void **state) {
  (void)state;
  static const struct truth still = {0};
  ern_context *context = support_context();
  struct ern_body_reference *reference = NULL;
  float motion[ERN_MOTION_VALUES];
  bool found = false;
  draw(&still);
  for (int i = 0; i < SIDE * SIDE; i++) memset(rgba + 4 * i, 90, 3);
  memset(background, 90, sizeof background);
  support_ok(context, ern_body_reference_make(context, SIDE, background, rgba, parts, &reference));
  support_ok(context, ern_body_reference_find(reference, rgba, parts, motion, &found));
  if (found) (void)expect_motion(motion, &still, 0.5);
  ern_body_reference_free(reference);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_moved), cmocka_unit_test(test_light),
                                     cmocka_unit_test(test_plain_cloth), cmocka_unit_test(test_plain)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
