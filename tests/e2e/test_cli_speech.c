/* SPDX-License-Identifier: MIT
 * From a sound to a mouth: `features`, and a sound wherever features are taken; what `eval` says of the mouth. */
#include "cli.h"

#include <math.h>

#include "ernerf/media.h"

static struct cli cli;

/* A clip without a file of features, and a head that is trained on its sound. */
static int make(void **state) {
  (void)state;
  cli_shared_clip("short", "clip");
  assert_int_equal(rename("clip/aud_ds.npy", "ds.npy"), 0);
  cli_run(&cli, "train clip -o m.safetensors --iters 30 --rays 512 --levels 4");
  cli_expect(&cli, 0, "articulatory-1", NULL);
  return 0;
}

static void test_features(void **state) {
  (void)state;
  cli_run(&cli, "features clip/aud.wav -o made.npy --json made.json");
  cli_expect(&cli, 0, "made.npy: articulatory-1, 33 windows of 16 rows of 45 values", NULL);
  json_t *report = cli_json(&cli, "made.json");
  assert_int_equal(json_integer_value(json_object_get(report, "windows")), 33);
  json_decref(report);
  cli_run(&cli, "features clip/aud.wav --kind cepstra -o cepstra.npy");
  cli_expect(&cli, 0, "cepstra.npy: cepstra-1, 33 windows of 16 rows of 13 values", NULL);
  cli_run(&cli, "features clip/aud.wav -o made.npy");
  cli_expect(&cli, 1, "made.npy", "--overwrite", NULL);
  cli_run(&cli, "features clip/aud.wav -o clip/aud.wav -y");
  cli_expect(&cli, 2, "clip/aud.wav", "expected a name that ends in .npy", NULL);
  cli_run(&cli, "features clip/aud.wav");
  cli_expect(&cli, 2, "-o FILE.npy is missing", NULL);
  support_write_text("text.wav", "no sound");
  cli_run(&cli, "features text.wav -o text.npy");
  cli_expect(&cli, 1, "text.wav", NULL);
  assert_false(cli_there("text.npy"));
  support_write_text("nothing.wav", "");
  cli_run(&cli, "features nothing.wav -o text.npy");
  cli_expect(&cli, 1, "nothing.wav: is empty", NULL);
  /* a training on the file is that on the sound, without augmentation */
  cli_run(&cli,
          "train clip --speech-augment off -o a.safetensors --iters 4 --rays 64 "
          "--levels 2 --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(rename("made.npy", "aud_art.npy"), 0);
  cli_run(&cli,
          "train clip --audio aud_art.npy -o b.safetensors --iters 4 --rays 64 --levels 2 --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(system("cmp a.safetensors b.safetensors"), 0);
  /* what it heard is kept as a hash alone */
  cli_run(&cli, "train clip -o a.safetensors --resume --iters 6 --quiet");
  cli_expect(&cli, 1, "a.run/state.safetensors", "the SHA-256", "--speech-augment", NULL);
}

/* A sound of 10 frames and a third is no sound that is missing, as its last frame outlasts it. */
static void test_last_frame_outlasts_the_sound(void **state) {
  (void)state;
  int16_t samples[6592];
  ern_context *context = support_context();
  for (int i = 0; i < 6592; i++) samples[i] = (int16_t)(1000 * (i % 7));
  const ern_sound sound = {.data = samples, .frames = 6592, .channels = 1, .rate = 16000};
  support_ok(context, ern_sound_write_wav(context, "third.wav", &sound));
  cli_run(&cli, "render m.safetensors --clip clip --audio third.wav -o third.mp4");
  cli_expect(&cli, 0, "with sound", NULL);
  assert_null(strstr(cli.err, "the rest is silent"));
  ern_context_free(&context);
}

static void test_render_long(void **state) {
  (void)state;
  cli_run(&cli, "render m.safetensors --clip clip --audio clip/aud.wav -o said.mp4");
  cli_expect(&cli, 0, "with sound", NULL);
  cli_run(&cli,
          "render m.safetensors --clip clip --audio said.mp4 --frames 0:8 -o again.mp4"); /* any file with a sound */
  cli_expect(&cli, 0, "with sound", NULL);
  cli_run(&cli, "features said.mp4 -o said.npy"); /* without what the encoder fills its last packet with */
  cli_expect(&cli, 0, "said.npy: articulatory-1, 33 windows", NULL);
  support_write("none.wav", "RIFF\44\0\0\0WAVEfmt \20\0\0\0\1\0\1\0\200>\0\0\0}\0\0\2\0\20\0data\0\0\0\0", 44);
  cli_run(&cli, "render m.safetensors --clip clip --wav none.wav -o wrong.mp4");
  cli_expect(&cli, 1, "none.wav: has no sound, 0 samples", NULL);
  cli_copy("clip", "mute");
  assert_int_equal(rename("none.wav", "mute/aud.wav"), 0);
  cli_run(&cli, "check mute");
  cli_expect_out(&cli, 1, "aud.wav: 0 samples. Rendered videos will have no sound", NULL);
  assert_int_equal(symlink("../ds.npy", "mute/aud_ds.npy"), 0);
  cli_run(&cli, "train mute -o ds29.safetensors --iters 4 --rays 64 --levels 2 --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render ds29.safetensors --clip mute --frames 0:8 -o mute.mp4");
  cli_expect(&cli, 0, "aud.wav: has no sound, 0 samples: the video is silent", "without sound", NULL);
  cli_run(&cli, "render m.safetensors --clip clip --audio ds.npy -o wrong.mp4");
  cli_expect(&cli, 1, "ds.npy", "29", "45", NULL);
  cli_run(&cli,
          "train clip --audio ds.npy -o ds.safetensors --iters 4 --rays 64 --levels 2 --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render ds.safetensors --clip clip --audio clip/aud.wav -o wrong.mp4");
  cli_expect(&cli, 1, "expected", NULL);
  assert_false(cli_there("wrong.mp4"));
  /* the noise of a short speech is the head's alone: the torso goes on by itself too */
  cli_run(&cli, "train clip --time 1s -o timed.safetensors --levels 2 --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip --torso --head timed.head.safetensors -o timed.safetensors --resume --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip --torso --head m.safetensors --speech-augment auto -o x.safetensors");
  cli_expect(&cli, 2, "--speech-augment", "which --torso does not change", NULL);
}

/* 45 numbers may be anybody's: a head that learnt them does not speak from a sound. */
static void test_others_long(void **state) {
  (void)state;
  cli_run(&cli, "features clip/aud.wav --warp 1.2 -o mine.npy --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip --audio mine.npy -o mine.safetensors --iters 4 --rays 64 --levels 2 --validate-frames 1");
  cli_expect(&cli, 0, "unknown kind", NULL);
  cli_run(&cli, "render mine.safetensors --clip clip --audio clip/aud.wav -o mine.mp4");
  cli_expect(&cli, 1, "mine.safetensors", "expected --audio FILE.npy", NULL);
  /* nor does it when a torso has been put under it, by a training that made its own features of the sound */
  cli_run(
      &cli,
      "train clip --torso --head mine.safetensors -o body.safetensors --iters 2 --rays 64 --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render body.safetensors --clip clip --audio clip/aud.wav -o mine.mp4");
  cli_expect(&cli, 1, "body.safetensors", "expected --audio FILE.npy", NULL);
  cli_run(&cli, "eval mine.safetensors clip");
  cli_expect(&cli, 1, "another kind than articulatory-1 and cepstra-1", NULL);
  cli_run(&cli, "eval mine.safetensors clip --audio mine.npy --quiet");
  cli_expect(&cli, 0, NULL);
  /* a training that goes on, and a torso, hear the sound as the head did */
  cli_run(
      &cli,
      "train clip --asr-model cepstra -o old.safetensors --iters 4 --rays 64 --levels 2 --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o old.safetensors --resume --iters 6 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(
      &cli,
      "train clip --torso --head old.safetensors -o both.safetensors --iters 2 --rays 64 --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "eval both.safetensors clip --quiet");
  cli_expect(&cli, 0, NULL);
}

static void test_mouth_long(void **state) {
  (void)state;
  cli_run(&cli, "eval m.safetensors clip --split train --json mouth.json");
  cli_expect_out(&cli, 0, "mouth: ", "of its motion, correlation", "eyes, open: PSNR", NULL);
  json_t *report = cli_json(&cli, "mouth.json");
  const json_t *measures = json_object_get(report, "measures"), *mouth = json_object_get(measures, "mouth_motion");
  const double sharp = json_real_value(json_object_get(measures, "sharpness_head"));
  assert_true(sharp > 0 && sharp < 2 && json_real_value(json_object_get(measures, "seam")) > 0);
  const json_t *eyes = json_object_get(measures, "eyes");
  const json_int_t open = json_integer_value(json_object_get(eyes, "open"));
  const json_int_t shut = json_integer_value(json_object_get(eyes, "shut"));
  assert_int_equal(open + shut, (json_int_t)json_array_size(json_object_get(report, "frames")));
  assert_true(open > 0 && json_real_value(json_object_get(eyes, "psnr_open")) > 5);
  assert_true(shut > 0 ? json_real_value(json_object_get(eyes, "psnr_shut")) > 5
                       : json_is_null(json_object_get(eyes, "psnr_shut")));
  assert_true(json_real_value(json_object_get(mouth, "explained")) < 1);
  assert_true(json_real_value(json_object_get(mouth, "amplitude")) > 0);
  assert_true(json_real_value(json_object_get(report, "samples_per_frame")) > 1);
  json_decref(report);
  /* the training has said the same of its last validation, in words and in a table */
  cli_run(&cli, "eval m.safetensors clip --json val.json");
  report = cli_json(&cli, "val.json");
  measures = json_object_get(report, "measures");
  mouth = json_object_get(measures, "mouth_motion");
  double found[7] = {0};
  FILE *table = fopen("m.run/measures.csv", "r");
  assert_non_null(table);
  assert_int_equal(fscanf(table, "%*[^\n]\n%lf,%lf,%lf,%lf,%lf,%lf,%lf", &found[0], &found[1], &found[2], &found[3],
                          &found[4], &found[5], &found[6]),
                   7);
  fclose(table);
  const double expected[7] = {30,
                              json_real_value(json_object_get(mouth, "explained")),
                              json_real_value(json_object_get(mouth, "correlation")),
                              json_real_value(json_object_get(mouth, "amplitude")),
                              json_real_value(json_object_get(measures, "sharpness_head")),
                              json_real_value(json_object_get(measures, "sharpness_mouth")),
                              json_real_value(json_object_get(measures, "seam"))};
  for (size_t i = 0; i < 7; i++) assert_true(fabs(found[i] - expected[i]) < 1e-4 * fmax(1, fabs(expected[i])));
  json_decref(report);
  cli_run(&cli, "train clip -o m.safetensors --resume --iters 34 --validate-every 2");
  cli_expect(&cli, 0, "of the mouth's motion over 3 validation frames", NULL);
  assert_null(strstr(cli.err, "was best at step"));
  assert_int_equal(system("test $(wc -l <m.run/measures.csv) = 4 && grep -q ^30, m.run/measures.csv"), 0);
  /* said where unseen frames speak worse than before */
  assert_int_equal(system("sed -i 's/^32,[^,]*/32,0.96/' m.run/measures.csv"), 0);
  cli_run(&cli, "train clip -o m.safetensors --resume --iters 36 --validate-every 2");
  cli_expect(&cli, 0, "the mouth of unseen frames was best at step 32, 96 % of its motion, now", NULL);
  cli_copy("clip", "blind");
  support_clear("blind/ori_imgs");
  cli_run(&cli, "eval m.safetensors blind --json -");
  report = cli_json(&cli, NULL);
  measures = json_object_get(report, "measures");
  assert_true(json_is_null(json_object_get(measures, "mouth_motion")) &&
              json_is_null(json_object_get(measures, "sharpness_head")) &&
              json_is_null(json_object_get(measures, "seam")));
  json_decref(report);
}

/* A made-up person who speaks a text, where espeak-ng is there. */
static void test_text(void **state) {
  (void)state;
  support_write_text("text.txt", "Mama opened a box.");
  cli_run(&cli, "synth said --size 64 --frames 8 --voice de");
  cli_expect(&cli, 2, "--voice", "is of --text", NULL);
  cli_run(&cli, "synth said --size 64 --text missing.txt");
  cli_expect(&cli, 1, "missing.txt", NULL);
  cli_run(&cli, "synth said --size 64 --frames 8 --text text.txt --voice en-us+f3 --json said.json");
  if (cli.status != 0) {
    cli_expect(&cli, 1, "espeak-ng", NULL);
    return;
  }
  json_t *report = cli_json(&cli, "said.json");
  assert_int_equal(json_integer_value(json_object_get(report, "frames")), 8);
  json_decref(report);
  cli_run(&cli, "check said");
  cli_expect_out(&cli, 0, "aud.wav: no file of speech features", NULL);
}

/* What is at the table's name and is no table of the program stays: a text, a link's target, a pipe. */
static void test_table_of_others_long(void **state) {
  (void)state;
  static const char *const there[] = {"printf 'mine\\n' > t.run/measures.csv", "ln -s ../mine.csv t.run/measures.csv",
                                      "mkfifo t.run/measures.csv"};
  const char train[] = "train clip -o t.safetensors --rays 64 --levels 2 --validate-every 2";
  support_write_text("mine.csv", "mine\n");
  cli_run(&cli, "%s --iters 2 --quiet", train);
  cli_expect(&cli, 0, NULL);
  for (int i = 0; i < 6; i++) {
    assert_int_equal(system("rm t.run/measures.csv"), 0);
    assert_int_equal(system(there[i % 3]), 0);
    cli_run(&cli, "%s --iters %d %s", train, i < 3 ? 4 + 2 * i : 4, i < 3 ? "--resume" : "-y");
    cli_expect(&cli, 0, "t.run/measures.csv: is no table of measures", "it is kept", NULL);
    if (i % 3 < 2) assert_int_equal(system("printf 'mine\\n' | cmp - t.run/measures.csv"), 0);
  }
  assert_int_equal(system("printf 'mine\\n' | cmp - mine.csv && test -p t.run/measures.csv && rm t.run/measures.csv"),
                   0);
  /* the table of a training that is replaced goes with its first save */
  cli_run(&cli, "%s --iters 4 -y --quiet", train);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "%s --iters 4 -y --validate-every 0 --save-every 1 --quiet", train);
  cli_expect(&cli, 0, NULL);
  assert_int_equal(system("test $(wc -l <t.run/measures.csv) = 2 && grep -q ^4, t.run/measures.csv"), 0);
}

static void test_check(void **state) {
  (void)state;
  cli_run(&cli, "check clip");
  cli_expect_out(&cli, 0, "aud.wav: no file of speech features; articulatory-1 is made of the sound",
                 "its mouth from articulatory-1 features", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_features),
                                     cmocka_unit_test(test_render_long),
                                     cmocka_unit_test(test_last_frame_outlasts_the_sound),
                                     cmocka_unit_test(test_mouth_long),
                                     cmocka_unit_test(test_others_long),
                                     cmocka_unit_test(test_text),
                                     cmocka_unit_test(test_table_of_others_long),
                                     cmocka_unit_test(test_check)};
  return cmocka_run_group_tests(tests, make, NULL);
}
