/* SPDX-License-Identifier: MIT
 * Which pixels of a frame are the head's: parsing against its definition, and as a clip gives it. Torso pictures, read
 * by several threads. */
#include <pthread.h>
#include <stdio.h>
#include <unistd.h>

#include "core/memory.h"
#include "core/rng.h"
#include "ernerf-lab/synth.h"
#include "io/file.h"
#include "media/clip/clip.h"
#include "support.h"

static const uint8_t head_colour[3] = {0, 0, 255};

/* The definition: whole where all pixels of the square have the head's colour, nothing where none has. */
static uint8_t expected_at(const uint8_t *rgb, int width, int height, int row, int column, int edge) {
  int heads = 0, all = 0; /* of the square */
  for (int y = row - edge; y <= row + edge; y++)
    for (int x = column - edge; x <= column + edge; x++) {
      if (y < 0 || y >= height || x < 0 || x >= width) continue;
      all++;
      heads += memcmp(rgb + 3 * (y * width + x), head_colour, 3) == 0;
    }
  return heads == 0 ? 0 : heads == all ? ERN_HEAD_WHOLE : ERN_HEAD_UNSURE;
}

/* `share` of 100 pixels have the head's colour, the others white, green and red. */
static void fill(ern_image *image, unsigned share, uint64_t seed) {
  static const uint8_t others[3][3] = {{255, 255, 255}, {0, 255, 0}, {255, 0, 0}};
  for (size_t i = 0; i < (size_t)image->width * (size_t)image->height; i++) {
    const struct ern_random random = ern_random_at(seed, 0, (uint32_t)i, ERN_RNG_PIXEL);
    memcpy(image->data + 3 * i, ern_below(random.word[0], 100) < share ? head_colour : others[random.word[1] % 3], 3);
  }
}

static void test_edges(void **state) {
  (void)state;
  ern_context *context = support_context();
  const struct {
    int width, height, edge;
  } sizes[] = {{1, 1, 1}, {2, 1, 1}, {1, 7, 1}, {24, 16, 1}, {383, 5, 1}, {384, 9, 2}, {512, 4, 2}, {1200, 3, 5}};
  const unsigned shares[] = {0, 3, 90, 99, 100};
  for (size_t k = 0; k < sizeof sizes / sizeof *sizes; k++)
    for (size_t s = 0; s < 5; s++) {
      const int width = sizes[k].width, height = sizes[k].height;
      const size_t pixels = (size_t)width * (size_t)height;
      ern_image image = {.width = width, .height = height, .channels = 3};
      uint8_t *rgb = malloc(3 * pixels);
      bool any = false;
      support_ok(context, ERN_NEW(context, 3 * pixels, &image.data));
      fill(&image, shares[s], k + 1);
      memcpy(rgb, image.data, 3 * pixels);
      support_ok(context, ern_clip_head_of_parsing(context, "parsing", &image));
      assert_true(image.width == width && image.height == height && image.channels == 1);
      for (size_t i = 0; i < pixels; i++) any = any || memcmp(rgb + 3 * i, head_colour, 3) == 0;
      for (int i = 0; i < width * height; i++)
        assert_int_equal(image.data[i],
                         any ? expected_at(rgb, width, height, i / width, i % width, sizes[k].edge) : ERN_HEAD_UNSURE);
      ern_image_free(context, &image);
      free(rgb);
    }
  ern_context_free(&context);
}

/* A twentieth of the pixels may have mixed colours; a grey mask, or the colours of other tools, may not. */
static void test_other_colours(void **state) {
  (void)state;
  ern_context *context = support_context();
  enum { PIXELS = 20 * 20 };
  for (int others = PIXELS / 20; others <= PIXELS / 20 + 1; others++) {
    ern_image image = {.width = 20, .height = 20, .channels = 3};
    support_ok(context, ERN_NEW(context, 3 * PIXELS, &image.data));
    fill(&image, 50, 1);
    memset(image.data, 128, 3 * (size_t)others);
    const ern_status status = ern_clip_head_of_parsing(context, "parsing/7.png", &image);
    if (others == PIXELS / 20)
      support_ok(context, status);
    else
      support_expect(context, status, ERN_E_FORMAT, "parsing/7.png", "21 of 400 pixels", "head 0 0 255", NULL);
    ern_image_free(context, &image);
  }
  ern_context_free(&context);
}

enum { SIDE = 64 };

/* Frame i has the head in rows [8, 40) and columns [10, 30 + i). */
static void write_parsing(ern_context *context, int frame, int width) {
  static uint8_t rgb[3 * (SIDE + 1) * SIDE];
  char path[64];
  const ern_image image = {.width = width, .height = SIDE, .channels = 3, .data = rgb};
  for (int i = 0; i < width * SIDE; i++) {
    const int row = i / width, column = i % width;
    const bool head = row >= 8 && row < 40 && column >= 10 && column < 30 + frame;
    memset(rgb + 3 * i, 255, 3);
    if (head) memcpy(rgb + 3 * i, head_colour, 3);
  }
  snprintf(path, sizeof path, "head/parsing/%d.png", frame);
  support_ok(context, ern_image_write(context, path, &image, 100));
}

static void expect_head(ern_context *context, ern_clip *clip, ern_split split, size_t index) {
  ern_image head;
  const int frame = (int)ern_clip_frame_at(clip, split, index)->pose.img_id;
  support_ok(context, ern_clip_head(clip, split, index, &head));
  assert_true(head.width == SIDE && head.height == SIDE && head.channels == 1);
  for (int i = 0; i < SIDE * SIDE; i++) {
    const int row = i / SIDE, column = i % SIDE;
    const bool whole = row >= 9 && row < 39 && column >= 11 && column < 29 + frame;
    const bool near = row >= 7 && row < 41 && column >= 9 && column < 31 + frame;
    assert_int_equal(head.data[i], whole ? ERN_HEAD_WHOLE : near ? ERN_HEAD_UNSURE : 0);
  }
}

static char said[8192];
static void note(void *user, int ok, const char *sentence) {
  const size_t used = strlen(said);
  (void)user;
  snprintf(said + used, sizeof said - used, "%d %s\n", ok, sentence);
}

static void expect_sentence(ern_context *context, ern_status expected, const char *sentence) {
  said[0] = 0;
  support_expect(context, ern_clip_check(context, "head", note, NULL), expected, NULL);
  if (strstr(said, sentence) == NULL) fail_msg("nothing says \"%s\" in:\n%s", sentence, said);
}

/* OK is said of a clip of which all was looked at: no allocation that is refused is passed over. */
static ern_status check_small(ern_context *context) {
  static char all[sizeof said];
  said[0] = 0;
  const ern_status status = ern_clip_check(context, "small", note, NULL);
  if (all[0] == 0) memcpy(all, said, sizeof said); /* of the first call, where nothing is refused */
  if (status == ERN_OK) assert_string_equal(said, all);
  return status;
}

/* Likewise of the figures: the sound is there. */
static ern_status measure_small(ern_context *context) {
  ern_clip *clip = NULL;
  ern_clip_measures measures = {0};
  ern_status status = ern_clip_open(context, "small", NULL, &clip);
  if (status == ERN_OK) status = ern_clip_measure(clip, &measures);
  if (status == ERN_OK) assert_true(measures.loud >= 0);
  ern_clip_free(&clip);
  return status;
}

static void test_check_without_memory(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_synth_options synth = ern_synth_options_default();
  synth.size = 64;
  synth.frames = 8;
  support_clear("small");
  support_ok(context, ern_synth_write(context, "small", &synth));
  assert_int_equal(unlink("small/au.csv"), 0); /* so that prepare.json is asked for */
  support_ok(context, check_small(context));
  support_refuse_each(check_small);
  support_refuse_each(measure_small);
  ern_context_free(&context);
}

/* ---- torso pictures ---------------------------------------------------------------------------------------------- */

enum { READERS = 3, TORSO_BYTES = SIDE * SIDE * 4 };

struct reader {
  ern_context *context;
  ern_clip *clip;
  const uint8_t *expected; /* [frames][TORSO_BYTES] */
  size_t frames;
  bool same;
};
static void *read_torsos(void *argument) {
  struct reader *reader = argument;
  reader->same = true;
  for (size_t i = 0; i < 3 * reader->frames && reader->same; i++) {
    const size_t k = i % reader->frames;
    ern_image torso;
    reader->same = ern_clip_torso(reader->clip, ERN_SPLIT_TRAIN, k, &torso) == ERN_OK &&
                   memcmp(torso.data, reader->expected + k * TORSO_BYTES, TORSO_BYTES) == 0;
    ern_image_free(reader->context, &torso);
  }
  return NULL;
}

static ern_status read_twice(ern_context *context) {
  ern_clip *clip = NULL;
  ern_status status = ern_clip_open(context, "small", NULL, &clip);
  for (int i = 0; i < 2 && status == ERN_OK; i++) {
    ern_image torso;
    status = ern_clip_torso(clip, ERN_SPLIT_TRAIN, 0, &torso);
    assert_true((torso.data != NULL) == (status == ERN_OK));
    ern_image_free(context, &torso);
  }
  ern_clip_free(&clip);
  return status;
}

/* Several threads at once, with memory for all pictures and for none; what is kept no longer needs its file. */
static void test_torsos(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_synth_options synth = ern_synth_options_default();
  ern_clip_options options = ern_clip_options_default();
  static uint8_t expected[8 * TORSO_BYTES];
  synth.size = SIDE;
  synth.frames = 8;
  support_clear("small");
  support_ok(context, ern_synth_write(context, "small", &synth));
  support_refuse_each(read_twice);
  for (int kept = 1; kept >= 0; kept--) {
    ern_clip *clip = NULL;
    ern_clip_info info;
    ern_image torso;
    pthread_t threads[READERS];
    struct reader readers[READERS];
    options.memory_bytes = kept ? sizeof expected : 1;
    support_ok(context, ern_clip_open(context, "small", &options, &clip));
    ern_clip_describe(clip, &info);
    for (size_t k = 0; kept && k < info.frames[ERN_SPLIT_TRAIN]; k++) {
      support_ok(context, ern_clip_pixels(clip, ERN_SPLIT_TRAIN, k, NULL, &torso));
      memcpy(expected + k * TORSO_BYTES, torso.data, TORSO_BYTES);
    }
    ern_clip_free(&clip);
    support_ok(context, ern_clip_open(context, "small", &options, &clip));
    for (int i = 0; i < READERS; i++) {
      readers[i] = (struct reader){context, clip, expected, info.frames[ERN_SPLIT_TRAIN], false};
      assert_int_equal(pthread_create(&threads[i], NULL, read_torsos, &readers[i]), 0);
    }
    for (int i = 0; i < READERS; i++) {
      assert_int_equal(pthread_join(threads[i], NULL), 0);
      assert_true(readers[i].same);
    }
    assert_int_equal(rename("small/torso_imgs", "small/away"), 0);
    support_expect(context, ern_clip_torso(clip, ERN_SPLIT_TRAIN, 1, &torso), kept ? ERN_OK : ERN_E_MISSING,
                   kept ? NULL : "small/torso_imgs/", NULL);
    assert_int_equal(rename("small/away", "small/torso_imgs"), 0);
    ern_image_free(context, &torso);
    ern_clip_free(&clip);
  }
  ern_context_free(&context);
}

static void test_clip_with_parsing(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_synth_options synth = ern_synth_options_default();
  ern_clip *clip = NULL;
  ern_clip_info info;
  ern_dataset data;
  ern_image head;
  synth.size = SIDE;
  synth.frames = 12;
  support_clear("head");
  support_ok(context, ern_synth_write(context, "head", &synth));
  expect_sentence(context, ERN_OK, "0 parsing: missing. The head will be learnt over the clip's background alone");
  support_ok(context, ern_clip_open(context, "head", NULL, &clip));
  ern_clip_describe(clip, &info);
  assert_false(info.has_parsing);
  support_ok(context, ern_clip_head(clip, ERN_SPLIT_TRAIN, 0, &head));
  assert_null(head.data);
  ern_clip_dataset(clip, &data);
  assert_true(data.head == NULL);
  ern_clip_free(&clip);

  support_ok(context, ern_folder_make(context, "head/parsing"));
  for (int i = 0; i < synth.frames; i++) write_parsing(context, i, SIDE);
  expect_sentence(context, ERN_OK, "1 parsing: the head, neck and torso of all 12 frames.");
  for (uint64_t bytes = 0; bytes < 2; bytes++) { /* all are kept; none is */
    ern_clip_options options = ern_clip_options_default();
    options.memory_bytes = bytes;
    support_ok(context, ern_clip_open(context, "head", &options, &clip));
    ern_clip_describe(clip, &info);
    assert_true(info.has_parsing);
    for (int round = 0; round < 2; round++)
      for (int split = 0; split < 2; split++)
        for (size_t i = 0; i < info.frames[split]; i++) expect_head(context, clip, (ern_split)split, i);
    ern_clip_dataset(clip, &data);
    assert_true(data.head != NULL);
    ern_clip_free(&clip);
  }
  write_parsing(context, 2, SIDE + 1);
  support_expect(context, ern_clip_open(context, "head", NULL, &clip), ERN_E_SHAPE, "head/parsing/2.png",
                 "size is 65 x 64, expected 64 x 64", NULL);
  expect_sentence(context, ERN_E_SHAPE,
                  "-1 parsing: 1 of 12 frames have no good file, the first is head/parsing/2.png");
  assert_int_equal(unlink("head/parsing/2.png"), 0);
  support_expect(context, ern_clip_open(context, "head", NULL, &clip), ERN_E_MISSING, "head/parsing/2.png", "img_id 2",
                 NULL);
  support_clear("head");
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_edges), cmocka_unit_test(test_other_colours),
                                     cmocka_unit_test(test_torsos), cmocka_unit_test(test_clip_with_parsing),
                                     cmocka_unit_test(test_check_without_memory)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
