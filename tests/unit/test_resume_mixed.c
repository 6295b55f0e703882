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

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_resume_under_another_head),
                                     cmocka_unit_test(test_links_in_the_run_folder)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
