/* SPDX-License-Identifier: MIT
 * Products of bf16 in training: where they are refused, what `auto` takes, the same bytes for any number of threads and
 * after a resume, which keeps what its state says. */
#include "made_clip.h"
#include "train/state_about.h"
#include "train/trainer.h"

enum { STEPS = 6, RAYS = 200 };

static struct made made;
static ern_backend *fast, *plain;    /* avx512bf16, NULL: not of this machine; another of the CPU's */
static char reported[SUPPORT_LINES]; /* warnings */

static ern_status open_backend(ern_backend **backend, const char *isa) {
  ern_backend_config config = ern_backend_config_default();
  config.name = "cpu";
  config.isa = isa;
  return ern_backend_create(backend, made.context, &config);
}

static ern_train_config config_of(ern_precision precision, const char *output) {
  ern_train_config config = small_config(STEPS, output);
  config.rays = RAYS;
  config.precision = precision;
  return config;
}

static void expect_refused(ern_backend *backend, const ern_train_config *config, ern_status status, const char *word) {
  ern_trainer *trainer = NULL;
  support_expect(made.context, ern_trainer_create(&trainer, backend, &made.data, config), status, "precision is", word,
                 NULL);
  assert_null(trainer);
}

static void expect_chosen(ern_backend *backend, const ern_train_config *config, bool bf16) {
  ern_trainer *trainer = NULL;
  support_ok(made.context, ern_trainer_create(&trainer, backend, &made.data, config));
  assert_int_equal(trainer->shared.bf16, bf16);
  ern_trainer_free(&trainer);
}

static void test_refused(void **state) {
  (void)state;
  ern_train_config config = config_of(ERN_PRECISION_BF16, NULL);
  expect_refused(plain, &config, ERN_E_UNSUPPORTED, "avx512bf16");
  config.precision = (ern_precision)4;
  expect_refused(plain, &config, ERN_E_ARGUMENT, "expected 0 to 3");
  config.precision = (ern_precision)-1;
  expect_refused(plain, &config, ERN_E_ARGUMENT, "expected 0 to 3");
  config = config_of(ERN_PRECISION_BF16, NULL);
  config.attention = ERN_ATTENTION_CONCAT;
  expect_refused(fast != NULL ? fast : plain, &config, ERN_E_UNSUPPORTED, "not trihash with channel attention");
}

static void test_chosen(void **state) {
  (void)state;
  static const ern_precision precisions[] = {ERN_PRECISION_DEFAULT, ERN_PRECISION_FP32, ERN_PRECISION_AUTO};
  for (size_t i = 0; i < sizeof precisions / sizeof *precisions; i++) {
    ern_train_config config = config_of(precisions[i], NULL);
    expect_chosen(plain, &config, false);
    if (fast == NULL) continue;
    expect_chosen(fast, &config, precisions[i] == ERN_PRECISION_AUTO);
    config.attention = ERN_ATTENTION_CONCAT;
    expect_chosen(fast, &config, false);
  }
}

/* The model of a whole training, by some threads; in two parts where `stop` > 0, the second by `again`. */
static void train_to(const char *output, ern_precision precision, int threads, uint64_t stop, ern_precision again) {
  ern_train_config config = config_of(precision, output);
  ern_trainer *trainer = NULL;
  ern_train_report report;
  config.threads = threads;
  if (stop > 0) {
    support_ok(made.context, ern_trainer_create(&trainer, fast, &made.data, &config));
    for (uint64_t k = 0; k < stop; k++) support_ok(made.context, ern_trainer_step(trainer, &report));
    support_ok(made.context, ern_trainer_save(trainer));
    ern_trainer_free(&trainer);
    config.overwrite = false;
    config.resume = true;
    config.precision = again;
  }
  support_ok(made.context, ern_trainer_create(&trainer, fast, &made.data, &config));
  assert_int_equal(trainer->shared.step, stop);
  support_ok(made.context, ern_trainer_run(trainer, NULL));
  ern_trainer_free(&trainer);
}

static bool same_values(const char *a, const char *b) {
  ern_model *model[2] = {NULL, NULL};
  support_ok(made.context, ern_model_load(&model[0], made.context, a));
  support_ok(made.context, ern_model_load(&model[1], made.context, b));
  const size_t count = model[0]->field.parameters;
  assert_int_equal(count, model[1]->field.parameters);
  const bool same = memcmp(model[0]->block, model[1]->block, count * sizeof(float)) == 0;
  for (int k = 0; k < 2; k++) ern_model_free(&model[k]);
  return same;
}

static void test_same_bytes(void **state) {
  (void)state;
  ern_train_state about;
  ern_model_info info;
  if (fast == NULL) skip();
  train_to("one.safetensors", ERN_PRECISION_BF16, 1, 0, 0);
  train_to("float.safetensors", ERN_PRECISION_FP32, 1, 0, 0);
  assert_false(same_values("one.safetensors", "float.safetensors"));
  for (int threads = 2; threads <= 4; threads *= 2) {
    train_to("other.safetensors", ERN_PRECISION_AUTO, threads, 0, 0);
    expect_same("one.safetensors", "other.safetensors");
  }
  reported[0] = 0;
  train_to("other.safetensors", ERN_PRECISION_BF16, 2, 3, ERN_PRECISION_DEFAULT);
  assert_string_equal(reported, "");
  assert_true(same_values("one.safetensors", "other.safetensors"));
  support_ok(made.context, ern_train_state_describe(made.context, "other.safetensors", &about, &info));
  assert_int_equal(about.precision, ERN_PRECISION_BF16);
  train_to("other.safetensors", ERN_PRECISION_FP32, 2, 3, ERN_PRECISION_DEFAULT);
  assert_true(same_values("float.safetensors", "other.safetensors"));
  support_ok(made.context, ern_train_state_describe(made.context, "other.safetensors", &about, &info));
  assert_int_equal(about.precision, ERN_PRECISION_FP32);
  assert_string_equal(reported, "");
}

/* Asked for, a resume goes on otherwise and says so; where its machine cannot, it is refused. */
static void test_changed(void **state) {
  (void)state;
  if (fast == NULL) skip();
  reported[0] = 0;
  train_to("changed.safetensors", ERN_PRECISION_FP32, 2, 3, ERN_PRECISION_BF16);
  assert_string_equal(reported, "changed.run/state.safetensors: precision was fp32, going on with bf16\n");
  ern_train_config config = config_of(ERN_PRECISION_DEFAULT, "changed.safetensors");
  config.overwrite = false;
  config.resume = true;
  expect_refused(plain, &config, ERN_E_UNSUPPORTED, "changed.run/state.safetensors");
  config.precision = ERN_PRECISION_FP32;
  expect_chosen(plain, &config, false);
}

static void test_torso_long(void **state) {
  (void)state;
  ern_model *head = NULL;
  clear_run("under");
  ern_train_config config = config_of(ERN_PRECISION_FP32, "under.safetensors");
  support_ok(made.context, train(&made, &config, NULL));
  support_ok(made.context, ern_model_load(&head, made.context, "under.safetensors"));
  config = config_of(ERN_PRECISION_BF16, NULL);
  config.torso = true;
  config.head = head;
  expect_refused(fast != NULL ? fast : plain, &config, ERN_E_UNSUPPORTED, "expected fp32 for a torso");
  config.precision = ERN_PRECISION_AUTO;
  expect_chosen(fast != NULL ? fast : plain, &config, false);
  ern_model_free(&head);
}

static void test_state(void **state) {
  (void)state;
  struct ern_state_about about;
#define STATE(more)                                                                                                   \
  "{\"torso\":false,\"step\":4,\"ema_updates\":2,\"seconds\":1.5,\"training\":{\"settings\":{\"data_end\":\"3\"" more \
  "},\"torso_layer\":true,\"features\":\"\",\"fingerprint\":\"\",\"seconds_beside\":0,\"fine_loss\":\"ssim\","        \
  "\"pruned\":false}}"
  support_ok(made.context, ern_state_about_parse(made.context, STATE(",\"precision\":\"bf16\""), "s", &about));
  assert_int_equal(about.config.precision, ERN_PRECISION_BF16);
  static const char *const wrong[] = {STATE(",\"precision\":\"fp16\""), STATE(",\"precision\":2")};
  for (size_t i = 0; i < 2; i++)
    support_expect(made.context, ern_state_about_parse(made.context, wrong[i], "s", &about), ERN_E_FORMAT,
                   "training.precision", NULL);
}

static int open_all(void **state) {
  (void)state;
  made_open(&made);
  ern_backend_free(&made.backend);
  ern_context_free(&made.context);
  ern_context_config config = ern_context_config_default();
  config.user = reported;
  config.log = support_keep_warnings;
  assert_int_equal(ern_context_create(&made.context, &config), ERN_OK);
  support_ok(made.context, open_backend(&made.backend, "ref"));
  if (open_backend(&plain, "avx512") != ERN_OK) support_ok(made.context, open_backend(&plain, "ref"));
  const ern_status status = open_backend(&fast, "avx512bf16");
  assert_true(status == ERN_OK || status == ERN_E_UNSUPPORTED);
  return 0;
}

static int close_all(void **state) {
  (void)state;
  ern_backend_free(&fast);
  ern_backend_free(&plain);
  made_close(&made);
  return 0;
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_refused),    cmocka_unit_test(test_chosen),
                                     cmocka_unit_test(test_same_bytes), cmocka_unit_test(test_changed),
                                     cmocka_unit_test(test_torso_long), cmocka_unit_test(test_state)};
  return cmocka_run_group_tests(tests, open_all, close_all);
}
