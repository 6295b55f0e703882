/* SPDX-License-Identifier: MIT
 * A slot that crashes is named before the process ends by the signal. */
#include "machines.h"

#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

/* Ends in a slot by `number`; its words go to `said`. */
static int crash(int number, char said[256]) {
  int ends[2], status = 0;
  assert_int_equal(pipe(ends), 0);
  fflush(NULL);
  const pid_t child = fork();
  assert_true(child >= 0);
  if (child == 0) {
    dup2(ends[1], STDERR_FILENO);
    machines.name[0] = "a machine";
    machines_begin(0, "a_slot");
    raise(number);
    _exit(0);
  }
  close(ends[1]);
  const ssize_t bytes = read(ends[0], said, 255);
  said[bytes > 0 ? bytes : 0] = 0;
  close(ends[0]);
  assert_int_equal(waitpid(child, &status, 0), child);
  assert_true(WIFSIGNALED(status));
  return WTERMSIG(status);
}

static void test_crash(void **state) {
  (void)state;
  static const int numbers[] = {SIGSEGV, SIGBUS, SIGILL, SIGFPE, SIGABRT};
  for (size_t i = 0; i < COUNT_OF(numbers); i++) {
    char said[256];
    assert_int_equal(crash(numbers[i], said), numbers[i]);
    assert_string_equal(said, "crashed in a_slot on a machine\n");
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_crash)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
