/* SPDX-License-Identifier: MIT
 * The words of `check`, on clips made by hand and on real ones. */
#include <unistd.h>

#include "clip_folder.h"

struct said {
  char text[16384]; /* "+", "o" or "-", the sentence, a newline; and so on */
  size_t used;
};

static void note(void *user, int ok, const char *sentence) {
  struct said *said = user;
  said->used += (size_t)snprintf(said->text + said->used, sizeof said->text - said->used, "%c%s\n",
                                 ok > 0    ? '+'
                                 : ok == 0 ? 'o'
                                           : '-',
                                 sentence);
  assert_true(said->used < sizeof said->text);
}

/* A sentence that starts with this mark and these words and has `word` in it. */
static void expect_said(const struct said *said, const char *start, const char *word) {
  for (const char *line = said->text; *line != 0; line = strchr(line, '\n') + 1) {
    char one[4096];
    const size_t length = (size_t)(strchr(line, '\n') - line);
    snprintf(one, sizeof one, "%.*s", (int)length, line);
    if (strncmp(one, start, strlen(start)) == 0 && strstr(one, word) != NULL) return;
  }
  fail_msg("nothing says \"%s ... %s\" in:\n%s", start, word, said->text);
}

static void check_again(ern_context *context, ern_status expected, struct said *said) {
  *said = (struct said){.used = 0};
  support_expect(context, ern_clip_check(context, "judged", note, said), expected, NULL);
}

static void test_check(void **state) {
  (void)state;
  ern_context *context = support_context();
  struct said said;
  support_clear("judged");
  write_clip(context, "judged");
  check_again(context, ERN_OK, &said);
  assert_int_equal(said.text[0], '+');
  assert_ptr_equal(strstr(said.text, "\no"), strstr(said.text, "\noparsing: missing")); /* no other part is */
  assert_null(strstr(said.text, "\n-"));
  expect_said(&said, "+transforms_train.json", "4 frames of 24 x 16");
  expect_said(&said, "+transforms_val.json", "2 frames");
  expect_said(&said, "+aud_ds.npy", "deepspeech, 6 windows of 16 vectors of 29");
  expect_said(&said, "+gt_imgs", "all 6 frames");
  expect_said(&said, "+torso_imgs", "all 6 frames");
  expect_said(&said, "+ori_imgs", "all 6 frames");
  expect_said(&said, "+au.csv", "6 rows");
  expect_said(&said, "+aud.wav", "0.24 s of sound at 16000 Hz");
  expect_said(&said, "+`ernerf train` will learn a head from 4 frames", "blinking from au.csv");
  expect_said(&said, "+`ernerf train`", "will learn the torso");

  unlink("judged/au.csv");
  unlink("judged/aud.wav");
  unlink("judged/transforms_val.json");
  unlink("judged/aud_ds.npy");
  write_features(context, "judged/aud_hu.npy", 5, 2, 1024);
  write_picture(context, "judged/bc.jpg", 50, 50, 3, 1);
  check_again(context, ERN_OK, &said);
  expect_said(&said, "oau.csv: missing. No blinking will be learnt", "OpenFace's FeatureExtraction");
  expect_said(&said, "oaud.wav: missing", "no sound");
  expect_said(&said, "otransforms_val.json: missing", "task 9");
  expect_said(&said, "+aud_hu.npy", "hubert, 5 windows of 2 vectors of 1024");
  expect_said(&said, "+bc.jpg", "50 x 50 pixels and will be scaled to 24 x 16");
  expect_said(&said, "+`ernerf train`", "no blinking");

  /* several things at once: all are said, the first is the error */
  unlink("judged/gt_imgs/1.jpg");
  unlink("judged/gt_imgs/3.jpg");
  unlink("judged/aud_hu.npy");
  write_landmarks("judged/ori_imgs/2.lms", 3, 2);
  check_again(context, ERN_E_MISSING, &said);
  support_expect(context, ERN_E_MISSING, ERN_E_MISSING, "no speech features", NULL);
  expect_said(&said, "-judged: no speech features", "ffmpeg");
  expect_said(&said, "-gt_imgs: 2 of 4 frames", "judged/gt_imgs/1.jpg: is missing");
  expect_said(&said, "-ori_imgs: 1 of 4 frames", "2.lms: has 3 landmarks");
  expect_said(&said, "-Not ready", "refuse");

  support_expect(context, ern_clip_check(context, "nowhere", note, &said), ERN_E_MISSING, "nowhere", NULL);
  expect_said(&said, "-nowhere", "folder");
  unlink("judged/transforms_train.json");
  check_again(context, ERN_E_MISSING, &said);
  expect_said(&said, "-judged/transforms_train.json", "tasks 8 and 9");
  ern_context_free(&context);
}

/* Clips that open but are suspicious. */
static void test_check_suspicious(void **state) {
  (void)state;
  ern_context *context = support_context();
  struct said said;
  support_clear("judged");
  write_clip(context, "judged");
  enum { MANY = 120 };
  for (int i = FRAMES; i < MANY; i++) {
    char name[64];
    snprintf(name, sizeof name, "gt_imgs/%d.jpg", i);
    write_picture(context, in_folder("judged", name), WIDTH, HEIGHT, 3, 1);
    snprintf(name, sizeof name, "torso_imgs/%d.png", i);
    write_picture(context, in_folder("judged", name), WIDTH, HEIGHT, 4, 1);
    snprintf(name, sizeof name, "ori_imgs/%d.lms", i);
    write_landmarks(in_folder("judged", name), 68, 1);
  }
  write_transforms("judged/transforms_train.json", 0, MANY, 100);
  write_blink("judged/au.csv", "AU45_r, AU46_r", MANY);
  write_features(context, "judged/aud_ds.npy", MANY * 25 / 30, 16, 29); /* a video of 30 frames a second */
  check_again(context, ERN_OK, &said);
  expect_said(&said, "oaud_ds.npy: 100 windows, but frames up to aud_id 119", "30 frames a second");
  expect_said(&said, "oaud.wav: 0.24 s, but pictures up to 4.80 s", "silent");
  write_features(context, "judged/aud_ds.npy", MANY / 3, 16, 29);
  check_again(context, ERN_OK, &said);
  expect_said(&said, "oaud_ds.npy: 40 windows, but frames up to aud_id 119", "repeat the last window");
  write_features(context, "judged/aud_ds.npy", MANY * 3, 16, 29);
  check_again(context, ERN_OK, &said);
  expect_said(&said, "oaud_ds.npy: 360 windows, but frames only up to aud_id 119", "part of the video");
  write_features(context, "judged/aud_ds.npy", MANY + 8, 16, 29); /* sound a little longer is the rule */
  check_again(context, ERN_OK, &said);
  assert_null(strstr(said.text, "windows, but frames"));

  write_blink("judged/au.csv", "frame, AU45_r", 0);
  check_again(context, ERN_E_SHAPE, &said);
  expect_said(&said, "-judged/au.csv: column AU45_r has 0 rows", "OpenFace");
  FILE *file = fopen("judged/au.csv", "w");
  assert_non_null(file);
  fprintf(file, "AU45_r\n");
  for (int i = 0; i < MANY; i++) fprintf(file, "0\n");
  fclose(file);
  write_picture(context, "judged/torso_imgs/0.png", WIDTH, HEIGHT, 3, 1);
  support_write_text("judged/aud.wav", "no sound");
  check_again(context, ERN_OK, &said);
  expect_said(&said, "oau.csv", "nobody blinks");
  expect_said(&said, "ojudged/torso_imgs/0.png", "no pixel is transparent");
  expect_said(&said, "ojudged/aud.wav", "no sound");
  expect_said(&said, "+`ernerf train`", "no blinking");
  ern_context_free(&context);
}

/* A sound of 2 s: noise, `spoken` of it much louder. */
static void write_noise(ern_context *context, const char *path, double spoken) {
  enum { RATE = 16000, SAMPLES = 2 * RATE };
  static int16_t data[SAMPLES];
  uint32_t seed = 1;
  for (int i = 0; i < SAMPLES; i++) {
    seed = seed * 1664525u + 1013904223u;
    data[i] = (int16_t)(((int)(seed >> 16) - 32768) / (i < spoken * SAMPLES ? 4 : 400));
  }
  const ern_sound sound = {.rate = RATE, .channels = 1, .frames = SAMPLES, .data = data};
  assert_int_equal(ern_sound_write_wav(context, path, &sound), ERN_OK);
}

static void write_eyes(const char *path, int shut) {
  FILE *file = fopen(path, "w");
  assert_non_null(file);
  fprintf(file, "AU45_r\n");
  for (int i = 0; i < FRAMES; i++) fprintf(file, "%d\n", i < shut ? 5 : 0);
  assert_int_equal(fclose(file), 0);
}

/* The masks of the training frames: above `rows` background, below the head. */
static void write_masks(ern_context *context, int rows) {
  static uint8_t data[HEIGHT][WIDTH][3];
  const ern_image image = {.width = WIDTH, .height = HEIGHT, .channels = 3, .data = &data[0][0][0]};
  for (int y = 0; y < HEIGHT; y++)
    for (int x = 0; x < WIDTH; x++) memcpy(data[y][x], y < rows ? "\xff\xff\xff" : "\0\0\xff", 3);
  for (int i = 0; i < FRAMES; i++) {
    char name[64];
    snprintf(name, sizeof name, "parsing/%d.png", i);
    assert_int_equal(ern_image_write(context, in_folder("judged", name), &image, 100), ERN_OK);
  }
}

/* Files that are well formed, of a clip that nothing can be learnt from: `check` says so, and opening warns. */
static void test_check_doubts(void **state) {
  (void)state;
  char lines[8192] = "";
  ern_context_config config = ern_context_config_default();
  config.log = support_keep_warnings;
  config.user = lines;
  ern_context *context = NULL;
  assert_int_equal(ern_context_create(&context, &config), ERN_OK);
  struct said said;
  ern_clip *clip = NULL;
  support_clear("judged");
  write_clip(context, "judged");
  assert_int_equal(ern_folder_make(context, "judged/parsing"), ERN_OK);
  write_masks(context, HEIGHT / 2);
  write_noise(context, "judged/aud.wav", 0.5);
  write_eyes("judged/au.csv", 3);
  check_again(context, ERN_OK, &said);
  expect_said(&said, "+au.csv", "up to 5");
  assert_null(strstr(said.text, "looked at"));
  assert_null(strstr(said.text, "is heard"));
  support_expect(context, ern_clip_open(context, "judged", NULL, &clip), ERN_OK, NULL);
  ern_clip_free(&clip);
  assert_string_equal(lines, "");

  for (int i = 1; i < FRAMES; i++) {
    char name[64];
    snprintf(name, sizeof name, "judged/ori_imgs/%d.lms", i);
    FILE *file = fopen(name, "w");
    assert_non_null(file);
    for (int k = 0; k < 68; k++) fprintf(file, i == 1 ? "%d 900\n" : "0 0\n", k % WIDTH);
    assert_int_equal(fclose(file), 0);
  }
  write_masks(context, 0);
  write_noise(context, "judged/aud.wav", 0);
  write_eyes("judged/au.csv", 1);
  check_again(context, ERN_OK, &said);
  expect_said(&said, "oau.csv", "nobody blinks");
  expect_said(&said, "oori_imgs: in 3 of 4 frames", "no face within the picture; the first is 1");
  expect_said(&said, "oparsing: in 4 of 4 frames", "no background; the first is 0");
  expect_said(&said, "oaud.wav: speech is heard in 0 %", "expected 20 %");
  support_expect(context, ern_clip_open(context, "judged", NULL, &clip), ERN_OK, NULL);
  assert_non_null(strstr(lines, "judged/ori_imgs: in 3 of 4"));
  assert_non_null(strstr(lines, "judged/parsing: in 4 of 4"));
  assert_non_null(strstr(lines, "judged/aud.wav: speech"));
  ern_clip_measures measures;
  assert_int_equal(ern_clip_measure(clip, &measures), ERN_OK);
  assert_true(measures.eye_low == 0 && measures.eye_high == 0);
  ern_clip_free(&clip);
  write_masks(context, HEIGHT);
  check_again(context, ERN_OK, &said);
  expect_said(&said, "oparsing: in 4 of 4 frames", "the mask has no head");
  ern_context_free(&context);
}

static void test_real(void **state) {
  (void)state;
  support_needs_shared();
  static const struct {
    const char *name, *features;
    int side;
    size_t train, val;
    bool blink;
  } cases[] = {{"real/presenter", "aud_eo.npy", 472, 200, 20, false}, {"parity/clip", "aud_ds.npy", 128, 60, 6, true}};
  ern_context *context = support_context();
  for (size_t i = 0; i < 2; i++) {
    char path[1024];
    ern_clip *clip = NULL;
    ern_clip_info info;
    ern_image truth, torso;
    struct said said = {.used = 0};
    support_shared(cases[i].name, path);
    support_expect(context, ern_clip_open(context, path, NULL, &clip), ERN_OK, NULL);
    ern_clip_describe(clip, &info);
    assert_int_equal(info.width, cases[i].side);
    assert_int_equal(info.height, cases[i].side);
    assert_int_equal(info.frames[0], cases[i].train);
    assert_int_equal(info.frames[1], cases[i].val);
    assert_string_equal(info.features_file, cases[i].features);
    assert_int_equal(info.has_blink, cases[i].blink);
    assert_true(info.has_torso && info.has_sound && info.has_landmarks);
    support_expect(context, ern_clip_pixels(clip, ERN_SPLIT_VAL, cases[i].val - 1, &truth, &torso), ERN_OK, NULL);
    assert_int_equal(truth.width, cases[i].side);
    assert_int_equal(torso.channels, 4);
    ern_clip_free(&clip);
    support_expect(context, ern_clip_check(context, path, note, &said), ERN_OK, NULL);
    expect_said(&said, "+`ernerf train`", "will learn the torso");
    assert_null(strstr(said.text, "windows, but frames"));
  }
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_check), cmocka_unit_test(test_check_suspicious),
                                     cmocka_unit_test(test_check_doubts), cmocka_unit_test(test_real)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
