/* SPDX-License-Identifier: MIT
 * Pictures made larger. */
#include "harness.h"

#include "render/upsample_ops.h"

/* Keys (1981), a = -1/2, at a distance; straight from the paper. */
static double keys(double x) {
  x = fabs(x);
  if (x >= 2) return 0;
  return x < 1 ? 1.5 * x * x * x - 2.5 * x * x + 1 : -0.5 * x * x * x + 2.5 * x * x - 4 * x + 2;
}

struct scaled {
  int width, height, small_width, small_height;
  float ratio;
  const float *small, *background;
};

static double clamped(double value, double most) { return fmin(fmax(value, 0), most); }

static double point(const struct scaled *s, int c, int x, int y) {
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

static double expected_at(const struct scaled *s, int c, int x, int y, bool over) {
  if (!over) return point(s, c, x, y);
  const double opacity = clamped(point(s, 3, x, y), 1);
  const size_t pixels = (size_t)s->width * (size_t)s->height, i = (size_t)y * (size_t)s->width + (size_t)x;
  return c == 3 ? opacity
                : clamped(point(s, c, x, y), opacity) + (1 - opacity) * (double)s->background[(size_t)c * pixels + i];
}

/* 16 products of values in [-1, 2] and weights whose magnitudes sum to at most 1.25^2: some tens of roundings of 6e-8,
 * and weights that are rounded polynomials. */
static const double rounding = 1e-5;

/* On other machines the same sums in the same order, which a compiler may contract in spite of the pragma. */
static void check_upsample(int width, int height, float ratio, bool over) {
  enum { CHANNELS = 4 };
  struct scaled s = {.width = width,
                     .height = height,
                     .small_width = (int)ceilf((float)width * ratio),
                     .small_height = (int)ceilf((float)height * ratio),
                     .ratio = ratio};
  const size_t pixels = (size_t)width * (size_t)height, few = (size_t)s.small_width * (size_t)s.small_height;
  float *values = floats(CHANNELS * few), *back = floats(3 * pixels);
  for (size_t i = 0; i < CHANNELS * few; i++) values[i] = 0.5f + random_at(31, i, 1.5f);
  for (size_t i = 0; i < 3 * pixels; i++) back[i] = fabsf(random_at(32, i, 1));
  s.small = values, s.background = back;
  const struct many_rows large = many_strided(NULL, CHANNELS, pixels, ERN_PER_SAMPLE);
  const struct many_rows small = many_strided(values, CHANNELS, few, ERN_PER_SAMPLE);
  const struct many_rows background = many_strided(back, 3, pixels, ERN_PER_SAMPLE);
  ON_EACH(upsample, ern_upsample_args,
          {.large = large.on[k],
           .small = small.on[k],
           .background = over ? background.on[k] : (ern_rows){.rows = 0},
           .width = width,
           .height = height,
           .small_width = s.small_width,
           .small_height = s.small_height,
           .ratio = ratio})
  expect_near("upsampled", of_rows(large), 0, rounding);
  const float *found = floats_of(0, of_rows(large));
  for (int c = 0; c < CHANNELS; c++)
    for (int y = 0; y < height; y++)
      for (int x = 0; x < width; x++) {
        const size_t at = (size_t)c * large.on[0].stride + (size_t)y * (size_t)width + (size_t)x;
        const double expected = expected_at(&s, c, x, y, over);
        if (!(fabs((double)found[at] - expected) <= rounding))
          fail_msg("%d x %d times %g, channel %d at (%d, %d): %.9g, expected %.9g", width, height, (double)ratio, c, x,
                   y, (double)found[at], expected);
        /* at ratio 1 every pixel falls on its own: the weights are 0 1 0 0 exactly */
        if (ratio == 1 && !over) assert_true(found[at] == values[(size_t)c * few + at % large.on[0].stride]);
      }
  machines_clear();
}

static void test_upsample(void **state) {
  (void)state;
  static const int sides[][2] = {{1, 1}, {2, 1}, {3, 7}, {64, 5}, {127, 4}, {128, 3}, {129, 9}, {257, 6}, {300, 40}};
  static const float ratios[] = {0.25f, 0.3f, 0.5f, 0.6180340f, 0.75f, 0.99f, 1};
  for (size_t i = 0; i < COUNT_OF(sides); i++)
    for (size_t r = 0; r < COUNT_OF(ratios); r++)
      for (int over = 0; over < 2; over++) check_upsample(sides[i][0], sides[i][1], ratios[r], over != 0);
}

static const struct CMUnitTest tests[] = {cmocka_unit_test(test_upsample)};
NOUN(upsample, NULL, .isa = NULL)
