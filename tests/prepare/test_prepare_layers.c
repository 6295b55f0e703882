/* SPDX-License-Identifier: MIT
 * The step "layers" of prepare on a made-up clip with its true poses and landmarks: person, head and background against
 * the truth, masks that are brought, a screen of one colour, a head alone, and pictures in which there is nothing. */
#include "made_layers.h"

enum { CALLS = 5 };

static int difference(const uint8_t *a, const uint8_t *b) {
  int most = 0;
  for (int c = 0; c < 3; c++)
    if (abs(a[c] - b[c]) > most) most = abs(a[c] - b[c]);
  return most;
}

static bool is_head(const uint8_t *c) { return c[0] == 0 && c[1] == 0 && c[2] == 255; }
static bool is_person(const uint8_t *c) { return !(c[0] == 255 && c[1] == 255 && c[2] == 255); }

/* Intersection over union of all frames. */
static void overlaps(const struct truth *t, double *person, double *head) {
  size_t both[2] = {0}, any[2] = {0};
  for (int f = 0; f < FRAMES; f++) {
    ern_image parsing = picture(t->context, name_of("clip", "parsing/%d.png", f), 3);
    for (int k = 0; k < pixels; k++) {
      const bool found[2] = {is_person(parsing.data + 3 * k), is_head(parsing.data + 3 * k)};
      const bool there[2] = {t->person[f * pixels + k], t->head[f * pixels + k]};
      for (int i = 0; i < 2; i++) {
        both[i] += found[i] && there[i];
        any[i] += found[i] || there[i];
      }
    }
    ern_image_free(t->context, &parsing);
  }
  *person = (double)both[0] / (double)any[0];
  *head = (double)both[1] / (double)any[1];
  print_message("person %.4f head %.4f\n", *person, *head);
}

static void test_truth(void **state) {
  struct truth *t = *state;
  struct run run = {.options = ern_prepare_options_default()};
  double person, head, sum = 0, beside = 0;
  size_t seen = 0, passed = 0;
  support_ok(t->context, run_layers(&run, t->context, FRAMES));
  if (run.verdict.grade != ERN_PREPARE_GOOD) fail_msg("the verdict is not good: %s", run.verdict.words);
  overlaps(t, &person, &head);
  assert_true(person >= 0.96);
  assert_true(head >= 0.93);
  ern_image background = picture(t->context, "clip/bc.jpg", 3);
  for (int k = 0; k < pixels; k++) {
    const double off = difference(background.data + 3 * k, t->background.data + 3 * k);
    int free = 0;
    for (int f = 0; f < FRAMES; f++) free += !t->person[f * pixels + k];
    if (free == FRAMES) sum += off, seen++;
    if (free >= FRAMES / 3 && free < FRAMES) beside += off, passed++;
  }
  /* Filled in along the person; elsewhere the noise of two JPEGs. */
  assert_true(sum / (double)seen < 4);
  assert_true(beside / (double)passed < 4); /* what the person covers at times */
  for (int f = 0; f < FRAMES; f += 7) {     /* the frame itself over its background */
    ern_image frame = picture(t->context, name_of("clip", "ori_imgs/%d.jpg", f), 3);
    ern_image shown = picture(t->context, name_of("clip", "gt_imgs/%d.jpg", f), 3);
    ern_image torso = picture(t->context, name_of("clip", "torso_imgs/%d.png", f), 4);
    double apart = 0;
    size_t hidden = 0, solid = 0;
    for (int k = 0; k < pixels; k++) {
      apart += difference(frame.data + 3 * k, shown.data + 3 * k);
      solid += torso.data[4 * k + 3] == 255;
      hidden += torso.data[4 * k + 3] == 255 && t->head[f * pixels + k];
    }
    assert_true(apart / pixels < 4);
    assert_true(hidden > 0 && solid > 4 * hidden); /* the neck goes on behind the head */
    ern_image_free(t->context, &frame);
    ern_image_free(t->context, &shown);
    ern_image_free(t->context, &torso);
  }
  ern_image_free(t->context, &background);
}

/* Masks without the torso: a person that has no shoulders, unless the head alone is asked for. */
static void test_no_shoulders_long(void **state) {
  struct truth *t = *state;
  struct run run = {.options = ern_prepare_options_default()};
  run.options.masks = "narrow";
  for (int step = 0; step < 3; step++) {
    write_masks(t, "narrow", step == 1);
    run.options.head_only = step == 2;
    support_ok(t->context, run_layers(&run, t->context, FRAMES));
    if ((strstr(run.verdict.words, "has no shoulders in 22 of the 22 frames") != NULL) != (step == 0))
      fail_msg("masks %d: %s", step, run.verdict.words);
  }
}

static void test_supplied(void **state) {
  struct truth *t = *state;
  struct run run = {.options = ern_prepare_options_default()};
  run.options.masks = "brought";
  run.options.head_only = true;
  mkdir("brought", 0755);
  uint8_t *rgb = calloc(3, (size_t)pixels);
  ern_image image = {.width = side, .height = side, .channels = 3, .data = rgb};
  for (int f = 0; f < FRAMES; f++) {
    for (int k = 0; k < pixels; k++)
      for (int c = 0; c < 3; c++) {
        const int person = t->person[f * pixels + k], head = t->head[f * pixels + k];
        rgb[3 * k + c] = (uint8_t)(255 * (head ? c == 2 : person ? c == 0 : 1));
      }
    support_ok(t->context, ern_image_write(t->context, name_of("brought", "%d.png", f), &image, 100));
  }
  support_ok(t->context, run_layers(&run, t->context, FRAMES));
  double person, head;
  overlaps(t, &person, &head);
  assert_true(person == 1 && head == 1);
  ern_image torso = picture(t->context, "clip/torso_imgs/3.png", 4);
  ern_image shown = picture(t->context, "clip/gt_imgs/3.jpg", 3);
  ern_image background = picture(t->context, "clip/bc.jpg", 3);
  double apart = 0;
  for (int k = 0; k < pixels; k++) assert_int_equal(torso.data[4 * k + 3], 0);
  for (int k = pixels - side; k < pixels; k++) apart += difference(shown.data + 3 * k, background.data + 3 * k);
  assert_true(apart / side < 6); /* the lowest row is all torso, and shows the background */
  ern_image_free(t->context, &torso);
  ern_image_free(t->context, &shown);
  ern_image_free(t->context, &background);
  /* white is the background also in a file that has nothing else, and the folder's files are alike */
  memset(rgb, 255, 3 * (size_t)pixels);
  support_ok(t->context, ern_image_write(t->context, "brought/0.png", &image, 100));
  support_ok(t->context, ern_image_write(t->context, "brought/9.png", &image, 100));
  support_ok(t->context, run_layers(&run, t->context, FRAMES));
  if (strstr(run.verdict.words, "in 2 of 22 frames, the first is 0, the person takes 0 % of the picture") == NULL)
    fail_msg("%s", run.verdict.words);
  for (int f = 0; f < 10; f += 9) {
    ern_image parsing = picture(t->context, name_of("clip", "parsing/%d.png", f), 3);
    for (int k = 0; k < pixels; k++) assert_false(is_person(parsing.data + 3 * k));
    ern_image_free(t->context, &parsing);
  }
  memset(rgb, 128, 3 * (size_t)pixels);
  support_ok(t->context, ern_image_write(t->context, "brought/9.png", &image, 100));
  support_expect(t->context, run_layers(&run, t->context, FRAMES), ERN_E_FORMAT, "brought/9.png: is grey",
                 "1.png is in colours", NULL);
  rgb[1] = 7; /* no colour of a part */
  support_ok(t->context, ern_image_write(t->context, "brought/0.png", &image, 100));
  support_expect(t->context, run_layers(&run, t->context, FRAMES), ERN_E_FORMAT, "brought/0.png", "expected", NULL);
  image.height = side / 2;
  support_ok(t->context, ern_image_write(t->context, "brought/0.png", &image, 100));
  char half[32];
  snprintf(half, sizeof half, "%d x %d", side, side / 2);
  support_expect(t->context, run_layers(&run, t->context, FRAMES), ERN_E_SHAPE, "brought/0.png", half, NULL);
  support_ok(t->context, ern_image_write(t->context, name_of("brought", "%d.png", FRAMES), &image, 100));
  support_expect(t->context, run_layers(&run, t->context, FRAMES), ERN_E_MISMATCH, "brought: has 23 files ID.png",
                 "22 frames", NULL);
  run.options.masks = "none";
  support_expect(t->context, run_layers(&run, t->context, FRAMES), ERN_E_MISSING, "none/0.png", NULL);
  free(rgb);
}

enum { LEAN_FIRST = 12, LEAN_LAST = 17 }; /* frames in which the person leans toward the camera */
/* Divides the head's distance in them by `factor`. */
static void lean(double factor) {
  for (int file = 0; file < 2; file++) {
    const char *path = file == 0 ? "clip/transforms_train.json" : "clip/transforms_val.json";
    json_t *root = json_load_file(path, 0, NULL), *frame;
    size_t i;
    assert_non_null(root);
    json_array_foreach(json_object_get(root, "frames"), i, frame) {
      const json_int_t id = json_integer_value(json_object_get(frame, "img_id"));
      const json_t *matrix = json_object_get(frame, "transform_matrix");
      for (size_t r = 0; r < 3 && id >= LEAN_FIRST && id <= LEAN_LAST; r++) {
        json_t *row = json_array_get(matrix, r);
        json_array_set_new(row, 3, json_real(json_number_value(json_array_get(row, 3)) / factor));
      }
    }
    assert_int_equal(json_dump_file(root, path, 0), 0);
    json_decref(root);
  }
}

/* A person who leans toward the camera takes more of the picture, and is there; a mask alone that is larger is wrong.
 */
static void test_leaning(void **state) {
  struct truth *t = *state;
  struct run run = {.options = ern_prepare_options_default()};
  run.options.masks = "near";
  run.options.head_only = true;
  mkdir("near", 0755);
  uint8_t *rgb = calloc(3, (size_t)pixels);
  assert_non_null(rgb);
  const ern_image image = {.width = side, .height = side, .channels = 3, .data = rgb};
  for (int f = 0; f < FRAMES; f++) { /* a head of 1/4 or 0.4 of the picture */
    const int edge = f >= LEAN_FIRST && f <= LEAN_LAST ? side * 63 / 100 : side / 2;
    memset(rgb, 255, 3 * (size_t)pixels);
    for (int k = 0; k < edge * edge; k++)
      memcpy(rgb + 3 * (k / edge * side + k % edge), (const uint8_t[3]){0, 0, 255}, 3);
    support_ok(t->context, ern_image_write(t->context, name_of("near", "%d.png", f), &image, 100));
  }
  support_ok(t->context, run_layers(&run, t->context, FRAMES));
  if (strstr(run.verdict.words, "in 6 of 22 frames, the first is 12, the person takes ") == NULL)
    fail_msg("larger masks: %s", run.verdict.words);
  lean(sqrt(1.58));
  support_ok(t->context, run_layers(&run, t->context, FRAMES));
  if (strstr(run.verdict.words, "the person takes") != NULL) fail_msg("leaning: %s", run.verdict.words);
  lean(1 / sqrt(1.58));
  free(rgb);
}

/* A picture of the place is cut as the video was, also where it is larger, and one of another form is refused. */
static void test_background(void **state) {
  struct truth *t = *state;
  const int wide = 4 * side, high = 2 * side, left = side / 2; /* twice the video's size */
  char found[32], expected[32];
  struct run run = {.options = ern_prepare_options_default()};
  uint8_t *rgb = calloc(3, (size_t)(wide * high));
  ern_image image = {.width = wide, .height = high, .channels = 3, .data = rgb};
  assert_non_null(rgb);
  run.options.masks = "person"; /* known, as they would take most of the time */
  write_masks(t, "person", true);
  for (int y = 0; y < high; y++)
    for (int x = left; x < left + high; x++)
      memcpy(rgb + 3 * (y * wide + x), t->background.data + 3 * (y / 2 * side + (x - left) / 2), 3);
  support_ok(t->context, ern_image_write(t->context, "place.png", &image, 100));
  run.options.background = "place.png";
  run.crop = json_pack("{s:f, s:f, s:f, s:f, s:i, s:i}", "x", 0.5 * left, "y", 0.0, "width", 1.0 * side, "side",
                       1.0 * side, "video_width", wide / 2, "video_height", high / 2);
  support_ok(t->context, run_layers(&run, t->context, FRAMES));
  ern_image background = picture(t->context, "clip/bc.jpg", 3);
  for (int k = 0; k < pixels; k++)
    assert_true(difference(background.data + 3 * k, t->background.data + 3 * k) <= 40); /* of JPEG, at edges */
  ern_image_free(t->context, &background);
  /* black and small */
  ern_image small = {
      .width = wide / 16, .height = high / 16, .channels = 3, .data = calloc(3, (size_t)(wide * high / 256))};
  support_ok(t->context, ern_image_write(t->context, "small.png", &small, 100));
  free(small.data);
  run.options.background = "small.png";
  run.crop = json_pack("{s:f, s:f, s:f, s:f, s:i, s:i}", "x", 0.5 * left, "y", 0.0, "width", 1.0 * side, "side",
                       1.0 * side, "video_width", wide / 2, "video_height", high / 2);
  support_ok(t->context, run_layers(&run, t->context, FRAMES));
  const char *by = strstr(run.verdict.words, "beside the person by ");
  assert_non_null(strstr(run.verdict.words, "--background small.png is enlarged 8 times"));
  const double told = by != NULL ? strtod(by + strlen("beside the person by "), NULL) : 0;
  if (!(told > 23 && told <= 255)) fail_msg("%s", run.verdict.words);
  run.options.background = "place.png";
  run.crop = json_pack("{s:f, s:f, s:f, s:f, s:i, s:i}", "x", 0.0, "y", 0.0, "width", 1.0 * side, "side", 1.0 * side,
                       "video_width", side, "video_height", side + 100);
  snprintf(found, sizeof found, "%d x %d", wide, high);
  snprintf(expected, sizeof expected, "%d x %d", side, side + 100);
  support_expect(t->context, run_layers(&run, t->context, FRAMES), ERN_E_SHAPE, "place.png", found, expected, NULL);
  free(rgb);
}

static int stop(void *user, const char *step, size_t done, size_t total) {
  assert_string_equal(step, "layers");
  assert_true(done <= total);
  return --*(int *)user == 0;
}

static void test_cancel(void **state) {
  struct truth *t = *state;
  int calls = CALLS;
  struct run run = {.options = ern_prepare_options_default()};
  run.options.progress = stop;
  run.options.user = &calls;
  unlink("clip/bc.jpg");
  assert_int_equal(run_layers(&run, t->context, FRAMES), ERN_E_CANCELLED);
  assert_int_not_equal(access("clip/bc.jpg", F_OK), 0);
}

/* A room of patches in the person's own colours, which only their standing still tells from the person. Changes the
 * frames, as the next one does. */
static void test_cluttered_long(void **state) {
  struct truth *t = *state;
  static const uint8_t colours[6][3] = {{205, 160, 135}, {120, 85, 60},  {60, 80, 70},
                                        {90, 60, 45},    {200, 120, 60}, {170, 160, 165}};
  struct run run = {.options = ern_prepare_options_default()};
  for (int f = 0; f < FRAMES; f++) {
    ern_image frame = picture(t->context, name_of("clip", "ori_imgs/%d.jpg", f), 3);
    for (int k = 0; k < pixels; k++) {
      const unsigned block = (unsigned)(k % side / 9 + 57 * (k / side / 7)) * 2654435761u;
      if (!t->person[f * pixels + k]) memcpy(frame.data + 3 * k, colours[(block >> 20) % 6], 3);
    }
    support_ok(t->context, ern_image_write(t->context, name_of("clip", "ori_imgs/%d.jpg", f), &frame, 90));
    ern_image_free(t->context, &frame);
  }
  support_ok(t->context, run_layers(&run, t->context, FRAMES));
  double person, head;
  overlaps(t, &person, &head);
  assert_true(person >= 0.93);
  assert_true(head >= 0.90);
}

/* What comes after uses the frames no more. */
static void test_key_long(void **state) {
  struct truth *t = *state;
  static const uint8_t green[3] = {40, 190, 60};
  struct run run = {.options = ern_prepare_options_default()};
  run.options.background = "key";
  for (int f = 0; f < FRAMES; f++) {
    ern_image frame = picture(t->context, name_of("clip", "ori_imgs/%d.jpg", f), 3);
    for (int k = 0; k < pixels; k++)
      if (!t->person[f * pixels + k]) memcpy(frame.data + 3 * k, green, 3);
    support_ok(t->context, ern_image_write(t->context, name_of("clip", "ori_imgs/%d.jpg", f), &frame, 98));
    ern_image_free(t->context, &frame);
  }
  support_ok(t->context, run_layers(&run, t->context, FRAMES));
  double person, head;
  overlaps(t, &person, &head);
  assert_true(person >= 0.96);
  assert_true(head >= 0.93);
  ern_image background = picture(t->context, "clip/bc.jpg", 3);
  for (int k = 0; k < pixels; k++) assert_true(difference(background.data + 3 * k, green) <= 4);
  ern_image_free(t->context, &background);
}

static void test_nothing_long(void **state) {
  struct truth *t = *state;
  struct run run = {.options = ern_prepare_options_default()};
  uint8_t *rgb = malloc(3 * (size_t)pixels);
  const ern_image image = {.width = side, .height = side, .channels = 3, .data = rgb};
  for (int grey = 0; grey <= 255; grey += 255) { /* one colour everywhere, and frames of both */
    memset(rgb, grey, 3 * (size_t)pixels);
    for (int f = 0; f < FRAMES; f++)
      if (grey == 0 || f % 2 == 0)
        support_ok(t->context, ern_image_write(t->context, name_of("clip", "ori_imgs/%d.jpg", f), &image, 98));
    support_ok(t->context, run_layers(&run, t->context, FRAMES));
    assert_int_not_equal(run.verdict.grade, ERN_PREPARE_GOOD);
    assert_true(strlen(run.verdict.words) > 20);
  }
  free(rgb);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_truth),          cmocka_unit_test(test_no_shoulders_long),
                                     cmocka_unit_test(test_supplied),       cmocka_unit_test(test_leaning),
                                     cmocka_unit_test(test_background),     cmocka_unit_test(test_cancel),
                                     cmocka_unit_test(test_cluttered_long), cmocka_unit_test(test_key_long),
                                     cmocka_unit_test(test_nothing_long)};
  return cmocka_run_group_tests(tests, make_truth, free_truth);
}
