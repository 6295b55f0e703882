/* SPDX-License-Identifier: MIT
 * A resume that meets what is not its own: another head, and links in X.run that lead to files of others. */
#include <unistd.h>

#include "made_clip.h"

static void train_to(struct made *m, const char *output, uint64_t iters) {
  const ern_train_config config = small_config(iters, output);
  support_ok(m->context, train(m, &config, NULL));
}

/* A torso that goes on under another head would be a mixture of two. */
static void test_resume_under_another_head(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  ern_model *heads[2] = {NULL, NULL};
  made_open(&m);
  clear_run("first"), clear_run("second"), clear_run("under");
  train_to(&m, "first.safetensors", 3);
  train_to(&m, "second.safetensors", 4);
  support_ok(m.context, ern_model_load(&heads[0], m.context, "first.safetensors"));
  support_ok(m.context, ern_model_load(&heads[1], m.context, "second.safetensors"));
  ern_train_config config = small_config(3, "under.safetensors");
  config.torso = true;
  config.head = heads[0];
  support_ok(m.context, train(&m, &config, NULL));
  config.iters = 5;
  config.resume = true;
  config.head = heads[1];
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_MISMATCH, "under.run",
                 "another head", NULL);
  config.head = heads[0];
  support_ok(m.context, train(&m, &config, NULL));
  ern_model_free(&heads[0]);
  ern_model_free(&heads[1]);
  made_close(&m);
}

/* Lines are appended to no file that a link in X.run leads to. */
static void test_links_in_the_run_folder(void **state) {
  (void)state;
  static const char *const names[] = {"linked.run/log.jsonl", "linked.run/curve.csv"};
  struct made m;
  ern_trainer *trainer = NULL;
  made_open(&m);
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    size_t count = 0;
    clear_run("linked");
    train_to(&m, "linked.safetensors", 3);
    support_write_text("somebodys.csv", "mine");
    (void)remove(names[i]);
    assert_int_equal(symlink("../somebodys.csv", names[i]), 0);
    ern_train_config config = small_config(6, "linked.safetensors");
    config.resume = true;
    support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_IO, names[i],
                   "symbolic link", NULL);
    char *text = read_file("somebodys.csv", &count);
    assert_int_equal(count, 4);
    free(text);
  }
  made_close(&m);
}

/* A training that hears copies of the speech is gone on with the same copies, as often; they change what is learnt. */
static void test_copies_long(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  made_open(&m);
  clear_run("plain"), clear_run("copied"), clear_run("whole");
  train_to(&m, "plain.safetensors", 6);
  static float spoken[sizeof m.speech / sizeof *m.speech];
  for (size_t i = 0; i < sizeof spoken / sizeof *spoken; i++) spoken[i] = -m.speech[i];
  const ern_features copy = {spoken, m.features.windows, m.features.window_length, m.features.width};
  m.data.copies = &copy;
  m.data.copy_count = 1;
  m.data.copy_share = 0.5f;
  train_to(&m, "whole.safetensors", 6);
  size_t count[2] = {0};
  char *plain = read_file("plain.safetensors", &count[0]), *whole = read_file("whole.safetensors", &count[1]);
  assert_true(count[0] == count[1] && memcmp(plain, whole, count[0]) != 0);
  free(plain), free(whole);
  ern_train_config config = small_config(6, "copied.safetensors");
  config.save_every = 4;
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  ern_train_report report;
  for (int k = 0; k < 4; k++) support_ok(m.context, ern_trainer_step(trainer, &report));
  support_ok(m.context, ern_trainer_save(trainer));
  ern_trainer_free(&trainer);
  config.resume = true;
  m.data.copy_share = 0.25f;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_MISMATCH, "copied.run",
                 "speech features and their augmentation", NULL);
  m.data.copy_share = 0.5f;
  spoken[5] += 1;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_MISMATCH,
                 "their augmentation", NULL);
  spoken[5] -= 1;
  m.data.speech_noise = 0.5f;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_MISMATCH,
                 "--speech-augment", NULL);
  m.data.speech_noise = 0;
  support_ok(m.context, train(&m, &config, NULL));
  expect_same("whole.safetensors", "copied.safetensors");
  made_close(&m);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_resume_under_another_head),
                                     cmocka_unit_test(test_links_in_the_run_folder),
                                     cmocka_unit_test(test_copies_long)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
