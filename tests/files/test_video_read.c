/* SPDX-License-Identifier: MIT
 * Videos as other programs write them: how a file says that its frames are shown. */
#include <stdlib.h>
#include <string.h>

#include "core/memory.h"
#include "ernerf/media.h"
#include "io/file.h"
#include "support.h"

static ern_context *context;

static int set_up(void **state) {
  (void)state;
  context = support_context();
  return 0;
}

static int tear_down(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

/* Writes the display matrix (ISO/IEC 14496-12, tkhd: a b 0 c d 0 0 0 1) of the first track of an mp4. */
static void put_matrix(uint8_t *bytes, size_t count, const int numbers[4]) {
  static const size_t places[4] = {0, 4, 12, 16};
  size_t at = 0;
  while (at + 80 < count && memcmp(bytes + at, "tkhd", 4) != 0) at++;
  assert_true(at + 80 < count);
  for (size_t i = 0; i < 4; i++) { /* 16.16, big end first */
    const uint8_t number[4] = {numbers[i] < 0 ? 0xff : 0, (uint8_t)numbers[i], 0, 0};
    memcpy(bytes + at + 44 + places[i], number, 4);
  }
}

/* A frame whose quarters are grey 40, 100, 160 and 220, by each of the eight matrices. A pixel (p, q) is shown at
 * (a p + c q, b p + d q). */
static void test_display_matrix(void **state) {
  (void)state;
  enum { WIDE = 64, HIGH = 32 };
  static const int matrices[8][4] = {{1, 0, 0, 1}, {-1, 0, 0, 1}, {-1, 0, 0, -1}, {1, 0, 0, -1},
                                     {0, 1, 1, 0}, {0, 1, -1, 0}, {0, -1, -1, 0}, {0, -1, 1, 0}};
  const ern_video_options options = ern_video_options_default(WIDE, HIGH);
  ern_video_writer *writer = NULL;
  uint8_t rgba[WIDE * HIGH * 4], *bytes = NULL;
  size_t count = 0;
  for (int i = 0; i < WIDE * HIGH; i++)
    memset(rgba + 4 * i, 40 + 60 * ((i / WIDE >= HIGH / 2) * 2 + (i % WIDE >= WIDE / 2)), 4);
  support_ok(context, ern_video_writer_open(context, "lying.mp4", &options, &writer));
  support_ok(context, ern_video_writer_frame(writer, rgba));
  support_ok(context, ern_video_writer_close(&writer));
  support_ok(context, ern_file_read(context, "lying.mp4", 1 << 20, &bytes, &count));
  for (int k = 0; k < 8; k++) {
    const int *m = matrices[k];
    ern_video_reader *reader = NULL;
    ern_image shown = {0};
    double seconds = 0;
    bool end = true;
    put_matrix(bytes, count, m);
    support_write("shown.mp4", bytes, count);
    support_ok(context, ern_video_reader_open(context, "shown.mp4", &reader));
    support_ok(context, ern_video_reader_frame(reader, &shown, &seconds, &end));
    assert_false(end);
    assert_int_equal(shown.width, m[0] != 0 ? WIDE : HIGH);
    assert_int_equal(shown.height, m[0] != 0 ? HIGH : WIDE);
    for (int place = 0; place < 4; place++) {
      const int p = place % 2 * 2 - 1, q = place / 2 * 2 - 1; /* a corner of the stored frame, from its centre */
      const int x = m[0] * p + m[2] * q > 0 ? shown.width - 1 : 0, y = m[1] * p + m[3] * q > 0 ? shown.height - 1 : 0;
      const int found = shown.data[3 * (y * shown.width + x)];
      if (abs(found - 40 - 60 * place) > 8)
        fail_msg("matrix %d %d %d %d: quarter %d is %d, expected %d", m[0], m[1], m[2], m[3], place, found,
                 40 + 60 * place);
    }
    ern_image_free(context, &shown);
    ern_video_reader_free(&reader);
  }
  ern_release(context, bytes);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_display_matrix),
  };
  return cmocka_run_group_tests_name("video_read", tests, set_up, tear_down);
}
