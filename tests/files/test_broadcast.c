/* SPDX-License-Identifier: MIT
 * The last seconds of a stream: where a viewer begins, and when it is dropped. */
#include "../support.h"

#include "../../src/serve/broadcast.c"

static struct broadcast all;

static void put(const char *text, ern_stream_piece piece) {
  const size_t half = strlen(text) / 2;
  assert_int_equal(broadcast_write(&all, text, half, ERN_STREAM_MORE), 0);
  assert_int_equal(broadcast_write(&all, text + half, strlen(text) - half, ERN_STREAM_MORE), 0);
  assert_int_equal(broadcast_write(&all, NULL, 0, piece), 0);
}

/* What the viewer gets at most `most` bytes at a time, up to where it must wait. */
static void expect(struct viewer *viewer, size_t most, const char *text) {
  char got[4096] = "";
  ssize_t count = 0;
  for (size_t at = 0; (count = broadcast_read(&all, viewer, got + at, most)) > 0; at += (size_t)count)
    assert_true(at + (size_t)count + most < sizeof got);
  assert_string_equal(got, text);
  assert_int_equal(count, all.ended ? -1 : 0);
}

static void test_begins_at_a_key(void **state) {
  (void)state;
  struct viewer early = {0}, late = {0}, last = {0};
  expect(&early, 100, "");
  put("HEAD", ERN_STREAM_HEAD);
  expect(&early, 100, "");
  put("[key one]", ERN_STREAM_KEY);
  put("(a)", ERN_STREAM_FRAME);
  expect(&early, 5, "HEAD[key one](a)");
  put("[key two]", ERN_STREAM_KEY);
  put("(b)", ERN_STREAM_FRAME);
  expect(&late, 3, "HEAD[key two](b)");
  expect(&early, 1, "[key two](b)");
  put("(c)", ERN_STREAM_FRAME);
  all.ended = true;
  expect(&early, 100, "(c)");
  expect(&late, 1, "(c)");
  expect(&last, 100, "HEAD[key two](b)(c)");
  broadcast_free(&all);
}

/* A viewer that reads nothing is dropped, and no other. Memory is bounded. */
static void test_slow_viewer(void **state) {
  (void)state;
  static uint8_t part[1 << 20];
  char some[8];
  struct viewer slow = {0}, quick = {0};
  put("HEAD", ERN_STREAM_HEAD);
  put("[key]", ERN_STREAM_KEY);
  assert_int_equal(broadcast_read(&all, &slow, some, 6), 6);
  expect(&quick, 100, "HEAD[key]");
  for (int k = 1; k < BROADCAST_PARTS; k++) {
    put("(f)", ERN_STREAM_FRAME);
    expect(&quick, 100, "(f)");
  }
  assert_int_equal(broadcast_read(&all, &slow, some, 2), 2);
  put("(f)", ERN_STREAM_FRAME); /* takes the place of the key frame */
  assert_int_equal(broadcast_read(&all, &slow, some, 2), -1);
  expect(&quick, 100, "(f)");
  for (int k = 0; k < 100; k++) {
    assert_int_equal(broadcast_write(&all, part, sizeof part, ERN_STREAM_KEY), 0);
    assert_true(all.bytes <= BROADCAST_BYTES);
  }
  broadcast_free(&all);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_begins_at_a_key), cmocka_unit_test(test_slow_viewer)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
