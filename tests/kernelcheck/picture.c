/* SPDX-License-Identifier: MIT
 * Between bytes and rows, and the test for finite values: the reference against the definition, all machines the same
 * numbers and bytes. Every pixel is one of its own, so that a tolerance has nothing to allow for but division that is
 * not correctly rounded. */
#include "harness.h"
#include "render/picture_ops.h"

enum { EVERY_PAIR = 65536, SOME_PAIRS = 4096 };

/* Every pair of two byte values is among the first 65536. */
static uint8_t byte_at(size_t i, size_t c) {
  return (uint8_t)(c == 3 ? i >> 8 : c == 0 ? i : words_at(5, 0, (4 * i + c)).word[0]);
}

/* Three roundings of values up to 1. */
static void define_background(const float *pixel, const float *opacity, const uint8_t *back, const uint8_t *front,
                              size_t n) {
  for (size_t i = 0; i < n; i++) {
    const double a = front != NULL ? front[4 * i + 3] / 255.0 : 0;
    assert_true(fabs((double)opacity[i] - a) <= 1e-7);
    for (size_t c = 0; c < 3; c++) {
      const double f = front != NULL ? front[4 * i + c] / 255.0 : 0, b = back != NULL ? back[3 * i + c] / 255.0 : 0;
      assert_true(fabs((double)pixel[c * (n + 5) + i] - (f * a + b * (1 - a))) <= 2e-7);
    }
  }
}

static void check_background(size_t n) {
  uint8_t *background = held_memory(3 * n, 1), *torso = held_memory(4 * n, 1);
  for (size_t i = 0; i < n; i++) {
    for (size_t c = 0; c < 3; c++) background[3 * i + c] = byte_at(i, c + 1 == 3 ? 3 : c + 1);
    for (size_t c = 0; c < 4; c++) torso[4 * i + c] = byte_at(i, c);
  }
  const struct many back = many_of(ERN_ELEMENT_BYTE, background, 3 * n),
                    front = many_of(ERN_ELEMENT_BYTE, torso, 4 * n);
  for (int with = 0; with < 4; with++) {
    const struct many_rows pixel = many_strided(NULL, 3, n, ERN_PER_RAY);
    const struct many opacity = many_empty(n);
    struct ern_background_args args[MACHINES];
    EACH_MACHINE (k)
      args[k] = (struct ern_background_args){pixel.on[k], opacity.on[k], with & 1 ? back.on[k] : (ern_span){0},
                                             with & 2 ? front.on[k] : (ern_span){0}, n};
    RUN(background, args);
    expect_near("pixel", of_rows(pixel), 0, 0);
    expect_near("opacity", opacity, 0, 0);
    define_background(floats_of(0, of_rows(pixel)), floats_of(0, opacity), with & 1 ? background : NULL,
                      with & 2 ? torso : NULL, n);
  }
  machines_clear();
}

static void test_background(void **state) {
  (void)state;
  for (size_t s = 0; s < size_count(); s++) check_background(test_sizes[s]);
  check_background(is_small() ? SOME_PAIRS : EVERY_PAIR);
  check_background(0);
}

/* Colours, and opacities among which 0 is: ordinary ones, borders between two bytes, and what no byte can hold. */
static float colour_at(size_t i) {
  static const float hard[] = {0,      -0.0f,  1,          -1,         2,          NAN,          INFINITY, -INFINITY,
                               1e-45f, 1e-30f, 0.5f / 255, 1.5f / 255, 2.5f / 255, 254.5f / 255, 1e30f,    0.99999994f};
  const size_t kinds = COUNT_OF(hard);
  if (i % 5 == 0) return hard[i / 5 % kinds];
  return i % 5 == 1 ? ((float)(i / 5 % 255) + 0.5f) / 255 : fabsf(random_at(9, i, 1.02f));
}

/* How far a byte may be off: a quotient of 2.5 ulp may cross a border between two bytes. */
static void expect_bytes(struct many span, bool divided) {
  const uint8_t *expected = bytes_of(0, span);
  EACH_OTHER (k) {
    const uint8_t *found = bytes_of(k, span);
    const int reach = divided && !divides_exactly(k) ? 1 : 0;
    for (size_t i = 0; i < span.on[k].count; i++)
      if (abs(found[i] - expected[i]) > reach)
        fail_msg("%s: byte [%zu]: %d, reference %d", machines.name[k], i, found[i], expected[i]);
  }
}

static void expect_byte(const char *what, double value, bool exact, uint8_t found) {
  const double clamped = isnan(value) ? 0 : fmin(fmax(value, 0), 1) * 255;
  /* 1/2 by the definition; 1e-4 for the roundings of the quotient, the factor and the sum before it: 4 u of 255 */
  if (fabs(found - clamped) > 0.5 + (exact ? 2e-5 : 1e-4)) fail_msg("%s: byte %d of %.9g", what, found, value);
}

struct shown {
  const uint8_t *rgba;
  const float *rgb, *alpha, *pixel, *head, *torso; /* pixel: [3][n]; head NULL: over a background */
};

static void define_picture(const struct shown *v, size_t n) {
  for (size_t i = 0; i < n; i++) {
    const float alpha = v->head == NULL ? 1 : v->head[i] + (1 - v->head[i]) * v->torso[i];
    assert_true(same_bits(v->alpha[i], alpha));
    expect_byte("alpha", (double)alpha, true, v->rgba[4 * i + 3]);
    for (size_t c = 0; c < 3; c++) {
      const float value = v->pixel[c * n + i];
      assert_true(same_bits(v->rgb[3 * i + c], value));
      const double straight = v->head == NULL ? (double)value : alpha > 0 ? (double)value / (double)alpha : 0;
      expect_byte("colour", straight, v->head == NULL, v->rgba[4 * i + c]);
    }
  }
}

static void check_picture(size_t n) {
  enum { WANT_RGBA = 1, WANT_RGB = 2, WANT_ALPHA = 4, WANT_ALL = 7 };
  const ern_span none = {0};
  float *values = floats(5 * n), *head = values + 3 * n, *torso = head + n;
  for (size_t c = 0; c < 3; c++)
    for (size_t i = 0; i < n; i++) values[c * n + i] = colour_at(7 * i + 3 * c + n);
  for (size_t i = 0; i < n; i++) {
    head[i] = i % 3 == 0 ? 0 : i % 3 == 1 ? fabsf(random_at(3, i, 1)) : colour_at(i);
    torso[i] = i % 4 < 2 ? (float)(i % 2) : fabsf(random_at(4, i, 1));
  }
  const struct many_rows pixel = many_strided(values, 3, n, ERN_PER_RAY);
  const struct many heads = many_reals(head, n), torsos = many_reals(torso, n);
  for (int over = 0; over < 2; over++) {
    for (int want = 0; want <= WANT_ALL; want++) {
      const struct many rgba = many_of(ERN_ELEMENT_BYTE, NULL, 4 * n);
      const struct many rgb = many_empty(3 * n);
      const struct many alpha = many_empty(n);
      struct ern_picture_args args[MACHINES];
      EACH_MACHINE (k)
        args[k] = (struct ern_picture_args){.rgba = want & WANT_RGBA ? rgba.on[k] : none,
                                            .rgb = want & WANT_RGB ? rgb.on[k] : none,
                                            .alpha = want & WANT_ALPHA ? alpha.on[k] : none,
                                            .pixel = pixel.on[k],
                                            .head = over ? none : heads.on[k],
                                            .torso = over ? none : torsos.on[k],
                                            .n = n};
      RUN(picture, args);
      expect_bytes(rgba, !over);
      expect_near("rgb", rgb, 0, 0);
      expect_near("alpha", alpha, 0, 0);
      const struct shown shown = {bytes_of(0, rgba),  floats_of(0, rgb),  floats_of(0, alpha), values,
                                  over ? NULL : head, over ? NULL : torso};
      if (want == WANT_ALL) define_picture(&shown, n);
    }
  }
  machines_clear();
}

static void test_picture(void **state) {
  (void)state;
  for (size_t s = 0; s < size_count(); s++) check_picture(test_sizes[s]);
  check_picture(is_small() ? SOME_PAIRS : EVERY_PAIR);
  check_picture(0);
}

/* ---- rows in the order of a list ---- */

enum { LISTED_CHANNELS = 3, SHARES = 5 };
struct listed {
  size_t all, n;
  const float *from, *behind, *known; /* [channels][all], known: [SHARES][all] by place in the list */
  const int32_t *pixel;
  const float *weight;
};

/* Of the reference: five products of values up to 2 in a blend. */
static void define_listed(const struct listed *s, const float *list, const float *placed, const float *blended,
                          const float *laid) {
  const size_t stride = s->all + 5;
  int32_t *place = held_memory(s->all, sizeof *place); /* in the list, from 1 */
  for (size_t i = 0; i < s->n; i++) place[s->pixel[i]] = (int32_t)i + 1;
  for (size_t i = 0; i < s->all; i++) {
    const size_t at = (size_t)place[i] - 1;
    double sum = 0;
    for (size_t j = 0; j < SHARES && place[i] > 0; j++) sum += (double)s->weight[j] * (double)s->known[j * s->all + at];
    if (place[i] > 0) assert_true(fabs((double)blended[i] - sum) <= 2e-6);
    if (place[i] == 0) assert_true(blended[i] == s->from[i]);
    for (size_t c = 0; c < LISTED_CHANNELS; c++) {
      const float behind = s->behind[c * s->all + i], here = s->from[c * s->all + i];
      if (place[i] > 0) assert_true(list[c * (s->n + 5) + at] == behind);
      assert_true(placed[c * stride + i] == (place[i] > 0 ? behind : here));
      const double over = (double)here + (1 - (double)s->behind[i]) * (double)behind;
      assert_true(fabs((double)laid[c * stride + i] - fmin(fmax(over, 0), 1)) <= 1e-6);
    }
  }
}

/* Every second pixel, and all of them; sums of five products that a compiler may contract. */
static void check_some_pixels(size_t all, size_t step) {
  const size_t n = (all + step - 1) / step;
  float *values = floats((2 * LISTED_CHANNELS + SHARES) * all), *back = values + LISTED_CHANNELS * all;
  float *known = back + LISTED_CHANNELS * all, weight[SHARES];
  int32_t *number = held_memory(n, sizeof *number);
  fill_random(values, (2 * LISTED_CHANNELS + SHARES) * all, 41, 1);
  fill_random(weight, SHARES, 42, 2);
  for (size_t i = 0; i < n; i++) number[i] = (int32_t)(step * (n - 1 - i));
  const struct many_rows from = many_strided(values, LISTED_CHANNELS, all, ERN_PER_SAMPLE);
  const struct many_rows behind = many_strided(back, LISTED_CHANNELS, all, ERN_PER_SAMPLE);
  const struct many_rows moments = many_strided(known, SHARES, all, ERN_PER_SAMPLE);
  const struct many_rows list = many_strided(NULL, LISTED_CHANNELS, n, ERN_PER_SAMPLE);
  const struct many_rows to = many_strided(values, LISTED_CHANNELS, all, ERN_PER_SAMPLE);
  const struct many_rows over = many_strided(NULL, LISTED_CHANNELS, all, ERN_PER_SAMPLE);
  const struct many sum = many_reals(values, all), share = many_reals(weight, SHARES);
  const struct many opacity = many_reals(back, all), pixel = many_int32s(number, n);
  ON_EACH(gather, ern_gather_args, {list.on[k], behind.on[k], pixel.on[k], n})
  expect_near("gather", of_rows(list), 0, 0);
  ON_EACH(scatter, ern_scatter_args, {to.on[k], list.on[k], pixel.on[k], n})
  expect_near("scatter", of_rows(to), 0, 0);
  ON_EACH(blend, ern_blend_args, {sum.on[k], moments.on[k], share.on[k], pixel.on[k], n})
  expect_near("blend", sum, 0, 2e-6); /* five products of values up to 2 */
  ON_EACH(overlay, ern_overlay_args, {over.on[k], from.on[k], opacity.on[k], behind.on[k], all})
  expect_near("overlay", of_rows(over), 0, 5e-7);
  const struct listed listed = {all, n, values, back, known, number, weight};
  define_listed(&listed, floats_of(0, of_rows(list)), floats_of(0, of_rows(to)), floats_of(0, sum),
                floats_of(0, of_rows(over)));
  machines_clear();
}

static void test_some_pixels(void **state) {
  (void)state;
  for (size_t s = 0; s < size_count(); s++)
    for (size_t step = 1; step < 3; step++) check_some_pixels(test_sizes[s], step);
}

/* One value that is not finite anywhere among finite ones, the largest of them too; what lies behind does not count. */
static void check_finite(size_t n) {
  static const float bad[] = {NAN, INFINITY, -INFINITY};
  float *values = floats(n);
  for (size_t i = 0; i < n; i++) {
    values[i] = i % 5 == 0 ? FLT_MAX : i % 5 == 1 ? -FLT_MAX : i % 5 == 2 ? 1e-45f : random_at(6, i, 1);
  }
  const struct many span = many_reals(values, n); /* a NaN before and behind it */
  EACH_MACHINE (k) {
    struct ern_finite_args args = {.values = span.on[k], .n = n};
    RUN_ON(k, finite, &args);
    assert_true(args.finite);
    for (size_t i = 0; i<n; i += n> 300 ? 37 : 1) {
      const ern_span one = ern_span_part(span.on[k], i, 1);
      machines_fill(k, one, &bad[i % 3], ERN_ELEMENT_REAL);
      args.n = n;
      RUN_ON(k, finite, &args);
      if (args.finite) fail_msg("%s: %g at %zu of %zu is called finite", machines.name[k], (double)bad[i % 3], i, n);
      args.n = i;
      RUN_ON(k, finite, &args);
      assert_true(args.finite);
      machines_fill(k, one, &values[i], ERN_ELEMENT_REAL);
      machines.checks += k > 0;
    }
  }
  machines_clear();
}

static void test_finite(void **state) {
  (void)state;
  for (size_t s = 0; s < size_count(); s++) check_finite(test_sizes[s]);
  if (!is_small()) check_finite(SOME_PAIRS);
  check_finite(0);
}

static void bench(void) {
  enum { N = 450 * 450 };
  uint8_t *bytes = held_memory(4 * N, 1);
  for (size_t i = 0; i < 4 * N; i++) bytes[i] = byte_at(i / 4, i % 4);
  const struct many back = many_of(ERN_ELEMENT_BYTE, bytes, 3 * N), front = many_of(ERN_ELEMENT_BYTE, bytes, 4 * N),
                    rgba = many_of(ERN_ELEMENT_BYTE, NULL, 4 * N), opacity = many_zeros(N);
  const struct many_rows pixel = many_strided(NULL, 3, N, ERN_PER_RAY);
  struct ern_background_args plain[MACHINES], torso[MACHINES];
  struct ern_picture_args picture[MACHINES];
  struct ern_finite_args finite[MACHINES];
  EACH_MACHINE (k) {
    plain[k] = (struct ern_background_args){pixel.on[k], opacity.on[k], back.on[k], {0}, N};
    torso[k] = (struct ern_background_args){pixel.on[k], opacity.on[k], back.on[k], front.on[k], N};
    picture[k] = (struct ern_picture_args){.rgba = rgba.on[k], .pixel = pixel.on[k], .n = N};
    finite[k] = (struct ern_finite_args){.values = opacity.on[k], .n = N};
  }
  BENCH("background", N, background, plain);
  BENCH("background with torso", N, background, torso);
  BENCH("picture", N, picture, picture);
  BENCH("finite", N, finite, finite);
  machines_clear();
}

static const struct CMUnitTest tests[] = {cmocka_unit_test(test_background), cmocka_unit_test(test_picture),
                                          cmocka_unit_test(test_some_pixels), cmocka_unit_test(test_finite)};
NOUN(picture, bench, .isa = NULL)
