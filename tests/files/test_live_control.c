/* SPDX-License-Identifier: MIT
 * The socket of `live --control NAME`: what is at NAME already, and what is removed at the end. */
#include "../support.h"

#include <stdbool.h>

/* In place of the program's. */
#define session_fail_with live_control_fail_with
#include "../../tools/ernerf-cli/live/live_control.c"

static char said[4096];

int session_fail_with(struct session *session, const char *format, ...) {
  va_list values;
  (void)session;
  va_start(values, format);
  vsnprintf(said, sizeof said, format, values);
  va_end(values);
  return EXIT_FAILURE;
}

static bool there(const char *path) {
  struct stat about;
  return lstat(path, &about) == 0;
}

/* A socket of another program, which waits for connections where `listens`. */
static int bound(const char *path, int type, bool listens) {
  struct sockaddr_un name = {.sun_family = AF_UNIX};
  const int other = socket(AF_UNIX, type, 0);
  strcpy(name.sun_path, path);
  assert_int_equal(bind(other, (const struct sockaddr *)&name, sizeof name), 0);
  if (listens) assert_int_equal(listen(other, 1), 0);
  return other;
}

static void start(struct live_control *control, const char *path, int status) {
  *control = (struct live_control){.path = path};
  assert_int_equal(live_control_start(control, NULL), status);
}

static void test_in_use(void **state) {
  static const struct {
    int type;
    bool listens;
    const char *word;
  } cases[] = {{SOCK_DGRAM, false, "did not make"},
               {SOCK_SEQPACKET, true, "did not make"},
               {SOCK_STREAM, true, "another program listens"}};
  struct live_control control;
  (void)state;
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    support_clear("used.sock");
    const int other = bound("used.sock", cases[i].type, cases[i].listens);
    start(&control, "used.sock", EXIT_FAILURE);
    live_control_stop(&control);
    assert_non_null(strstr(said, "used.sock"));
    assert_non_null(strstr(said, cases[i].word));
    assert_true(there("used.sock"));
    close(other);
  }
  support_write_text("file", "mine");
  start(&control, "file", EXIT_FAILURE);
  live_control_stop(&control);
  assert_non_null(strstr(said, "is no socket"));
  assert_true(there("file"));
}

/* One whose backlog is full does not answer. */
static void test_full(void **state) {
  struct live_control control;
  struct sockaddr_un name = {.sun_family = AF_UNIX, .sun_path = "full.sock"};
  int client[8];
  (void)state;
  support_clear("full.sock");
  const int other = bound("full.sock", SOCK_STREAM, true);
  for (size_t i = 0; i < sizeof client / sizeof *client; i++) {
    client[i] = socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0);
    (void)connect(client[i], (const struct sockaddr *)&name, sizeof name);
  }
  start(&control, "full.sock", EXIT_FAILURE);
  live_control_stop(&control);
  assert_non_null(strstr(said, "another program listens"));
  assert_true(there("full.sock"));
  for (size_t i = 0; i < sizeof client / sizeof *client; i++) close(client[i]);
  close(other);
}

static void test_stale(void **state) {
  struct live_control control;
  (void)state;
  support_clear("stale.sock");
  close(bound("stale.sock", SOCK_STREAM, true));
  start(&control, "stale.sock", 0);
  live_control_stop(&control);
  assert_false(there("stale.sock"));
}

/* Lines that have come in together are served together, not one a frame. */
static void test_many_lines(void **state) {
  enum { LINES = 40 };
  const struct sockaddr_un name = {.sun_family = AF_UNIX, .sun_path = "many.sock"};
  struct live_control control;
  char text[LINES * 8] = "";
  int served = 0, looks = 0;
  (void)state;
  support_clear("many.sock");
  start(&control, "many.sock", 0);
  const int client = socket(AF_UNIX, SOCK_STREAM, 0);
  for (int i = 0; i < LINES; i++) strcat(text, "eyes 1\n");
  assert_int_equal(connect(client, (const struct sockaddr *)&name, sizeof name), 0);
  assert_int_equal(write(client, text, strlen(text)), (ssize_t)strlen(text));
  (void)nanosleep(&(struct timespec){.tv_nsec = 300000000}, NULL); /* the thread takes the connection */
  for (; served < LINES && looks < LINES; looks++)
    for (; live_control_line(&control) != NULL; served++) live_control_answer(&control, "ok");
  live_control_stop(&control);
  close(client);
  assert_int_equal(served, LINES);
  if (looks > 5) fail_msg("%d looks for %d lines, expected 1 where the machine is idle", looks, LINES);
}

/* At the end the name may be another program's. */
static void test_replaced(void **state) {
  struct live_control control;
  (void)state;
  support_clear("taken.sock");
  start(&control, "taken.sock", 0);
  assert_int_equal(unlink("taken.sock"), 0);
  const int other = bound("taken.sock", SOCK_DGRAM, false);
  live_control_stop(&control);
  assert_true(there("taken.sock"));
  close(other);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_in_use), cmocka_unit_test(test_full),
                                     cmocka_unit_test(test_stale), cmocka_unit_test(test_many_lines),
                                     cmocka_unit_test(test_replaced)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
