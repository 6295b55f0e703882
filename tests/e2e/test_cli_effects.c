/* SPDX-License-Identifier: MIT
 * What clips hold: `ernerf check` measures it, on clips made to hold an effect or to lack it. */
#include "cli.h"

#include <math.h>

#include "ernerf/media.h"
#include "io/npy.h"

static struct cli cli;

enum { FRAMES = 22, SIZE = 64 };

static int make_clips(void **state) {
  (void)state;
  static const struct {
    const char *name, *options;
  } clips[] = {{"whole", ""}, {"open", "--no-blink"}, {"bust", "--no-torso"}, {"still", "--static-camera"}};
  for (size_t i = 0; i < sizeof clips / sizeof clips[0]; i++) {
    support_clear(clips[i].name);
    cli_run(&cli, "synth %s --size %d --frames %d --seed 3 --quiet %s", clips[i].name, SIZE, FRAMES, clips[i].options);
    cli_expect(&cli, 0, NULL);
  }
  return 0;
}

/* The report of check, with the effects that the clip is said to hold and to lack (names between blanks). */
static json_t *check(const char *clip, const char *holds, const char *lacks) {
  cli_run(&cli, "check %s --json -", clip);
  json_t *report = cli_json(&cli, NULL);
  const char *name;
  json_t *effect;
  size_t named = 0;
  if (!json_is_true(json_object_get(report, "ok"))) fail_msg("%s: not ready", clip);
  json_object_foreach(json_object_get(report, "effects"), name, effect) {
    const bool there = json_is_true(json_object_get(effect, "there"));
    if (strstr(there ? holds : lacks, name) == NULL)
      fail_msg("%s: %s is %s: %s", clip, name, there ? "there" : "not there",
               json_string_value(json_object_get(effect, "sentence")));
    named++;
  }
  assert_int_equal(named, 6); /* audio, camera, and the four of --effects */
  return report;
}

static double measure(const json_t *report, const char *name) {
  const json_t *value = json_object_get(json_object_get(report, "measures"), name);
  if (!json_is_number(value)) fail_msg("no measure %s", name);
  return json_number_value(value);
}

static const char *sentence(const json_t *report, const char *effect) {
  return json_string_value(json_object_get(json_object_get(json_object_get(report, "effects"), effect), "sentence"));
}

static void test_whole(void **state) {
  (void)state;
  json_t *report = check("whole", "audio camera eye codes view torso", "");
  assert_true(measure(report, "eye_high") - measure(report, "eye_low") > 0.4); /* a made blink shuts the lids */
  assert_true(measure(report, "frames") == 20 && measure(report, "looked") == 20);
  assert_true(measure(report, "turn") > 2 && measure(report, "turn") < 60);
  assert_true(measure(report, "torso_cover") > 0.05 && measure(report, "torso_cover") < 0.6);
  json_decref(report);
  cli_run(&cli, "check whole");
  cli_expect_out(&cli, 0, "holds    eye", "holds    view", "degrees apart", "covers", NULL);
}

static void test_blink(void **state) {
  (void)state;
  json_decref(check("open", "audio camera codes view torso", "eye"));
  cli_copy("whole", "constant"); /* an au.csv is there, but nothing moves in it */
  char rows[4096] = "frame, AU45_r\n";
  for (size_t i = 0, at = strlen(rows); i < FRAMES; i++)
    at += (size_t)snprintf(rows + at, sizeof rows - at, "%zu, %.2f\n", i + 1, 0.60 + 0.01 * (double)(i % 3));
  cli_replace("constant/au.csv", rows, strlen(rows));
  json_t *report = check("constant", "audio camera codes view torso", "eye");
  assert_non_null(strstr(sentence(report, "eye"), "0.30 to 0.31"));
  json_decref(report);
  cli_run(&cli, "check constant");
  cli_expect_out(&cli, 0, "missing  au.csv: AU45_r stays from 0.6 to 0.62", "no blinking", "lacks    eye", NULL);
}

static void test_camera(void **state) {
  (void)state;
  json_t *report = check("still", "audio eye torso", "camera view codes");
  assert_true(measure(report, "turn") == 0 && measure(report, "camera_turn") == 0 &&
              measure(report, "camera_shift") == 0);
  assert_non_null(strstr(sentence(report, "torso"), "stands still"));
  json_decref(report);
}

/* A torso layer that is a disc where the head is seen, in each frame. */
static void glue_torso(const char *clip) {
  ern_context *context = support_context();
  static uint8_t pixels[SIZE * SIZE * 4];
  const char *const lists[] = {"transforms_train.json", "transforms_val.json"};
  for (size_t l = 0; l < 2; l++) {
    char path[256];
    ern_pose_list list = {0};
    snprintf(path, sizeof path, "%s/%s", clip, lists[l]);
    support_ok(context, ern_pose_list_load(context, path, &list));
    for (size_t f = 0; f < list.count; f++) {
      const float *pose = list.poses[f].matrix;
      double seen[3] = {0};
      for (size_t i = 0; i < 3; i++)
        for (size_t k = 0; k < 3; k++) seen[i] -= (double)pose[4 * k + i] * (double)pose[4 * k + 3];
      const double x = list.cx - list.focal * seen[0] / seen[2], y = list.cy + list.focal * seen[1] / seen[2];
      for (size_t i = 0; i < SIZE * SIZE; i++) /* an edge one pixel wide, so that the centre follows closely */
        pixels[4 * i + 3] =
            (uint8_t)(255 * fmin(1, fmax(0, 12.5 - hypot((double)(i % SIZE) - x, (double)(i / SIZE) - y))));
      const ern_image image = {.width = SIZE, .height = SIZE, .channels = 4, .data = pixels};
      snprintf(path, sizeof path, "%s/torso_imgs/%d.png", clip, (int)list.poses[f].img_id);
      remove(path);
      support_ok(context, ern_image_write(context, path, &image, 100));
    }
    ern_pose_list_free(context, &list);
  }
  ern_context_free(&context);
}

static void test_torso(void **state) {
  (void)state;
  json_t *report = check("bust", "audio camera eye codes view", "torso");
  assert_true(measure(report, "torso_cover") == 0);
  json_decref(report);
  cli_copy("whole", "glued");
  glue_torso("glued");
  report = check("glued", "audio camera eye codes view torso", "");
  assert_non_null(strstr(sentence(report, "torso"), "moves as the head does"));
  /* bytes of alpha and pixels of a disc place its centre to well below a tenth of a pixel */
  assert_true(measure(report, "torso_move") > 0.5 && measure(report, "torso_against") < 0.1);
  json_decref(report);
}

static void test_speech(void **state) {
  (void)state;
  static float windows[FRAMES * 16 * 29];
  for (size_t i = 0; i < sizeof windows / sizeof windows[0]; i++) windows[i] = 0.25f * (float)(i % (16 * 29) % 7);
  ern_context *context = support_context();
  cli_copy("whole", "mute");
  remove("mute/aud_ds.npy");
  support_ok(context, ern_npy_write_f32(context, "mute/aud_ds.npy", windows, 3, (const size_t[]){FRAMES, 16, 29}));
  ern_context_free(&context);
  json_t *report = check("mute", "camera eye codes view torso", "audio");
  assert_true(measure(report, "feature_change") < 1e-6); /* sums of equal numbers, in double */
  json_decref(report);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_whole), cmocka_unit_test(test_blink),
                                     cmocka_unit_test(test_camera), cmocka_unit_test(test_torso),
                                     cmocka_unit_test(test_speech)};
  return cmocka_run_group_tests(tests, make_clips, NULL);
}
