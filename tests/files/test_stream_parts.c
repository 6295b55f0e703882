/* SPDX-License-Identifier: MIT
 * A stream that a callback takes: its parts, a receiver that begins late, and a callback that refuses. */
#include "stream_support.h"

enum { PARTS = 64, PART_BYTES = 1 << 16 };

struct taken {
  uint8_t bytes[PARTS][PART_BYTES];
  size_t count[PARTS], parts;
  ern_stream_piece piece[PARTS];
  int left; /* calls until one refuses; below 0: none does */
};

static int take(void *user, const void *bytes, size_t count, ern_stream_piece piece) {
  struct taken *taken = user;
  if (taken->left == 0) return 1;
  taken->left--;
  if (piece != ERN_STREAM_MORE) {
    assert_int_equal(count, 0);
    taken->piece[taken->parts++] = piece;
    assert_true(taken->parts < PARTS);
    return 0;
  }
  uint8_t *to = taken->bytes[taken->parts] + taken->count[taken->parts];
  assert_true(taken->count[taken->parts] + count <= PART_BYTES);
  if (count > 0) memcpy(to, bytes, count);
  taken->count[taken->parts] += count;
  return 0;
}

static struct taken taken;

static ern_stream_options options_of_parts(int left) {
  ern_stream_options options = options_of_stream(NULL);
  memset(&taken, 0, sizeof taken);
  taken.left = left;
  options.write = take;
  options.user = &taken;
  return options;
}

/* The head, and the parts from `from` on. */
static void save_parts(const char *path, size_t from) {
  FILE *file = fopen(path, "wb");
  assert_non_null(file);
  for (size_t i = 0; i < taken.parts; i++)
    if (i == 0 || i >= from) assert_int_equal(fwrite(taken.bytes[i], 1, taken.count[i], file), taken.count[i]);
  (void)fclose(file);
}

static bool begins_with(size_t part, const char *box) {
  return taken.count[part] > 8 && memcmp(taken.bytes[part] + 4, box, 4) == 0;
}

/* A part for each picture; whole for one who sees all, and for one who begins at a key frame. */
static void test_parts(void **state) {
  (void)state;
  const ern_stream_options options = options_of_parts(-1);
  support_ok(context, write_stream("parts", &options));
  assert_in_range(taken.parts, 1 + FRAMES, 2 + FRAMES); /* the end of the sound may be one more */
  assert_int_equal(taken.piece[0], ERN_STREAM_HEAD);
  assert_true(begins_with(0, "ftyp"));
  for (size_t i = 1; i < taken.parts; i++) {
    assert_true(begins_with(i, "moof"));
    assert_true(taken.piece[i] == ERN_STREAM_KEY || (i > 1 && taken.piece[i] == ERN_STREAM_FRAME));
  }
  save_parts("whole.mp4", 1);
  const struct times whole = times_of("whole.mp4");
  assert_int_equal(whole.pictures, FRAMES);
  assert_int_equal(whole.wrong, 0);
  assert_true(fabs(whole.first_sound - whole.first_picture) <= 1024.0 / RATE);
  size_t key = 1 + FPS; /* x264 makes one each second, and where all of the picture changes */
  while (key <= 2 * FPS && taken.piece[key] != ERN_STREAM_KEY) key++;
  save_parts("late.mp4", key);
  const struct times late = times_of("late.mp4");
  assert_int_equal(late.pictures, FRAMES + 1 - (int)key);
  assert_int_equal(late.wrong, 0);
  assert_true(fabs(late.first_picture - whole.first_picture - (double)(key - 1) / FPS) < 1e-6);
  assert_true(fabs(late.first_sound - late.first_picture) < 2 * 1024.0 / RATE); /* of whole packets of AAC */
}

static void test_refused(void **state) {
  (void)state;
  ern_stream_options options = options_of_parts(20);
  support_expect(context, write_stream("parts", &options), ERN_E_IO, "parts: cannot write", NULL);
  options = options_of_parts(-1);
  options.format = "mpegts";
  support_expect(context, write_stream("parts", &options), ERN_E_UNSUPPORTED, "expected mp4", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_parts), cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, set_up, tear_down);
}
