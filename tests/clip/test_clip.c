/* SPDX-License-Identifier: MIT
 * Clips: made by hand piece by piece, each piece broken in turn; the memory budget. */
#include <sys/stat.h>
#include <unistd.h>

#include "clip_folder.h"
#include "core/memory.h"

/* ---- opening ------------------------------------------------------------------------------------------------------
 */

static void test_open(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_clip *clip = NULL;
  ern_clip_info info;
  support_clear("whole");
  write_clip(context, "whole");
  support_expect(context, ern_clip_open(context, "whole", NULL, &clip), ERN_OK, NULL);
  ern_clip_describe(clip, &info);
  assert_int_equal(info.width, WIDTH);
  assert_int_equal(info.height, HEIGHT);
  assert_true(info.focal == 100 && info.cx == WIDTH / 2 && info.cy == HEIGHT / 2);
  assert_int_equal(info.frames[ERN_SPLIT_TRAIN], TRAIN);
  assert_int_equal(info.frames[ERN_SPLIT_VAL], VAL);
  assert_string_equal(info.features_file, "aud_ds.npy");
  assert_true(info.has_blink && info.has_torso && info.has_sound && info.has_landmarks && !info.has_parsing);

  /* identity: SHA-256 of transforms_train.json, then bc.jpg */
  uint8_t *first = NULL, *second = NULL, both[65536];
  size_t first_bytes = 0, second_bytes = 0;
  char hex[65];
  assert_int_equal(ern_file_read(context, "whole/transforms_train.json", 32768, &first, &first_bytes), ERN_OK);
  assert_int_equal(ern_file_read(context, "whole/bc.jpg", 32768, &second, &second_bytes), ERN_OK);
  memcpy(both, first, first_bytes);
  memcpy(both + first_bytes, second, second_bytes);
  ern_sha256_hex(both, first_bytes + second_bytes, hex);
  assert_string_equal(info.identity, hex);
  ern_release(context, first);
  ern_release(context, second);

  const ern_features *features = ern_clip_features(clip);
  assert_int_equal(features->windows, FRAMES);
  assert_int_equal(features->width, 29);
  const ern_image *background = ern_clip_background(clip);
  assert_int_equal(background->channels, 3);
  assert_int_equal(background->width, WIDTH);

  /* blink rows are 0, 0.75, 1.5, 2.25 ...: eye = clamp(row, 0, 2)/2 */
  const float eyes[] = {0, 0.375f, 0.75f, 1, 1, 1};
  for (size_t i = 0; i < FRAMES; i++) {
    const ern_clip_frame *frame =
        i < TRAIN ? ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, i) : ern_clip_frame_at(clip, ERN_SPLIT_VAL, i - TRAIN);
    assert_non_null(frame);
    assert_int_equal(frame->pose.img_id, i);
    assert_int_equal(frame->pose.aud_id, i);
    assert_true(frame->pose.matrix[11] == (float)i);
    assert_true(frame->eye == eyes[i]);
    assert_true(frame->has_landmarks);
    assert_true(frame->landmarks[5][0] == 5.25f && frame->landmarks[5][1] == (float)i);
  }
  assert_null(ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, TRAIN));
  assert_null(ern_clip_frame_at(clip, ERN_SPLIT_VAL, VAL));
  assert_null(ern_clip_frame_at(clip, (ern_split)2, 0));
  ern_clip_free(&clip);
  assert_null(clip);
  ern_clip_free(&clip);
  ern_clip_free(NULL);
  ern_context_free(&context);
}

/* What may be missing, and what follows. */
static void test_optional(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_clip *clip = NULL;
  ern_clip_info info;
  ern_image truth, torso;
  support_clear("bare");
  write_clip(context, "bare");
  assert_int_equal(unlink("bare/transforms_val.json"), 0);
  assert_int_equal(unlink("bare/au.csv"), 0);
  assert_int_equal(unlink("bare/aud.wav"), 0);
  assert_int_equal(rename("bare/torso_imgs", "bare/other"), 0);
  assert_int_equal(rename("bare/ori_imgs", "bare/another"), 0);
  assert_int_equal(rename("bare/gt_imgs/1.jpg", "bare/other/1.jpg"), 0);
  write_picture(context, "bare/gt_imgs/1.png", WIDTH, HEIGHT, 3, 1); /* in place of the .jpg */
  write_picture(context, "bare/bc.jpg", 2 * WIDTH + 6, 3 * HEIGHT, 3, 5);
  support_expect(context, ern_clip_open(context, "bare", NULL, &clip), ERN_OK, NULL);
  ern_clip_describe(clip, &info);
  assert_int_equal(info.frames[ERN_SPLIT_TRAIN], TRAIN);
  assert_int_equal(info.frames[ERN_SPLIT_VAL], 0);
  assert_false(info.has_blink || info.has_torso || info.has_sound || info.has_landmarks);
  const ern_clip_frame *frame = ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, 3);
  assert_true(frame->eye == 0);
  assert_false(frame->has_landmarks);
  const ern_image *background = ern_clip_background(clip);
  assert_int_equal(background->width, WIDTH);
  assert_int_equal(background->height, HEIGHT);
  for (size_t i = 0; i < 3 * WIDTH * HEIGHT; i++) {
    assert_in_range(background->data[i], 60 * (i % 3 + 1) - 3, 60 * (i % 3 + 1) + 3);
  }
  support_expect(context, ern_clip_pixels(clip, ERN_SPLIT_TRAIN, 1, &truth, &torso), ERN_OK, NULL);
  assert_int_equal(truth.data[1], 40); /* PNG: exact */
  assert_null(torso.data);
  ern_clip_free(&clip);
  ern_context_free(&context);
}

static void test_features_choice(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_clip *clip = NULL;
  ern_clip_info info;
  support_clear("speech");
  write_clip(context, "speech");
  write_features(context, "speech/aud_eo.npy", FRAMES, 16, 44);
  write_features(context, "speech/aud_hu.npy", FRAMES, 2, 1024);
  write_features(context, "other.npy", 3, 16, 5);
  static const struct {
    const char *model, *features, *name;
    int width, length;
  } cases[] = {{NULL, NULL, "aud_ds.npy", 29, 16},
               {"deepspeech", NULL, "aud_ds.npy", 29, 16},
               {"cpierse/wav2vec2-large-xlsr-53-esperanto", NULL, "aud_eo.npy", 44, 16},
               {"hubert", NULL, "aud_hu.npy", 1024, 2},
               {NULL, "other.npy", "other.npy", 5, 16}};
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    ern_clip_options options = ern_clip_options_default();
    options.asr_model = cases[i].model;
    options.features = cases[i].features;
    support_expect(context, ern_clip_open(context, "speech", &options, &clip), ERN_OK, NULL);
    ern_clip_describe(clip, &info);
    assert_string_equal(info.features_file, cases[i].name);
    assert_int_equal(ern_clip_features(clip)->width, cases[i].width);
    assert_int_equal(ern_clip_features(clip)->window_length, cases[i].length);
    /* frames past the last window use the last one */
    const int64_t windows = (int64_t)ern_clip_features(clip)->windows;
    assert_int_equal(ern_clip_frame_at(clip, ERN_SPLIT_VAL, VAL - 1)->pose.aud_id, windows < FRAMES ? windows - 1 : 5);
    ern_clip_free(&clip);
  }
  ern_clip_options options = ern_clip_options_default();
  options.asr_model = "whisper";
  support_expect(context, ern_clip_open(context, "speech", &options, &clip), ERN_E_ARGUMENT, "asr_model is \"whisper\"",
                 "hubert", NULL);
  assert_int_equal(unlink("speech/aud_hu.npy"), 0);
  options.asr_model = "hubert";
  support_expect(context, ern_clip_open(context, "speech", &options, &clip), ERN_E_MISSING, "speech/aud_hu.npy", NULL);
  assert_int_equal(unlink("speech/aud_ds.npy"), 0);
  assert_int_equal(rename("speech/aud_eo.npy", "speech/aud.npy"), 0);
  support_expect(context, ern_clip_open(context, "speech", NULL, &clip), ERN_OK, NULL);
  ern_clip_describe(clip, &info);
  assert_string_equal(info.features_file, "aud.npy");
  ern_clip_free(&clip);
  assert_int_equal(unlink("speech/aud.npy"), 0);
  support_ok(context, ern_clip_open(context, "speech", NULL, &clip)); /* features are made of the sound */
  ern_clip_describe(clip, &info);
  assert_true(info.hears_sound && strcmp(info.features_file, "aud.wav") == 0 && ern_clip_features(clip)->width == 45);
  const float warps[] = {0.9f, 1.1f};
  size_t copies = 0;
  support_ok(context, ern_clip_vary_speech(clip, warps, 2));
  const ern_features *copy = ern_clip_speech_copies(clip, &copies);
  assert_true(copies == 2 && copy[1].windows == ern_clip_features(clip)->windows);
  ern_clip_free(&clip);
  assert_int_equal(unlink("speech/aud.wav"), 0);
  support_expect(context, ern_clip_open(context, "speech", NULL, &clip), ERN_E_MISSING, "speech", "aud_ds.npy",
                 "aud.npy", NULL);
  assert_null(clip);
  ern_clip_options raw;
  memset(&raw, 0, sizeof raw);
  support_expect(context, ern_clip_open(context, "speech", &raw, &clip), ERN_E_ARGUMENT, "ern_clip_options_default",
                 NULL);
  ern_context_free(&context);
}

/* Breaks one thing, expects the words, and mends it by making the clip again. */
static void expect_broken(ern_context *context, ern_status status, const char *first, const char *second) {
  ern_clip *clip = NULL;
  support_expect(context, ern_clip_open(context, "broken", NULL, &clip), status, first, second, NULL);
  assert_null(clip);
  write_clip(context, "broken");
  support_expect(context, ern_clip_open(context, "broken", NULL, &clip), ERN_OK, NULL);
  ern_clip_free(&clip);
}

static void test_broken(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_clip *clip = NULL;
  support_clear("broken");
  write_clip(context, "broken");
  support_expect(context, ern_clip_open(context, "nowhere", NULL, &clip), ERN_E_MISSING, "nowhere", "folder", NULL);
  support_write_text("a_file", "x");
  support_expect(context, ern_clip_open(context, "a_file", NULL, &clip), ERN_E_IO, "a_file", "no folder", NULL);
  unlink("broken/transforms_train.json");
  expect_broken(context, ERN_E_MISSING, "broken/transforms_train.json", "No such file");
  write_transforms("broken/transforms_val.json", TRAIN, VAL, 101);
  expect_broken(context, ERN_E_MISMATCH, "broken/transforms_val.json", "focal_len is 101, expected 100");
  support_write_text("broken/transforms_val.json", "{}");
  expect_broken(context, ERN_E_FORMAT, "broken/transforms_val.json", "focal_len");
  unlink("broken/bc.jpg");
  expect_broken(context, ERN_E_MISSING, "broken/bc.jpg", "No such file");
  support_write_text("broken/bc.jpg", "no picture");
  expect_broken(context, ERN_E_FORMAT, "broken/bc.jpg", "");
  support_write_text("broken/aud_ds.npy", "no features");
  expect_broken(context, ERN_E_FORMAT, "broken/aud_ds.npy", "no .npy file");
  write_blink("broken/au.csv", "frame, AU45_c", FRAMES);
  expect_broken(context, ERN_E_MISSING, "broken/au.csv", "column AU45_r is missing");
  write_blink("broken/au.csv", "frame, AU45_r", FRAMES - 1);
  expect_broken(context, ERN_E_SHAPE, "broken/au.csv: column AU45_r has 5 rows", "expected at least 6");
  unlink("broken/gt_imgs/5.jpg"); /* of the validation split */
  expect_broken(context, ERN_E_MISSING, "broken/gt_imgs/5.jpg", "img_id 5");
  write_picture(context, "broken/gt_imgs/2.jpg", HEIGHT, WIDTH, 3, 2);
  expect_broken(context, ERN_E_SHAPE, "broken/gt_imgs/2.jpg", "size is 16 x 24, expected 24 x 16");
  support_write_text("broken/gt_imgs/2.jpg", "no picture");
  expect_broken(context, ERN_E_FORMAT, "broken/gt_imgs/2.jpg", "");
  unlink("broken/torso_imgs/3.png");
  expect_broken(context, ERN_E_MISSING, "broken/torso_imgs/3.png", "img_id 3");
  write_picture(context, "broken/torso_imgs/3.png", WIDTH + 1, HEIGHT, 4, 3);
  expect_broken(context, ERN_E_SHAPE, "broken/torso_imgs/3.png", "size is 25 x 16, expected 24 x 16");
  unlink("broken/ori_imgs/0.lms");
  expect_broken(context, ERN_E_MISSING, "broken/ori_imgs/0.lms", "img_id 0");
  write_landmarks("broken/ori_imgs/0.lms", 67, 0);
  expect_broken(context, ERN_E_SHAPE, "broken/ori_imgs/0.lms", "has 67 landmarks, expected 68");
  ern_context_free(&context);
}

/* ---- pixels -------------------------------------------------------------------------------------------------------
 */

static void expect_pixels(ern_context *context, ern_clip *clip, ern_split split, size_t index, int frame) {
  ern_image truth, torso;
  support_expect(context, ern_clip_pixels(clip, split, index, &truth, &torso), ERN_OK, NULL);
  assert_int_equal(truth.width, WIDTH);
  assert_int_equal(truth.height, HEIGHT);
  assert_int_equal(truth.channels, 3);
  assert_int_equal(torso.channels, 4);
  for (int i = 0; i < WIDTH * HEIGHT; i++) {
    for (int c = 0; c < 3; c++) {
      const int off = (int)truth.data[3 * i + c] - 10 * (frame + 1) * (c + 1);
      assert_true(off >= -3 && off <= 3); /* JPEG of one colour at quality 100 */
    }
    for (int c = 0; c < 4; c++) assert_int_equal(torso.data[4 * i + c], 10 * (frame + 1) * (c + 1));
  }
}

/* With room for everything, for two frames' worth, for one odd byte less, and for nothing. */
static void test_pixels(void **state) {
  (void)state;
  const uint64_t frame_bytes = 7 * WIDTH * HEIGHT;
  const uint64_t budgets[] = {0, 100 * frame_bytes, 2 * frame_bytes, 2 * frame_bytes - 1, 1};
  const bool all_kept[] = {true, true, false, false, false};
  ern_context *context = support_context();
  for (size_t k = 0; k < sizeof budgets / sizeof budgets[0]; k++) {
    ern_clip *clip = NULL;
    ern_clip_options options = ern_clip_options_default();
    options.memory_bytes = budgets[k];
    write_clip(context, "pixels");
    support_expect(context, ern_clip_open(context, "pixels", &options, &clip), ERN_OK, NULL);
    for (int round = 0; round < 3; round++) {
      for (size_t i = 0; i < TRAIN; i++) expect_pixels(context, clip, ERN_SPLIT_TRAIN, i, (int)i);
      for (size_t i = 0; i < VAL; i++) expect_pixels(context, clip, ERN_SPLIT_VAL, i, (int)i + TRAIN);
    }
    /* the last frame is in memory, or it is read again and the loss of its file is noticed */
    ern_image truth, torso;
    assert_int_equal(unlink("pixels/gt_imgs/5.jpg"), 0);
    support_expect(context, ern_clip_pixels(clip, ERN_SPLIT_VAL, 1, NULL, &torso), ERN_OK, NULL);
    const ern_status status = ern_clip_pixels(clip, ERN_SPLIT_VAL, 1, &truth, NULL);
    if (all_kept[k]) {
      assert_int_equal(status, ERN_OK);
    } else {
      support_expect(context, status, ERN_E_MISSING, "pixels/gt_imgs/5.jpg", NULL);
      write_picture(context, "pixels/gt_imgs/5.jpg", WIDTH + 2, HEIGHT, 3, 5);
      support_expect(context, ern_clip_pixels(clip, ERN_SPLIT_VAL, 1, &truth, NULL), ERN_E_SHAPE,
                     "pixels/gt_imgs/5.jpg", "26 x 16, expected 24 x 16", NULL);
      assert_null(truth.data);
      expect_pixels(context, clip, ERN_SPLIT_VAL, 0, TRAIN);
    }
    support_expect(context, ern_clip_pixels(clip, ERN_SPLIT_VAL, VAL, &truth, &torso), ERN_E_ARGUMENT, "frame 2", NULL);
    ern_clip_free(&clip);
  }
  ern_context_free(&context);
}

/* Past the budget, reading more frames takes no more memory; and nothing is left when the clip is freed. */
static void test_memory(void **state) {
  (void)state;
  struct support_meter meter = {0};
  ern_context *context = support_metered_context(&meter);
  ern_clip *clip = NULL;
  const size_t before = meter.now;
  write_clip(context, "metered");
  assert_int_equal(meter.now, before);
  ern_clip_options options = ern_clip_options_default();
  options.memory_bytes = 7 * WIDTH * HEIGHT;
  support_expect(context, ern_clip_open(context, "metered", &options, &clip), ERN_OK, NULL);
  const size_t opened = meter.now;
  for (size_t i = 0; i < TRAIN; i++) expect_pixels(context, clip, ERN_SPLIT_TRAIN, i, (int)i);
  assert_true(meter.now <= opened + 2 * 7 * WIDTH * HEIGHT + 8 * 64); /* the budget, the two read last, padding */
  assert_true(meter.now >= opened + 7 * WIDTH * HEIGHT);
  ern_clip_free(&clip);
  assert_int_equal(meter.now, before);
  ern_context_free(&context);
  assert_int_equal(meter.now, 0);
}

static ern_status open_and_read(ern_context *context) {
  ern_clip *clip = NULL;
  ern_image truth, torso;
  ern_status status = ern_clip_open(context, "refused", NULL, &clip);
  if (status == ERN_OK) status = ern_clip_pixels(clip, ERN_SPLIT_TRAIN, 1, &truth, &torso);
  if (status == ERN_OK) status = ern_clip_pixels(clip, ERN_SPLIT_TRAIN, 2, &truth, &torso);
  ern_clip_free(&clip);
  return status;
}

static void test_no_memory(void **state) {
  (void)state;
  ern_context *context = support_context();
  write_clip(context, "refused");
  write_picture(context, "refused/bc.jpg", 50, 50, 3, 1);
  ern_context_free(&context);
  support_refuse_each(open_and_read);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_open),     cmocka_unit_test(test_optional), cmocka_unit_test(test_features_choice),
      cmocka_unit_test(test_broken),   cmocka_unit_test(test_pixels),   cmocka_unit_test(test_memory),
      cmocka_unit_test(test_no_memory)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
