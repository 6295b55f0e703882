/* SPDX-License-Identifier: MIT
 * Between bytes and rows on an OpenCL device: the reference's numbers and bytes. Every pixel is one of its own, so that
 * a tolerance has nothing to allow for but division that is not correctly rounded. */
#include "twin.h"

#include "backend_opencl/opencl.h"

enum { EVERY_PAIR = 65536, SOME_PAIRS = 4096 };

static ern_context *context;
static struct twin twin;

/* Every pair of two byte values is among the first 65536. */
static uint8_t byte_at(size_t i, size_t c) {
  return (uint8_t)(c == 3 ? i >> 8 : c == 0 ? i : ern_random_at(5, 0, (uint32_t)(4 * i + c), ERN_RNG_INIT).word[0]);
}

static void check_backdrop(size_t n) {
  uint8_t *background = malloc(3 * n + 1), *torso = malloc(4 * n + 1);
  assert_true(background != NULL && torso != NULL);
  for (size_t i = 0; i < n; i++) {
    for (size_t c = 0; c < 3; c++) background[3 * i + c] = byte_at(i, c + 1 == 3 ? 3 : c + 1);
    for (size_t c = 0; c < 4; c++) torso[4 * i + c] = byte_at(i, c);
  }
  const struct twin_span back = twin_bytes(&twin, background, 3 * n), front = twin_bytes(&twin, torso, 4 * n);
  for (int with = 0; with < 4; with++) {
    const struct twin_rows pixel = twin_rows_of(&twin, NULL, 3, n, ERN_PER_RAY);
    const struct twin_span opacity = twin_take(&twin, ERN_ELEMENT_REAL, n);
    struct ern_backdrop_args args[2];
    for (int k = 0; k < 2; k++)
      args[k] = (struct ern_backdrop_args){pixel.on[k], opacity.on[k], with & 1 ? back.on[k] : (ern_span){0},
                                           with & 2 ? front.on[k] : (ern_span){0}, n};
    TWIN_RUN(&twin, backdrop, args)
    twin_same_rows(&twin, "pixel", pixel, 0, 0);
    twin_same(&twin, "opacity", opacity, 0, 0);
  }
  twin_clear(&twin);
  free(background);
  free(torso);
}

static void test_backdrop(void **state) {
  (void)state;
  for (size_t s = 0; s < TWIN_SIZES; s++) check_backdrop(twin_sizes[s]);
  check_backdrop(twin_is_small() ? SOME_PAIRS : EVERY_PAIR);
  check_backdrop(0);
}

/* Colours, and opacities among which 0 is: ordinary ones, borders between two bytes, and what no byte can hold. */
static float colour_at(size_t i) {
  static const float hard[] = {0,      -0.0f,  1,          -1,         2,          NAN,          INFINITY, -INFINITY,
                               1e-45f, 1e-30f, 0.5f / 255, 1.5f / 255, 2.5f / 255, 254.5f / 255, 1e30f,    0.99999994f};
  const size_t kinds = sizeof hard / sizeof *hard;
  if (i % 5 == 0) return hard[i / 5 % kinds];
  return i % 5 == 1 ? ((float)(i / 5 % 255) + 0.5f) / 255 : fabsf(twin_random(9, i, 1.02f));
}

/* `reach`: how far a byte may be off. */
static void expect_bytes(struct twin_span span, int reach) {
  const size_t all = span.on[0].count + 2 * TWIN_GUARD;
  uint8_t *bytes[2];
  for (int k = 0; k < 2; k++) {
    bytes[k] = malloc(all);
    assert_non_null(bytes[k]);
    const ern_span whole = {span.on[k].buffer, 0, all};
    support_ok(context, twin.backend[k]->download_bytes(twin.stream[k], bytes[k], whole, all));
  }
  for (size_t i = 0; i < all; i++)
    if (abs(bytes[0][i] - bytes[1][i]) > reach)
      fail_msg("byte [%ld]: device %d, reference %d", (long)i - TWIN_GUARD, bytes[1][i], bytes[0][i]);
  free(bytes[0]);
  free(bytes[1]);
}

static void check_picture(size_t n) {
  enum { WANT_RGBA = 1, WANT_RGB = 2, WANT_ALPHA = 4, WANT_ALL = 7 };
  const ern_span none = {0};
  const bool exact = ((const struct ern_cl_backend *)twin.backend[1])->device.exact_divide;
  float *values = malloc((5 * n + 1) * sizeof *values), *head = values + 3 * n, *torso = head + n;
  assert_non_null(values);
  for (size_t c = 0; c < 3; c++)
    for (size_t i = 0; i < n; i++) values[c * n + i] = colour_at(7 * i + 3 * c + n);
  for (size_t i = 0; i < n; i++) {
    head[i] = i % 3 == 0 ? 0 : i % 3 == 1 ? fabsf(twin_random(3, i, 1)) : colour_at(i);
    torso[i] = i % 4 < 2 ? (float)(i % 2) : fabsf(twin_random(4, i, 1));
  }
  const struct twin_rows pixel = twin_rows_of(&twin, values, 3, n, ERN_PER_RAY);
  const struct twin_span heads = twin_reals(&twin, head, n), torsos = twin_reals(&twin, torso, n);
  for (int over = 0; over < 2; over++) {
    for (int want = 0; want <= WANT_ALL; want++) {
      const struct twin_span rgba = twin_take(&twin, ERN_ELEMENT_BYTE, 4 * n);
      const struct twin_span rgb = twin_take(&twin, ERN_ELEMENT_REAL, 3 * n);
      const struct twin_span alpha = twin_take(&twin, ERN_ELEMENT_REAL, n);
      struct ern_picture_args args[2];
      for (int k = 0; k < 2; k++)
        args[k] = (struct ern_picture_args){.rgba = want & WANT_RGBA ? rgba.on[k] : none,
                                            .rgb = want & WANT_RGB ? rgb.on[k] : none,
                                            .alpha = want & WANT_ALPHA ? alpha.on[k] : none,
                                            .pixel = pixel.on[k],
                                            .head = over ? none : heads.on[k],
                                            .torso = over ? none : torsos.on[k],
                                            .n = n};
      TWIN_RUN(&twin, picture, args)
      expect_bytes(rgba, exact || over ? 0 : 1); /* a quotient of 2.5 ulp may cross a border between two bytes */
      twin_same(&twin, "rgb", rgb, 0, 0);
      twin_same(&twin, "alpha", alpha, 0, 0);
    }
  }
  twin_clear(&twin);
  free(values);
}

static void test_picture(void **state) {
  (void)state;
  for (size_t s = 0; s < TWIN_SIZES; s++) check_picture(twin_sizes[s]);
  check_picture(twin_is_small() ? SOME_PAIRS : EVERY_PAIR);
  check_picture(0);
}

/* The same sums in the same order, which a compiler may contract in spite of the pragma: roundings of 16 products. */
static void check_enlarge(int width, int height, float ratio, bool over) {
  enum { CHANNELS = 4 };
  const int small_width = (int)ceilf((float)width * ratio), small_height = (int)ceilf((float)height * ratio);
  const size_t pixels = (size_t)width * (size_t)height, few = (size_t)small_width * (size_t)small_height;
  float *values = malloc((CHANNELS * few + 3 * pixels) * sizeof *values), *back = values + CHANNELS * few;
  assert_non_null(values);
  twin_fill(values, CHANNELS * few, 31, 1.5f);
  for (size_t i = 0; i < 3 * pixels; i++) back[i] = fabsf(twin_random(32, i, 1));
  const struct twin_rows large = twin_rows_of(&twin, NULL, CHANNELS, pixels, ERN_PER_SAMPLE);
  const struct twin_rows small = twin_rows_of(&twin, values, CHANNELS, few, ERN_PER_SAMPLE);
  const struct twin_rows background = twin_rows_of(&twin, back, 3, pixels, ERN_PER_SAMPLE);
  struct ern_enlarge_args args[2];
  for (int k = 0; k < 2; k++)
    args[k] = (struct ern_enlarge_args){.large = large.on[k],
                                        .small = small.on[k],
                                        .background = over ? background.on[k] : (ern_rows){.rows = 0},
                                        .width = width,
                                        .height = height,
                                        .small_width = small_width,
                                        .small_height = small_height,
                                        .ratio = ratio};
  TWIN_RUN(&twin, enlarge, args)
  twin_same_rows(&twin, "enlarged", large, 0, 1e-5);
  twin_clear(&twin);
  free(values);
}

static void test_enlarge(void **state) {
  (void)state;
  static const int sides[][2] = {{1, 1}, {3, 7}, {64, 5}, {129, 9}, {65, 40}};
  static const float ratios[] = {0.25f, 0.5f, 0.6180340f, 1};
  for (size_t i = 0; i < sizeof sides / sizeof *sides; i++)
    for (size_t k = 0; k < sizeof ratios / sizeof *ratios; k++)
      for (int over = 0; over < 2; over++) check_enlarge(sides[i][0], sides[i][1], ratios[k], over != 0);
}

/* Every second pixel, and all of them; sums of five products that a compiler may contract. */
static void check_some_pixels(size_t all, size_t step) {
  enum { CHANNELS = 3, COUNT = 5 };
  const size_t n = (all + step - 1) / step;
  float *values = malloc((2 * CHANNELS + COUNT) * all * sizeof *values), *back = values + CHANNELS * all;
  float *known = back + CHANNELS * all, weight[COUNT];
  int32_t *number = malloc(n * sizeof *number);
  assert_true(values != NULL && number != NULL);
  twin_fill(values, (2 * CHANNELS + COUNT) * all, 41, 1);
  twin_fill(weight, COUNT, 42, 2);
  for (size_t i = 0; i < n; i++) number[i] = (int32_t)(step * (n - 1 - i));
  const struct twin_rows from = twin_rows_of(&twin, values, CHANNELS, all, ERN_PER_SAMPLE);
  const struct twin_rows behind = twin_rows_of(&twin, back, CHANNELS, all, ERN_PER_SAMPLE);
  const struct twin_rows moments = twin_rows_of(&twin, known, COUNT, all, ERN_PER_SAMPLE);
  const struct twin_rows list = twin_rows_of(&twin, NULL, CHANNELS, n, ERN_PER_SAMPLE);
  const struct twin_rows to = twin_rows_of(&twin, values, CHANNELS, all, ERN_PER_SAMPLE);
  const struct twin_rows over = twin_rows_of(&twin, NULL, CHANNELS, all, ERN_PER_SAMPLE);
  const struct twin_span sum = twin_reals(&twin, values, all), share = twin_reals(&twin, weight, COUNT);
  const struct twin_span opacity = twin_reals(&twin, back, all), pixel = twin_int32s(&twin, number, n);
  struct ern_pick_args pick[2];
  struct ern_place_args place[2];
  struct ern_blend_args blend[2];
  struct ern_overlay_args overlay[2];
  for (int k = 0; k < 2; k++) {
    pick[k] = (struct ern_pick_args){list.on[k], behind.on[k], pixel.on[k], n};
    place[k] = (struct ern_place_args){to.on[k], list.on[k], pixel.on[k], n};
    blend[k] = (struct ern_blend_args){sum.on[k], moments.on[k], share.on[k], pixel.on[k], n};
    overlay[k] = (struct ern_overlay_args){over.on[k], from.on[k], opacity.on[k], behind.on[k], all};
  }
  TWIN_RUN(&twin, pick, pick)
  twin_same_rows(&twin, "pick", list, 0, 0);
  TWIN_RUN(&twin, place, place)
  twin_same_rows(&twin, "place", to, 0, 0);
  TWIN_RUN(&twin, blend, blend)
  twin_same(&twin, "blend", sum, 0, 2e-6); /* five products of values up to 2 */
  TWIN_RUN(&twin, overlay, overlay)
  twin_same_rows(&twin, "overlay", over, 0, 5e-7);
  twin_clear(&twin);
  free(values);
  free(number);
}

static void test_some_pixels(void **state) {
  (void)state;
  for (size_t s = 0; s < TWIN_SIZES; s++)
    for (size_t step = 1; step < 3; step++) check_some_pixels(twin_sizes[s], step);
}

static int set_up(void **state) {
  (void)state;
  context = support_context();
  twin_open(&twin, context);
  return 0;
}
static int tear_down(void **state) {
  (void)state;
  twin_close(&twin);
  ern_context_free(&context);
  return 0;
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_backdrop), cmocka_unit_test(test_picture),
                                     cmocka_unit_test(test_enlarge), cmocka_unit_test(test_some_pixels)};
  return cmocka_run_group_tests_name("opencl picture", tests, set_up, tear_down);
}
