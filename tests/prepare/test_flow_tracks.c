/* SPDX-License-Identifier: MIT
 * Points followed by optical flow: a picture that is shifted, turned and enlarged by known amounts, and pictures that
 * hold nothing to follow. */
#include "prepare/pose/flow_tracks.h"
#include "prepare_test.h"

enum { SIDE = 256, WAVES = 40 };
static uint8_t first[SIDE * SIDE], other[SIDE * SIDE];

/* Smooth texture with waves of 8 to 60 pixels, as a function of the place. */
static double texture(double x, double y) {
  static double wave[WAVES][3];
  if (wave[0][0] == 0) {
    uint64_t random = 4;
    for (int i = 0; i < WAVES; i++) {
      const double length = 8 + 26 * (1 + made_random(&random)), angle = 3.14159 * made_random(&random);
      wave[i][0] = 6.2832 / length * cos(angle);
      wave[i][1] = 6.2832 / length * sin(angle);
      wave[i][2] = 3.14159 * made_random(&random);
    }
  }
  double sum = 0;
  for (int i = 0; i < WAVES; i++) sum += sin(wave[i][0] * x + wave[i][1] * y + wave[i][2]);
  return fmin(fmax(128 + 18 * sum, 0), 255);
}

/* The picture whose pixel p shows what `first` has at the place that `warp` brings to p. */
static void draw(uint8_t grey[SIDE * SIDE], const double warp[4]) {
  const double square = warp[0] * warp[0] + warp[1] * warp[1];
  for (int i = 0; i < SIDE * SIDE; i++) {
    const double x = i % SIDE - warp[2], y = i / SIDE - warp[3];
    grey[i] = (uint8_t)lround(texture((warp[0] * x + warp[1] * y) / square, (warp[0] * y - warp[1] * x) / square));
  }
}

static bool keep_left(const void *user, float x, float y) {
  (void)y;
  return x < *(const float *)user;
}

static const struct ern_flow_region middle = {48, 48, 160, 160};
static const float edge = 150;

static void test_followed(void **state) {
  (void)state;
  static const double none[4] = {1, 0, 0, 0};
  static const double warps[][4] = {
      {1, 0, 0, 0}, {1, 0, 3.4, -2.6}, {1.03, 0, -4, -3}, {0.999, 0.05, 6, -7}, {1, 0, 20, 12}};
  ern_context *context = support_context();
  struct ern_flow_reference *reference = NULL;
  const float(*points)[2] = NULL;
  static float seen[4096][2];
  draw(first, none);
  support_ok(context, ern_flow_reference_make(context, "clip", first, SIDE, middle, keep_left, &edge, &reference));
  const size_t count = ern_flow_reference_points(reference, &points);
  assert_in_range(count, 200, 4096);
  for (size_t i = 0; i < count; i++)
    assert_true(points[i][0] >= 48 && points[i][0] < 150 && points[i][1] >= 48 && points[i][1] < 208);
  for (size_t w = 0; w < sizeof warps / sizeof *warps; w++) {
    const double *truth = warps[w];
    /* expected: where it is, to some pixels; the last one is told of */
    double warp[4] = {1, 0, w == 4 ? 18 : 0, w == 4 ? 14 : 0};
    size_t near = 0, held = 0;
    draw(other, truth);
    support_ok(context, ern_flow_reference_find(reference, other, warp, seen));
    for (size_t i = 0; i < count; i++) {
      if (isnan(seen[i][0])) continue;
      const double x = (double)points[i][0], y = (double)points[i][1];
      const double away = hypot((double)seen[i][0] - (truth[0] * x - truth[1] * y + truth[2]),
                                (double)seen[i][1] - (truth[1] * x + truth[0] * y + truth[3]));
      held++;
      near += away < 0.3;
    }
    if (10 * held < 7 * count || 100 * near < 95 * held)
      fail_msg("warp %zu: %zu of %zu points held, %zu within 0.3 pixels", w, held, count, near);
    for (int c = 0; c < 4; c++)
      if (fabs(warp[c] - truth[c]) > (c < 2 ? 0.003 : 0.4))
        fail_msg("warp %zu: number %d is %.4f, expected %.4f", w, c, warp[c], truth[c]);
  }
  ern_flow_reference_free(&reference);
  assert_null(reference);
  ern_flow_reference_free(&reference);
  ern_flow_reference_free(NULL);
  ern_context_free(&context);
}

/* Nothing to follow: no points, or points that are lost, and the expected warp stays. */
static void test_nothing(void **state) {
  (void)state;
  static const double none[4] = {1, 0, 0, 0};
  static const uint8_t levels[] = {0, 128, 255};
  ern_context *context = support_context();
  struct ern_flow_reference *reference = NULL;
  const float(*points)[2] = NULL;
  static float seen[4096][2];
  double warp[4] = {1, 0, 5, 6};
  draw(first, none);
  for (size_t i = 0; i < sizeof levels / sizeof *levels; i++) {
    memset(other, levels[i], sizeof other);
    support_ok(context, ern_flow_reference_make(context, "clip", other, SIDE, middle, keep_left, &edge, &reference));
    assert_int_equal(ern_flow_reference_points(reference, &points), 0);
    support_ok(context, ern_flow_reference_find(reference, first, warp, seen));
    assert_true(warp[0] == 1 && warp[1] == 0 && warp[2] == 5 && warp[3] == 6);
    ern_flow_reference_free(&reference);
  }
  const float nowhere = -1; /* nothing is wanted */
  support_ok(context, ern_flow_reference_make(context, "clip", first, SIDE, middle, keep_left, &nowhere, &reference));
  assert_int_equal(ern_flow_reference_points(reference, &points), 0);
  ern_flow_reference_free(&reference);
  /* warps that lead nowhere */
  const double bad[][4] = {{NAN, 0, 0, 0},  {1, 0, NAN, 0},   {0, 0, 0, 0},
                           {1e30, 0, 0, 0}, {1, 0, 1e9, 1e9}, {1, 0, -INFINITY, 0}};
  support_ok(context, ern_flow_reference_make(context, "clip", first, SIDE, middle, keep_left, &edge, &reference));
  for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
    memcpy(warp, bad[i], sizeof warp);
    const ern_status status = ern_flow_reference_find(reference, first, warp, seen);
    if (status != ERN_OK) assert_true(strlen(ern_last_error(context)) > 0);
  }
  ern_flow_reference_free(&reference);
  ern_context_free(&context);
}

static void test_regions(void **state) {
  (void)state;
  static const double none[4] = {1, 0, 0, 0};
  static const struct {
    struct ern_flow_region region;
    bool fine;
  } regions[] = {{{0, 0, SIDE, SIDE}, true},   {{-500, -500, 2000, 2000}, true}, {{0, 0, 32, 32}, true},
                 {{224, 224, 900, 900}, true}, {{0, 0, 31, 200}, false},         {{300, 0, 100, 100}, false},
                 {{-90, -90, 80, 80}, false},  {{50, 50, -40, 60}, false},       {{0, 0, 0, 0}, false}};
  ern_context *context = support_context();
  static float seen[4096][2];
  draw(first, none);
  for (size_t i = 0; i < sizeof regions / sizeof *regions; i++) {
    struct ern_flow_reference *reference = NULL;
    const float wide = 1e9f, (*points)[2] = NULL;
    double warp[4] = {1, 0, 0, 0};
    const ern_status status =
        ern_flow_reference_make(context, "clip", first, SIDE, regions[i].region, keep_left, &wide, &reference);
    if (!regions[i].fine) {
      support_expect(context, status, ERN_E_SHAPE, "clip: ", "region", "at least 32 a side: where the head leaves",
                     NULL);
    } else {
      support_ok(context, status);
      assert_in_range(ern_flow_reference_points(reference, &points), 1, 4096);
      support_ok(context, ern_flow_reference_find(reference, first, warp, seen));
    }
    ern_flow_reference_free(&reference);
  }
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_followed), cmocka_unit_test(test_nothing),
                                     cmocka_unit_test(test_regions)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
