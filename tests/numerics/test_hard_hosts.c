/* SPDX-License-Identifier: MIT
 * Programs that link the library and have changed what it computes in: rounding, denormal numbers, traps, stacks, the
 * sign of decimals. A training and two frames have the bytes that they have anywhere, and the program keeps its choice
 * (docs/numerics.md). */
#define _GNU_SOURCE /* feenableexcept, pthread_setattr_default_np */
#include <fenv.h>
#include <pthread.h>
#if defined __x86_64__
#include <immintrin.h>
#endif

#include "made_clip.h"

enum { STEPS = 6, PIXELS = SIDE * SIDE, FLUSH = 0x8040 /* of MXCSR: results and operands that are denormal are 0 */ };
#if defined __GLIBC__
#define TRAPPED (FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW | FE_UNDERFLOW)
#endif

struct result {
  char *model;
  size_t bytes;
  float rgb[2][3 * PIXELS];
};

static struct made made;
static struct result plain;

/* As usual, and with a focal length that is 0 where denormal numbers are. */
static void draw(struct result *result) {
  ern_model *model = NULL;
  ern_renderer *renderer = NULL;
  ern_camera camera = {.focal = 48, .cx = SIDE / 2, .cy = SIDE / 2, .width = SIDE, .height = SIDE};
  ern_dataset_frame frame;
  (void)made_frame(&made, 0, 1, &frame);
  ern_camera_pose(camera.pose, frame.matrix, 4);
  static float windows[8 * 16 * WIDTH];
  ern_audio_windows(windows, &made.features, 2, ERN_AUDIO_PAD_EDGE);
  ern_frame_input input = {
      .camera = camera, .windows = windows, .window_length = 16, .eye = 0.3f, .background = made.background};
  support_ok(made.context, ern_model_load(&model, made.context, "host.safetensors"));
  support_ok(made.context, ern_renderer_create(&renderer, made.backend, model, NULL));
  for (size_t k = 0; k < 2; k++) {
    const ern_frame_output output = {.rgb = result->rgb[k]};
    if (k == 1) input.camera.focal = 1e-39f;
    support_ok(made.context, ern_renderer_frame(renderer, &input, &output, NULL));
  }
  ern_renderer_free(&renderer);
  ern_model_free(&model);
}

/* With a backend, and threads, of its own. */
static void learn_and_draw(struct result *result) {
  ern_train_config config = small_config(STEPS, "host.safetensors");
  config.validate_every = STEPS;
  clear_run("host");
  ern_backend_free(&made.backend);
  support_ok(made.context, ern_backend_create(&made.backend, made.context, NULL));
  support_ok(made.context, train(&made, &config, NULL));
  draw(result);
  result->model = read_file("host.safetensors", &result->bytes);
}

static void expect_plain(const char *host) {
  struct result found = {0};
  learn_and_draw(&found);
  const bool same_model = found.bytes == plain.bytes && memcmp(found.model, plain.model, plain.bytes) == 0,
             same_picture = memcmp(found.rgb, plain.rgb, sizeof plain.rgb) == 0;
  free(found.model);
  if (!same_model || !same_picture) {
    fesetenv(FE_DFL_ENV);
    fail_msg("%s: the %s differs", host, same_model ? "picture" : "model");
  }
}

/* case: denormals are 0, as with `-ffast-math` | plain code: a focal length of 1e-39 is refused | here: kept | bound:
 * same bytes */
static void test_host_that_flushes_denormals(void **state) {
  (void)state;
  fesetenv(FE_DFL_ENV); /* a failure before may have left another */
#if defined __x86_64__
  _mm_setcsr(_mm_getcsr() | FLUSH);
  expect_plain("denormal numbers are 0");
  const unsigned after = _mm_getcsr();
  fesetenv(FE_DFL_ENV);
  assert_int_equal(after & FLUSH, FLUSH);
#else
  skip();
#endif
}

static const struct {
  int mode;
  const char *name;
} modes[] = {{FE_UPWARD, "rounds up"}, {FE_DOWNWARD, "rounds down"}, {FE_TOWARDZERO, "rounds to zero"}};

/* case: rounds up, down, to zero | plain code: light of 1e-30 becomes 2e-7 (AVX2) | here: to nearest | bound: same
 * bytes */
static void test_host_that_rounds_otherwise(void **state) {
  (void)state;
  fesetenv(FE_DFL_ENV); /* a failure before may have left another */
  for (size_t m = 0; m < sizeof modes / sizeof *modes; m++) {
    assert_int_equal(fesetround(modes[m].mode), 0);
    expect_plain(modes[m].name);
    const int after = fegetround();
    fesetenv(FE_DFL_ENV);
    assert_int_equal(after, modes[m].mode);
  }
}

static const ern_setting *setting_named(const char *name) {
  const ern_setting *found = NULL;
  for (size_t i = 0; (found = ern_train_setting(i)) != NULL && strcmp(found->name, name) != 0; i++) continue;
  assert_non_null(found);
  return found;
}

/* case: rounds up, down, to zero | plain code: the default 0.01 of lr becomes 0.0100000007, "0.001" a number below the
 * least 0.001 of torso_shrink | here: to nearest | bound: same bytes, same texts */
static void test_settings_of_a_host_that_rounds_otherwise(void **state) {
  (void)state;
  fesetenv(FE_DFL_ENV); /* a failure before may have left another */
  const ern_train_config nearest = ern_train_config_default();
  const ern_setting *const shrink = setting_named("torso_shrink");
  char found[2][64];
  ern_setting_expected(shrink, found[0], sizeof found[0]);
  for (size_t m = 0; m < sizeof modes / sizeof *modes; m++) {
    char text[ERN_SETTING_TEXT_BYTES] = "";
    assert_int_equal(fesetround(modes[m].mode), 0);
    ern_train_config config = ern_train_config_default();
    const float lr = config.lr;
    const bool taken = ern_setting_read(shrink, "0.001", &config);
    ern_setting_write(shrink, &config, text);
    ern_setting_expected(shrink, found[1], sizeof found[1]);
    fesetenv(FE_DFL_ENV);
    if (memcmp(&lr, &nearest.lr, sizeof lr) != 0) fail_msg("%s: the default of lr is %.9g", modes[m].name, (double)lr);
    if (!taken || strcmp(text, "0.001") != 0 || (double)config.torso_shrink != (double)0.001f)
      fail_msg("%s: 0.001 is read as %.9g and written as %s", modes[m].name, (double)config.torso_shrink, text);
    assert_string_equal(found[0], found[1]);
  }
}

/* case: traps NaN, infinity, underflow, division by 0 | plain code: `1/d` along an axis ends the program | here: not
 * trapped; the caller's flags stay | bound: same bytes */
static void test_host_that_traps(void **state) {
  (void)state;
  fesetenv(FE_DFL_ENV); /* a failure before may have left another */
#if defined __GLIBC__
  feclearexcept(FE_ALL_EXCEPT);
  if (feenableexcept(TRAPPED) == -1) skip(); /* processors may have no traps */
  expect_plain("traps");
  const int after = fegetexcept();
  fesetenv(FE_DFL_ENV);
  assert_int_equal(after, TRAPPED);
#else
  skip();
#endif
}

static void *train_and_draw(void *unused) {
  (void)unused;
  expect_plain("small stacks");
  return NULL;
}

/* case: a thread with 512 KiB of stack calls, and the default of other threads is 64 KiB | plain code: a thread of the
 * library leaves its stack | here: the library's own threads have 512 KiB at least | bound: same bytes */
static void test_host_of_small_stacks(void **state) {
  (void)state;
#if defined __GLIBC__
  pthread_attr_t before, small, own;
  pthread_t thread;
  assert_int_equal(pthread_getattr_default_np(&before), 0);
  assert_int_equal(pthread_attr_init(&small), 0);
  assert_int_equal(pthread_attr_init(&own), 0);
  assert_int_equal(pthread_attr_setstacksize(&small, 64 << 10), 0);
  assert_int_equal(pthread_attr_setstacksize(&own, 512 << 10), 0);
  assert_int_equal(pthread_setattr_default_np(&small), 0);
  assert_int_equal(pthread_create(&thread, &own, train_and_draw, NULL), 0);
  assert_int_equal(pthread_join(thread, NULL), 0);
  assert_int_equal(pthread_setattr_default_np(&before), 0);
  pthread_attr_destroy(&before);
  pthread_attr_destroy(&small);
  pthread_attr_destroy(&own);
#else
  skip();
#endif
}

/* As many commas as part the values of its lines. The number of lines of a log follows the clock. */
static void expect_commas(const char *path, size_t of_a_line) {
  size_t count = 0, commas = 0, lines = 0;
  char *text = read_file(path, &count);
  for (size_t i = 0; i < count; i++) {
    commas += text[i] == ',';
    lines += text[i] == '\n';
  }
  if (lines == 0 || commas != lines * of_a_line)
    fail_msg("%s has %zu commas in %zu lines, expected %zu a line: %s", path, commas, lines, of_a_line, text);
  free(text);
}

/* case: a locale that writes 0,5 | plain code: `{"loss": 0,5}` | here: points | bound: same bytes */
static void test_host_that_writes_commas(void **state) {
  (void)state;
  char half[8];
  if (!support_comma_locale()) skip();
  assert_non_null(setlocale(LC_NUMERIC, "comma_XX"));
  snprintf(half, sizeof half, "%.1f", 0.5);
  assert_string_equal(half, "0,5");
  expect_plain("commas");
  expect_commas("host.run/log.jsonl", 5);
  expect_commas("host.run/curve.csv", 2);
  snprintf(half, sizeof half, "%.1f", 0.5);
  assert_string_equal(half, "0,5");
  setlocale(LC_NUMERIC, "C");
}

static int prepare(void **state) {
  (void)state;
  made_open(&made);
  learn_and_draw(&plain);
  return 0;
}

static int close_all(void **state) {
  (void)state;
  free(plain.model);
  made_close(&made);
  return 0;
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_host_that_flushes_denormals),
                                     cmocka_unit_test(test_host_that_rounds_otherwise),
                                     cmocka_unit_test(test_settings_of_a_host_that_rounds_otherwise),
                                     cmocka_unit_test(test_host_that_traps),
                                     cmocka_unit_test(test_host_of_small_stacks),
                                     cmocka_unit_test(test_host_that_writes_commas)};
  return cmocka_run_group_tests(tests, prepare, close_all);
}
