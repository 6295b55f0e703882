/* SPDX-License-Identifier: MIT
 * The files of a clip's frames are not those that one takes them for: exchanged since a training began, or two pictures
 * of one frame. */
#include <unistd.h>

#include "ernerf-lab/synth.h"
#include "ernerf/media.h"
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
  support_ok(context, ern_image_write(context, "made/gt_imgs/2.jpg", &picture, 50));
  print_of(context, after);
  assert_string_not_equal(before, after);
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
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_exchanged), cmocka_unit_test(test_two_of_one_frame)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
