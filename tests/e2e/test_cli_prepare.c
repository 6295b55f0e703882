/* SPDX-License-Identifier: MIT
 * A made-up video becomes a clip: all of it, again, step by step, stopped and gone on with, replaced by another part.
 */
#include "cli.h"

#include <math.h>
#include <time.h>

#include "core/memory.h"
#include "ernerf/data.h"
#include "ernerf/media.h"
#include "io/csv.h"
#include "io/landmarks.h"

enum { FRAMES = 30, PART = 26 };
static struct cli cli;

static int make(void **state) {
  (void)state;
  static const char *const old[] = {"truth", "clip", "again", "part", "mine", "m.safetensors", "m.run", "v.mp4"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  cli_shared_video();
  cli_run(&cli, "prepare v.mp4 -o clip --size 160 --json clip.json");
  cli_expect(&cli, 0, "clip: 30 frames of 160 x 160", "face: doubtful: the part is 1.2 s long", NULL);
  return 0;
}

/* Every fifth picture of v.mp4, 5 a second, with the first 0.5 s of its sound. */
static void write_shorter_sound(const char *path) {
  ern_context *context = support_context();
  ern_video_reader *reader = NULL;
  ern_video_writer *writer = NULL;
  ern_video_options options = ern_video_options_default(160, 160);
  ern_sound sound = {0};
  ern_image image = {0};
  static uint8_t rgba[4 * 160 * 160];
  double seconds = 0;
  bool end = false;
  support_ok(context, ern_sound_read(context, "v.mp4", &sound));
  sound.frames = (size_t)sound.rate / 2;
  options.sound = &sound;
  options.rate_numerator = 5;
  support_ok(context, ern_video_reader_open(context, "v.mp4", &reader));
  support_ok(context, ern_video_writer_open(context, path, &options, &writer));
  for (int k = 0;; k++) {
    support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
    if (end) break;
    if (k % 5 != 0) continue;
    for (size_t i = 0; i < sizeof rgba / 4; i++) memcpy(rgba + 4 * i, image.data + 3 * i, 3);
    support_ok(context, ern_video_writer_frame(writer, rgba));
  }
  support_ok(context, ern_video_writer_close(&writer));
  ern_video_reader_free(&reader);
  ern_image_free(context, &image);
  ern_sound_free(context, &sound);
  ern_context_free(&context);
}

static void test_sound_ends_early(void **state) {
  (void)state;
  support_clear("early.mp4");
  support_clear("early");
  write_shorter_sound("early.mp4");
  cli_run(&cli, "prepare early.mp4 -o early --size 160 --only face");
  cli_expect(&cli, 0, "face: doubtful", "the sound ends at 0.5", "--to 0.5", "has no pictures of its own", NULL);
}

/* No file below a folder that was being written. */
static void expect_none_begun(const char *folder) {
  char command[512];
  snprintf(command, sizeof command, "test -z \"$(find %s -name '*.ernerf-tmp*')\"", folder);
  assert_int_equal(system(command), 0);
}

/* Features of the video's sound do not fit a sound that is moved. */
static void test_moved_sound(void **state) {
  (void)state;
  cli_run(&cli, "prepare v.mp4 -o clip --size 160 --features truth/aud_ds.npy --sound-offset 0.1");
  cli_expect(&cli, 0, "features: doubtful", "truth/aud_ds.npy is taken as it is", "is moved by -0.10 s", NULL);
  cli_run(&cli, "prepare v.mp4 -o clip --size 160 --features truth/aud_ds.npy --sound-offset 0");
  cli_expect(&cli, 0, "clip: 30 frames", NULL);
  assert_null(strstr(cli.err, "as it is"));
  cli_run(&cli, "prepare v.mp4 -o clip --size 160 --quiet");
  cli_expect(&cli, 0, NULL);
}

static void test_whole(void **state) {
  (void)state;
  static const char *const steps[] = {"face", "pose", "landmarks", "layers", "eyes", "features"};
  static const char *const folders[] = {"clip/gt_imgs", "clip/torso_imgs", "clip/parsing"};
  json_t *report = cli_json(&cli, "clip.json");
  const json_t *verdicts = json_object_get(report, "verdicts");
  assert_int_equal(json_integer_value(json_object_get(report, "frames")), FRAMES);
  assert_int_equal(json_array_size(verdicts), sizeof steps / sizeof *steps);
  for (size_t i = 0; i < sizeof steps / sizeof *steps; i++)
    assert_string_equal(json_string_value(json_object_get(json_array_get(verdicts, i), "step")), steps[i]);
  json_decref(report);
  for (size_t i = 0; i < sizeof folders / sizeof *folders; i++) assert_int_equal(cli_count(folders[i]), FRAMES);
  assert_int_equal(cli_count("clip/ori_imgs"), 2 * FRAMES);
  assert_true(cli_there("clip/report.html") && cli_there("clip/overlay.mp4") && cli_there("clip/bc.jpg"));
  expect_none_begun(".");
  cli_run(&cli, "check clip");
  cli_expect_out(&cli, 0, "30", NULL);
  cli_run(&cli, "train clip -o m.safetensors --iters 10 --rays 256 --levels 4 --validate-frames 2 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_true(cli_there("m.safetensors"));
}

/* The middle of the mouth is within a tenth of the eyes' distance from the truth's (median), and each blink is one. */
static void test_truth(void **state) {
  (void)state;
  ern_context *context = support_context();
  float *truth = NULL, *found = NULL;
  size_t rows = 0, count = 0, near = 0, blinks = 0;
  for (int i = 0; i < FRAMES; i++) {
    float points[2][ERN_LANDMARKS][2];
    double mouth[2][2] = {{0}}, eyes[2][2] = {{0}};
    char path[64];
    for (int k = 0; k < 2; k++) {
      snprintf(path, sizeof path, "%s/ori_imgs/%d.lms", k == 0 ? "truth" : "clip", i);
      support_ok(context, ern_landmarks_read(context, path, points[k]));
      for (int p = 48; p < 60; p++)
        for (int c = 0; c < 2; c++) mouth[k][c] += (double)points[k][p][c] / 12;
    }
    for (int p = 36; p < 48; p++)
      for (int c = 0; c < 2; c++) eyes[p >= 42][c] += (double)points[0][p][c] / 6;
    const double distance = hypot(eyes[0][0] - eyes[1][0], eyes[0][1] - eyes[1][1]);
    near += hypot(mouth[0][0] - mouth[1][0], mouth[0][1] - mouth[1][1]) < 0.1 * distance;
  }
  if (2 * near <= FRAMES) fail_msg("the mouth is found in %zu of %d frames", near, FRAMES);
  support_ok(context, ern_csv_read_column(context, "truth/au.csv", "AU45_r", &truth, &rows));
  support_ok(context, ern_csv_read_column(context, "clip/au.csv", "AU45_r", &found, &count));
  assert_true(rows == FRAMES && count == FRAMES);
  for (size_t i = 0; i < rows;) { /* closed for a while: in both, and never in one alone */
    size_t end = i;
    float most[2] = {0, 0};
    for (; end < rows && (truth[end] > 0.2f || found[end] > 0.2f); end++) {
      most[0] = fmaxf(most[0], truth[end]);
      most[1] = fmaxf(most[1], found[end]);
    }
    if (end > i && (most[0] < 1 || most[1] < 1))
      fail_msg("frames %zu to %zu: the lids close to %.2f, found %.2f", i, end - 1, (double)most[0], (double)most[1]);
    blinks += end > i;
    i = end > i ? end : i + 1;
  }
  assert_true(blinks >= 1);
  ern_release(context, truth);
  ern_release(context, found);
  ern_context_free(&context);
}

static long long changed(const char *path) { /* nanoseconds */
  struct stat about;
  assert_int_equal(stat(path, &about), 0);
  return about.st_mtim.tv_sec * 1000000000LL + about.st_mtim.tv_nsec;
}

/* Of a clip some of whose files are of earlier results. */
static void expect_no_training(const char *step) {
  cli_run(&cli, "check clip");
  cli_expect_out(&cli, 1, step, NULL);
  cli_run(&cli, "train clip -o none.safetensors --iters 2 --rays 64 --levels 2 --quiet");
  cli_expect(&cli, 1, "clip/prepare.json: the step", step, "is not done", NULL);
}

static void list_clip(const char *into) {
  char command[128];
  snprintf(command, sizeof command, "find clip -type f -printf '%%p %%T@ %%s\\n' | sort >%s", into);
  assert_int_equal(system(command), 0);
}

/* What is brought cannot be read: that is told before anything of the clip is taken away. */
static void test_supplied_unread_long(void **state) {
  (void)state;
  static const char *const bad[] = {
      "au none.csv",     "features none.npy", "features v.mp4",      "poses none.json",    "landmarks none",
      "masks none",      "masks holed",       "background none.png", "detector none.onnx", "landmarks none.csv",
      "masks none.onnx", "poses small.json",  "au short.csv",        "au long.csv",        "features long.npy"};
  assert_int_equal(system("rm -rf holed && cp -r clip/parsing holed && rm holed/19.png"), 0); /* of no example */
  assert_int_equal(system("sed 's/: 160,/: 128,/; s/: 80.0,/: 64.0,/' truth/transforms_train.json >small.json"), 0);
  support_write_text("short.csv", "AU45_r\n1\n");
  assert_int_equal(system("(echo AU45_r; yes 0 | head -n 33) >long.csv"), 0);
  cli_run(&cli, "synth longer --size 64 --frames 34 --quiet"); /* of the whole of a longer video */
  cli_expect(&cli, 0, NULL);
  assert_int_equal(system("mv longer/aud_ds.npy long.npy && rm -r longer"), 0);
  list_clip("before.txt");
  for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
    cli_run(&cli, "prepare v.mp4 -o clip --size 160 --quiet --%s", bad[i]);
    cli_expect(&cli, 1, strchr(bad[i], ' ') + 1, NULL);
    list_clip("after.txt");
    cli_same_bytes("before.txt", "after.txt");
  }
  cli_run(&cli, "prepare v.mp4 -o clip --size 160 --quiet --only pose --poses small.json");
  cli_expect(&cli, 1, "small.json: is for pictures of 128 x 128", NULL);
  list_clip("after.txt");
  cli_same_bytes("before.txt", "after.txt");
  cli_run(&cli, "check clip");
  cli_expect_out(&cli, 0, NULL);
  cli_run(&cli, "prepare v.mp4 -o new --size 160 --au none.csv"); /* nor is a long work begun */
  cli_expect(&cli, 1, "none.csv", NULL);
  assert_false(cli_there("new"));
}

static void test_second_call_long(void **state) {
  (void)state;
  static const char *const files[] = {"clip/transforms_train.json", "clip/ori_imgs/3.jpg", "clip/gt_imgs/3.jpg",
                                      "clip/ori_imgs/3.lms", "clip/aud.wav"};
  enum { COUNT = sizeof files / sizeof *files };
  long long before[COUNT];
  for (int i = 0; i < COUNT; i++) before[i] = changed(files[i]);
  const long long eyes = changed("clip/au.csv");
  cli_run(&cli, "prepare v.mp4 -o clip --size 160");
  cli_expect(&cli, 0, "clip: 30 frames", "pose: good", NULL);
  assert_true(changed("clip/au.csv") == eyes);
  assert_int_equal(system("cp clip/au.csv au_first.csv"), 0);
  cli_run(&cli, "prepare v.mp4 -o clip --size 160 --only eyes");
  cli_expect(&cli, 0, NULL);
  assert_true(changed("clip/au.csv") > eyes);
  cli_same_bytes("clip/au.csv", "au_first.csv");
  for (int i = 0; i < COUNT; i++)
    if (changed(files[i]) != before[i]) fail_msg("%s was made again", files[i]);
  /* the user's own eyes, and their own sound's features, which go where they are no longer asked for */
  cli_run(&cli, "prepare v.mp4 -o clip --size 160 --au truth/au.csv --features truth/aud_ds.npy --quiet");
  cli_expect(&cli, 0, NULL);
  assert_true(cli_there("clip/aud.npy"));
  assert_int_equal(system("cmp -s clip/au.csv au_first.csv"), 256);
  assert_int_equal(system("cp truth/au.csv $(printf 'au\\377.csv')"), 0); /* no UTF-8 */
  for (int i = 0; i < 2; i++) {
    const long long before_this = changed("clip/au.csv");
    cli_run(&cli, "prepare v.mp4 -o clip --size 160 --quiet --au au\377.csv --features truth/aud_ds.npy");
    cli_expect(&cli, 0, NULL);
    assert_true((changed("clip/au.csv") > before_this) == (i == 0));
  }
  cli_run(&cli, "prepare v.mp4 -o clip --size 160 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_false(cli_there("clip/aud.npy"));
  cli_same_bytes("clip/au.csv", "au_first.csv");
  /* features that the user put there are replaced with -y alone */
  support_write_text("clip/aud.npy", "mine");
  for (int i = 0; i < 3; i++) {
    cli_run(&cli, "prepare v.mp4 -o clip --size 160 --quiet%s", i == 1 ? "" : " --features truth/aud_ds.npy");
    cli_expect(&cli, i == 1 ? 0 : 1, i == 1 ? NULL : "clip/aud.npy: ernerf prepare did not make it", "--overwrite",
               NULL);
    assert_int_equal(system("printf mine | cmp - clip/aud.npy"), 0);
  }
  cli_run(&cli, "prepare v.mp4 -o clip --size 160 --quiet --features truth/aud_ds.npy -y");
  cli_expect(&cli, 0, NULL);
  assert_true(cli_there("clip/prepare.json") && system("printf mine | cmp -s - clip/aud.npy") != 0);
  cli_run(&cli, "prepare v.mp4 -o clip --size 160 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_false(cli_there("clip/aud.npy"));
  /* another content under the same name is another input */
  static const char *const lids[] = {"0.5", "1.25"};
  for (int i = 0; i < 2; i++) {
    char line[128];
    snprintf(line, sizeof line, "(echo AU45_r; for i in $(seq 30); do echo %s; done) >own.csv", lids[i]);
    assert_int_equal(system(line), 0);
    cli_run(&cli, "prepare v.mp4 -o clip --size 160 --quiet --au own.csv");
    cli_expect(&cli, 0, NULL);
    snprintf(line, sizeof line, "grep -q ', %s0*$' clip/au.csv", lids[i]);
    assert_int_equal(system(line), 0);
  }
  /* a file of a brought folder, rewritten in place */
  assert_int_equal(system("rm -rf masks && cp -r clip/parsing masks"), 0);
  for (int i = 0; i < 3; i++) {
    const long long before_this = changed("clip/bc.jpg");
    cli_run(&cli, "prepare v.mp4 -o clip --size 160 --quiet --masks masks");
    cli_expect(&cli, 0, NULL);
    assert_true((changed("clip/bc.jpg") > before_this) == (i != 1));
    if (i == 1) assert_int_equal(system("cat masks/19.png >masks/20.png"), 0);
  }
  /* a file that is gone is made again; with masks that are brought the layers take least */
  static const char *const gone[] = {"clip/torso_imgs/20.png", "clip/au.csv"};
  const long long layers = changed("clip/gt_imgs/0.jpg");
  for (int i = 0; i < 2; i++) {
    assert_int_equal(unlink(gone[i]), 0);
    cli_run(&cli, "prepare v.mp4 -o clip --size 160 --quiet --masks masks");
    cli_expect(&cli, 0, NULL);
    assert_true(cli_there(gone[i]));
  }
  assert_true(changed("clip/gt_imgs/0.jpg") > layers);
  cli_same_bytes("clip/au.csv", "au_first.csv");
  cli_run(&cli, "prepare v.mp4 -o clip --size 160 --only pose --focal 500");
  cli_expect(&cli, 0, "next: ernerf prepare VIDEO -o clip", "depend on changed ones: landmarks, layers, eyes\n", NULL);
  expect_no_training("\"landmarks\"");
  cli_run(&cli, "prepare v.mp4 -o clip --size 160 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "check clip");
  cli_expect_out(&cli, 0, NULL);
  cli_run(&cli, "prepare v.mp4 -o new --size 160 --only eyes");
  cli_expect(&cli, 1, "new", "\"face\"", "--only", NULL);
  assert_false(cli_there("new"));
}

/* Starts, waits for a file or for words on stderr ("\"..."), and sends SIGINT. */
static void start_and_stop(const char *sign) {
  snprintf(cli.line, sizeof cli.line, "prepare v.mp4 -o again --size 160");
  support_clear("cli_err.txt");
  cli_start(&cli, NULL, 0);
  for (int i = 0; i < 6000; i++) {
    cli_read("cli_err.txt", cli.err);
    if (sign[0] != '"' ? cli_there(sign) : strstr(cli.err, sign + 1) != NULL) break;
    nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
  }
  assert_int_equal(kill(cli.pid, SIGINT), 0);
  cli_wait(&cli);
  cli_expect(&cli, 128 + SIGINT, "goes on from here", NULL);
  expect_none_begun("again");
}

static void test_stopped_long(void **state) {
  (void)state;
  static const char *const same[] = {
      "transforms_train.json", "transforms_val.json", "au.csv",          "aud.wav",       "bc.jpg",
      "gt_imgs/7.jpg",         "torso_imgs/7.png",    "ori_imgs/29.jpg", "ori_imgs/7.lms"};
  start_and_stop("again/ori_imgs/10.jpg");
  assert_true(cli_there("again/prepare.json") && !cli_there("again/transforms_train.json"));
  start_and_stop("again/prepare/faces.csv");
  cli_run(&cli, "prepare v.mp4 -o again --size 160 --only face");
  cli_expect(&cli, 0, "again: 30 frames of 160 x 160; next: ernerf prepare", "steps that are left", NULL);
  start_and_stop("again/ori_imgs/9.lms");
  cli_run(&cli, "prepare v.mp4 -o again --size 160 --quiet");
  cli_expect(&cli, 0, NULL);
  for (size_t i = 0; i < sizeof same / sizeof *same; i++) {
    char one[256], other[256];
    snprintf(one, sizeof one, "again/%s", same[i]);
    snprintf(other, sizeof other, "clip/%s", same[i]);
    cli_same_bytes(one, other);
  }
}

/* The folder is moved away, and another clip has its name: the call ends, and no file of that clip is replaced. */
static void test_moved(void **state) {
  (void)state;
  static const char list[] = "find part -type f -printf '%p %i %T@\\n' | sort";
  char command[256];
  support_clear("moved");
  support_clear("part");
  assert_int_equal(system("rm -rf mine && cp -r clip mine"), 0);
  snprintf(cli.line, sizeof cli.line, "prepare v.mp4 -o part --size 160");
  support_clear("cli_err.txt");
  cli_start(&cli, NULL, 0);
  for (int i = 0; i < 6000 && !cli_there("part/transforms_train.json"); i++)
    nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
  assert_true(rename("part", "moved") == 0 && rename("mine", "part") == 0);
  snprintf(command, sizeof command, "%s >before.txt", list);
  assert_int_equal(system(command), 0);
  cli_wait(&cli);
  cli_expect(&cli, 1, "part", "moved", NULL);
  snprintf(command, sizeof command, "%s | cmp - before.txt", list);
  assert_int_equal(system(command), 0);
  support_clear("part");
  support_clear("moved");
}

/* A host program whose locale writes 0,5 gets the bytes that any other gets. */
static void test_comma_locale_long(void **state) {
  (void)state;
  static const char *const files[] = {
      "au.csv",           "transforms_train.json", "transforms_val.json", "ori_imgs/7.lms", "prepare/faces.csv",
      "prepare/pose.csv", "torso_imgs/7.png",      "report.html"};
  if (!support_comma_locale()) skip();
  support_clear("comma_clip");
  assert_non_null(setlocale(LC_NUMERIC, "comma_XX"));
  cli_run(&cli, "prepare v.mp4 -o comma_clip --size 160 --quiet");
  setlocale(LC_NUMERIC, "C");
  cli_expect(&cli, 0, NULL);
  for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
    char paths[2][64];
    for (int k = 0; k < 2; k++) snprintf(paths[k], sizeof *paths, "%s/%s", k == 0 ? "clip" : "comma_clip", files[i]);
    cli_same_bytes(paths[0], paths[1]);
  }
}

/* Another part of the video takes the clip's place only when asked to, and then nothing of the first one stays. */
static void test_replaced_long(void **state) {
  (void)state;
  cli_run(&cli, "prepare v.mp4 -o again --size 160 --from 0.16");
  cli_expect(&cli, 1, "again", "another video", "--overwrite", NULL);
  assert_true(cli_there("again/gt_imgs/29.jpg"));
  support_write_text("again/notes.txt", "mine");
  /* with the first part's masks, which saves their search */
  assert_int_equal(system("rm -rf part_masks && mkdir part_masks && for i in $(seq 0 25); do"
                          " cp clip/parsing/$i.png part_masks; done"),
                   0);
  cli_run(&cli, "prepare v.mp4 -o again --size 160 --to 1.04 -y --quiet --masks part_masks");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(cli_count("again/ori_imgs"), 2 * PART);
  assert_int_equal(cli_count("again/gt_imgs"), PART);
  assert_int_equal(cli_count("again/torso_imgs"), PART);
  assert_int_equal(cli_count("again/parsing"), PART);
  assert_true(cli_there("again/notes.txt"));
  cli_same_bytes("again/ori_imgs/7.jpg", "clip/ori_imgs/7.jpg");
  cli_run(&cli, "check again");
  cli_expect_out(&cli, 0, NULL);
  /* and the clip stays where the new video is refused */
  cli_run(&cli, "prepare v.mp4 -o again --size 160 --from 0.8 -y");
  cli_expect(&cli, 1, "v.mp4", "0.40 s long", "at least 1 s", NULL);
  cli_run(&cli, "check again");
  cli_expect_out(&cli, 0, NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_whole),
                                     cmocka_unit_test(test_truth),
                                     cmocka_unit_test(test_moved_sound),
                                     cmocka_unit_test(test_comma_locale_long),
                                     cmocka_unit_test(test_sound_ends_early),
                                     cmocka_unit_test(test_supplied_unread_long),
                                     cmocka_unit_test(test_second_call_long),
                                     cmocka_unit_test(test_stopped_long),
                                     cmocka_unit_test(test_moved),
                                     cmocka_unit_test(test_replaced_long)};
  return cmocka_run_group_tests(tests, make, NULL);
}
