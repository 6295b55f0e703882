/* SPDX-License-Identifier: MIT
 * The watermark (docs/watermark.md): the pattern's bytes, and that its key alone finds it. */
#include "support.h"

#include <math.h>

#include "ernerf/media.h"
#include "io/file.h"
#include "media/watermark.h"

enum { SIDE = 256 };

/* Smooth shapes and noise of RMS 4, which stands for a picture. */
static void draw(uint8_t *rgb, int width, int height, int channels) {
  uint32_t state = 1;
  for (int y = 0; y < height; y++) {
    for (int x = 0; x < width; x++) {
      double noise = 0;
      for (int i = 0; i < 4; i++) {
        state = state * 1664525U + 1013904223U;
        noise += (state >> 24) / 255.0 - 0.5;
      }
      const double wave = 128 + 60 * sin(x * 0.03) * cos(y * 0.05) + 7 * noise;
      const size_t at = ((size_t)y * (size_t)width + (size_t)x) * (size_t)channels;
      for (int c = 0; c < channels; c++) rgb[at + (size_t)c] = c == 3 ? 200 : (uint8_t)wave;
    }
  }
}

/* A marked frame as the detector takes it. key NULL: not marked. */
static ern_image make_frame(ern_context *context, const char *key, int width, int height) {
  uint8_t *rgba = malloc((size_t)width * (size_t)height * 4);
  ern_image frame = {.width = width, .height = height, .channels = 3};
  frame.data = malloc((size_t)width * (size_t)height * 3);
  assert_true(rgba != NULL && frame.data != NULL);
  draw(rgba, width, height, 4);
  if (key != NULL) {
    ern_watermark *watermark = NULL;
    support_ok(context, ern_watermark_open(context, key, width, height, &watermark));
    support_ok(context, ern_watermark_put(watermark, rgba));
    ern_watermark_free(&watermark);
  }
  for (size_t i = 0; i < (size_t)width * (size_t)height; i++) {
    memcpy(frame.data + 3 * i, rgba + 4 * i, 3);
    assert_int_equal(rgba[4 * i + 3], 200);
  }
  free(rgba);
  return frame;
}

static double search(ern_context *context, const char *key, const ern_image *frame, double *scale) {
  ern_watermark_detector *detector = NULL;
  double score = 0, false_positive = 1;
  support_ok(context, ern_watermark_detector_open(context, key, &detector));
  support_ok(context, ern_watermark_detector_frame(detector, frame));
  support_ok(context, ern_watermark_detector_search(detector, &score, &false_positive, scale));
  assert_true(isfinite(score) && false_positive >= 0 && false_positive <= 1);
  double none = 0;
  support_expect(context, ern_watermark_detector_search(detector, &none, &none, &none), ERN_E_STATE, "no frames", NULL);
  ern_watermark_detector_free(&detector);
  return false_positive;
}

static void test_found_with_its_key_alone_long(void **state) {
  (void)state;
  static const int sizes[][2] = {{301, 257}, {128, 128}, {129, 515}, {256, 256}, {640, 360}};
  const size_t count = getenv("ERNERF_TEST_LONG") != NULL ? sizeof sizes / sizeof *sizes : 3;
  ern_context *context = support_context();
  for (size_t i = 0; i < count; i++) {
    double scale = 0;
    ern_image marked = make_frame(context, "right", sizes[i][0], sizes[i][1]);
    ern_image clean = make_frame(context, NULL, sizes[i][0], sizes[i][1]);
    assert_true(search(context, "right", &marked, &scale) <= ERN_WATERMARK_FALSE_POSITIVE);
    assert_true(fabs(scale - 1) < 0.01);
    assert_true(search(context, "wrong", &marked, &scale) > ERN_WATERMARK_FALSE_POSITIVE);
    assert_true(search(context, "right", &clean, &scale) > ERN_WATERMARK_FALSE_POSITIVE);
    free(marked.data);
    free(clean.data);
  }
  ern_context_free(&context);
}

/* 90 % of each side from (17, 11) on, whose scale is 1/0.9; and half the size, whose scale is 1. */
static void test_cut_and_made_smaller(void **state) {
  (void)state;
  enum { CUT = SIDE * 9 / 10 };
  ern_context *context = support_context();
  ern_image marked = make_frame(context, "right", SIDE, SIDE), half = {0};
  static uint8_t part[CUT * CUT * 3];
  for (size_t y = 0; y < CUT; y++)
    memcpy(part + y * CUT * 3, marked.data + ((y + 11) * SIDE + 17) * 3, (size_t)CUT * 3);
  const ern_image cut = {.width = CUT, .height = CUT, .channels = 3, .data = part};
  double scale = 0;
  assert_true(search(context, "right", &cut, &scale) <= ERN_WATERMARK_FALSE_POSITIVE);
  assert_true(fabs(scale - (double)SIDE / CUT) < 0.01);
  assert_true(search(context, "wrong", &cut, &scale) > ERN_WATERMARK_FALSE_POSITIVE);
  support_ok(context, ern_image_resize(context, &marked, SIDE / 2, SIDE / 2, &half));
  assert_true(search(context, "right", &half, &scale) <= ERN_WATERMARK_FALSE_POSITIVE);
  assert_true(fabs(scale - 1) < 0.01);
  ern_image_free(context, &half);
  free(marked.data);
  ern_context_free(&context);
}

/* Integers make the pattern, so these bytes hold for each compiler and machine. */
static void test_same_bytes(void **state) {
  (void)state;
  enum { WIDTH = 321, HEIGHT = 256 };
  static uint8_t rgba[WIDTH * HEIGHT * 4];
  ern_context *context = support_context();
  ern_watermark *watermark = NULL;
  char hex[65];
  memset(rgba, 128, sizeof rgba);
  support_ok(context, ern_watermark_open(context, "a key", WIDTH, HEIGHT, &watermark));
  support_ok(context, ern_watermark_put(watermark, rgba));
  ern_sha256_hex(rgba, sizeof rgba, hex);
  assert_string_equal(hex, "fbc8856d77af94f5b1106ed77b7d08ab8f03db8fdc9ae9c96d109b3e3bdeb6a0");
  double sum = 0, squares = 0;
  for (size_t i = 0; i < sizeof rgba; i += 4) {
    const double d = rgba[i] - 128.0;
    sum += d;
    squares += d * d;
  }
  const double n = (double)WIDTH * HEIGHT;
  /* The mean over the waves of 1.2^2 (cos(pi x/512) cos(pi y/512))^2, what interpolation at the middle of two units
   * leaves, and 1/12 of rounding to whole steps: 1.402; 5 % for a width that is no whole tile. 45 dB are 2.06. */
  assert_true(squares / n > 1.33 && squares / n < 1.47);
  assert_true(fabs(sum / n) < 0.05);
  for (int i = 0; i < 256; i++) rgba[4 * i] = (uint8_t)(i < 128 ? 0 : 255);
  support_ok(context, ern_watermark_put(watermark, rgba)); /* limited, not wrapped around */
  for (int i = 0; i < 256; i++) assert_true(i < 128 ? rgba[4 * i] < 20 : rgba[4 * i] > 235);
  ern_watermark_free(&watermark);
  ern_context_free(&context);
}

static void test_list(void **state) {
  (void)state;
  static struct ern_watermark_waves waves;
  size_t count = 0;
  for (int x = 0; x <= 64; x++)
    for (int y = -64; y <= 64; y++) count += x * x + y * y >= 24 * 24 && x * x + y * y <= 64 * 64 && (x > 0 || y > 0);
  assert_int_equal(count, ERN_WATERMARK_WAVES);
  ern_watermark_list(&waves);
  for (size_t k = 1; k < count; k++)
    assert_true(waves.x[k] > waves.x[k - 1] || (waves.x[k] == waves.x[k - 1] && waves.y[k] > waves.y[k - 1]));
}

/* Of 200 wrong keys at one scale: the law of the score at one place has variance 1 at most, so its greatest over 65,536
 * places is about 4.4; the bound at 6.2 for all of them together is 200 65,536 e^(-19.2) = 0.06. */
static void test_wrong_keys(void **state) {
  (void)state;
  ern_context *context = support_context();
  static float mean[SIDE * SIDE];
  static ern_watermark_spectrum spectrum;
  static struct ern_watermark_code code;
  ern_image marked = make_frame(context, "right", SIDE, SIDE);
  for (size_t i = 0; i < SIDE * SIDE; i++) mean[i] = marked.data[3 * i];
  const double scale = 1;
  support_ok(context, ern_watermark_spectra(context, mean, SIDE, SIDE, &scale, 1, &spectrum));
  double least = INFINITY, most = 0, score;
  for (int i = 0; i < 200; i++) {
    char key[16];
    snprintf(key, sizeof key, "wrong %d", i);
    support_ok(context, ern_watermark_code_make(context, key, &code));
    support_ok(context, ern_watermark_peak(context, spectrum, &code, &score));
    least = fmin(least, score);
    most = fmax(most, score);
  }
  assert_true(least > 3 && most < 6.2);
  support_ok(context, ern_watermark_code_make(context, "right", &code));
  support_ok(context, ern_watermark_peak(context, spectrum, &code, &score));
  assert_true(score > 20);
  free(marked.data);
  ern_context_free(&context);
}

static void test_blank(void **state) {
  (void)state;
  ern_context *context = support_context();
  static uint8_t pixels[64 * 80 * 3];
  const ern_image frame = {.width = 64, .height = 80, .channels = 3, .data = pixels};
  double scale = 0;
  assert_true(search(context, "any", &frame, &scale) == 1);
  memset(pixels, 255, sizeof pixels);
  assert_true(search(context, "any", &frame, &scale) == 1);
  ern_context_free(&context);
}

static void test_refused(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_watermark *watermark = NULL;
  ern_watermark_detector *detector = NULL;
  char key[ERN_WATERMARK_KEY_BYTES + 1];
  memset(key, 'k', sizeof key);
  key[ERN_WATERMARK_KEY_BYTES] = 0;
  support_expect(context, ern_watermark_open(context, key, SIDE, SIDE, &watermark), ERN_E_ARGUMENT, "255", NULL);
  support_expect(context, ern_watermark_open(context, "", SIDE, SIDE, &watermark), ERN_E_ARGUMENT, "0 bytes", NULL);
  support_expect(context, ern_watermark_detector_open(context, key, &detector), ERN_E_ARGUMENT, "255", NULL);
  key[ERN_WATERMARK_KEY_BYTES - 1] = 0;
  support_ok(context, ern_watermark_open(context, key, SIDE, SIDE, &watermark));
  ern_watermark_free(&watermark);
  support_ok(context, ern_watermark_open(context, "\xff%s\n", SIDE, SIDE, &watermark));
  ern_watermark_free(&watermark);
  support_expect(context, ern_watermark_open(context, "a", 127, SIDE, &watermark), ERN_E_SHAPE, "127 x 256", NULL);
  assert_null(watermark);
  support_expect(context, ern_watermark_open(context, "a", SIDE, -1, &watermark), ERN_E_SHAPE, NULL);
  support_expect(context, ern_watermark_open(context, "a", SIDE, 1 << 30, &watermark), ERN_E_SHAPE, NULL);
  support_ok(context, ern_watermark_detector_open(context, "a", &detector));
  static uint8_t pixels[64 * 65 * 4];
  ern_image frame = {.width = 63, .height = 64, .channels = 3, .data = pixels};
  support_expect(context, ern_watermark_detector_frame(detector, &frame), ERN_E_SHAPE, "63 x 64", NULL);
  frame.width = 64;
  support_ok(context, ern_watermark_detector_frame(detector, &frame));
  frame.height = 65;
  support_expect(context, ern_watermark_detector_frame(detector, &frame), ERN_E_SHAPE, "64 x 65", "64 x 64", NULL);
  frame.channels = 4;
  support_expect(context, ern_watermark_detector_frame(detector, &frame), ERN_E_SHAPE, "4 channels", NULL);
  ern_watermark_detector_free(&detector);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_found_with_its_key_alone_long),
                                     cmocka_unit_test(test_cut_and_made_smaller),
                                     cmocka_unit_test(test_same_bytes),
                                     cmocka_unit_test(test_list),
                                     cmocka_unit_test(test_wrong_keys),
                                     cmocka_unit_test(test_blank),
                                     cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
