/* SPDX-License-Identifier: MIT
 * Hard sounds through the embedded speech features: every value stays a number of ordinary size. */
#include "../support.h"

#include <math.h>

#include "ernerf/speech.h"

enum { WIDTH = ERN_SPEECH_WIDTH, RATE = 16000, HOP = 320, ROWS = 60 };

/* The features are logarithms of powers between 0.001 and some 1e3 of the level, brought to mean 0 and deviation 1. */
static const double most = 20;

/* Rows of `count` samples, which must be one for each 20 ms that have begun. */
static size_t hear(const float *samples, size_t count, float rows[ROWS * WIDTH]) {
  ern_context *context = support_context();
  ern_speech_stream *stream = NULL;
  support_ok(context, ern_speech_stream_open(context, RATE, 1, 1, &stream));
  support_ok(context, ern_speech_stream_push(stream, samples, count));
  support_ok(context, ern_speech_stream_end(stream));
  const size_t made = ern_speech_stream_pull(stream, rows, ROWS);
  assert_int_equal(made, (count + HOP - 1) / HOP);
  for (size_t i = 0; i < made * WIDTH; i++)
    if (!(fabs((double)rows[i]) < most)) fail_msg("value %zu of %zu samples: %g", i, count, (double)rows[i]);
  ern_speech_stream_free(&stream);
  ern_context_free(&context);
  return made;
}

/* case: a sound of zeros, denormals, a constant | plain code: logarithm of 0; 0/0 | here: a level of at least -50 dB, a
 * floor of 0.001 of it, a row's mean taken off | bound: values under 20; the same as of zeros */
/* Zeros, values that are 0 when squared, and a constant are all the same: nothing is heard. */
static void test_sound_of_nothing(void **state) {
  (void)state;
  static const float values[] = {0, -0.0f, 1e-45f, 1e-30f, 1, -1e6f};
  static float samples[RATE], silence[ROWS * WIDTH], rows[ROWS * WIDTH];
  for (size_t v = 0; v < sizeof values / sizeof *values; v++) {
    for (size_t i = 0; i < RATE; i++) samples[i] = values[v];
    const size_t made = hear(samples, RATE, v == 0 ? silence : rows);
    for (size_t r = 1; v > 0 && r + 1 < made; r++) /* at the ends a constant is a step */
      for (size_t q = 0; q < WIDTH && fabsf(values[v]) < 1; q++)
        assert_true(rows[r * WIDTH + q] == silence[r * WIDTH + q]);
  }
}

/* case: full scale at half the rate, single samples, a million times full scale | plain code: powers out of range |
 * here: features relative to the level | bound: 1e-3 */
/* Full scale at half the rate, single samples of it, and 120 dB over it: features do not depend on the gain. */
static void test_sound_of_full_scale(void **state) {
  (void)state;
  static float samples[RATE], rows[ROWS * WIDTH], louder[ROWS * WIDTH];
  for (int kind = 0; kind < 2; kind++) {
    for (size_t i = 0; i < RATE; i++) samples[i] = kind == 0 ? (i % 2 == 0 ? 1.0f : -1.0f) : i % 1000 == 0 ? 1.0f : 0;
    const size_t made = hear(samples, RATE, rows);
    for (size_t i = 0; i < RATE; i++) samples[i] *= 1e6f;
    assert_int_equal(hear(samples, RATE, louder), made);
    for (size_t i = 0; i < made * WIDTH; i++) assert_true(fabsf(rows[i] - louder[i]) < 1e-3f);
  }
}

/* case: a sound of one sample, of a row and one more or less | plain code: a row of no samples | here: zeros behind the
 * sound | bound: one row for each 20 ms begun */
/* One sample, and one more or less than a row's. */
static void test_sound_of_one_sample(void **state) {
  (void)state;
  static float samples[HOP + 1], rows[ROWS * WIDTH];
  static const size_t counts[] = {1, HOP - 1, HOP, HOP + 1};
  for (size_t i = 0; i <= HOP; i++) samples[i] = 0.5f;
  for (size_t c = 0; c < 4; c++) (void)hear(samples, counts[c], rows);
}

/* case: a NaN, infinity, 1e7 in a sound | plain code: the level is lost | here: refused with its time; rows before it
 * stay | bound: exact */
/* What is no number is refused with its time, and what was pushed before it stays. */
static void test_sound_with_a_nan(void **state) {
  (void)state;
  static const float odd[] = {NAN, INFINITY, -INFINITY, 1e7f};
  for (size_t k = 0; k < sizeof odd / sizeof *odd; k++) {
    ern_context *context = support_context();
    ern_speech_stream *stream = NULL;
    float samples[HOP] = {0}, row[WIDTH];
    support_ok(context, ern_speech_stream_open(context, RATE, 1, 1, &stream));
    support_ok(context, ern_speech_stream_push(stream, samples, HOP));
    samples[160] = odd[k];
    support_expect(context, ern_speech_stream_push(stream, samples, HOP), k < 3 ? ERN_E_NONFINITE : ERN_E_FORMAT,
                   "at 0.030 s", NULL);
    support_ok(context, ern_speech_stream_end(stream));
    assert_true(ern_speech_stream_pull(stream, row, 1) == 1 && isfinite(row[0]));
    ern_speech_stream_free(&stream);
    ern_context_free(&context);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_sound_of_nothing), cmocka_unit_test(test_sound_of_full_scale),
      cmocka_unit_test(test_sound_of_one_sample), cmocka_unit_test(test_sound_with_a_nan)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
