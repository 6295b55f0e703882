/* SPDX-License-Identifier: MIT
 * A stream that a callback takes: its parts, a receiver that begins late, and a callback that refuses; the same stream
 * passed on to an address, from a callback that has few bytes at a time. */
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
  assert_non_null(bytes); /* also where there are none: memcpy may not get NULL */
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
  assert_true(fabs(whole.first_sound - whole.first_picture) < 0.001);
  size_t key = 1 + FPS; /* x264 makes one each second, and where all of the picture changes */
  while (key <= 2 * FPS && taken.piece[key] != ERN_STREAM_KEY) key++;
  save_parts("late.mp4", key);
  const struct times late = times_of("late.mp4");
  assert_int_equal(late.pictures, FRAMES + 1 - (int)key);
  assert_int_equal(late.wrong, 0);
  assert_true(fabs(late.first_picture - whole.first_picture - (double)(key - 1) / FPS) < 1e-6);
  /* of whole packets of AAC, of which less than one waits for samples, one is being coded, and one is its delay */
  assert_true(fabs(late.first_sound - late.first_picture) < 3 * 1024.0 / RATE);
}

/* The sound of a frame is heard when it is shown: the delay of AAC's encoder, 1024 samples, is not in the stream. */
static void test_sound_is_not_late(void **state) {
  (void)state;
  const ern_stream_options options = options_of_parts(-1);
  support_ok(context, write_stream_after("parts", &options, FPS));
  save_parts("loud.mp4", 1);
  assert_true(fabs(loud_after_picture("loud.mp4") - 1) < 0.005);
}

static void test_refused(void **state) {
  (void)state;
  ern_stream_options options = options_of_parts(20);
  support_expect(context, write_stream("parts", &options), ERN_E_IO, "parts: cannot write", NULL);
  options = options_of_parts(-1);
  options.format = "mpegts";
  support_expect(context, write_stream("parts", &options), ERN_E_UNSUPPORTED, "expected mp4", NULL);
}

/* ---- passed on --------------------------------------------------------------------------------------------------- */

enum { SENT_MOST = 1 << 20 };

/* What a callback has of `taken`: at most `step` bytes a call; from byte `wrong_at` on it returns `wrong`. */
struct source {
  size_t part, at, step, done, wrong_at;
  ptrdiff_t wrong;
};

static ptrdiff_t give(void *user, void *bytes, size_t most) {
  struct source *from = user;
  if (from->done >= from->wrong_at) return from->wrong < 0 ? from->wrong : (ptrdiff_t)most + from->wrong;
  while (from->part < taken.parts && from->at == taken.count[from->part]) from->part++, from->at = 0;
  if (from->part == taken.parts) return 0;
  size_t count = taken.count[from->part] - from->at;
  if (count > from->step) count = from->step;
  if (count > most) count = most;
  memcpy(bytes, taken.bytes[from->part] + from->at, count);
  from->at += count;
  from->done += count;
  return (ptrdiff_t)count;
}

/* What arrives at an address of this machine, `step` bytes a call. */
static size_t pass_on(size_t step, uint8_t *sent) {
  struct sockaddr_in at = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
  socklen_t bytes = sizeof at;
  struct source from = {.step = step, .wrong_at = SIZE_MAX};
  char url[64];
  size_t count = 0;
  const int receiver = socket(AF_INET, SOCK_DGRAM, 0);
  assert_true(receiver >= 0 && bind(receiver, (struct sockaddr *)&at, sizeof at) == 0);
  assert_int_equal(getsockname(receiver, (struct sockaddr *)&at, &bytes), 0);
  snprintf(url, sizeof url, "udp://127.0.0.1:%d", ntohs(at.sin_port));
  support_ok(context, ern_stream_copy(context, url, give, NULL, &from));
  for (ssize_t got; (got = recv(receiver, sent + count, SENT_MOST - count, MSG_DONTWAIT)) > 0;) count += (size_t)got;
  close(receiver);
  return count;
}

static void test_passed_on(void **state) {
  (void)state;
  static uint8_t whole[SENT_MOST], again[SENT_MOST];
  static const size_t steps[] = {1, 7, 100, 512, 1000};
  const ern_stream_options options = options_of_parts(-1);
  support_ok(context, write_stream("parts", &options));
  const size_t count = pass_on(SIZE_MAX, whole);
  assert_true(count > 188 * FRAMES); /* a packet of the transport stream for each picture, and more */
  for (size_t i = 0; i < sizeof steps / sizeof *steps; i++) {
    assert_int_equal(pass_on(steps[i], again), count);
    assert_memory_equal(again, whole, count);
  }
}

static int stops(void *user) {
  const struct source *from = user;
  return from->done > 2000;
}

/* What a callback may not return, and one that stops. */
static void test_passed_on_wrongly(void **state) {
  (void)state;
  const char *url = "udp://127.0.0.1:9";
  const ern_stream_options options = options_of_parts(-1);
  support_ok(context, write_stream("parts", &options));
  for (int k = 0; k < 4; k++) {
    struct source from = {.step = SIZE_MAX, .wrong_at = k < 2 ? 0 : 5000, .wrong = k % 2 == 0 ? -5 : 1};
    support_expect(context, ern_stream_copy(context, url, give, NULL, &from), ERN_E_ARGUMENT, "read returned", NULL);
  }
  struct source from = {.step = 50, .wrong_at = SIZE_MAX};
  support_expect(context, ern_stream_copy(context, url, give, stops, &from), ERN_E_CANCELLED, "stopped", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_parts), cmocka_unit_test(test_sound_is_not_late),
                                     cmocka_unit_test(test_refused), cmocka_unit_test(test_passed_on),
                                     cmocka_unit_test(test_passed_on_wrongly)};
  return cmocka_run_group_tests(tests, set_up, tear_down);
}
