/* SPDX-License-Identifier: MIT
 * What the program does to files that were there before: it replaces those that it was told to replace, and touches no
 * other. */
#include <math.h>
#include <time.h>

#include "cli.h"

static struct cli cli;

static int make_files(void **state) {
  (void)state;
  cli_run(&cli, "synth clip --size 64 --frames 8 --seed 3 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o m.safetensors --rays 32 --iters 2 --levels 2 --quiet");
  cli_expect(&cli, 0, NULL);
  return 0;
}

static void expect_text(const char *path, const char *expected) {
  size_t count = 0;
  uint8_t *bytes = cli_bytes(path, &count);
  if (strcmp((const char *)bytes, expected) != 0) fail_msg("%s is no longer \"%s\"", path, expected);
  free(bytes);
}

/* ---- files of others --------------------------------------------------------------------------------------------- */

/* Whatever a file in the folder of the output is called, it stays. */
static void test_neighbours(void **state) {
  (void)state;
  static const char *const names[] = {"left/thesis.tmp-99999",      "left/.cache.tmp-77777.db",
                                      "left/.clip10.tmp-1.mp4",     "left/00000.png.tmp-99999",
                                      "left/clip1.mp4.tmp-99999",   "left/.clip1.tmp-99999.mp4",
                                      "left/clip10.mp4.ernerf-tmp", "left/00001.png.ernerf-tmp"};
  static const char *const outputs[] = {"left/%05d.png", "left/%05d.exr", "left/clip1.mp4"};
  assert_int_equal(mkdir("left", 0777), 0);
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) support_write_text(names[i], "mine");
  for (size_t i = 0; i < sizeof outputs / sizeof *outputs; i++) {
    cli_run(&cli, "render m.safetensors --clip clip -o %s --frames 0:1 --quiet --json left/r%zu.json", outputs[i], i);
    cli_expect(&cli, 0, NULL);
  }
  cli_run(&cli, "convert m.safetensors left/m.pth");
  cli_expect(&cli, 0, NULL);
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) expect_text(names[i], "mine");
}

/* A folder of the user's that is empty is still there after a failure. */
static void test_empty_folder_long(void **state) {
  (void)state;
  assert_int_equal(mkdir("empty", 0777), 0);
  cli_run_full(&cli, 1000, "tradeoff m.safetensors clip -o empty --frames 0:2 --split train --seconds 1 --quiet");
  cli_expect(&cli, 1, "empty/", NULL);
  assert_true(cli_there("empty"));
}

/* ---- outputs that exist ------------------------------------------------------------------------------------------ */

static const struct {
  const char *file, *line;
} outputs[] = {
    {"o.mp4", "render m.safetensors --clip clip --frames 0:2 --quiet -o o.mp4"},
    {"o00001.png", "render m.safetensors --clip clip --frames 0:2 --quiet -o o%05d.png"},
    {"o00001.exr", "render m.safetensors --clip clip --frames 0:2 --quiet -o o%05d.exr"},
    {"o.pth", "convert m.safetensors o.pth"},
    {"o.safetensors", "convert m.safetensors o.safetensors"},
    {"eval.json", "eval m.safetensors clip --quiet --json eval.json"},
    {"info.json", "info m.safetensors --json info.json"},
    {"check.json", "check clip --json check.json"},
    {"synth.json", "synth made --size 64 --frames 8 --quiet --json synth.json"},
    {"synth.mp4", "synth filmed --size 64 --frames 8 --quiet --video synth.mp4"},
    {"table/ablation.csv",
     "ablate clip -o table --iters 1 --rays 16 --frames 0:1 --repeats 3 --only "
     "trihash-concat --quiet"},
    {"table2/trihash-concat.safetensors",
     "ablate clip -o table2 --iters 1 --rays 16 --frames 0:1 --repeats 3 --only trihash-concat --quiet"},
    {"trade/exact.svg", "tradeoff m.safetensors clip -o trade --frames 0:2 --split train --seconds 1 --quiet"},
    {"learnt/training_steps.png",
     "tradeoff --training clip -o learnt --seconds 1 --seeds 1 --rays 16 --levels 5 --quiet"},
    {"learnt2/training_mouth_seconds.png",
     "tradeoff --training clip -o learnt2 --seconds 1 --seeds 1 --rays 16 --levels 5 --quiet"}};

static void test_refused(void **state) {
  (void)state;
  static const char *const folders[] = {"table", "table2", "trade", "learnt", "learnt2"};
  for (size_t i = 0; i < sizeof folders / sizeof *folders; i++) assert_int_equal(mkdir(folders[i], 0777), 0);
  for (size_t i = 0; i < sizeof outputs / sizeof *outputs; i++) {
    support_write_text(outputs[i].file, "mine");
    cli_run(&cli, "%s", outputs[i].line);
    cli_expect(&cli, 1, outputs[i].file, "is there already", "--overwrite", NULL);
    expect_text(outputs[i].file, "mine");
  }
  assert_false(cli_there("o00000.png") || cli_there("o00000.exr") || cli_there("made") || cli_there("filmed"));
  for (size_t i = 0; i < sizeof folders / sizeof *folders; i++) assert_int_equal(cli_count(folders[i]), 1);
}

static void test_overwritten(void **state) {
  (void)state;
  for (size_t i = 0; i < sizeof outputs / sizeof *outputs; i++) {
    if (strncmp(outputs[i].line, "ablate", 6) == 0 || strncmp(outputs[i].line, "tradeoff", 8) == 0) continue;
    cli_run(&cli, "%s %s", outputs[i].line, i % 2 == 0 ? "-y" : "--overwrite");
    cli_expect(&cli, 0, NULL);
    size_t count = 0;
    uint8_t *bytes = cli_bytes(outputs[i].file, &count);
    if (strcmp((const char *)bytes, "mine") == 0) fail_msg("ernerf %s: %s is as before", cli.line, outputs[i].file);
    free(bytes);
  }
}

static void test_training(void **state) {
  (void)state;
  cli_run(&cli, "train clip -o t.safetensors --rays 32 --iters 2 --levels 2 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "convert t.safetensors was.safetensors --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o t.safetensors --rays 32 --iters 1 --levels 2 --seed 4 --quiet");
  cli_expect(&cli, 1, "t.safetensors", "--resume", "--overwrite", NULL);
  cli_run(&cli, "convert t.safetensors is.safetensors --quiet");
  cli_same_bytes("was.safetensors", "is.safetensors");
  cli_run(&cli, "train clip -o t.safetensors --rays 32 --iters 3 --levels 2 --resume --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "info t.safetensors");
  cli_expect_out(&cli, 0, "3", NULL);
  cli_run(&cli, "train clip -o t.safetensors --rays 32 --iters 2 --levels 2 --overwrite --quiet");
  cli_expect(&cli, 0, NULL);
  cli_same_bytes("t.safetensors", "m.safetensors");
}

static double number_of(const char *command, const char *name) {
  cli_run(&cli, "%s --json", command);
  json_t *report = cli_json(&cli, NULL);
  const double value = json_number_value(json_object_get(report, name));
  assert_true(value > 0);
  json_decref(report);
  return value;
}

/* A validation draws the model that a save writes: the average where that is asked for. */
static void test_validation_of_the_average_long(void **state) {
  (void)state;
  static const char train[] =
      "train clip --rays 64 --iters 40 --levels 2 --set ema-every=2 --validate-frames 0 --quiet";
  char average[200], weights[200];
  snprintf(average, sizeof average, "%s -o va.safetensors --set ema=yes", train);
  snprintf(weights, sizeof weights, "%s -o vw.safetensors", train);
  const double of_average = number_of(average, "val_psnr"), of_weights = number_of(weights, "val_psnr");
  const double written = number_of("eval va.safetensors clip --set transmittance-stop=0.0001", "psnr");
  print_message("validated %.4f, written %.4f, weights %.4f dB\n", of_average, written, of_weights);
  assert_true(fabs(of_average - of_weights) > 0.02);
  assert_true(fabs(of_average - written) < 0.005); /* eval may stop a ray earlier by rounding */
}

/* Pictures and plots of X.run are not written through a link, and a file with a temporary name is no leftover. */
static void test_run_folder_long(void **state) {
  (void)state;
  cli_run(&cli, "train clip -o r.safetensors --rays 32 --iters 2 --levels 2 --quiet");
  cli_expect(&cli, 0, NULL);
  support_write_text("picture", "mine");
  support_write_text("plot", "mine");
  assert_int_equal(symlink("../picture", "r.run/val_000004.png"), 0);
  assert_int_equal(remove("r.run/curve_steps.svg"), 0);
  assert_int_equal(symlink("../plot", "r.run/curve_steps.svg"), 0);
  cli_run(&cli, "train clip -o r.safetensors --rays 32 --iters 4 --resume --quiet");
  cli_expect(&cli, 0, "val_000004.png", "curve_steps.svg", "symbolic link", NULL);
  expect_text("picture", "mine");
  expect_text("plot", "mine");
  support_write_text("r.run/val_000006.png", "mine");
  cli_run(&cli, "train clip -o r.safetensors --rays 32 --iters 6 --resume");
  cli_expect(&cli, 0, "val_000006.png: is there already and is kept", NULL);
  expect_text("r.run/val_000006.png", "mine");
  /* an average stays one, unless it is asked for the weights */
  cli_run(&cli, "train clip -o e.safetensors --rays 32 --iters 20 --levels 2 --set ema=yes --set ema-every=2 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o w.safetensors --rays 32 --iters 20 --levels 2 --set ema-every=2 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(system("cp e.safetensors average.safetensors"), 0);
  for (int ema = 1; ema >= 0; ema--) {
    cli_run(&cli, "train clip -o e.safetensors --resume --quiet %s", ema == 1 ? "" : "--set ema=no");
    cli_expect(&cli, 0, NULL);
    assert_int_equal(system(ema == 1 ? "cmp e.safetensors average.safetensors" : "cmp e.safetensors w.safetensors"), 0);
  }
  /* a resume of a head replaces no portrait, and a state keeps its rights */
  assert_int_equal(system("cp e.safetensors head.safetensors && chmod 600 e.run/state.safetensors"), 0);
  cli_run(&cli, "train clip --torso --head head.safetensors -o p.safetensors --rays 32 --iters 2 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(system("cp p.safetensors e.safetensors"), 0);
  cli_run(&cli, "train clip -o e.safetensors --resume --iters 21 --quiet");
  cli_expect(&cli, 1, "e.safetensors: is a portrait with a torso", "--overwrite", NULL);
  assert_int_equal(system("cmp p.safetensors e.safetensors && cp head.safetensors e.safetensors"), 0);
  cli_run(&cli, "train clip -o e.safetensors --resume --iters 22 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(system("test $(stat -c %a e.run/state.safetensors) = 600"), 0);
  support_write_text("e.run/state.next.safetensors.ernerf-tmp", "mine"); /* the save fails, and leaves nothing empty */
  cli_run(&cli, "train clip -o e.safetensors --resume --iters 24 --quiet");
  cli_expect(&cli, 1, "not made by this program", NULL);
  assert_false(cli_there("e.run/state.next.safetensors"));
  /* the pictures of a training that is replaced go with its first save, and no sooner */
  cli_run(&cli, "train clip -o v.safetensors --rays 32 --iters 6 --levels 2 --validate-every 2 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(system("cp v.run/val_000004.png old.png && cp v.run/curve_steps.svg old.svg"), 0);
  cli_run(&cli, "train clip -o v.safetensors --rays 32 --iters 2 --levels 2 --seed 7 -y --quiet");
  cli_expect(&cli, 0, NULL);
  assert_false(cli_there("v.run/val_000004.png") || cli_there("v.run/val_000006.png"));
  assert_true(cli_there("v.run/val_000002.png"));
  assert_int_not_equal(system("cmp -s old.svg v.run/curve_steps.svg"), 0);
  /* a file with another name, as in a snapshot of hard links, is not written through it */
  assert_int_equal(system("cp -al v.run snap && cp snap/curve.csv curve.before"), 0);
  cli_run(&cli, "train clip -o v.safetensors --rays 32 --iters 3 --levels 2 --resume --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(system("cmp snap/curve.csv curve.before && ! cmp -s v.run/curve.csv curve.before"), 0);
  cli_run(&cli, "train clip -o v.safetensors --rays 32 --iters 2 --levels 2 -y --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(system("cmp snap/curve.csv curve.before"), 0);
  /* nor is another training's folder, behind a link */
  assert_int_equal(symlink("v.run", "other.run"), 0);
  cli_run(&cli, "train clip -o other.safetensors --rays 32 --iters 2 --levels 2 -y --quiet");
  cli_expect(&cli, 1, "other.run: is a symbolic link", NULL);
  /* nor what the training starts from, where it is one of the states that it replaces */
  const char *const starts[] = {"--from", "--torso --head"};
  for (size_t i = 0; i < 2; i++) {
    cli_run(&cli, "train clip %s r.run/state.safetensors -o r.safetensors --rays 32 --iters 9 -y --quiet", starts[i]);
    cli_expect(&cli, 1, "r.run/state.safetensors", "is an input in r.run", "another", NULL);
    assert_true(cli_there("r.run/state.safetensors") && cli_there("r.run/state.previous.safetensors"));
  }
  support_write_text("n.safetensors.ernerf-tmp", "mine");
  cli_run(&cli, "convert m.safetensors n.safetensors --quiet");
  cli_expect(&cli, 1, "n.safetensors.ernerf-tmp", "not made by this program", NULL);
  expect_text("n.safetensors.ernerf-tmp", "mine");
}

/* ---- what a name leads to ---------------------------------------------------------------------------------------- */

static void test_links(void **state) {
  (void)state;
  struct stat about;
  assert_int_equal(mkdir("big", 0777), 0);
  assert_int_equal(symlink("big/talk.mp4", "talk.mp4"), 0);
  for (int i = 0; i < 2; i++) {
    cli_run(&cli, "render m.safetensors --clip clip --frames 0:2 --quiet -o talk.mp4 %s", i > 0 ? "-y" : "");
    cli_expect(&cli, 0, NULL);
    assert_int_equal(lstat("talk.mp4", &about), 0);
    assert_true(S_ISLNK(about.st_mode));
    assert_true(cli_there("big/talk.mp4"));
  }
}

/* The folder behind a link is missed before a training, not after it. */
static void test_link_to_nowhere(void **state) {
  (void)state;
  assert_int_equal(symlink("nowhere/n.safetensors", "n.safetensors"), 0);
  cli_run(&cli, "train clip -o n.safetensors --rays 32 --iters 2 --levels 2 --quiet");
  cli_expect(&cli, 1, "n.safetensors", "its folder is not there", NULL);
  assert_false(cli_there("n.run"));
}

/* What is read is not written over through a link either, whatever it is asked to replace. */
static void test_links_to_inputs(void **state) {
  (void)state;
  static const struct {
    const char *link, *input, *line;
  } cases[] = {
      {"in.mp4", "m.safetensors", "render m.safetensors --clip clip --frames 0:1 -o in.mp4"},
      {"in.mp4", "clip/aud_ds.npy", "render m.safetensors --clip clip --frames 0:1 -o in.mp4"},
      {"in.mp4", "other.npy", "render m.safetensors --clip clip --audio other.npy --frames 0:1 -o in.mp4"},
      {"in0.png", "clip/torso_imgs/3.png", "render m.safetensors --clip clip --frames 0:1 -o in%d.png"},
      {"in.json", "m.safetensors", "render m.safetensors --clip clip --frames 0:1 -o new.mp4 --json in.json"},
      {"in.json", "m.safetensors", "eval m.safetensors clip --json in.json"},
      {"in.json", "m.safetensors", "info m.safetensors --json in.json"},
      {"in.json", "m.safetensors", "convert m.safetensors new.pth --json in.json"},
      {"in.json", "clip/bc.jpg", "check clip --json in.json"},
      {"in.json", "clip/aud_cep.npy", "check clip --json in.json"},
      {"in.safetensors", "clip/au.csv", "train clip -o in.safetensors --rays 32 --iters 1 --levels 2"},
      {"in.json", "clip/gt_imgs/0.jpg", "train clip -o new.safetensors --rays 32 --iters 1 --levels 2 --json in.json"}};
  size_t speech_bytes = 0;
  uint8_t *speech = cli_bytes("clip/aud_ds.npy", &speech_bytes);
  support_write("other.npy", speech, speech_bytes);
  support_write("clip/aud_cep.npy", speech, speech_bytes);
  free(speech);
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    size_t before = 0, after = 0;
    uint8_t *was = cli_bytes(cases[i].input, &before);
    (void)unlink(cases[i].link);
    assert_int_equal(symlink(cases[i].input, cases[i].link), 0);
    cli_run(&cli, "%s --quiet -y", cases[i].line);
    cli_expect(&cli, 1, cases[i].link, "expected another", NULL);
    uint8_t *is = cli_bytes(cases[i].input, &after);
    assert_true(before == after && memcmp(was, is, before) == 0);
    free(was), free(is);
  }
  assert_false(cli_there("new.mp4") || cli_there("new.pth") || cli_there("new.run"));
  assert_int_equal(unlink("clip/aud_cep.npy"), 0);
}

/* Nor are the parts of a clip that is not read, except its features by `features`. */
static void test_parts_of_a_clip(void **state) {
  (void)state;
  static const char *const lines[] = {"info m.safetensors --json clip/transforms_val.json",
                                      "features s.wav -o s.npy --json clip/transforms_train.json",
                                      "features s.wav -o link.npy"};
  size_t sound_bytes = 0;
  uint8_t *sound = cli_bytes("clip/aud.wav", &sound_bytes);
  support_write("s.wav", sound, sound_bytes);
  free(sound);
  assert_int_equal(symlink("clip/gt_imgs/0.jpg", "link.npy"), 0);
  for (size_t i = 0; i < sizeof lines / sizeof *lines; i++) {
    cli_run(&cli, "%s --quiet -y", lines[i]);
    cli_expect(&cli, 1, "is a part of the clip", "expected another name", NULL);
  }
  assert_false(cli_there("s.npy"));
  cli_run(&cli, "check clip --quiet");
  cli_expect(&cli, 0, NULL);
  for (int i = 0; i < 2; i++) {
    cli_run(&cli, "features s.wav -o clip/aud_cep.npy --quiet -y");
    cli_expect(&cli, 0, NULL);
  }
  assert_int_equal(unlink("clip/aud_cep.npy"), 0);
}

/* Two outputs of one call are two files, wherever their names lead. */
static void test_same_output(void **state) {
  (void)state;
  static const struct {
    const char *link, *target, *line, *other;
  } cases[] = {
      {"two.json", "two.safetensors", "train clip -o two.safetensors --rays 32 --iters 1 --levels 2",
       "two.safetensors"},
      {"two.json", "two.run/state.safetensors", "train clip -o two.safetensors --rays 32 --iters 1 --levels 2",
       "two.run"},
      {"two.json", "two.pth", "convert m.safetensors two.pth", "two.pth"},
      {"two.json", "two.npy", "features clip/aud.wav -o two.npy", "two.npy"},
      {"two.json", "two.mp4", "render m.safetensors --clip clip --frames 0:1 -o two.mp4", "two.mp4"},
      {"two.json", "two0.png", "render m.safetensors --clip clip --frames 0:1 -o two%d.png", "two0.png"},
      {"two.json", "two/clip.png", "tradeoff m.safetensors clip -o two --frames 0:2 --split train --seconds 1",
       "two/clip.png"},
      {"two.json", "two/training.csv", "tradeoff --training clip -o two --seconds 1 --seeds 1 --rays 16 --levels 5",
       "two/training.csv"},
      {"two.json", "two/ablation.csv", "ablate clip -o two --iters 1 --rays 16 --frames 0:1 --only trihash-concat",
       "two/ablation.csv"},
      {"two.json", "two/trihash-concat.safetensors",
       "ablate clip -o two --iters 1 --rays 16 --frames 0:1 --only trihash-concat", "two/trihash-concat.safetensors"},
      {"two.json", "two/transforms_train.json", "synth two --size 64 --frames 8", "two"}};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    (void)unlink(cases[i].link);
    assert_int_equal(symlink(cases[i].target, cases[i].link), 0); /* leads to nothing yet */
    cli_run(&cli, "%s --quiet -y --json %s", cases[i].line, cases[i].link);
    cli_expect(&cli, 1, cases[i].link, cases[i].other, "expected another", NULL);
    assert_false(cli_there(cases[i].target) || cli_there("two") || cli_there("two.run"));
  }
  /* two names of a file that is there */
  support_write_text("two.mp4", "mine");
  assert_int_equal(link("two.mp4", "hard.json"), 0);
  assert_int_equal(symlink("./two.mp4", "soft.json"), 0);
  static const char *const names[] = {"soft.json", "hard.json"};
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    cli_run(&cli, "render m.safetensors --clip clip --frames 0:1 -o two.mp4 --quiet -y --json %s", names[i]);
    cli_expect(&cli, 1, "two.mp4: is the same file as", names[i], "expected another", NULL);
    expect_text("two.mp4", "mine");
  }
  assert_int_equal(mkdir("three", 0777), 0);
  cli_run(&cli,
          "tradeoff m.safetensors clip -o three --frames 0:2 --split train --seconds 1 --json three/tradeoff.json");
  cli_expect(&cli, 1, "three/tradeoff.json", "an output too", NULL);
  assert_int_equal(cli_count("three"), 0);
}

static void test_devices(void **state) {
  (void)state;
  struct stat about;
  assert_int_equal(symlink("/dev/null", "null.json"), 0);
  cli_run(&cli, "info m.safetensors --quiet -y --json null.json");
  cli_expect(&cli, 1, "null.json", "device", NULL);
  assert_int_equal(stat("/dev/null", &about), 0);
  assert_true(S_ISCHR(about.st_mode));
}

/* A byte that is no UTF-8 is U+FFFD in the object, and itself in the names of files. */
static void test_odd_names(void **state) {
  (void)state;
  cli_run(&cli, "convert m.safetensors wei\xdf.safetensors --json odd.json");
  cli_expect(&cli, 0, NULL);
  assert_true(cli_there("wei\xdf.safetensors"));
  json_t *object = cli_json(&cli, "odd.json");
  assert_string_equal(json_string_value(json_object_get(object, "out")), "wei\xef\xbf\xbd.safetensors");
  json_decref(object);
  cli_run(&cli, "render wei\xdf.safetensors --clip clip --frames 0:2 --quiet -o tal\xed\xa0\x80k\xff.mp4 --json -");
  cli_expect(&cli, 0, NULL);
  object = cli_json(&cli, NULL);
  assert_string_equal(json_string_value(json_object_get(object, "output")),
                      "tal\xef\xbf\xbd\xef\xbf\xbd\xef\xbf\xbdk\xef\xbf\xbd.mp4");
  json_decref(object);
}

/* ---- two processes ----------------------------------------------------------------------------------------------- */

/* While one renders, another one of the same name is refused, and one of a name that begins alike does it no harm. */
static void test_two_renders_long(void **state) {
  (void)state;
  static struct cli slow;
  snprintf(slow.line, sizeof slow.line, "render m.safetensors --clip clip --size 192x192 --quiet -o two10.mp4");
  cli_start(&slow, "slow.txt", 0);
  /* The file is locked just after it was made, and before its first byte. */
  struct stat about = {.st_size = 0};
  for (int i = 0; i < 2000 && (stat("two10.mp4.ernerf-tmp", &about) != 0 || about.st_size == 0); i++)
    nanosleep(&(struct timespec){.tv_nsec = 5000000}, NULL);
  assert_int_equal(kill(slow.pid, SIGSTOP), 0);
  assert_true(cli_there("two10.mp4.ernerf-tmp") && !cli_there("two10.mp4"));
  cli_run(&cli, "render m.safetensors --clip clip --frames 0:2 --quiet -o two1.mp4");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render m.safetensors --clip clip --frames 0:2 --quiet -y -o two10.mp4");
  cli_expect(&cli, 1, "two10.mp4", "another process", NULL);
  assert_int_equal(kill(slow.pid, SIGCONT), 0);
  cli_wait(&slow);
  assert_int_equal(slow.status, 0);
  assert_true(cli_there("two10.mp4") && !cli_there("two10.mp4.ernerf-tmp"));
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_neighbours),      cmocka_unit_test(test_empty_folder_long),
      cmocka_unit_test(test_refused),         cmocka_unit_test(test_overwritten),
      cmocka_unit_test(test_training),        cmocka_unit_test(test_validation_of_the_average_long),
      cmocka_unit_test(test_run_folder_long), cmocka_unit_test(test_links),
      cmocka_unit_test(test_link_to_nowhere), cmocka_unit_test(test_links_to_inputs),
      cmocka_unit_test(test_parts_of_a_clip), cmocka_unit_test(test_same_output),
      cmocka_unit_test(test_devices),         cmocka_unit_test(test_odd_names),
      cmocka_unit_test(test_two_renders_long)};
  return cmocka_run_group_tests(tests, make_files, NULL);
}
