/* SPDX-License-Identifier: MIT
 * The files of a clip's frames are not those that one takes them for: exchanged since a training began or the clip was
 * opened, or two pictures of one frame. */
#include <math.h>
#include <unistd.h>

#include "ernerf-lab/synth.h"
#include "ernerf/media.h"
#include "io/npy.h"
#include "support.h"

static char lines[SUPPORT_LINES];

static ern_context *open_made(void) {
  ern_context_config config = ern_context_config_default();
  ern_synth_options synth = ern_synth_options_default();
  ern_context *context = NULL;
  config.log = support_keep_warnings;
  config.user = lines;
  assert_int_equal(ern_context_create(&context, &config), ERN_OK);
  synth.size = 64;
  synth.frames = 8;
  synth.parsing = true;
  support_clear("made");
  support_ok(context, ern_synth_write(context, "made", &synth));
  lines[0] = 0;
  return context;
}

static void print_of(ern_context *context, char print[65]) {
  ern_clip *clip = NULL;
  ern_dataset dataset;
  support_ok(context, ern_clip_open(context, "made", NULL, &clip));
  ern_clip_dataset(clip, &dataset);
  snprintf(print, 65, "%s", dataset.fingerprint);
  ern_clip_free(&clip);
}

static void test_exchanged(void **state) {
  (void)state;
  ern_context *context = open_made();
  char before[65], after[65];
  uint8_t grey[64 * 64 * 4] = {0};
  ern_image picture = {.width = 64, .height = 64, .channels = 3, .data = grey};
  print_of(context, before);
  assert_int_equal(system("cp -r made copy && rm -r made && mv copy made"), 0);
  print_of(context, after);
  assert_string_equal(before, after);
  /* other contents of the same size */
  assert_int_equal(system("printf x | dd of=made/gt_imgs/3.jpg bs=1 conv=notrunc status=none "
                          "seek=$(($(stat -c %s made/gt_imgs/3.jpg) - 20))"),
                   0);
  print_of(context, after);
  assert_string_not_equal(before, after);
  assert_memory_equal(before, after, 16);
  support_ok(context, ern_image_write(context, "made/gt_imgs/2.jpg", &picture, 50));
  print_of(context, before);
  assert_string_not_equal(before, after);
  print_of(context, after);
  picture.channels = 4;
  support_ok(context, ern_image_write(context, "made/torso_imgs/7.png", &picture, 50));
  print_of(context, before);
  assert_string_not_equal(before, after);
  assert_int_equal(system("sed -i '20s/.*/1 1/' made/ori_imgs/0.lms"), 0);
  print_of(context, after);
  assert_string_not_equal(before, after);
  assert_int_equal(unlink("made/au.csv"), 0);
  print_of(context, before);
  assert_string_not_equal(before, after);
  ern_context_free(&context);
}

/* A picture that was replaced after the clip was opened belongs to other poses; one in memory is still the earlier. */
static void test_replaced(void **state) {
  (void)state;
  static const char *const files[] = {"made/gt_imgs/3.jpg", "made/torso_imgs/3.png", "made/parsing/3.png"};
  ern_context *context = open_made();
  ern_clip *clip = NULL;
  ern_image truth, torso, head;
  uint8_t before[64], white[64 * 64 * 4];
  memset(white, 255, sizeof white);
  support_ok(context, ern_clip_open(context, "made", NULL, &clip));
  size_t at = 0; /* of img_id 3 */
  while (ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, at)->pose.img_id != 3) at++;
  const size_t other = at == 0 ? 1 : 0;
  support_ok(context, ern_clip_pixels(clip, ERN_SPLIT_TRAIN, other, &truth, &torso));
  memcpy(before, truth.data, sizeof before);
  for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
    const ern_image picture = {.width = 64, .height = 64, .channels = i == 1 ? 4 : 3, .data = white};
    support_ok(context, ern_image_write(context, files[i], &picture, 50));
  }
  support_expect(context, ern_clip_pixels(clip, ERN_SPLIT_TRAIN, at, &truth, NULL), ERN_E_STATE, files[0],
                 "was replaced since the clip was opened", NULL);
  support_expect(context, ern_clip_pixels(clip, ERN_SPLIT_TRAIN, at, NULL, &torso), ERN_E_STATE, files[1], NULL);
  support_expect(context, ern_clip_torso(clip, ERN_SPLIT_TRAIN, at, &torso), ERN_E_STATE, files[1], NULL);
  support_expect(context, ern_clip_head(clip, ERN_SPLIT_TRAIN, at, &head), ERN_E_STATE, files[2], NULL);
  support_ok(context, ern_clip_pixels(clip, ERN_SPLIT_TRAIN, other, &truth, &torso));
  assert_memory_equal(truth.data, before, sizeof before);
  ern_clip_free(&clip);
  ern_context_free(&context);
}

/* A link to a disk that is not there: without au.csv the head would not blink, without ori_imgs it would learn no
 * mouth. */
static void test_links_to_nothing(void **state) {
  (void)state;
  static const char *const names[] = {"made/au.csv", "made/ori_imgs", "made/torso_imgs"};
  ern_context *context = open_made();
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    ern_clip *clip = NULL;
    assert_int_equal(rename(names[i], "moved"), 0);
    support_ok(context, ern_clip_open(context, "made", NULL, &clip));
    ern_clip_free(&clip);
    assert_int_equal(symlink("nowhere", names[i]), 0);
    support_expect(context, ern_clip_open(context, "made", NULL, &clip), ERN_E_MISSING, names[i], NULL);
    assert_int_equal(unlink(names[i]), 0);
    assert_int_equal(rename("moved", names[i]), 0);
  }
  ern_context_free(&context);
}

static void ignore(void *user, int ok, const char *sentence) { (void)user, (void)ok, (void)sentence; }

static void expect_motion_refused(ern_context *context, const float *motion, int dims, const size_t *shape,
                                  ern_status status, const char *said) {
  ern_clip *clip = NULL;
  support_ok(context, ern_npy_write_f32(context, "made/torso.npy", motion, dims, shape));
  support_expect(context, ern_clip_open(context, "made", NULL, &clip), status, "made/torso.npy", said, NULL);
  assert_null(clip);
  support_expect(context, ern_clip_check(context, "made", ignore, NULL), status, "made/torso.npy", said, NULL);
}

static void test_motion(void **state) {
  (void)state;
  enum { FRAMES = 8, SIDE = ERN_MOTION_SIDE };
  static float motion[FRAMES][ERN_MOTION_VALUES];
  static const size_t shape[4] = {FRAMES, 2, SIDE, SIDE}, short_of_one[4] = {FRAMES - 1, 2, SIDE, SIDE},
                      flat[3] = {FRAMES, 2 * SIDE, SIDE}, turned[4] = {2, FRAMES, SIDE, SIDE};
  ern_context *context = open_made();
  ern_clip *clip = NULL;
  ern_clip_info info;
  char before[65], after[65];
  print_of(context, before);
  for (int f = 0; f < FRAMES; f++)
    for (int k = 0; k < ERN_MOTION_VALUES; k++) motion[f][k] = 0.1f * (float)f - 0.001f * (float)k;
  support_ok(context, ern_npy_write_f32(context, "made/torso.npy", motion[0], 4, shape));
  print_of(context, after);
  assert_string_not_equal(before, after);
  support_ok(context, ern_clip_open(context, "made", NULL, &clip));
  ern_clip_describe(clip, &info);
  assert_true(info.has_torso_motion);
  for (size_t i = 0; i < info.frames[0]; i++) {
    const ern_clip_frame *frame = ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, i);
    assert_memory_equal(frame->torso_motion, motion[frame->pose.img_id], sizeof frame->torso_motion);
  }
  ern_clip_free(&clip);
  expect_motion_refused(context, motion[0], 4, short_of_one, ERN_E_SHAPE, "has 7 frames");
  expect_motion_refused(context, motion[0], 3, flat, ERN_E_SHAPE, "[frames][2][16][16]");
  expect_motion_refused(context, motion[0], 4, turned, ERN_E_SHAPE, "[frames][2][16][16]");
  motion[3][7] = 1001;
  expect_motion_refused(context, motion[0], 4, shape, ERN_E_FORMAT, "frame 3, value 7 is 1001");
  motion[3][7] = NAN;
  expect_motion_refused(context, motion[0], 4, shape, ERN_E_FORMAT, "frame 3, value 7");
  ern_context_free(&context);
}

static void note(void *user, int ok, const char *sentence) {
  if (!ok && strstr(sentence, "gt_imgs: 1 frames have several pictures, the first is img_id 3") != NULL)
    *(bool *)user = true;
}

static void test_two_of_one_frame(void **state) {
  (void)state;
  ern_context *context = open_made();
  char print[65];
  bool said = false;
  print_of(context, print);
  assert_string_equal(lines, "");
  assert_int_equal(system("cp made/torso_imgs/3.png made/gt_imgs/3.png && cp made/gt_imgs/3.jpg made/gt_imgs/3.jpeg"),
                   0);
  print_of(context, print);
  assert_non_null(strstr(lines, "made/gt_imgs: 1 frames have several pictures, the first is img_id 3"));
  support_ok(context, ern_clip_check(context, "made", note, &said));
  assert_true(said);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_exchanged), cmocka_unit_test(test_replaced),
                                     cmocka_unit_test(test_links_to_nothing), cmocka_unit_test(test_motion),
                                     cmocka_unit_test(test_two_of_one_frame)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
