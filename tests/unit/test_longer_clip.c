/* SPDX-License-Identifier: MIT
 * --from a file of a clip with fewer or more training frames: individual codes go row by row, with what the optimizer
 * keeps of them. */
#include "made_clip.h"
#include "train/trainer.h"

static struct made made;
static char reported[4096];

static void keep_line(void *user, ern_log_level level, const char *line) {
  (void)user;
  if (level <= ERN_LOG_INFO) snprintf(reported, sizeof reported, "%s", line);
}

/* Trained on 3 of the frames: early.safetensors, and its state. */
static int open_clip(void **state) {
  (void)state;
  made_open(&made);
  ern_backend_free(&made.backend);
  ern_context_free(&made.context);
  ern_context_config config = ern_context_config_default();
  config.log = keep_line;
  assert_int_equal(ern_context_create(&made.context, &config), ERN_OK);
  support_ok(made.context, ern_backend_create(&made.backend, made.context, NULL));
  clear_run("early"), clear_run("body");
  made.data.frames[0] = 3;
  const ern_train_config train_config = small_config(12, "early.safetensors");
  support_ok(made.context, train(&made, &train_config, NULL));
  ern_model *head = NULL;
  support_ok(made.context, ern_model_load(&head, made.context, "early.safetensors"));
  ern_train_config torso = small_config(4, "body.safetensors");
  torso.torso = true;
  torso.head = head;
  support_ok(made.context, train(&made, &torso, NULL));
  ern_model_free(&head);
  return 0;
}

static int close_clip(void **state) {
  (void)state;
  made_close(&made);
  return 0;
}

static ern_trainer *begun(const ern_train_config *config) {
  ern_trainer *trainer = NULL;
  support_ok(made.context, ern_trainer_create(&trainer, made.backend, &made.data, config));
  return trainer;
}

/* Values of a tensor that a trainer has in one of its blocks; the caller frees them. */
static float *values_of(ern_trainer *t, ern_span block, const char *name, size_t *count) {
  const struct ern_parameter *row = ern_parameters_find(&t->shared.model->table, name);
  assert_non_null(row);
  float *values = malloc(row->count * sizeof *values);
  assert_non_null(values);
  *count = row->count;
  support_ok(made.context, t->shared.backend->download_reals(t->shared.stream, values,
                                                             ern_span_part(block, row->at, row->count), row->count));
  return values;
}

/* The first `same` rows of a tensor are the same in two blocks of two trainers. */
static void expect_rows(ern_trainer *a, ern_span in_a, ern_trainer *b, ern_span in_b, const char *name, size_t from,
                        size_t count) {
  size_t all_a = 0, all_b = 0;
  float *left = values_of(a, in_a, name, &all_a), *right = values_of(b, in_b, name, &all_b);
  assert_true(from + count <= all_a && from + count <= all_b);
  assert_memory_equal(left + from, right + from, count * sizeof *left);
  free(left), free(right);
}

static void test_to_a_longer_clip(void **state) {
  (void)state;
  enum { KEPT = 3 * ERN_CODE_WIDTH };
  size_t count = 0;
  ern_train_report report;
  ern_train_config config = small_config(20, NULL);
  made.data.frames[0] = FRAMES;
  ern_trainer *fresh = begun(&config);
  config.from = "early.run/state.safetensors";
  ern_trainer *longer = begun(&config);
  if (strstr(reported, "early.run/state.safetensors: has 3 individual codes for the 4 of this training") == NULL)
    fail_msg("the log says \"%s\"", reported);
  made.data.frames[0] = 3;
  ern_trainer *same = begun(&config);
  made.data.frames[0] = FRAMES;
  ern_trainer_describe(longer, &report);
  assert_int_equal(report.step, 12);
  expect_rows(longer, longer->shared.parameters, same, same->shared.parameters, "individual_codes", 0, KEPT);
  expect_rows(longer, longer->values.second_moment, same, same->values.second_moment, "individual_codes", 0, KEPT);
  expect_rows(longer, longer->values.average, same, same->values.average, "individual_codes", 0, KEPT);
  expect_rows(longer, longer->shared.parameters, same, same->shared.parameters, "color_net.net.0.weight", 0, 8);
  expect_rows(longer, longer->shared.parameters, fresh, fresh->shared.parameters, "individual_codes", KEPT,
              ERN_CODE_WIDTH);
  expect_rows(longer, longer->values.average, fresh, fresh->shared.parameters, "individual_codes", KEPT,
              ERN_CODE_WIDTH);
  float *moment = values_of(longer, longer->values.second_moment, "individual_codes", &count);
  assert_int_equal(count, FRAMES * ERN_CODE_WIDTH);
  for (size_t i = KEPT; i < count; i++) assert_true(moment[i] == 0);
  free(moment);
  support_ok(made.context, ern_trainer_run(longer, NULL));
  ern_trainer_free(&fresh), ern_trainer_free(&longer), ern_trainer_free(&same);
}

static void test_to_a_shorter_clip(void **state) {
  (void)state;
  enum { KEPT = 2 * ERN_CODE_WIDTH };
  size_t count = 0;
  ern_train_config config = small_config(20, NULL);
  config.from = "early.run/state.safetensors";
  made.data.frames[0] = 3;
  ern_trainer *same = begun(&config);
  made.data.frames[0] = 2;
  ern_trainer *shorter = begun(&config);
  if (strstr(reported, "3 individual codes for the 2 of this training: the first 2 are kept") == NULL)
    fail_msg("the log says \"%s\"", reported);
  expect_rows(shorter, shorter->shared.parameters, same, same->shared.parameters, "individual_codes", 0, KEPT);
  expect_rows(shorter, shorter->values.second_moment, same, same->values.second_moment, "individual_codes", 0, KEPT);
  free(values_of(shorter, shorter->shared.parameters, "individual_codes", &count));
  assert_int_equal(count, KEPT);
  support_ok(made.context, ern_trainer_run(shorter, NULL));
  made.data.frames[0] = FRAMES;
  ern_trainer_free(&shorter), ern_trainer_free(&same);
}

/* A torso of the shorter clip under a head that has gone on to the longer one: the torso's rows are the file's, the
 * head's stay those of the head. */
static void test_torso_to_a_longer_clip(void **state) {
  (void)state;
  ern_model *head = NULL;
  made.data.frames[0] = FRAMES;
  ern_train_config config = small_config(14, "late.safetensors");
  clear_run("late");
  config.from = "early.run/state.safetensors";
  support_ok(made.context, train(&made, &config, NULL));
  support_ok(made.context, ern_model_load(&head, made.context, "late.safetensors"));
  config = small_config(8, NULL);
  config.torso = true;
  config.head = head;
  ern_trainer *fresh = begun(&config);
  config.from = "body.run/state.safetensors";
  ern_trainer *longer = begun(&config);
  made.data.frames[0] = 3;
  ern_model *early = NULL;
  support_ok(made.context, ern_model_load(&early, made.context, "early.safetensors"));
  config.head = early;
  ern_trainer *same = begun(&config);
  made.data.frames[0] = FRAMES;
  expect_rows(longer, longer->shared.parameters, same, same->shared.parameters, "individual_codes_torso", 0,
              3 * ERN_TORSO_CODE_WIDTH);
  expect_rows(longer, longer->values.second_moment, same, same->values.second_moment, "individual_codes_torso", 0,
              3 * ERN_TORSO_CODE_WIDTH);
  expect_rows(longer, longer->shared.parameters, fresh, fresh->shared.parameters, "individual_codes_torso",
              3 * ERN_TORSO_CODE_WIDTH, ERN_TORSO_CODE_WIDTH);
  expect_rows(longer, longer->shared.parameters, same, same->shared.parameters, "torso_net.net.0.weight", 0, 8);
  expect_rows(longer, longer->shared.parameters, fresh, fresh->shared.parameters, "individual_codes", 0,
              FRAMES * ERN_CODE_WIDTH);
  expect_rows(longer, longer->shared.parameters, fresh, fresh->shared.parameters, "color_net.net.0.weight", 0, 8);
  support_ok(made.context, ern_trainer_run(longer, NULL));
  ern_model *portrait = NULL;
  ern_model_info info;
  support_ok(made.context, ern_trainer_model(longer, &portrait));
  ern_model_describe(portrait, &info);
  assert_int_equal(info.head_steps, 14);
  assert_int_equal(info.torso_steps, 8);
  assert_int_equal(info.codes, FRAMES);
  ern_model_free(&portrait), ern_model_free(&head), ern_model_free(&early);
  ern_trainer_free(&fresh), ern_trainer_free(&longer), ern_trainer_free(&same);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_to_a_longer_clip), cmocka_unit_test(test_to_a_shorter_clip),
                                     cmocka_unit_test(test_torso_to_a_longer_clip)};
  return cmocka_run_group_tests(tests, open_clip, close_clip);
}
