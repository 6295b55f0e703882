/* SPDX-License-Identifier: MIT
 * Silence told from features and loudness of any size, and a rate that is held whatever a clock says
 * (docs/numerics.md). */
#include <float.h>

#include "ernerf/render.h"
#include "made_speech.h"

static const int learnt_from[] = {20, 45, 80, 85, 100, 120, MADE_FRAMES};

/* Rest of a speech whose silence was learnt from itself. */
static ern_status rest_of(ern_context *context, struct made_speech *s, const float *loudness) {
  ern_silence *silence = NULL;
  ern_status status = ern_silence_learn(context, &s->features, loudness, &silence);
  if (status == ERN_OK) status = ern_silence_weights(silence, &s->features, s->weight);
  ern_silence_free(&silence);
  return status;
}

static void expect_same_weights(const char *what, double size, const float *weights, const float *expected) {
  for (int t = 0; t < MADE_FRAMES; t++)
    if (weights[t] != expected[t])
      fail_msg("%s %g: frame %d has weight %g, expected %g", what, size, t, (double)weights[t], (double)expected[t]);
}

static void scale_features(struct made_speech *s, float scale) {
  for (size_t i = 0; i < MADE_FRAMES * (size_t)s->features.window_length * (size_t)s->features.width; i++)
    s->features.data[i] *= scale;
}

/* case: features times 2^90, 2^40, 2^-20 | plain code: squares leave float | here: the same frames at rest: double, a
 * relative level | bound: exact */
/* A power of two changes no digit of what is computed in double. */
static void test_silence_in_features_of_any_size(void **state) {
  (void)state;
  static const float scales[] = {0x1p90f, 0x1p40f, 0x1p-20f};
  static struct made_speech s;
  float expected[2][MADE_FRAMES];
  ern_context *context = support_context();
  for (size_t k = 0; k <= sizeof scales / sizeof *scales; k++) {
    made_speech(&s, 4, 12, 3, learnt_from);
    if (k > 0) scale_features(&s, scales[k - 1]);
    for (int heard = 0; heard < 2; heard++) {
      support_ok(context, rest_of(context, &s, heard ? s.loudness : NULL));
      if (k == 0) memcpy(expected[heard], s.weight, sizeof s.weight);
      expect_same_weights("features times", k > 0 ? (double)scales[k - 1] : 1, s.weight, expected[heard]);
    }
    free(s.features.data);
  }
  float most = 0;
  for (int t = 0; t < MADE_FRAMES; t++) most = fmaxf(most, expected[0][t]);
  assert_true(most == 1);
  ern_context_free(&context);
}

/* case: features that never change | plain code: 0/0 | here: refused: they tell nothing apart | bound: 0.0 dB */
/* Features that never change, and those that are all 0, tell nothing; and say so. */
static void test_silence_in_features_that_stand_still(void **state) {
  (void)state;
  static struct made_speech s;
  ern_context *context = support_context();
  for (int k = 0; k < 3; k++) {
    made_speech(&s, 4, 12, 3, learnt_from);
    for (size_t i = 0; i < MADE_FRAMES * 4 * 12; i++) s.features.data[i] = k == 0 ? 0 : k == 1 ? 1e30f : -FLT_MIN;
    support_expect(context, rest_of(context, &s, NULL), ERN_E_STATE, "silence", "differ by 0.0 dB", NULL);
    support_expect(context, rest_of(context, &s, s.loudness), ERN_E_STATE, "silence", "of the frames correctly", NULL);
    free(s.features.data);
  }
  ern_context_free(&context);
}

/* case: loudness of -infinity, -3e38, NaN, +-infinity in turn | plain code: infinite means | here: levels end 60 dB
 * under a loud frame; NaN is not quiet; nothing but such is refused | bound: exact */
/* Digital silence has no level in dB; a meter that failed says NaN: such a frame counts as loud. */
static void test_silence_of_loudness_without_end(void **state) {
  (void)state;
  static struct made_speech s;
  float loudness[MADE_FRAMES], expected[MADE_FRAMES];
  ern_context *context = support_context();
  made_speech(&s, 4, 12, 3, learnt_from);
  support_ok(context, rest_of(context, &s, s.loudness));
  memcpy(expected, s.weight, sizeof expected);
  for (int t = 0; t < MADE_FRAMES; t++) loudness[t] = s.loudness[t] < 40 ? -INFINITY : s.loudness[t];
  support_ok(context, rest_of(context, &s, loudness));
  expect_same_weights("quiet frames of", -INFINITY, s.weight, expected);
  for (int t = 0; t < MADE_FRAMES; t++) loudness[t] = s.loudness[t] < 40 ? -FLT_MAX : s.loudness[t];
  support_ok(context, rest_of(context, &s, loudness));
  expect_same_weights("quiet frames of", -(double)FLT_MAX, s.weight, expected);
  for (int t = 0; t < MADE_FRAMES; t++) loudness[t] = t == 5 || t == 60 ? NAN : s.loudness[t];
  support_ok(context, rest_of(context, &s, loudness));
  expect_same_weights("two frames of", NAN, s.weight, expected);
  for (int t = 0; t < MADE_FRAMES; t++) loudness[t] = t % 2 == 0 ? INFINITY : -INFINITY;
  support_expect(context, rest_of(context, &s, loudness), ERN_E_STATE, "silence", NULL);
  for (int t = 0; t < MADE_FRAMES; t++) loudness[t] = NAN;
  support_expect(context, rest_of(context, &s, loudness), ERN_E_STATE, "silence", NULL);
  free(s.features.data);
  ern_context_free(&context);
}

/* case: frames that took NaN, 0, -1, 1e-300, 1e300 ms | plain code: the mean never comes back | here: passed over or
 * held near the mean; the rate is held again after two seconds | bound: setting of before */
/* After minutes of nonsense, two seconds of usual frames bring back what held before. */
static void test_rate_of_a_clock_gone_wrong(void **state) {
  (void)state;
  static const double cost[] = {60, 30, 12};
  static const double times[] = {-1, 0, NAN, INFINITY, -INFINITY, 1e-300, 1e300, DBL_MAX, 4.9e-324};
  enum { TIMES = sizeof times / sizeof *times, RECOVERY = 60 };
  ern_rate_controller pace;
  ern_rate_controller_begin(&pace, cost, 3, 40);
  assert_int_equal(pace.at, 1);
  for (int f = 0; f < 5000; f++) {
    assert_true(ern_rate_controller_next(&pace, times[f * 7 % TIMES]) < 3 && pace.at < 3);
    assert_true(isfinite(pace.slowness) && pace.slowness > 0 && isfinite(pace.late));
  }
  for (int f = 0; f < RECOVERY; f++) ern_rate_controller_next(&pace, cost[pace.at]);
  assert_int_equal(pace.at, 1);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_silence_in_features_of_any_size),
                                     cmocka_unit_test(test_silence_in_features_that_stand_still),
                                     cmocka_unit_test(test_silence_of_loudness_without_end),
                                     cmocka_unit_test(test_rate_of_a_clock_gone_wrong)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
