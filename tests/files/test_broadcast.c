/* SPDX-License-Identifier: MIT
 * The last seconds of a stream: where a viewer begins, and when it is dropped. The picture in a part of it. */
#include "../support.h"

#include "../../src/serve/broadcast.c"
#include "../../src/serve/fragment.c"

static struct broadcast all;

static void put(const char *text, ern_stream_piece piece) {
  const size_t half = strlen(text) / 2;
  assert_int_equal(broadcast_write(&all, text, half, ERN_STREAM_MORE), 0);
  assert_int_equal(broadcast_write(&all, text + half, strlen(text) - half, ERN_STREAM_MORE), 0);
  assert_int_equal(broadcast_write(&all, NULL, 0, piece), 0);
}

/* What the viewer gets at most `most` bytes at a time, up to where it must wait. */
static void expect(struct ern_http_place *viewer, size_t most, const char *text) {
  char got[4096] = "";
  ssize_t count = 0;
  for (size_t at = 0; (count = broadcast_read(&all, viewer, got + at, most)) > 0; at += (size_t)count)
    assert_true(at + (size_t)count + most < sizeof got);
  assert_string_equal(got, text);
  assert_int_equal(count, all.ended ? -1 : 0);
}

static void test_begins_at_a_key(void **state) {
  (void)state;
  struct ern_http_place early = {0}, late = {0}, last = {0};
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
  struct ern_http_place slow = {0}, quick = {0};
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

/* A fragment as libernerf-media writes it: the size of the picture in tfhd, then one with flags and size in trun. Cut
 * anywhere, it has no picture, and nothing behind it is read. */
static void test_picture(void **state) {
  (void)state;
  static const uint8_t head[] = {0, 0, 0, 15, 'a', 'v', 'c', 'C', 1, 0x42, 0xc0, 11, 9, 9, 9};
  static const uint8_t plain[] = {0, 0, 0, 68,   'm', 'o', 'o', 'f', 0,   0,   0,   8,   'f', 'r', 'e', 'e',
                                  0, 0, 0, 52,   't', 'r', 'a', 'f', 0,   0,   0,   24,  't', 'f', 'h', 'd',
                                  0, 2, 0, 0x18, 0,   0,   0,   1,   0,   0,   2,   0,   0,   0,   0,   3,
                                  0, 0, 0, 20,   't', 'r', 'u', 'n', 0,   0,   0,   1,   0,   0,   0,   1,
                                  0, 0, 0, 76,   0,   0,   0,   11,  'm', 'd', 'a', 't', 'a', 'b', 'c'};
  static const uint8_t sized[] = {0,   0,   0,   60,  'm', 'o', 'o', 'f', 0, 0,  0,   52,  't', 'r', 'a', 'f', 0,  0,
                                  0,   16,  't', 'f', 'h', 'd', 0,   2,   0, 0,  0,   0,   0,   1,   0,   0,   0,  28,
                                  't', 'r', 'u', 'n', 0,   0,   2,   5,   0, 0,  0,   1,   0,   0,   0,   69,  2,  0,
                                  0,   0,   0,   0,   0,   2,   0,   0,   0, 11, 'm', 'd', 'a', 't', 'a', 'b', 'c'};
  const struct {
    const uint8_t *bytes;
    size_t count;
    const char *picture;
  } rows[] = {{plain, sizeof plain, "abc"}, {sized, sizeof sized, "bc"}};
  const uint8_t *found;
  size_t bytes;
  assert_true(fragment_avcc(head, sizeof head, &found, &bytes) && bytes == 7 && found[3] == 11);
  for (size_t k = 0; k < sizeof head; k++) assert_false(fragment_avcc(head, k, &found, &bytes));
  for (size_t i = 0; i < 2; i++) {
    assert_true(fragment_picture(rows[i].bytes, rows[i].count, &found, &bytes));
    assert_int_equal(bytes, strlen(rows[i].picture));
    assert_memory_equal(found, rows[i].picture, bytes);
    for (size_t k = 0; k < rows[i].count; k++) {
      uint8_t *cut = malloc(k + 1); /* of that size, for the address sanitizer */
      memcpy(cut, rows[i].bytes, k);
      assert_false(fragment_picture(cut, k, &found, &bytes));
      free(cut);
    }
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_begins_at_a_key), cmocka_unit_test(test_slow_viewer),
                                     cmocka_unit_test(test_picture)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
