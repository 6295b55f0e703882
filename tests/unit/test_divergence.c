/* SPDX-License-Identifier: MIT
 * A training that dies with every value finite is told of; one that is merely uneven is not. */
#include "made_clip.h"

#include "train/divergence.h"

/* Steps of `count` at about `psnr` dB, each up to `spread` off; how often the fall was told. */
static int run(struct ern_divergence *divergence, int count, double psnr, double spread) {
  int reported = 0;
  for (int i = 0; i < count; i++) reported += ern_divergence_step(divergence, psnr + spread * sin(1.7 * i));
  return reported;
}

static void test_even_and_uneven(void **state) {
  (void)state;
  struct ern_divergence even = {0}, uneven = {0}, rising = {0};
  assert_int_equal(run(&even, 1000, 20, 0), 0);
  assert_int_equal(run(&uneven, 1000, 20, 12), 0);
  for (int i = 0; i < 1000; i++) assert_false(ern_divergence_step(&rising, 5 + 0.03 * i));
}

/* A first step that is better by chance is not what the rest is held against. */
static void test_chance(void **state) {
  (void)state;
  struct ern_divergence divergence = {0};
  assert_int_equal(run(&divergence, 1, 18, 0), 0);
  assert_int_equal(run(&divergence, 500, 10, 1), 0);
}

static void test_fall(void **state) {
  (void)state;
  struct ern_divergence early = {0}, late = {0};
  assert_int_equal(run(&early, 16, 19, 0.5) + run(&early, 47, 4, 0.5), 0); /* 63 steps say nothing yet */
  assert_int_equal(run(&early, 1, 4, 0.5), 1);
  assert_int_equal(run(&early, 1000, 4, 0.5), 0); /* said once */
  assert_int_equal(run(&late, 5000, 31, 2), 0);
  assert_int_equal(run(&late, 64, 6, 1), 1);
  assert_int_equal(run(&late, 200, 31, 1), 0); /* it came back */
  assert_int_equal(run(&late, 200, 6, 1), 1);
}

static int warnings;

static void count_warnings(void *user, ern_log_level level, const char *line) {
  (void)user;
  if (level == ERN_LOG_WARNING && strstr(line, "has fallen") != NULL) warnings++;
}

/* Pictures that are a little darker than their background. */
static void open_even(struct made *m) {
  ern_context_config config = ern_context_config_default();
  config.log = count_warnings;
  made_open(m);
  for (int i = 0; i < FRAMES * SIDE * SIDE * 3; i++)
    m->truth[i / (SIDE * SIDE * 3)][i % (SIDE * SIDE * 3)] = (uint8_t)(m->background[i % (SIDE * SIDE * 3)] - 5);
  ern_backend_free(&m->backend);
  ern_context_free(&m->context);
  support_ok(NULL, ern_context_create(&m->context, &config));
  support_ok(m->context, ern_backend_create(&m->backend, m->context, NULL));
}

/* The state in `path` is of step `step`. */
static void expect_step(struct made *m, const char *path, uint64_t step) {
  ern_train_config config = small_config(1000, "another.safetensors");
  ern_train_report report;
  ern_trainer *trainer = NULL;
  config.from = path;
  clear_run("another");
  support_ok(m->context, ern_trainer_create(&trainer, m->backend, &m->data, &config));
  ern_trainer_describe(trainer, &report);
  assert_int_equal(report.step, step);
  ern_trainer_free(&trainer);
}

/* A training at the usual rates, and its resume at three hundred times the networks'. */
static void test_training_long(void **state) {
  (void)state;
  struct made m;
  open_even(&m);
  clear_run("decline");
  ern_train_config config = small_config(80, "decline.safetensors");
  support_ok(m.context, train(&m, &config, NULL));
  assert_int_equal(warnings, 0);
  config.resume = true;
  config.iters = 160;
  config.lr_net = 0.3f;
  support_ok(m.context, train(&m, &config, NULL));
  assert_int_equal(warnings, 1);
  expect_step(&m, "decline.run/state.good.safetensors", 80);
  expect_step(&m, "decline.run/state.safetensors", 160);
  made_close(&m);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_even_and_uneven), cmocka_unit_test(test_chance),
                                     cmocka_unit_test(test_fall), cmocka_unit_test(test_training_long)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
