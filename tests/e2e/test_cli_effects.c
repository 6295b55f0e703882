/* SPDX-License-Identifier: MIT
 * What clips hold: `ernerf check` measures it, on clips made to hold an effect or to lack it; `ernerf train --effects`
 * makes models of it, whose files hold just that. */
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

/* Directions on a cross: neither end of its long bar is the furthest from the first frame, in the middle. */
static void test_widest_turn(void **state) {
  (void)state;
  static const double ends[4][2] = {{0, 0}, {0, 5}, {-4.9, 0}, {4.9, 0}}; /* degrees */
  const double degree = 3.14159265358979323846 / 180;
  cli_copy("still", "cross");
  json_t *clip = json_load_file("cross/transforms_train.json", 0, NULL), *frame;
  size_t i;
  json_array_foreach(json_object_get(clip, "frames"), i, frame) {
    const double *end = ends[i < 4 ? i : 0], place[] = {tan(end[0] * degree), tan(end[1] * degree), 1};
    for (size_t row = 0; row < 3; row++)
      json_array_set_new(json_array_get(json_object_get(frame, "transform_matrix"), row), 3, json_real(place[row]));
  }
  support_clear("cross/transforms_train.json");
  assert_int_equal(json_dump_file(clip, "cross/transforms_train.json", 0), 0);
  json_decref(clip);
  cli_run(&cli, "check cross --json -");
  json_t *report = cli_json(&cli, NULL);
  assert_true(fabs(measure(report, "turn") - 9.8) < 1e-4); /* floats */
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
  cli_run(&cli, "check bust");
  cli_expect_out(&cli, 0, "there is no torso to learn", "`ernerf train --torso` cannot run on it", NULL);
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
  cli_run(&cli, "check mute");
  cli_expect_out(&cli, 1, "aud_ds.npy: is the same in every window, so the mouth would not move", "Not ready", NULL);
}

/* ---- train ------------------------------------------------------------------------------------------------------- */

#define SHORT "--levels 3 --rays 32 --iters 2 --quiet"

/* The model's effects (names between blanks) by info, and whether its tensors are those alone. */
static void expect_model(const char *path, const char *effects, json_int_t *parameters) {
  static const char *const of[][2] = {{"eye", "eye_att_net.net.0.weight"}, {"codes", "individual_codes"}};
  cli_run(&cli, "info %s --json -", path);
  json_t *info = cli_json(&cli, NULL), *list = json_object_get(info, "effects"),
         *tensors = json_object_get(info, "tensors");
  char words[128] = "";
  for (size_t i = 0; i < json_array_size(list); i++) {
    strncat(words, i > 0 ? " " : "", sizeof words - strlen(words) - 1);
    strncat(words, json_string_value(json_array_get(list, i)), sizeof words - strlen(words) - 1);
  }
  assert_string_equal(words, effects);
  const bool view = strstr(effects, "view") != NULL, codes = strstr(effects, "codes") != NULL;
  bool found[2] = {false, false};
  json_int_t inputs = 0;
  for (size_t i = 0; i < json_array_size(tensors); i++) {
    const json_t *tensor = json_array_get(tensors, i);
    const char *name = json_string_value(json_object_get(tensor, "name"));
    for (size_t k = 0; k < 2; k++) found[k] |= strcmp(name, of[k][1]) == 0;
    if (strcmp(name, "color_net.net.0.weight") == 0)
      inputs = json_integer_value(json_array_get(json_object_get(tensor, "shape"), 1));
  }
  for (size_t k = 0; k < 2; k++) assert_true(found[k] == (strstr(effects, of[k][0]) != NULL));
  assert_int_equal(inputs, (view ? 16 : 0) + 64 + (codes ? 4 : 0));
  *parameters = json_integer_value(json_object_get(info, "parameters"));
  json_decref(info);
}

static void train(const char *clip, const char *model, const char *options) {
  char run[64];
  snprintf(run, sizeof run, "%.40s.run", model);
  support_clear(run);
  cli_run(&cli, "train %s -o %s.safetensors " SHORT " %s", clip, model, options);
  cli_expect(&cli, 0, NULL);
}

/* auto is what check says of the clip; a list is what it says. */
static void test_train_long(void **state) {
  (void)state;
  enum { CODES = 4 * 20, EYE = 16 * 9 + 16 + 64, VIEW = 16 * 64 }; /* 9 features of 3 levels; 20 training frames */
  json_int_t whole, without;
  train("whole", "whole", "");
  expect_model("whole.safetensors", "audio eye view codes", &whole);
  train("open", "open", "");
  expect_model("open.safetensors", "audio view codes", &without);
  assert_int_equal(whole - without, EYE);
  train("still", "still", "");
  expect_model("still.safetensors", "audio eye", &without);
  assert_int_equal(whole - without, CODES + 4 * 64 + VIEW);
  train("whole", "bare", "--effects none");
  expect_model("bare.safetensors", "audio", &without);
  assert_int_equal(whole - without, EYE + CODES + 4 * 64 + VIEW);
  train("whole", "some", "--effects view,torso --json some.json");
  expect_model("some.safetensors", "audio view", &without);
  json_t *report = cli_json(&cli, "some.json");
  const json_t *effects = json_object_get(report, "effects");
  assert_int_equal(json_array_size(effects), 2);
  assert_string_equal(json_string_value(json_array_get(effects, 1)), "torso");
  json_decref(report);
}

/* A head of a clip whose torso pictures are transparent goes on as a head alone, also with --time. */
static void test_from_without_torso_long(void **state) {
  (void)state;
  static const char small[] = "--rays 32 --levels 2 --validate-frames 1";
  support_clear("b.safetensors"), support_clear("b.run"), support_clear("c.safetensors"), support_clear("c.run");
  cli_run(&cli, "train bust -o b.safetensors --iters 4 %s --quiet", small);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train bust -o c.safetensors --from b.safetensors --time 1s %s", small);
  cli_expect(&cli, 0, "effects eye, ", "done, c.safetensors", NULL);
  assert_null(strstr(cli.err, "torso"));
  assert_false(cli_there("c.head.safetensors"));
}

/* A model without a view is drawn, goes on, gets a torso, and is told from others. */
static void test_use_long(void **state) {
  (void)state;
  support_clear("frames");
  assert_int_equal(mkdir("frames", 0777), 0);
  train("still", "used", "");
  cli_run(&cli, "render used.safetensors --clip still --frames 0:2 -o frames/%%d.png --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render used.safetensors --clip still --frames 0:2 -o frames/r%%d.png --isa ref --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(cli_count("frames"), 6); /* two pictures and a file that tells of them, twice */
  cli_run(&cli, "train still -o used.safetensors --resume --levels 3 --rays 32 --iters 4 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli,
          "train still -o used.safetensors --resume --levels 3 --rays 32 --iters 6 --quiet --effects eye,view,torso");
  cli_expect(&cli, 1, "view dependence is 0, this training expects 1", NULL);
  support_clear("more.run");
  cli_run(&cli, "train whole -y -o more.safetensors --from used.safetensors --rays 32 --iters 3 --quiet");
  cli_expect(&cli, 0, NULL); /* --from says what the head is like */
  cli_run(&cli,
          "train whole -y -o more.safetensors --from used.safetensors --rays 32 --iters 3 --effects eye --ind-num 0");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train whole -y -o more.safetensors --from used.safetensors --rays 32 --iters 3 --effects eye,view");
  cli_expect(&cli, 1, "view dependence", NULL);
  support_clear("portrait.run");
  cli_run(&cli, "train still --torso --head used.safetensors -o portrait.safetensors --rays 32 --iters 2 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "convert used.safetensors used.pth");
  cli_expect(&cli, 1, "does not depend on the view", NULL);
  cli_run(&cli, "render open.safetensors --clip open --frames 0:1 -o frames/%%d.png --fix-eye 0.5");
  cli_expect(&cli, 1, "eye", NULL);
}

/* A torso that was trained with the body's motion, and a clip that has lost it. */
static void test_motion_is_gone(void **state) {
  (void)state;
  enum { MANY = 100 };
  static float motion[MANY][ERN_MOTION_VALUES];
  static const size_t shape[4] = {MANY, 2, ERN_MOTION_SIDE, ERN_MOTION_SIDE};
  ern_context *context = support_context();
  for (int f = 0; f < MANY; f++)
    for (int k = 0; k < ERN_MOTION_VALUES / 2; k++) motion[f][k] = 0.01f * (float)(f % 9);
  support_ok(context, ern_npy_write_f32(context, "still/torso.npy", motion[0], 4, shape));
  ern_context_free(&context);
  support_clear("moves");
  assert_int_equal(mkdir("moves", 0777), 0);
  cli_run(&cli, "train still -o moves/head.safetensors --rays 32 --iters 2 --levels 2 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli,
          "train still --torso --head moves/head.safetensors -y -o moves/p.safetensors --rays 32 --iters 2 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render moves/p.safetensors --clip still --torso model --frames 0:1 -o moves/m%%d.png --quiet");
  cli_expect(&cli, 0, NULL);
  assert_null(strstr(cli.err, "torso.npy"));
  assert_int_equal(remove("still/torso.npy"), 0);
  cli_run(&cli, "render moves/p.safetensors --clip still --frames 0:1 -o moves/n%%d.png --quiet"); /* recorded */
  cli_expect(&cli, 0, NULL);
  assert_null(strstr(cli.err, "torso.npy"));
  cli_run(&cli, "render moves/p.safetensors --clip still --torso model --frames 0:1 -o moves/o%%d.png --quiet");
  cli_expect(&cli, 0, "still: has no torso.npy", NULL);
}

static void test_refusals(void **state) {
  (void)state;
  static const struct {
    const char *line, *word;
    int status;
  } wrong[] = {
      {"train whole -o x.safetensors --effects eye,lips", "\"lips\" is none of them", 2},
      {"train whole -o x.safetensors --effects eye,eye", "eye is there twice", 2},
      {"train whole -o x.safetensors --effects eye,", "\"\" is none of them", 2},
      {"train whole -o x.safetensors --effects none,eye", "\"none\" is none of them", 2},
      {"train whole -o x.safetensors --effects eye --ind-num 40", "--effects has no codes", 2},
      {"train whole --torso --head whole.safetensors -o x.safetensors --effects eye", "--torso", 2},
      {"render whole.safetensors --clip whole -o x.mp4 --max-steps 5000", "number from 0 to 1024; 0: as in training",
       2},
      {"train open -o x.safetensors --effects eye", "no au.csv", 1},
      {"train open -o x.safetensors --set eye-attention=concat", "there is no au.csv", 1},
      {"train open -o x.safetensors --set eye-attention=concat --effects codes", "there is no au.csv", 1},
      {"train whole -o x.safetensors --set eye-attention=concat --effects codes", "--effects has no eye", 1},
      {"train mute -o x.safetensors", "the mouth would not move", 1},
      {"train bust --torso --head whole.safetensors -o x.safetensors --force", "transparent everywhere", 1},
  };
  if (!cli_there("whole.safetensors")) train("whole", "whole", "");
  for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
    cli_run(&cli, "%s", wrong[i].line);
    cli_expect(&cli, wrong[i].status, wrong[i].word, NULL);
    assert_false(cli_there("x.safetensors") || cli_there("x.run"));
  }
  train("mute", "mute", "--effects none"); /* asked for in words */
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_whole),         cmocka_unit_test(test_blink),
      cmocka_unit_test(test_camera),        cmocka_unit_test(test_widest_turn),
      cmocka_unit_test(test_torso),         cmocka_unit_test(test_speech),
      cmocka_unit_test(test_train_long),    cmocka_unit_test(test_from_without_torso_long),
      cmocka_unit_test(test_use_long),      cmocka_unit_test(test_refusals),
      cmocka_unit_test(test_motion_is_gone)};
  return cmocka_run_group_tests(tests, make_clips, NULL);
}
