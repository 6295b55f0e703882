/* SPDX-License-Identifier: MIT
 * A small picture drawn larger: the reference against the definition (a sum of 16 points in double). */
#include "kernelcheck.h"

#include "core/kernels.h"

enum { CHANNELS = 4, MOST = 300 };

/* Keys (1981), a = -1/2, at a distance; straight from the paper. */
static double keys(double x) {
  x = fabs(x);
  if (x >= 2) return 0;
  return x < 1 ? 1.5 * x * x * x - 2.5 * x * x + 1 : -0.5 * x * x * x + 2.5 * x * x - 4 * x + 2;
}

struct scene {
  int width, height, small_width, small_height;
  float ratio, *small, *background;
};

static double clamped(double value, double most) { return fmin(fmax(value, 0), most); }

static double point(const struct scene *s, int c, int x, int y) {
  /* positions are float in every build */
  const float at_x = ((float)x + 0.5f) * s->ratio - 0.5f, at_y = ((float)y + 0.5f) * s->ratio - 0.5f;
  double sum = 0;
  for (int j = (int)floorf(at_y) - 1; j <= (int)floorf(at_y) + 2; j++)
    for (int i = (int)floorf(at_x) - 1; i <= (int)floorf(at_x) + 2; i++) {
      const int column = i < 0 ? 0 : i >= s->small_width ? s->small_width - 1 : i;
      const int row = j < 0 ? 0 : j >= s->small_height ? s->small_height - 1 : j;
      sum += keys((double)at_x - i) * keys((double)at_y - j) *
             (double)s->small[(c * s->small_height + row) * s->small_width + column];
    }
  return sum;
}

static double expected_at(const struct scene *s, int c, int x, int y, bool over) {
  if (!over) return point(s, c, x, y);
  const double opacity = clamped(point(s, 3, x, y), 1);
  const size_t pixels = (size_t)s->width * (size_t)s->height, i = (size_t)y * (size_t)s->width + (size_t)x;
  return c == 3 ? opacity
                : clamped(point(s, c, x, y), opacity) + (1 - opacity) * (double)s->background[(size_t)c * pixels + i];
}

/* 16 products of values in [-1, 2] and weights whose magnitudes sum to at most 1.25^2: some tens of roundings of 6e-8,
 * and weights that are rounded polynomials. */
static const double rounding = 1e-5;

static void check(int width, int height, float ratio, bool over) {
  struct scene s = {.width = width,
                    .height = height,
                    .small_width = (int)ceilf((float)width * ratio),
                    .small_height = (int)ceilf((float)height * ratio),
                    .ratio = ratio};
  const size_t pixels = (size_t)width * (size_t)height, few = (size_t)s.small_width * (size_t)s.small_height;
  s.small = malloc(CHANNELS * few * sizeof *s.small);
  s.background = malloc(3 * pixels * sizeof *s.background);
  assert_true(s.small != NULL && s.background != NULL);
  for (size_t i = 0; i < CHANNELS * few; i++)
    s.small[i] = 3 * ern_uniform(ern_random_at(3, 0, (uint32_t)i, ERN_RNG_INIT).word[0]) - 1;
  for (size_t i = 0; i < 3 * pixels; i++)
    s.background[i] = ern_uniform(ern_random_at(4, 0, (uint32_t)i, ERN_RNG_INIT).word[0]);
  const size_t stride = pixels + 5;
  struct guarded large = guarded_make(CHANNELS * stride);
  const struct ern_enlarge_view view = {.large = large.data,
                                        .small = s.small,
                                        .background = over ? s.background : NULL,
                                        .large_stride = stride,
                                        .small_stride = few,
                                        .background_stride = pixels,
                                        .channels = CHANNELS,
                                        .width = width,
                                        .small_width = s.small_width,
                                        .small_height = s.small_height,
                                        .ratio = ratio};
  ern_enlarge_ref(&view, 0, height / 2);
  ern_enlarge_ref(&view, height / 2, height);
  guarded_check(&large, CHANNELS, stride, pixels, "enlarge");
  for (int c = 0; c < CHANNELS; c++)
    for (int y = 0; y < height; y++)
      for (int x = 0; x < width; x++) {
        const double found = (double)large.data[(size_t)c * stride + (size_t)y * (size_t)width + (size_t)x];
        const double expected = expected_at(&s, c, x, y, over);
        if (!(fabs(found - expected) <= rounding))
          fail_msg("%d x %d times %g, channel %d at (%d, %d): %.9g, expected %.9g", width, height, (double)ratio, c, x,
                   y, found, expected);
      }
  guarded_free(&large);
  free(s.small);
  free(s.background);
}

static void test_definition(void **state) {
  (void)state;
  static const int sides[][2] = {{1, 1}, {2, 1}, {3, 7}, {64, 5}, {127, 4}, {128, 3}, {129, 9}, {257, 6}, {MOST, 40}};
  static const float ratios[] = {0.25f, 0.3f, 0.5f, 0.6180340f, 0.75f, 0.99f, 1};
  for (size_t i = 0; i < sizeof sides / sizeof *sides; i++)
    for (size_t k = 0; k < sizeof ratios / sizeof *ratios; k++)
      for (int over = 0; over < 2; over++) check(sides[i][0], sides[i][1], ratios[k], over != 0);
}

/* At ratio 1 every pixel falls on its own: the weights are 0 1 0 0 exactly. */
static void test_nothing_to_enlarge(void **state) {
  (void)state;
  enum { WIDTH = 130, HEIGHT = 3, PIXELS = WIDTH * HEIGHT };
  static float small[PIXELS], large[PIXELS];
  for (int i = 0; i < PIXELS; i++) small[i] = sinf((float)i);
  const struct ern_enlarge_view view = {.large = large,
                                        .small = small,
                                        .large_stride = PIXELS,
                                        .small_stride = PIXELS,
                                        .channels = 1,
                                        .width = WIDTH,
                                        .small_width = WIDTH,
                                        .small_height = HEIGHT,
                                        .ratio = 1};
  ern_enlarge_ref(&view, 0, HEIGHT);
  assert_memory_equal(small, large, sizeof small);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_definition),
      cmocka_unit_test(test_nothing_to_enlarge),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
