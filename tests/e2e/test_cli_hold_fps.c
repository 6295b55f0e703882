/* SPDX-License-Identifier: MIT
 * A budget in place of settings: `ernerf render --hold-fps`, `--quality`, with a stored front and with a
 * quick look; the curve that a training leaves; and `ernerf tradeoff --training`. How fast anything is is not checked.
 */
#include "../made_lpips.h"
#include "cli.h"

#include <math.h>

#include "core/cpu.h"

static struct cli cli;
static const char clip[] = "small";

static int make_model(void **state) {
  (void)state;
  static const char *const old[] = {"m.safetensors", "m.run", "m.tradeoff", "study", "a", "b",
                                    "fine",          "small", "bare",       "x.mp4"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  cli_run(&cli, "synth small --size 64 --frames 24 --seed 5 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli,
          "train '%s' -o m.safetensors --iters 60 --rays 256 --levels 6 --lr-net 0.004 --validate-every 20 "
          "--validate-frames 1 --quiet",
          clip);
  cli_expect(&cli, 0, NULL);
  return 0;
}

static double number(const json_t *object, const char *name) {
  const json_t *member = json_object_get(object, name);
  if (!json_is_number(member)) fail_msg("%s is missing or no number", name);
  return json_number_value(member);
}

/* ---- the curve --------------------------------------------------------------------------------------------------- */

static size_t count_of(const char *text, const char *word) {
  size_t count = 0;
  for (const char *at = strstr(text, word); at != NULL; at = strstr(at + 1, word)) count++;
  return count;
}

static void test_curve_long(void **state) {
  (void)state;
  static const char *const plots[] = {"m.run/curve_seconds.svg", "m.run/curve_steps.svg"};
  static const char *const pictures[] = {"m.run/curve_seconds.png", "m.run/curve_steps.png"};
  static char text[CLI_TEXT_BYTES];
  cli_read("m.run/curve.csv", text);
  assert_int_equal(count_of(text, "\n"), 4); /* a head, and a point every 20 of 60 steps */
  for (int i = 0; i < 2; i++) {
    size_t bytes = 0;
    cli_read(plots[i], text);
    assert_non_null(strstr(text, "<svg"));
    assert_non_null(strstr(text, "</svg>"));
    unsigned char *png = (unsigned char *)cli_bytes(pictures[i], &bytes);
    assert_true(bytes > 2000 && memcmp(png, "\x89PNG", 4) == 0);
    free(png);
  }
  /* goes on where it was */
  cli_run(&cli,
          "train '%s' -o m.safetensors --iters 80 --rays 256 --levels 6 --lr-net 0.004 --validate-every 20 "
          "--validate-frames 1 --resume --quiet",
          clip);
  cli_expect(&cli, 0, NULL);
  cli_read("m.run/curve.csv", text);
  assert_int_equal(count_of(text, "\n"), 5);
  /* what was damaged is told of and stops nothing */
  FILE *file = fopen("m.run/curve.csv", "w");
  assert_non_null(file);
  fputs("step,seconds,psnr\n20,what\n", file);
  fclose(file);
  cli_run(&cli,
          "train '%s' -o m.safetensors --iters 84 --rays 256 --levels 6 --lr-net 0.004 --validate-frames 1 "
          "--resume",
          clip);
  cli_expect(&cli, 0, "curve.csv: line 2 is \"20,what\", expected three numbers", NULL);
}

/* ---- budgets ----------------------------------------------------------------------------------------------------- */

/* Frames add up, settings go from the most accurate to the fastest. */
static void check_pace(const json_t *pace, size_t frames) {
  const json_t *settings = json_object_get(pace, "settings");
  size_t drawn = 0;
  assert_true(json_array_size(settings) >= 1);
  for (size_t i = 0; i < json_array_size(settings); i++) {
    const json_t *one = json_array_get(settings, i), *before = i > 0 ? json_array_get(settings, i - 1) : NULL;
    drawn += (size_t)number(one, "frames");
    assert_true(number(one, "ms") > 0);
    if (before == NULL) continue;
    assert_true(number(one, "ms") < number(before, "ms"));
    assert_true(number(one, "psnr_db") <= number(before, "psnr_db"));
  }
  assert_int_equal(drawn, frames);
}

/* A rate that everything holds: the most accurate settings, which are those of a render without a stop. */
static void test_quick_look(void **state) {
  (void)state;
  size_t bytes[2];
  cli_run(&cli, "render m.safetensors --clip '%s' --frames 0:3 --hold-fps 0.1 -o a/%%d.png -y --json pace.json", clip);
  cli_expect(&cli, 1, "a/%d.png: its folder is not there", NULL);
  assert_int_equal(mkdir("a", 0777) + mkdir("b", 0777), 0);
  cli_run(&cli, "render m.safetensors --clip '%s' --frames 0:3 --hold-fps 0.1 -o a/%%d.png -y --json pace.json", clip);
  cli_expect(&cli, 0, "measures the cost of the settings briefly", "speed 100.0%  80/80", "render: settings",
             "100.0 dB against the most accurate", NULL);
  json_t *object = cli_json(&cli, "pace.json");
  const json_t *pace = json_object_get(object, "rate_control");
  check_pace(pace, 3);
  assert_true(number(pace, "budget_ms") == 1000 / (double)0.1f);
  assert_string_equal(json_string_value(json_object_get(pace, "front")), "");
  json_decref(object);
  cli_run(&cli, "render m.safetensors --clip '%s' --frames 0:3 --set transmittance-stop=1e-4 -o b/%%d.png --quiet",
          clip);
  cli_expect(&cli, 0, NULL);
  char *first = (char *)cli_bytes("a/2.png", &bytes[0]), *second = (char *)cli_bytes("b/2.png", &bytes[1]);
  assert_int_equal(bytes[0], bytes[1]);
  assert_memory_equal(first, second, bytes[0]);
  free(first);
  free(second);
}

static void test_out_of_reach_long(void **state) {
  (void)state;
  cli_run(&cli, "render m.safetensors --clip '%s' --frames 0:3 --hold-fps 10000 -y -o x.mp4", clip);
  cli_expect(&cli, 1, "--hold-fps 10000: no settings reach it on this machine: the fastest", "frames a second", NULL);
  assert_int_not_equal(access("x.mp4", F_OK), 0);
}

/* With a front of its own: in the folder that is looked for, by name, and where it does not fit. */
static void test_front_long(void **state) {
  (void)state;
  cli_run(&cli, "tradeoff m.safetensors '%s' -o m.tradeoff --seconds 1 --frames 0:2 --quiet", clip);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render m.safetensors --clip '%s' --frames 0:4 --hold-fps 0.0167 -y -o x.mp4 --json pace.json", clip);
  cli_expect(&cli, 0, "m.tradeoff/tradeoff.json", "dB against the exact render", "against the clip's frames", NULL);
  json_t *object = cli_json(&cli, "pace.json");
  check_pace(json_object_get(object, "rate_control"), 4);
  json_decref(object);
  static const char *const qualities[] = {"exact", "balanced", "draft"};
  double db[3];
  for (int q = 0; q < 3; q++) {
    cli_run(&cli, "render m.safetensors --clip '%s' --frames 0:2 --quality %s -y -o x.mp4 --json pace.json --quiet",
            clip, qualities[q]);
    cli_expect(&cli, 0, NULL);
    object = cli_json(&cli, "pace.json");
    const json_t *settings = json_object_get(json_object_get(object, "rate_control"), "settings");
    assert_int_equal(json_array_size(settings), 1);
    assert_true(json_is_null(json_object_get(json_object_get(object, "rate_control"), "budget_ms")));
    db[q] = number(json_array_get(settings, 0), "psnr_db");
    json_decref(object);
  }
  assert_true(db[0] >= db[1] && db[1] >= db[2]);
  cli_run(&cli, "render m.safetensors --clip '%s' --frames 0:2 --size 80x80 --hold-fps 1 -y -o x.mp4", clip);
  cli_expect(&cli, 0, "is not used: it was measured at 64 x 64, the output is 80 x 80",
             "measures the cost of the settings briefly", NULL);
  cli_run(&cli,
          "render m.safetensors --clip '%s' --size 80x80 --hold-fps 1 --set front=m.tradeoff/tradeoff.json -y -o x.mp4",
          clip);
  cli_expect(&cli, 1, "m.tradeoff/tradeoff.json: it was measured at 64 x 64", NULL);
  cli_run(&cli,
          "render m.safetensors --clip '%s' --hold-fps 1 --set front=m.tradeoff/tradeoff.json --json "
          "m.tradeoff/tradeoff.json "
          "-y -o x.mp4",
          clip);
  cli_expect(&cli, 1, "m.tradeoff/tradeoff.json: is an input", NULL);
  cli_run(&cli, "render m.safetensors --clip '%s' --hold-fps 1 --set front=m.run/log.jsonl -y -o x.mp4", clip);
  cli_expect(&cli, 1, "m.run/log.jsonl", NULL);
}

static void test_words(void **state) {
  (void)state;
  static const struct {
    const char *options, *said;
  } cases[] = {{"--hold-fps 25 --quality draft", "expected one of them"},
               {"--quality good", "exact"},
               {"--hold-fps 0", "--hold-fps"},
               {"--hold-fps nan", "--hold-fps"},
               {"--hold-fps 25 --max-steps 8", "max-steps"},
               {"--hold-fps 25 --set image-scale=0.5", "image-scale"},
               {"--hold-fps 25 --smooth-lips", "smooth-lips"},
               {"--set front=x.json", "--set front needs"},
               {"--hold-fps 25 --set front=x.json --isa ref", "isa"}};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    cli_run(&cli, "render m.safetensors --clip '%s' -y -o x.mp4 %s", clip, cases[i].options);
    cli_expect(&cli, 2, cases[i].said, NULL);
  }
  cli_run(&cli, "tradeoff --training '%s'", clip);
  cli_expect(&cli, 2, "-o DIR is missing", NULL);
  cli_run(&cli, "tradeoff --training nowhere -o y");
  cli_expect(&cli, 1, "nowhere", NULL);
}

/* ---- trainings --------------------------------------------------------------------------------------------------- */

static const json_t *training_of(const json_t *trainings, const char *name) {
  for (size_t i = 0; i < json_array_size(trainings); i++) {
    const json_t *one = json_array_get(trainings, i);
    if (strcmp(json_string_value(json_object_get(one, "name")), name) == 0) return one;
  }
  return NULL;
}

/* name NULL: the base. */
static void expect_kind(const json_t *trainings, const char *name, double rays, const char *sampling,
                        double refresh_every, const char *precision) {
  const json_t *one = name != NULL ? training_of(trainings, name) : json_array_get(trainings, 0);
  if (one == NULL) fail_msg("no training is %s", name != NULL ? name : "the base");
  assert_string_equal(json_string_value(json_object_get(one, "ray_sampling")), sampling);
  assert_string_equal(json_string_value(json_object_get(one, "precision")), precision);
  assert_true(number(one, "refresh_every") == refresh_every && number(one, "rays") == rays &&
              number(one, "levels") == 5);
}

/* Of trainings of `rays` rays, from a clip with or without landmarks. */
static void expect_kinds(const json_t *trainings, double rays, bool landmarks) {
  const char *sampling = landmarks ? "regions" : "uniform";
  expect_kind(trainings, NULL, rays, sampling, 0, "fp32");
  expect_kind(trainings, "as published", rays, "uniform", 16, "fp32");
  const json_t *timed = training_of(trainings, "as train --time, 512 rays");
  assert_non_null(timed);
  assert_true(number(timed, "rays") == 512);
  if (landmarks) expect_kind(trainings, "uniform rays", rays, "uniform", 0, "fp32");
  assert_true(landmarks || training_of(trainings, "uniform rays") == NULL); /* the base is one */
  if (ern_isa_available(ERN_ISA_AVX512BF16)) expect_kind(trainings, "bf16", rays, sampling, 0, "bf16");
  assert_true(ern_isa_available(ERN_ISA_AVX512BF16) || training_of(trainings, "bf16") == NULL);
}

static void test_training_long(void **state) {
  (void)state;
  static char text[CLI_TEXT_BYTES];
  cli_run(&cli, "tradeoff --training '%s' -o study --seconds 0.1 --seeds 1 --rays 64 --levels 5 --json --quiet", clip);
  cli_expect(&cli, 0, NULL);
  json_t *object = cli_json(&cli, NULL);
  const json_t *trainings = json_object_get(object, "trainings");
  bool any = false;                             /* figures of the mouth that training changes */
  assert_true(json_array_size(trainings) >= 6); /* base, three of rays, two of levels; instruction sets */
  for (size_t i = 0; i < json_array_size(trainings); i++) {
    const json_t *one = json_array_get(trainings, i), *curve = json_array_get(json_object_get(one, "seeds"), 0);
    double last = 0, explained = NAN;
    assert_true(number(one, "psnr_db_mean") > 3 && number(one, "steps") >= 1);
    assert_true(json_array_size(curve) >= 5);
    assert_true(number(one, "mouth_explained_mean") <= 1);
    assert_true(json_is_null(json_object_get(one, "mouth_explained_deviation"))); /* of one seed */
    for (size_t k = 0; k < json_array_size(curve); k++) {
      const double seconds = number(json_array_get(curve, k), "seconds");
      assert_true(seconds > last);
      last = seconds;
      explained = number(json_array_get(curve, k), "mouth_explained");
    }
    assert_true(number(one, "mouth_explained_mean") == explained);
    any |= explained != number(json_array_get(curve, 0), "mouth_explained");
  }
  assert_true(any);
  expect_kinds(trainings, 64, true);
  assert_true(json_is_null(json_object_get(object, "fine_stage")));
  json_decref(object);
  cli_read("study/training.md", text);
  assert_non_null(strstr(text, "Not measured: a patch is 32 x 32 pixels, so it needs pictures of that size and 1024"));
  assert_non_null(strstr(text, "| 16 rays |"));
  assert_non_null(strstr(text, "| 9 levels |"));
  assert_non_null(strstr(text, "| mouth's motion explained at the end |"));
  cli_read("study/training.csv", text);
  assert_non_null(strstr(text,
                         "training,rays,levels,ray_sampling,refresh_every,precision,backend,isa,seed,step,seconds,"
                         "psnr_db,mouth_explained\n"));
  assert_non_null(strstr(text, "as published,64,5,uniform,16,fp32,cpu,"));
  assert_null(strstr(text, ",\n")); /* the mouth's motion is known everywhere */
  cli_read("study/training_mouth_seconds.svg", text);
  assert_non_null(strstr(text, "</svg>"));
  assert_true(cli_there("study/training_mouth_seconds.png"));
  cli_read("study/training_seconds.svg", text);
  assert_non_null(strstr(text, "</svg>"));
}

static void expect_quartiles(const json_t *of) {
  assert_true(number(of, "quartile_1") > 0 && number(of, "median") >= number(of, "quartile_1"));
  assert_true(number(of, "quartile_3") >= number(of, "median"));
}

/* A row for each kind of step; the coarse one is the unit. Without landmarks the mouth is not measured. */
static void test_fine_stage_without_landmarks_long(void **state) {
  (void)state;
  static char text[CLI_TEXT_BYTES];
  static const char *const losses[] = {"coarse", "ssim", "lpips-alexnet"};
  const size_t count = ERN_PERCEPTUAL ? 3 : 2;
  if (ERN_PERCEPTUAL) made_lpips("a.safetensors", "h.safetensors", 0);
  cli_copy(clip, "bare");
  support_clear("bare/ori_imgs");
  cli_run(&cli, "tradeoff --training bare -o fine --seconds 0.1 --seeds 1 --rays 1024 --levels 5 --json --quiet %s",
          ERN_PERCEPTUAL ? "--lpips-network a.safetensors --lpips-heads h.safetensors" : "");
  cli_expect(&cli, 0, NULL);
  json_t *object = cli_json(&cli, NULL);
  const json_t *fine = json_object_get(object, "fine_stage"), *steps = json_object_get(fine, "steps");
  assert_int_equal(json_array_size(steps), count);
  assert_true(number(fine, "turns") >= 8 && number(fine, "rays") == 1024 && number(fine, "patch_size") == 32);
  for (size_t i = 0; i < count; i++) {
    const json_t *row = json_array_get(steps, i), *times = json_object_get(row, "times_coarse");
    assert_string_equal(json_string_value(json_object_get(row, "loss")), losses[i]);
    expect_quartiles(json_object_get(row, "ms"));
    expect_quartiles(times);
    assert_true(i > 0 || (number(times, "quartile_1") == 1 && number(times, "quartile_3") == 1));
  }
  const json_t *trainings = json_object_get(object, "trainings");
  expect_kinds(trainings, 1024, false);
  for (size_t i = 0; i < json_array_size(trainings); i++)
    assert_true(json_is_null(json_object_get(json_array_get(trainings, i), "mouth_explained_mean")));
  json_decref(object);
  assert_true(cli_there("fine/training_mouth_seconds.svg"));
  cli_read("fine/training.md", text);
  assert_null(strstr(text, "nan"));
  assert_non_null(strstr(text, "| coarse |"));
  assert_non_null(strstr(text, "| fine, ssim |"));
  assert_true((strstr(text, "| fine, lpips-alexnet |") != NULL) == ERN_PERCEPTUAL);
  assert_true((strstr(text, "LPIPS: not measured: needs --lpips-network") == NULL) == ERN_PERCEPTUAL);
  cli_run(&cli, "tradeoff --training '%s' -o none --lpips-network a.safetensors", clip);
  cli_expect(&cli, 2, "--lpips-heads", NULL);
  cli_run(&cli, "tradeoff --training '%s' -o none --rays 64 --lpips-network a --lpips-heads h", clip);
  cli_expect(&cli, 2, "--rays is 64, expected 1024", NULL);
  cli_run(&cli, "tradeoff --training '%s' -o none --lpips-network absent.pth --lpips-heads h", clip);
  cli_expect(&cli, 1, ERN_PERCEPTUAL ? "absent.pth" : "libernerf-perceptual", NULL);
  assert_false(cli_there("none"));
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_curve_long),
                                     cmocka_unit_test(test_quick_look),
                                     cmocka_unit_test(test_out_of_reach_long),
                                     cmocka_unit_test(test_front_long),
                                     cmocka_unit_test(test_words),
                                     cmocka_unit_test(test_training_long),
                                     cmocka_unit_test(test_fine_stage_without_landmarks_long)};
  return cmocka_run_group_tests(tests, make_model, NULL);
}
