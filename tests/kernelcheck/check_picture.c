/* SPDX-License-Identifier: MIT
 * Between bytes and rows: the reference against its definition, every instruction set against the reference, bit for
 * bit. */
#include "kernelcheck.h"

#include "core/kernels.h"

struct kernel {
  const char *name;
  machine_isa isa;
  ern_backdrop_kernel *backdrop;
  ern_picture_kernel *picture;
};

static const struct kernel kernels[] = {
    {"ref", MACHINE_REF, ern_backdrop_ref, ern_picture_ref},
#if defined(ERN_X86_KERNELS)
    {"avx2", MACHINE_AVX2, ern_backdrop_avx2, ern_picture_avx2},
    {"avx512", MACHINE_AVX512, ern_backdrop_avx512, ern_picture_avx512},
#endif
#if defined(ERN_ARM_KERNELS)
    {"neon", MACHINE_NEON, ern_backdrop_neon, ern_picture_neon},
#endif
};
enum { KERNELS = sizeof kernels / sizeof *kernels };

/* Around the lanes of every instruction set. */
static const size_t sizes[] = {1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 32, 33, 63, 64, 65, 257, 65536};
enum { SIZES = sizeof sizes / sizeof *sizes, MOST = 65536, EDGE = 64, MARK = 0xa5 };

/* Every pair of two byte values is among the first 65536. */
static uint8_t byte_at(size_t i, size_t c) {
  return (uint8_t)(c == 3 ? i >> 8 : c == 0 ? i : ern_random_at(5, 0, (uint32_t)(4 * i + c), ERN_RNG_INIT).word[0]);
}

static void fill_bytes(uint8_t *background, uint8_t *torso, size_t n) {
  for (size_t i = 0; i < n; i++) {
    for (size_t c = 0; c < 3; c++) background[3 * i + c] = byte_at(i, c + 1 == 3 ? 3 : c + 1);
    for (size_t c = 0; c < 4; c++) torso[4 * i + c] = byte_at(i, c);
  }
}

static void run_backdrop(const struct kernel *kernel, const uint8_t *background, const uint8_t *torso, size_t n,
                         struct guarded *pixel, struct guarded *opacity) {
  const size_t stride = n + 5;
  *pixel = guarded_make(3 * stride);
  *opacity = guarded_make(n);
  kernel->backdrop(pixel->data, stride, opacity->data, background, torso, n);
  guarded_check(pixel, 3, stride, n, kernel->name);
  guarded_check(opacity, 1, n, n, kernel->name);
}

/* The bytes lie at the end of their room, but for what a kernel may read past them. */
static void test_backdrop(void **state) {
  (void)state;
  static uint8_t background[3 * MOST + EDGE], torso[4 * MOST + EDGE];
  for (size_t s = 0; s < SIZES; s++) {
    const size_t n = sizes[s];
    fill_bytes(background, torso, n);
    for (int with = 0; with < 4; with++) {
      const uint8_t *back = with & 1 ? background : NULL, *front = with & 2 ? torso : NULL;
      struct guarded pixel, opacity, found, found_opacity;
      run_backdrop(&kernels[0], back, front, n, &pixel, &opacity);
      for (size_t i = 0; i < n; i++) {
        const double a = front != NULL ? front[4 * i + 3] / 255.0 : 0;
        assert_true(fabs((double)opacity.data[i] - a) <= 1e-7);
        for (size_t c = 0; c < 3; c++) {
          const double f = front != NULL ? front[4 * i + c] / 255.0 : 0, b = back != NULL ? back[3 * i + c] / 255.0 : 0;
          /* three roundings of values up to 1 */
          assert_true(fabs((double)pixel.data[c * (n + 5) + i] - (f * a + b * (1 - a))) <= 2e-7);
        }
      }
      for (size_t k = 1; k < KERNELS; k++) {
        if (!machine_has(kernels[k].isa)) continue;
        run_backdrop(&kernels[k], back, front, n, &found, &found_opacity);
        assert_memory_equal(found.data, pixel.data, 3 * (n + 5) * sizeof(float));
        assert_memory_equal(found_opacity.data, opacity.data, n * sizeof(float));
        guarded_free(&found), guarded_free(&found_opacity);
      }
      guarded_free(&pixel), guarded_free(&opacity);
    }
  }
}

struct shown {
  uint8_t *rgba;
  struct guarded rgb, alpha;
};

enum { WANT_RGBA = 1, WANT_RGB = 2, WANT_ALPHA = 4, WANT_ALL = 7 };

static void run_picture(const struct kernel *kernel, struct ern_picture_view view, int want, size_t n,
                        struct shown *shown) {
  *shown = (struct shown){malloc(4 * n + 2 * EDGE), guarded_make(3 * n), guarded_make(n)};
  assert_non_null(shown->rgba);
  memset(shown->rgba, MARK, 4 * n + 2 * EDGE);
  if (want & WANT_RGBA) view.rgba = shown->rgba + EDGE;
  if (want & WANT_RGB) view.rgb = shown->rgb.data;
  if (want & WANT_ALPHA) view.alpha = shown->alpha.data;
  kernel->picture(&view, n);
  guarded_check(&shown->rgb, 1, 3 * n, 3 * n, kernel->name);
  guarded_check(&shown->alpha, 1, n, n, kernel->name);
  for (size_t i = 0; i < EDGE; i++)
    if (shown->rgba[i] != MARK || shown->rgba[EDGE + 4 * n + i] != MARK)
      fail_msg("%s: bytes were written outside the picture", kernel->name);
}

static void shown_free(struct shown *shown) {
  free(shown->rgba);
  guarded_free(&shown->rgb), guarded_free(&shown->alpha);
}

/* Colours, and opacities among which 0 is: ordinary ones, borders between two bytes, and what no byte can hold. */
static float colour_at(size_t i) {
  static const float hard[] = {0,      -0.0f,  1,          -1,         2,          NAN,          INFINITY, -INFINITY,
                               1e-45f, 1e-30f, 0.5f / 255, 1.5f / 255, 2.5f / 255, 254.5f / 255, 1e30f,    0.99999994f};
  const size_t kinds = sizeof hard / sizeof *hard;
  if (i % 5 == 0) return hard[i / 5 % kinds];
  return i % 5 == 1 ? ((float)(i / 5 % 255) + 0.5f) / 255 : fabsf(random_at(9, i, 1.02f));
}

/* The bits, but those of a NaN, which are nobody's promise. */
static bool same(float a, float b) { return memcmp(&a, &b, sizeof a) == 0 || (isnan(a) && isnan(b)); }

static void expect_byte(const char *what, double value, bool exact, uint8_t found) {
  const double clamped = isnan(value) ? 0 : fmin(fmax(value, 0), 1) * 255;
  /* 1/2 by the definition; 1e-4 for the roundings of the quotient, the factor and the sum before it: 4 u of 255 */
  if (fabs(found - clamped) > 0.5 + (exact ? 2e-5 : 1e-4)) fail_msg("%s: byte %d of %.9g", what, found, value);
}

static void expect_definition(const struct shown *shown, const struct ern_picture_view *v, size_t n) {
  for (size_t i = 0; i < n; i++) {
    const float alpha = v->head == NULL ? 1 : v->head[i] + (1 - v->head[i]) * v->torso[i];
    assert_true(same(shown->alpha.data[i], alpha));
    expect_byte("alpha", (double)alpha, true, shown->rgba[EDGE + 4 * i + 3]);
    for (size_t c = 0; c < 3; c++) {
      const float value = v->pixel[c * v->stride + i];
      assert_true(same(shown->rgb.data[3 * i + c], value));
      const double straight = v->head == NULL ? (double)value : alpha > 0 ? (double)value / (double)alpha : 0;
      expect_byte("colour", straight, v->head == NULL, shown->rgba[EDGE + 4 * i + c]);
    }
  }
}

static void test_picture(void **state) {
  (void)state;
  for (size_t s = 0; s < SIZES; s++) {
    const size_t n = sizes[s], stride = n + 3;
    struct guarded pixel = guarded_make(3 * stride), head = guarded_make(n), torso = guarded_make(n);
    for (size_t c = 0; c < 3; c++)
      for (size_t i = 0; i < n; i++) pixel.data[c * stride + i] = colour_at(7 * i + 3 * c + s);
    for (size_t i = 0; i < n; i++) {
      head.data[i] = i % 3 == 0 ? 0 : i % 3 == 1 ? fabsf(random_at(3, i, 1)) : colour_at(i);
      torso.data[i] = i % 4 < 2 ? (float)(i % 2) : fabsf(random_at(4, i, 1));
    }
    for (int over = 0; over < 2; over++) {
      const struct ern_picture_view view = {
          .pixel = pixel.data, .head = over ? NULL : head.data, .torso = over ? NULL : torso.data, .stride = stride};
      struct shown expected, found;
      run_picture(&kernels[0], view, WANT_ALL, n, &expected);
      expect_definition(&expected, &view, n);
      for (size_t k = 1; k < KERNELS; k++) {
        if (!machine_has(kernels[k].isa)) continue;
        for (int want = 0; want <= WANT_ALL; want++) {
          run_picture(&kernels[k], view, want, n, &found);
          if (want & WANT_RGBA) assert_memory_equal(found.rgba, expected.rgba, 4 * n + 2 * EDGE);
          if (want & WANT_RGB) assert_memory_equal(found.rgb.data, expected.rgb.data, 3 * n * sizeof(float));
          for (size_t i = 0; i < n && (want & WANT_ALPHA) != 0; i++)
            assert_true(same(found.alpha.data[i], expected.alpha.data[i]));
          shown_free(&found);
        }
      }
      shown_free(&expected);
    }
    guarded_free(&pixel), guarded_free(&head), guarded_free(&torso);
  }
}

/* ---- speed ------------------------------------------------------------------------------------------------------- */

enum { BENCH = 450 * 450 };
static struct bench {
  const struct kernel *kernel;
  uint8_t background[3 * BENCH], torso[4 * BENCH], rgba[4 * BENCH];
  float pixel[3 * BENCH], opacity[BENCH];
  bool with_torso;
} bench;

static void backdrop_run(void *user) {
  (void)user;
  bench.kernel->backdrop(bench.pixel, BENCH, bench.opacity, bench.background, bench.with_torso ? bench.torso : NULL,
                         BENCH);
}
static void picture_run(void *user) {
  (void)user;
  const struct ern_picture_view view = {.rgba = bench.rgba, .pixel = bench.pixel, .stride = BENCH};
  bench.kernel->picture(&view, BENCH);
}

static void measure(void) {
  fill_bytes(bench.background, bench.torso, BENCH);
  for (size_t k = 0; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    bench.kernel = &kernels[k];
    bench.with_torso = false;
    const double plain = seconds_of(backdrop_run, NULL);
    bench.with_torso = true;
    const double torso = seconds_of(backdrop_run, NULL);
    printf("450 x 450, one core, %-6s: backdrop %.3f ms, with torso %.3f ms, picture %.3f ms\n", kernels[k].name,
           1e3 * plain, 1e3 * torso, 1e3 * seconds_of(picture_run, NULL));
  }
}

/* The reference of rows in the order of a list, against what they are. */
static void test_some_pixels(void **state) {
  (void)state;
  enum { ALL = 700, SOME = 300, CHANNELS = 3, COUNT = 5, STRIDE = ALL + 9, NONE = -7 };
  static float from[CHANNELS * STRIDE], list[CHANNELS * STRIDE], known[COUNT * STRIDE];
  static float placed[CHANNELS * STRIDE], blended[ALL];
  static int32_t pixel[SOME];
  const float weight[COUNT] = {0.5f, -1, 2, 0.25f, -0.75f};
  for (size_t i = 0; i < CHANNELS * STRIDE; i++) from[i] = sinf((float)i), placed[i] = NONE;
  for (size_t i = 0; i < COUNT * STRIDE; i++) known[i] = cosf((float)(3 * i));
  for (size_t i = 0; i < SOME; i++) pixel[i] = (int32_t)((i * 11 + 3) % ALL); /* 11 and 700 share nothing: each once */
  for (size_t i = 0; i < ALL; i++) blended[i] = NONE;
  struct guarded picked = guarded_make(CHANNELS * STRIDE), laid = guarded_make(CHANNELS * STRIDE);
  ern_pick_ref(picked.data, STRIDE, from, STRIDE, CHANNELS, pixel, SOME);
  guarded_check(&picked, CHANNELS, STRIDE, SOME, "pick");
  for (size_t c = 0; c < CHANNELS; c++) memcpy(list + c * STRIDE, picked.data + c * STRIDE, SOME * sizeof *list);
  ern_place_ref(placed, STRIDE, list, STRIDE, CHANNELS, pixel, SOME);
  ern_blend_ref(blended, known, STRIDE, weight, COUNT, pixel, SOME);
  ern_overlay_ref(laid.data, STRIDE, from, STRIDE, from + 2 * STRIDE, known, STRIDE, ALL);
  guarded_check(&laid, CHANNELS, STRIDE, ALL, "overlay");
  for (size_t i = 0; i < ALL; i++) {
    size_t at = 0;
    while (at < SOME && (size_t)pixel[at] != i) at++;
    double sum = NONE;
    for (size_t k = 0; k < COUNT && at < SOME; k++)
      sum = (k > 0 ? sum : 0) + (double)weight[k] * (double)known[k * STRIDE + at];
    assert_true(fabs((double)blended[i] - sum) <= 1e-6); /* five products of values up to 2 */
    for (size_t c = 0; c < CHANNELS; c++) {
      const float here = from[c * STRIDE + i];
      if (at < SOME) assert_true(memcmp(&list[c * STRIDE + at], &here, sizeof here) == 0);
      const float expected = at < SOME ? here : NONE;
      assert_true(memcmp(&placed[c * STRIDE + i], &expected, sizeof expected) == 0);
      const double over = (double)here + (1 - (double)from[2 * STRIDE + i]) * (double)known[c * STRIDE + i];
      assert_true(fabs((double)laid.data[c * STRIDE + i] - fmin(fmax(over, 0), 1)) <= 1e-6);
    }
  }
  guarded_free(&picked), guarded_free(&laid);
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) {
    measure();
    return 0;
  }
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_backdrop),
      cmocka_unit_test(test_some_pixels),
      cmocka_unit_test(test_picture),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
