/* SPDX-License-Identifier: MIT
 * Data augmentation of the speech: the windows of a step with noise, also of features that do not vary, of
 * windows that do not overlap, and with wrong settings (docs/numerics.md). */
#include "made_clip.h"
#include "train/trainer.h"

enum { LENGTH = 16, VALUES = ERN_AUDIO_WINDOWS * LENGTH * WIDTH, VECTORS = 2 * (ERN_AUDIO_WINDOWS - 1) + LENGTH };

static struct made made;

static ern_trainer *trainer_of(float noise) {
  ern_trainer *t = NULL;
  ern_train_config config = small_config(10, NULL);
  made.data.speech_noise = noise;
  support_ok(made.context, ern_trainer_create(&t, made.backend, &made.data, &config));
  return t;
}

/* host_windows of a training frame, as part k of this step has them. */
static const float *step_windows(ern_trainer *t, size_t frame, size_t k) {
  ern_span windows;
  const struct ern_arena_mark mark = ern_arena_mark(t->shared.stream);
  support_ok(made.context, ern_trainer_upload_windows(&t->speech, frame, k, &windows));
  ern_arena_release(t->shared.stream, mark);
  return t->speech.windows;
}

static void plain_windows(ern_trainer *t, size_t frame, float *to) {
  support_ok(made.context, ern_trainer_windows(&t->speech, 0, frame, to));
}

/* noise[v][c]: what vector v of the step has beyond plain, in deviations. Checks that all windows agree on it. */
static void noise_of(const ern_trainer *t, const float *heard, const float *plain, float noise[VECTORS][WIDTH]) {
  bool known[VECTORS][WIDTH] = {{false}};
  for (int i = 0; i < VALUES; i++) {
    const int w = i / (LENGTH * WIDTH), c = i % WIDTH, v = 2 * w + i / WIDTH % LENGTH;
    const float added = (heard[i] - plain[i]) / t->speech.deviation[c];
    if (known[v][c]) assert_float_equal(added, noise[v][c], 1e-5); /* rounding of heard */
    noise[v][c] = added;
    known[v][c] = true;
  }
}

/* case: noise of the speech of 0.5 deviations | plain code: another noise in each window | here: one noise a vector, of
 * that deviation, the same in a step | bound: 1e-5; 4 standard errors */
/* A vector has one noise, whichever windows it is in; its deviation is that asked for. The same step has the same
 * noise, another part or step has another. */
static void test_speech_noise(void **state) {
  (void)state;
  made_open(&made);
  static float plain[VALUES], noise[VECTORS][WIDTH], first[VALUES];
  enum { STEPS = 40 };
  const double count = (double)STEPS * VECTORS * WIDTH;
  ern_trainer *t = trainer_of(0.5f);
  plain_windows(t, 3, plain);
  double sum = 0, squares = 0;
  for (t->shared.step = 0; t->shared.step < STEPS; t->shared.step++) {
    noise_of(t, step_windows(t, 3, 1), plain, noise);
    for (int v = 0; v < VECTORS; v++)
      for (int c = 0; c < WIDTH; c++) sum += (double)noise[v][c], squares += (double)noise[v][c] * (double)noise[v][c];
  }
  /* within four standard errors: sigma/sqrt(n), and sigma/sqrt(2n) */
  assert_true(fabs(sum / count) < 4 * 0.5 / sqrt(count));
  assert_true(fabs(sqrt(squares / count) - 0.5) < 4 * 0.5 / sqrt(2 * count));
  memcpy(first, step_windows(t, 3, 1), sizeof first);
  assert_memory_equal(first, step_windows(t, 3, 1), sizeof first);
  assert_memory_not_equal(first, step_windows(t, 3, 2), sizeof first);
  t->shared.step++;
  assert_memory_not_equal(first, step_windows(t, 3, 1), sizeof first);
  ern_trainer_free(&t);
  made_close(&made);
}

/* case: noise of a feature that never changes | plain code: 0/0 | here: none | bound: exact */
/* A feature that never changes has no deviation, and gets no noise. */
static void test_constant_feature(void **state) {
  (void)state;
  made_open(&made);
  static float plain[VALUES];
  for (int i = 0; i < WINDOWS * LENGTH; i++) made.speech[i * WIDTH + 1] = 7;
  ern_trainer *t = trainer_of(ERN_SPEECH_NOISE_MOST);
  plain_windows(t, 3, plain);
  const float *heard = step_windows(t, 3, 0);
  size_t others = 0;
  for (int i = 0; i < VALUES; i++) {
    if (i % WIDTH == 1) assert_true(heard[i] == 7);
    if (i % WIDTH != 1) others += heard[i] != plain[i];
  }
  assert_true(others > VALUES / 2);
  ern_trainer_free(&t);
  made_close(&made);
}

/* case: the largest noise, of windows of one vector | plain code: a vector in no window | here: finite | bound: finite
 */
/* The largest noise leaves a training finite, also on windows that do not overlap. */
static void test_largest_noise(void **state) {
  (void)state;
  made_open(&made);
  made.features = (ern_features){made.speech, WINDOWS * LENGTH, 1, WIDTH};
  made.data.speech_noise = ERN_SPEECH_NOISE_MOST;
  const ern_train_config config = small_config(20, NULL);
  support_ok(made.context, train(&made, &config, NULL));
  made_close(&made);
}

/* case: noise of -0.1, 10.1, NaN, infinity | plain code: values without a bound | here: refused by name | bound: exact
 */
static void test_refused_noise(void **state) {
  (void)state;
  made_open(&made);
  static const float noises[] = {-0.1f, 10.1f, NAN, INFINITY};
  const ern_train_config config = small_config(10, NULL);
  ern_trainer *t = NULL;
  for (size_t k = 0; k < sizeof noises / sizeof *noises; k++) {
    made.data.speech_noise = noises[k];
    support_expect(made.context, ern_trainer_create(&t, made.backend, &made.data, &config), ERN_E_ARGUMENT,
                   "speech_noise", NULL);
  }
  made_close(&made);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_speech_noise), cmocka_unit_test(test_constant_feature),
                                     cmocka_unit_test(test_largest_noise), cmocka_unit_test(test_refused_noise)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
