/* SPDX-License-Identifier: MIT
 * eval --refine-poses finds poses that were wrong by a known turn, and reports both figures apart; corrections of one
 * clip's frames are not applied to another's. */
#include "cli.h"

#include <math.h>

static struct cli cli;

enum { TURN = 3 /* degrees */ };

/* Every pose of the file turned about the world's first axis: the camera goes around the head. */
static void turn_poses(const char *path) {
  json_error_t error;
  json_t *file = json_load_file(path, 0, &error), *frame;
  assert_non_null(file);
  const double angle = TURN * 3.14159265358979323846 / 180, c = cos(angle), s = sin(angle);
  size_t index;
  json_array_foreach(json_object_get(file, "frames"), index, frame) {
    json_t *matrix = json_object_get(frame, "transform_matrix");
    json_t *second = json_array_get(matrix, 1), *third = json_array_get(matrix, 2);
    for (size_t k = 0; k < 4; k++) {
      const double y = json_number_value(json_array_get(second, k)), z = json_number_value(json_array_get(third, k));
      json_array_set_new(second, k, json_real(c * y - s * z));
      json_array_set_new(third, k, json_real(s * y + c * z));
    }
  }
  char *text = json_dumps(file, 0);
  assert_non_null(text);
  cli_replace(path, text, strlen(text));
  free(text);
  json_decref(file);
}

static int copy_clips(void **state) {
  (void)state;
  static const char *const old[] = {"clip", "turned", "other", "more", "m.safetensors", "m.run", "both.json"};
  for (size_t i = 0; i < sizeof old / sizeof old[0]; i++) support_clear(old[i]);
  cli_shared_clip("short", "clip");
  cli_copy("clip", "turned");
  turn_poses("turned/transforms_val.json");
  return 0;
}

static double number(const json_t *object, const char *name) {
  const json_t *value = json_object_get(object, name);
  if (!json_is_number(value)) fail_msg("ernerf %s: %s is no number", cli.line, name);
  return json_number_value(value);
}

static void test_known_turn_long(void **state) {
  (void)state;
  cli_run(&cli,
          "train clip -o m.safetensors --iters 1000 --rays 512 --levels 6 --validate-every 0 "
          "--validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "eval m.safetensors clip --frames 0:2 --json - --quiet");
  cli_expect(&cli, 0, NULL);
  json_t *exact = cli_json(&cli, NULL);
  assert_null(json_object_get(exact, "refined"));
  cli_run(&cli, "eval m.safetensors turned --force --refine-poses --frames 0:2 --json both.json");
  cli_expect_out(&cli, 0, "refined: each frame at the pose that the model draws it best at", NULL);
  json_t *turned = cli_json(&cli, "both.json"), *refined = json_object_get(turned, "refined"), *frame;
  const double best = number(exact, "psnr"), wrong = number(turned, "psnr"), found = number(refined, "psnr");
  assert_true(wrong < best - 1);
  assert_true(found > best - 0.2);
  assert_true(number(refined, "psnr_head") > number(turned, "psnr_head") + 1);
  /* a head of 1,000 steps is drawn best 0.3 degrees from exact poses */
  assert_true(fabs(number(refined, "turned_degrees") - TURN) < 0.7);
  size_t index;
  json_array_foreach(json_object_get(turned, "frames"), index, frame)
      assert_true(number(json_object_get(frame, "refined"), "psnr") > number(frame, "psnr"));
  json_decref(exact);
  json_decref(turned);
}

/* The figures of the frames' own poses are those of an eval without it: both.json is of test_known_turn_long. */
static void test_own_figures_stay_long(void **state) {
  (void)state;
  cli_run(&cli, "eval m.safetensors turned --force --frames 0:2 --json plain.json -y --quiet");
  cli_expect(&cli, 0, NULL);
  json_t *plain = cli_json(&cli, "plain.json");
  json_t *both = cli_json(&cli, "both.json");
  static const char *const figures[] = {"psnr", "ssim", "psnr_head", "psnr_mouth", "samples_per_frame"};
  for (size_t i = 0; i < sizeof figures / sizeof *figures; i++)
    assert_true(number(plain, figures[i]) == number(both, figures[i]));
  assert_true(json_equal(json_object_get(plain, "measures"), json_object_get(both, "measures")));
  json_decref(plain);
  json_decref(both);
  cli_run(&cli, "eval m.safetensors clip --refine-poses --smooth-lips");
  cli_expect(&cli, 2, "--smooth-lips", NULL);
}

/* A clip of the same frames is another one as soon as a byte of its poses' file differs. */
static void test_of_another_clip(void **state) {
  (void)state;
  static const char *const old[] = {"r.safetensors", "r.run", "s.safetensors", "s.run", "own_3.png", "others_3.png"};
  for (size_t i = 0; i < sizeof old / sizeof old[0]; i++) support_clear(old[i]);
  size_t count = 0;
  uint8_t *poses = cli_bytes("clip/transforms_train.json", &count);
  poses[count] = '\n';
  cli_copy("clip", "other");
  cli_replace("other/transforms_train.json", poses, count + 1);
  free(poses);
  cli_run(&cli,
          "train clip -o r.safetensors --set refine-poses=yes --iters 20 --rays 128 --levels 2 --validate-frames 1 "
          "--quiet");
  cli_expect(&cli, 0, NULL);

  cli_run(&cli, "render r.safetensors --clip clip --split train --frames 3:4 -o own_%%d.png --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render r.safetensors --clip other --force --split train --frames 3:4 -o others_%%d.png");
  cli_expect(&cli, 0, NULL);
  size_t first = 0, second = 0;
  uint8_t *own = cli_bytes("own_3.png", &first), *others = cli_bytes("others_3.png", &second);
  assert_true(first != second || memcmp(own, others, first) != 0);
  free(own);
  free(others);
  cli_expect(&cli, 0, "its pose corrections are of that clip's frames, and are left out", NULL);

  /* moments too: a state of another clip may be of another number of frames */
  cli_shared_clip("long", "more");
  cli_run(&cli,
          "train more -o s.safetensors --from r.run/state.safetensors --set refine-poses=yes --iters 21 --rays 128 "
          "--validate-frames 1");
  cli_expect(&cli, 0, "its pose corrections are of the frames of another clip, and are left out", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_known_turn_long),
                                     cmocka_unit_test(test_own_figures_stay_long),
                                     cmocka_unit_test(test_of_another_clip)};
  return cmocka_run_group_tests(tests, copy_clips, NULL);
}
