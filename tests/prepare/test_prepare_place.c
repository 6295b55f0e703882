/* SPDX-License-Identifier: MIT
 * The step "layers" of prepare where what is behind the person is not one place that stands still: a camera that moves,
 * another place, an inset picture, light that changes, running text. */
#include "made_layers.h"

/* Draws running text: letters are blocks, in rows from 7/8 of the picture on. */
static void draw_banner(ern_image *image, int frame) {
  for (int y = side * 7 / 8; y < side * 31 / 32; y++)
    for (int x = 0; x < side; x++) {
      const unsigned letter = (unsigned)((x + frame * side * 3 / 64) / 3) * 2654435761u + (unsigned)(y / 3) * 40503u;
      memset(image->data + 3 * (y * side + x), (letter >> 13 & 1) != 0 ? 230 : 40, 3);
    }
}

/* In the second half of the frames the camera has turned, by 8 pixels of 512. */
static void move_camera(ern_image *image, int frame) {
  const int by = 8 * side / 512;
  for (int y = 0; y < side && frame >= FRAMES / 2; y++) {
    uint8_t *row = image->data + 3 * y * side;
    memmove(row + 3 * by, row, 3 * (size_t)(side - by));
  }
}

/* Another place in each frame, of blocks in greys from 60 to 187. */
static void change_place(ern_image *image, int frame) {
  for (int y = 0; y < side; y++)
    for (int x = 0; x < side; x++) {
      unsigned block = (unsigned)(x / 8 + 64 * (y / 8) + 4096 * frame) * 2654435761u;
      block = (block ^ block >> 15) * 2246822519u; /* else a frame is the one before it, shifted */
      memset(image->data + 3 * (y * side + x), (int)(60 + (block >> 20) % 128), 3);
    }
}

/* What the step says of frames that `change` has changed. */
static void run_changed(const struct truth *t, struct run *run, void (*change)(ern_image *image, int frame)) {
  uint8_t *kept[FRAMES];
  size_t bytes[FRAMES];
  for (int f = 0; f < FRAMES; f++) {
    const char *path = name_of("clip", "ori_imgs/%d.jpg", f);
    ern_image image = picture(t->context, path, 3);
    support_ok(t->context, ern_file_read(t->context, path, 1 << 20, &kept[f], &bytes[f]));
    change(&image, f);
    support_ok(t->context, ern_image_write(t->context, path, &image, 95));
    ern_image_free(t->context, &image);
  }
  support_ok(t->context, run_layers(run, t->context, FRAMES));
  for (int f = 0; f < FRAMES; f++) {
    support_write(name_of("clip", "ori_imgs/%d.jpg", f), kept[f], bytes[f]);
    ern_release(t->context, kept[f]);
  }
}

/* How far a camera moves is told in pixels of 512, as its bound is, whatever the clip's side. */
static void test_camera(void **state) {
  struct truth *t = *state;
  struct run run = {.options = ern_prepare_options_default()};
  double shift = 0;
  run.options.masks = "person"; /* known, as they would take most of the time */
  write_masks(t, "person", true);
  run_changed(t, &run, move_camera);
  assert_int_equal(run.verdict.grade, ERN_PREPARE_DOUBTFUL);
  const char *told = strstr(run.verdict.words, "what is behind the person shifts by ");
  if (told == NULL || sscanf(told, "what is behind the person shifts by %lf pixels of 512", &shift) != 1)
    fail_msg("%s", run.verdict.words);
  if (!(fabs(shift - 8) < 1)) fail_msg("%s", run.verdict.words); /* a quarter of a pixel of 128 */
}

/* A wall out of focus in place of the background, `by` pixels further right, with another noise in each frame: its
 * corners are of the noise alone. */
static void draw_wall(ern_image *image, const uint8_t *person, int by, int frame) {
  unsigned noise = (unsigned)frame + 1;
  for (int y = 0; y < side; y++)
    for (int x = 0; x < side; x++) {
      noise = noise * 1664525u + 1013904223u;
      const double u = 12.0 * (x - by) / side, v = 9.0 * y / side;
      uint8_t *to = image->data + 3 * (y * side + x);
      if (person[y * side + x] == 0) memset(to, (int)(110 + 20 * sin(u) + 15 * cos(v) + noise / 0x1p28), 3);
    }
}

/* Hair that the masks lack: strands from `near` to `far` pixels left of the person's ear, which move with the head. */
static void draw_hair(ern_image *image, const uint8_t *person, int near, int far) {
  int least = 0;
  while (least < side && person[side * side / 4 + least] == 0) least++;
  for (int y = 0; y < side / 2; y++)
    for (int k = near; k < far && k <= least; k++) {
      const unsigned strand = (unsigned)(k / 2 * 31 + y / 3) * 2654435761u >> 24;
      memset(image->data + 3 * (y * side + least - k), 60 + (int)strand % 128, 3);
    }
}

/* The hair moves by up to 14 pixels of 128, the camera not. */
static void wall_and_hair(ern_image *image, int frame) {
  const int by = 7 + (int)lround(7 * sin(frame));
  draw_wall(image, made.person + frame * pixels, 0, frame);
  draw_hair(image, made.person + frame * pixels, 6 + by, 18 + by);
}

static void wall_by_hand(ern_image *image, int frame) {
  draw_wall(image, made.person + frame * pixels, (int)lround(6 * sin(frame)), frame);
}

/* Before a wall without corners, the camera that moves is told from hair that does. */
static void test_blurred_place(void **state) {
  struct truth *t = *state;
  struct run run = {.options = ern_prepare_options_default()};
  run.options.masks = "person";
  write_masks(t, "person", true);
  run_changed(t, &run, wall_and_hair);
  if (strstr(run.verdict.words, "the camera moves") != NULL) fail_msg("hair: %s", run.verdict.words);
  run_changed(t, &run, wall_by_hand);
  if (strstr(run.verdict.words, "the camera moves") == NULL) fail_msg("by hand: %s", run.verdict.words);
}

/* A background that is another one in each frame does not pass for noise. */
static void test_changing_place(void **state) {
  struct truth *t = *state;
  struct run run = {.options = ern_prepare_options_default()};
  run.options.masks = "person";
  run.options.head_only = true;
  write_masks(t, "person", true);
  run_changed(t, &run, change_place);
  assert_int_equal(run.verdict.grade, ERN_PREPARE_DOUBTFUL);
  if (strstr(run.verdict.words, "the background changes: ") == NULL) fail_msg("%s", run.verdict.words);
}

/* An inset picture in the upper left corner, 2 % of the picture: another one every third frame. */
static void draw_inset(ern_image *image, int frame) {
  const int edge = side / 7;
  for (int y = 0; y < edge; y++)
    for (int x = 0; x < edge; x++) {
      const unsigned block = (unsigned)(x / 4 + 64 * (y / 4) + 4096 * (frame / 3)) * 2654435761u;
      memset(image->data + 3 * (y * side + x), (int)(40 + (block >> 20) % 180), 3);
    }
}

/* A small part of the background that changes is told, and where it is. */
static void test_inset(void **state) {
  struct truth *t = *state;
  struct run run = {.options = ern_prepare_options_default()};
  run.options.masks = "person";
  run.options.head_only = true;
  write_masks(t, "person", true);
  run_changed(t, &run, draw_inset);
  assert_int_equal(run.verdict.grade, ERN_PREPARE_DOUBTFUL);
  if (strstr(run.verdict.words,
             "a part of the background changes, at 0 to 14 % of the picture's width and 0 to 14 %") == NULL)
    fail_msg("%s", run.verdict.words);
}

/* The light, from 0.4 to all of it. */
static void change_light(ern_image *image, int frame) {
  const double light = 0.4 + 0.6 * frame / (FRAMES - 1);
  for (int i = 0; i < 3 * pixels; i++) image->data[i] = (uint8_t)lround(light * image->data[i]);
}

/* Light that changes is no camera that moves, and no other place. */
static void test_light(void **state) {
  struct truth *t = *state;
  struct run run = {.options = ern_prepare_options_default()};
  run.options.masks = "person";
  run.options.head_only = true;
  write_masks(t, "person", true);
  run_changed(t, &run, change_light);
  if (strstr(run.verdict.words, "the light changes: ") == NULL ||
      strstr(run.verdict.words, "the camera moves") != NULL ||
      strstr(run.verdict.words, "the background changes") != NULL)
    fail_msg("%s", run.verdict.words);
}

/* Text that runs through the picture is named, and where it does so. */
static void test_banner_long(void **state) {
  struct run run = {.options = ern_prepare_options_default()};
  run_changed(*state, &run, draw_banner);
  assert_int_equal(run.verdict.grade, ERN_PREPARE_DOUBTFUL);
  if (strstr(run.verdict.words, "a banner moves through the picture without pause, at 88 to 97 %") == NULL)
    fail_msg("%s", run.verdict.words);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_camera),         cmocka_unit_test(test_blurred_place),
                                     cmocka_unit_test(test_changing_place), cmocka_unit_test(test_inset),
                                     cmocka_unit_test(test_light),          cmocka_unit_test(test_banner_long)};
  return cmocka_run_group_tests(tests, make_truth, free_truth);
}
