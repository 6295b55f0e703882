/* SPDX-License-Identifier: MIT
 * The last error of a context that several threads fail on at the same time. */
#include <pthread.h>
#include <stdatomic.h>

#include "core/status.h"
#include "support.h"

enum { THREADS = 2, ROUNDS = 20000, LENGTH = 1500 };

struct failing {
  ern_context *context;
  char letter;
  atomic_size_t *torn; /* texts that were not one thread's sentence */
};

/* A sentence is one letter, LENGTH times: a copy of parts of two of them holds two letters. */
static void *fail_and_copy(void *user) {
  const struct failing *f = user;
  char sentence[LENGTH + 1], text[LENGTH + 8];
  memset(sentence, f->letter, LENGTH);
  sentence[LENGTH] = 0;
  for (int i = 0; i < ROUNDS; i++) {
    (void)ern_fail(f->context, ERN_E_IO, "%s", sentence);
    const size_t length = ern_last_error_copy(f->context, text, sizeof text);
    if (length != LENGTH || strspn(text, (char[]){text[0], 0}) != LENGTH) atomic_fetch_add(f->torn, 1);
  }
  return NULL;
}

static void test_threads_copy_whole_sentences(void **state) {
  (void)state;
  atomic_size_t torn = 0;
  struct failing failing[THREADS];
  pthread_t thread[THREADS];
  ern_context *context = support_context();
  for (int i = 0; i < THREADS; i++) {
    failing[i] = (struct failing){context, (char)('a' + i), &torn};
    assert_int_equal(pthread_create(&thread[i], NULL, fail_and_copy, &failing[i]), 0);
  }
  for (int i = 0; i < THREADS; i++) assert_int_equal(pthread_join(thread[i], NULL), 0);
  assert_int_equal(torn, 0);
  ern_context_free(&context);
}

static void test_cut_to_the_room(void **state) {
  (void)state;
  char text[8] = "........";
  ern_context *context = support_context();
  assert_int_equal(ern_last_error_copy(context, text, sizeof text), 0);
  assert_string_equal(text, "");
  (void)ern_fail(context, ERN_E_IO, "0123456789");
  assert_int_equal(ern_last_error_copy(context, text, 4), 10);
  assert_string_equal(text, "012");
  assert_int_equal(ern_last_error_copy(context, text, 1), 10);
  assert_string_equal(text, "");
  assert_int_equal(ern_last_error_copy(context, NULL, 0), 10);
  ern_context_free(&context);
}

static void keep_line(void *user, ern_log_level level, const char *line) {
  (void)level;
  assert_true(strlen(line) < 64);
  strcpy(user, line);
}

/* What a file holds is in the text: a terminal would interpret it, and the log has lines. */
static void test_control_characters_are_spaces(void **state) {
  (void)state;
  char line[64] = "";
  ern_context *context = NULL;
  ern_context_config config = ern_context_config_default();
  config.log = keep_line;
  config.user = line;
  assert_int_equal(ern_context_create(&context, &config), ERN_OK);
  (void)ern_fail(context, ERN_E_FORMAT, "%s: knows no %s", "a.json", "x\033[31m\n\xc2\x9bZ\x7f\xc3\xa9\xc2\xa0");
  assert_string_equal(ern_last_error(context), "a.json: knows no x [31m   Z \xc3\xa9\xc2\xa0");
  assert_string_equal(line, ern_last_error(context));
  ern_log(context, ERN_LOG_WARNING, "%s\xc2", "tab\there");
  assert_string_equal(line, "tab here\xc2");
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_threads_copy_whole_sentences),
                                     cmocka_unit_test(test_control_characters_are_spaces),
                                     cmocka_unit_test(test_cut_to_the_room)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
