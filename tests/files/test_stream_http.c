/* SPDX-License-Identifier: MIT
 * Streams to viewers by HTTP: who is served, who is not, and who does not keep others waiting. */
#include <errno.h>
#include <pthread.h>
#include <stdbool.h>
#include <time.h>

#include "media/live/descriptor_io.h"
#include "stream_support.h"

struct browser {
  uint16_t port;
  bool has_piece; /* of an mp4 */
};

static int connect_to(uint16_t port) {
  const struct sockaddr_in address = {
      .sin_family = AF_INET, .sin_port = htons(port), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
  for (int look = 0; look < PATIENCE; look++) {
    const int made = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (made < 0 || connect(made, (const struct sockaddr *)&address, sizeof address) == 0) return made;
    (void)close(made);
    (void)nanosleep(&(struct timespec){.tv_nsec = 50000000}, NULL);
  }
  return -1;
}

/* Reads until the first piece of an mp4, and leaves. */
static void *browse(void *user) {
  static const char ask[] = "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n";
  struct browser *browser = user;
  char bytes[16384];
  size_t count = 0;
  const int to = connect_to(browser->port);
  if (to < 0) return NULL;
  if (send(to, ask, sizeof ask - 1, 0) != (ssize_t)sizeof ask - 1) count = sizeof bytes;
  while (count < sizeof bytes && !browser->has_piece) {
    const ssize_t got = recv(to, bytes + count, sizeof bytes - count, 0);
    if (got <= 0) break;
    count += (size_t)got;
    for (size_t i = 0; i + 4 <= count; i++) browser->has_piece |= memcmp(bytes + i, "moof", 4) == 0;
  }
  (void)close(to);
  return NULL;
}

static void test_a_browser_comes_and_leaves(void **state) {
  (void)state;
  struct browser browser = {.port = free_port()};
  struct patience patience = {PATIENCE};
  ern_stream_options options = options_of_stream(NULL);
  char url[64];
  pthread_t thread;
  ern_status status = ERN_OK;
  const size_t before = descriptors();
  options.stop = loses_patience;
  options.user = &patience;
  snprintf(url, sizeof url, "http://127.0.0.1:%d/", browser.port);
  assert_int_equal(pthread_create(&thread, NULL, browse, &browser), 0);
  for (int k = 0; k < 1000 && (status = write_stream(url, &options)) == ERN_OK; k++) continue;
  assert_int_equal(pthread_join(thread, NULL), 0);
  support_expect(context, status, ERN_E_IO, url, NULL);
  assert_true(browser.has_piece);
  assert_int_equal(descriptors(), before);
}

/* Sends a request, and copies the first line of the answer. */
static void ask(uint16_t port, const char *head, char answer[64]) {
  const int to = connect_to(port);
  size_t count = 0;
  if (to >= 0 && send(to, head, strlen(head), 0) == (ssize_t)strlen(head)) {
    while (count < 63) {
      const ssize_t got = recv(to, answer + count, 63 - count, 0);
      if (got <= 0) break;
      count += (size_t)got;
    }
  }
  answer[count] = 0;
  answer[strcspn(answer, "\r\n")] = 0;
  if (to >= 0) (void)close(to);
}

static const char *const refused_heads[][2] = {
    {"GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n", "403"},
    {"GET / HTTP/1.1\r\nHost: evil.example:80\r\n\r\n", "403"},
    {"GET / HTTP/1.1\r\nHost: 127.0.0.1.evil.example\r\n\r\n", "403"},
    {"GET / HTTP/1.1\r\nHost: [evil.example]\r\n\r\n", "403"},
    {"GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: http://evil.example\r\n\r\n", "403"},
    {"GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: null\r\n\r\n", "403"},
    {"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n", "400"},
    {"GET / HTTP/1.1\r\nAccept: */*\r\n\r\n", "400"},
    {"POST / HTTP/1.1\r\nHost: localhost\r\n\r\n", "405"}};
enum { REFUSED_HEADS = sizeof refused_heads / sizeof *refused_heads, SILENT = 9 };

struct visit {
  struct browser browser;
  char answers[REFUSED_HEADS][64];
};

/* Requests of other sites' pages, then more silent connections than the server keeps, then a browser. */
static void *visit(void *user) {
  struct visit *visit = user;
  int silent[SILENT];
  for (size_t i = 0; i < REFUSED_HEADS; i++) ask(visit->browser.port, refused_heads[i][0], visit->answers[i]);
  for (size_t i = 0; i < SILENT; i++) silent[i] = connect_to(visit->browser.port);
  (void)browse(&visit->browser);
  for (size_t i = 0; i < SILENT; i++)
    if (silent[i] >= 0) (void)close(silent[i]);
  return NULL;
}

static void test_only_its_own_pages_are_served(void **state) {
  (void)state;
  struct visit visits = {.browser.port = free_port()};
  struct patience patience = {PATIENCE};
  ern_stream_options options = options_of_stream(NULL);
  ern_stream_writer *writer;
  char url[64];
  pthread_t thread;
  ern_status status = ERN_OK;
  const size_t before = descriptors();
  options.stop = loses_patience;
  options.user = &patience;
  snprintf(url, sizeof url, "http://127.0.0.1:%d/", visits.browser.port);
  assert_int_equal(pthread_create(&thread, NULL, visit, &visits), 0);
  for (int k = 0; k < 1000 && (status = write_stream(url, &options)) == ERN_OK; k++) continue;
  assert_int_equal(pthread_join(thread, NULL), 0);
  support_expect(context, status, ERN_E_IO, url, NULL);
  for (size_t i = 0; i < REFUSED_HEADS; i++)
    if (strncmp(visits.answers[i], "HTTP/1.1 ", 9) != 0 || strstr(visits.answers[i], refused_heads[i][1]) == NULL)
      fail_msg("\"%s\" to %s, expected %s", visits.answers[i], refused_heads[i][0], refused_heads[i][1]);
  assert_true(visits.browser.has_piece);
  assert_int_equal(descriptors(), before);

  /* where another program listens, and what is no address to listen at */
  struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
  socklen_t bytes = sizeof address;
  const int other = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  assert_int_equal(bind(other, (const struct sockaddr *)&address, bytes), 0);
  assert_int_equal(listen(other, 1), 0);
  assert_int_equal(getsockname(other, (struct sockaddr *)&address, &bytes), 0);
  snprintf(url, sizeof url, "http://127.0.0.1:%d/", ntohs(address.sin_port));
  support_expect(context, ern_stream_writer_open(context, url, &options, &writer), ERN_E_BUSY, url, "cannot listen",
                 NULL);
  (void)close(other);
  static const char *const wrong[] = {"http://[::1/",
                                      "http://127.0.0.1:80x/",
                                      "http://127.0.0.1:99999/",
                                      "http://127.0.0.1:65536/",
                                      "http://127.0.0.1:0/",
                                      "http://",
                                      "http:///a.mp4"};
  for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++)
    support_expect(context, ern_stream_writer_open(context, wrong[i], &options, &writer), ERN_E_ARGUMENT, wrong[i],
                   "expected http://HOST:PORT/", NULL);
}

/* A viewer who takes nothing any more does not keep others out for ever. */
static void test_a_stalled_viewer_is_left(void **state) {
  (void)state;
  static uint8_t bytes[1 << 20];
  struct ern_descriptor_io io = {.patience_ms = 200};
  int ends[2];
  assert_int_equal(socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, ends), 0);
  support_ok(context, ern_descriptor_io_take(context, "viewer", ends[0], &io));
  avio_write(io.io, bytes, sizeof bytes);
  avio_flush(io.io);
  assert_int_equal(io.io->error, AVERROR(ETIMEDOUT));
  ern_descriptor_io_close(&io);
  (void)close(ends[1]);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_a_browser_comes_and_leaves),
                                     cmocka_unit_test(test_only_its_own_pages_are_served),
                                     cmocka_unit_test(test_a_stalled_viewer_is_left)};
  return cmocka_run_group_tests(tests, set_up, tear_down);
}
