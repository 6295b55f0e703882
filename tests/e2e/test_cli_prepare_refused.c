/* SPDX-License-Identifier: MIT
 * Videos that no clip can be made of, and folders that are not the program's: a message, exit status 1, nothing
 * half-written. */
#include "cli.h"

#include <math.h>

#include "core/memory.h"
#include "ernerf/media.h"

enum { FRAMES = 30, SIDE = 160, WIDE = 6 * SIDE, HIGH = 4 * SIDE };
static struct cli cli;
static ern_image frames[FRAMES];

/* How a made video differs from the first one. */
enum kind { STILL, CUT, DIM, SILENT, NOBODY, TINY, SHORT, MUTED, SMALL, KINDS };
static const char *const names[KINDS] = {"still.mp4", "cut.mp4",   "dim.mp4",   "silent.mp4", "nobody.mp4",
                                         "tiny.mp4",  "short.mp4", "muted.mp4", "small.mp4"};

static void paint(enum kind kind, int k, uint8_t *rgba) {
  const ern_image *from = &frames[kind == STILL ? 0 : k];
  const int t = k > FRAMES / 2 ? k - FRAMES / 2 : 0; /* the light goes down in five frames */
  const float light = kind == DIM ? fmaxf(0.3f, 1 - 0.03f * (float)(t * t)) : 1;
  for (int i = 0; i < SIDE * SIDE; i++) {
    const int x = i % SIDE, y = i / SIDE;
    const bool other = kind == CUT && k >= FRAMES / 2; /* the other half: mirrored, in other light */
    const uint8_t *p = from->data + 3 * (other ? y * SIDE + SIDE - 1 - x : i);
    for (int c = 0; c < 3; c++) rgba[4 * i + c] = kind == NOBODY ? 90 : (uint8_t)(light * (other ? p[c] / 3 : p[c]));
    rgba[4 * i + 3] = 255;
  }
}

/* A lecture: the person is a small part of a picture that keeps still otherwise. */
static void paint_small(int k, uint8_t *rgba) {
  memset(rgba, 90, (size_t)4 * WIDE * HIGH);
  for (int y = 0; y < SIDE; y++)
    for (int x = 0; x < SIDE; x++)
      memcpy(rgba + 4 * ((size_t)(y + SIDE) * WIDE + (size_t)(x + SIDE)), frames[k].data + 3 * (y * SIDE + x), 3);
}

static void make_video(ern_context *context, enum kind kind, const ern_sound *sound) {
  static uint8_t rgba[4 * WIDE * HIGH];
  const int side = kind == TINY ? 2 : SIDE;
  ern_video_options options = ern_video_options_default(kind == SMALL ? WIDE : side, kind == SMALL ? HIGH : side);
  ern_video_writer *writer = NULL;
  ern_sound muted = *sound;
  muted.data = calloc(muted.frames * (size_t)muted.channels, sizeof *muted.data);
  if (kind != SILENT) options.sound = kind == MUTED ? &muted : sound;
  support_ok(context, ern_video_writer_open(context, names[kind], &options, &writer));
  for (int k = 0; k < (kind == SHORT ? FRAMES / 2 : FRAMES); k++) {
    if (kind == SMALL)
      paint_small(k, rgba);
    else
      paint(kind, k, rgba);
    support_ok(context, ern_video_writer_frame(writer, rgba));
  }
  support_ok(context, ern_video_writer_close(&writer));
  free(muted.data);
}

static int make(void **state) {
  (void)state;
  support_clear("truth");
  support_clear("v.mp4");
  for (int i = 0; i < KINDS; i++) remove(names[i]);
  cli_shared_video();
  ern_context *context = support_context();
  ern_video_reader *reader = NULL;
  ern_sound sound = {0};
  bool end = false;
  double seconds = 0;
  support_ok(context, ern_video_reader_open(context, "v.mp4", &reader));
  for (int k = 0; k < FRAMES; k++) support_ok(context, ern_video_reader_frame(reader, &frames[k], &seconds, &end));
  ern_video_reader_free(&reader);
  support_ok(context, ern_sound_read(context, "v.mp4", &sound));
  for (int i = 0; i < KINDS; i++) make_video(context, (enum kind)i, &sound);
  ern_sound_free(context, &sound);
  for (int k = 0; k < FRAMES; k++) ern_image_free(context, &frames[k]);
  ern_context_free(&context);
  size_t count = 0;
  uint8_t *bytes = cli_bytes("v.mp4", &count);
  support_write("third.mp4", bytes, count / 3);
  support_write("empty.mp4", bytes, 0);
  support_write("head.mp4", bytes, 64);
  free(bytes);
  support_write_text("text.mp4", "Once upon a time there was no video.\n");
  return 0;
}

static void expect_none_begun(void) { assert_int_equal(system("test -z \"$(find . -name '*.ernerf-tmp*')\""), 0); }

/* Looked at, and refused in words that name the video, what was found and what was expected. What is left is a record
 * and a report, and no training takes it. */
static void expect_verdict(const char *video, const char *found, const char *expected) {
  support_clear("clip");
  cli_run(&cli, "prepare %s -o clip --size 160", video);
  cli_expect(&cli, 1, video, found, expected, NULL);
  assert_true(cli_there("clip/prepare.json") && cli_there("clip/report.html"));
  assert_false(cli_there("clip/transforms_train.json") || cli_there("clip/transforms_val.json"));
  expect_none_begun();
  cli_run(&cli, "train clip -o m.safetensors --iters 2 --rays 64 --levels 2 --quiet");
  cli_expect(&cli, 1, "clip", NULL);
  assert_false(cli_there("m.safetensors"));
}

static void test_verdicts(void **state) {
  (void)state;
  expect_verdict("still.mp4", "still", "expected");
  expect_verdict("cut.mp4", "cut", "--to");
  expect_verdict("nobody.mp4", "no face was found in 1 s", "expected a person");
  expect_verdict("short.mp4", "0.60 s long", "expected at least 1 s");
}

static void test_small_person(void **state) {
  (void)state;
  support_clear("clip");
  cli_run(&cli, "prepare small.mp4 -o clip --size 160 --only face");
  cli_expect(&cli, 0, "1.2 s long", NULL);
}

/* A light that goes down within a fifth of a second is no cut. */
static void test_light_long(void **state) {
  (void)state;
  support_clear("clip");
  cli_run(&cli, "prepare dim.mp4 -o clip --size 160 --only face");
  cli_expect(&cli, 0, "1.2 s long", NULL);
  assert_null(strstr(cli.err, "at once"));
  support_clear("clip");
  cli_run(&cli, "prepare dim.mp4 -o clip --size 160 --only face --to 1.1"); /* as good as its end */
  cli_expect(&cli, 0, NULL);
  assert_null(strstr(cli.err, "ends at"));
  support_clear("clip");
  cli_run(&cli, "prepare dim.mp4 -o clip --size 160 --only face --to 99");
  cli_expect(&cli, 0, "face: doubtful", "the video ends at 1.20 s, before --to 99", NULL);
}

/* What is read may not lie where the clip is written, a link of the clip is not written through, and --json is no file
 * of the clip. */
static void test_inputs_and_links(void **state) {
  (void)state;
  support_clear("clip");
  assert_int_equal(mkdir("clip", 0777), 0);
  assert_int_equal(system("cp cut.mp4 clip/own.mp4 && cp cut.mp4 was.mp4 && ln -sf clip/own.mp4 link.mp4"), 0);
  static const char *const videos[] = {"clip/own.mp4", "link.mp4"};
  for (int i = 0; i < 2; i++) {
    cli_run(&cli, "prepare %s -o clip --size 160 -y", videos[i]);
    cli_expect(&cli, 1, videos[i], "is an input, and is in clip", NULL);
    assert_int_equal(system("cmp was.mp4 clip/own.mp4"), 0);
  }
  support_clear("clip");
  cli_run(&cli, "prepare cut.mp4 -o clip --size 160");
  cli_expect(&cli, 1, "cut", NULL);
  support_write_text("mine.html", "mine");
  assert_int_equal(system("rm clip/report.html && ln -s ../mine.html clip/report.html"), 0);
  cli_run(&cli, "prepare cut.mp4 -o clip --size 160");
  cli_expect(&cli, 1, NULL);
  assert_int_equal(system("printf mine | cmp - mine.html"), 0);
  cli_run(&cli, "prepare cut.mp4 -o clip --size 160 --json clip/prepare.json -y");
  cli_expect(&cli, 1, "is in clip", NULL);
}

/* A folder that an earlier call was refused in has nothing of a clip: files of such names are the user's. */
static void test_files_of_others(void **state) {
  (void)state;
  static const char *const mine[] = {"aud.wav", "transforms_train.json", "bc.jpg",
                                     "au.csv",  "ori_imgs/3.jpg",        "ori_imgs/3.lms"};
  support_clear("clip");
  cli_run(&cli, "prepare still.mp4 -o clip --size 160");
  cli_expect(&cli, 1, "still", NULL);
  assert_int_equal(mkdir("clip/ori_imgs", 0777), 0);
  for (size_t i = 0; i < sizeof mine / sizeof *mine; i++) {
    char path[64], same[128];
    snprintf(path, sizeof path, "clip/%s", mine[i]);
    snprintf(same, sizeof same, "printf mine | cmp - %s", path);
    support_write_text(path, "mine");
    for (int k = 0; k < 2; k++) {
      cli_run(&cli, "prepare %s -o clip --size 160 --quiet", k == 0 ? "still.mp4" : "v.mp4");
      cli_expect(&cli, 1, path, "ernerf prepare did not make it", NULL);
      assert_int_equal(system(same), 0);
    }
    assert_int_equal(remove(path), 0);
  }
}

/* A track without speech: before a frame is written; and in a clip of another program. */
static void test_muted(void **state) {
  (void)state;
  static int16_t silence[16000];
  const ern_sound sound = {.rate = 16000, .channels = 1, .frames = 16000, .data = silence};
  ern_context *context = support_context();
  support_clear("muted");
  cli_run(&cli, "prepare muted.mp4 -o muted --size 160");
  cli_expect(&cli, 1, "face", "the sound of the part is silent", "--features FILE.npy", NULL);
  assert_false(cli_there("muted/ori_imgs"));
  support_clear("muted");
  cli_copy("truth", "muted");
  assert_int_equal(remove("muted/aud_ds.npy"), 0);
  remove("muted/aud.wav");
  support_ok(context, ern_sound_write_wav(context, "muted/aud.wav", &sound));
  cli_run(&cli, "check muted");
  cli_expect_out(&cli, 1, "aud.wav: is silent: its features are the same in every window", "Not ready", NULL);
  ern_context_free(&context);
}

/* No speech, no mouth: told before a frame is read; brought features help. A call that is refused takes nothing away
 * that an earlier one made. */
static void test_silent_long(void **state) {
  (void)state;
  support_clear("clip");
  cli_run(&cli, "prepare silent.mp4 -o clip --size 160");
  cli_expect(&cli, 1, "silent.mp4: the video has no sound", "--features FILE.npy", NULL);
  assert_false(cli_there("clip"));
  /* with masks, which saves their search */
  cli_run(&cli, "prepare silent.mp4 -o clip --size 160 --features truth/aud_ds.npy --masks truth/parsing --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o m.safetensors --iters 2 --rays 64 --levels 2 --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  support_clear("m.safetensors");
  support_clear("m.run");
  static const char *const refused[] = {"silent.mp4 --quiet", "silent.mp4 --only face", "still.mp4 -y",
                                        "silent.mp4 --quiet" /* and a frame is gone */};
  static const char list[] = "find clip -type f -printf '%p %T@ %s\\n' | sort";
  char command[256];
  for (int i = 0; i < 4; i++) {
    if (i == 3) assert_int_equal(rename("clip/ori_imgs/7.jpg", "7.jpg"), 0);
    snprintf(command, sizeof command, "%s >before.txt", list);
    assert_int_equal(system(command), 0);
    cli_run(&cli, "prepare %s -o clip --size 160", refused[i]);
    cli_expect(&cli, 1, i == 2 ? "still" : "has no sound", NULL);
    snprintf(command, sizeof command, "%s | cmp - before.txt", list);
    assert_int_equal(system(command), 0);
  }
  assert_int_equal(rename("7.jpg", "clip/ori_imgs/7.jpg"), 0);
  /* nor one that meets a pipe or a folder in the place of a file, which it then forgets to have made */
  static const char others[] = "find clip -type f ! -name prepare.json -printf '%p %T@ %s\\n' | sort";
  assert_int_equal(remove("clip/transforms_val.json"), 0);
  for (int i = 0; i < 2; i++) {
    assert_int_equal(i == 0 ? mkfifo("clip/transforms_val.json", 0644) : mkdir("clip/transforms_val.json", 0755), 0);
    snprintf(command, sizeof command, "%s >before.txt", others);
    assert_int_equal(system(command), 0);
    cli_run(&cli, "prepare silent.mp4 -o clip --size 160 --features truth/aud_ds.npy --only pose");
    cli_expect(&cli, 1, "clip/transforms_val.json: is no regular file", NULL);
    snprintf(command, sizeof command, "%s | cmp - before.txt", others);
    assert_int_equal(system(command), 0);
    assert_int_equal(remove("clip/transforms_val.json"), 0);
  }
}

/* Nor does what is no network of faces. */
static void test_no_detector(void **state) {
  (void)state;
  static const char *const bad[] = {"text.mp4", "empty.mp4", "v.mp4", "nowhere.onnx", "truth"};
  for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
    support_clear("clip");
    cli_run(&cli, "prepare v.mp4 -o clip --size 160 --detector %s", bad[i]);
    cli_expect(&cli, 1, bad[i], NULL);
    assert_false(cli_there("clip"));
  }
}

/* What cannot be read as a video leaves no folder behind. */
static void test_no_videos(void **state) {
  (void)state;
  static const char *const bad[] = {"third.mp4",     "empty.mp4", "head.mp4", "text.mp4",
                                    "truth/aud.wav", "tiny.mp4",  "none.mp4", "truth"};
  support_clear("clip");
  for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
    cli_run(&cli, "prepare %s -o clip --size 160", bad[i]);
    cli_expect(&cli, 1, bad[i], NULL);
    const bool third = strcmp(bad[i], "third.mp4") == 0,
               read = third || strcmp(bad[i], "tiny.mp4") == 0; /* are videos */
    if (third) cli_expect(&cli, 1, "third.mp4: is cut short: its last packet is not whole", NULL);
    if (cli_there("clip") != read) fail_msg("ernerf %s: %s", cli.line, read ? "no report" : "clip is left");
    support_clear("clip");
    expect_none_begun();
  }
}

/* Somebody's own files stay as they are, whatever is asked. */
static void test_folders_long(void **state) {
  (void)state;
  support_clear("clip");
  support_clear("mine");
  assert_int_equal(mkdir("mine", 0777), 0);
  support_write_text("mine/thesis.txt", "mine");
  for (int i = 0; i < 2; i++) {
    cli_run(&cli, "prepare v.mp4 -o mine --size 160%s", i == 0 ? "" : " -y");
    cli_expect(&cli, 1, "mine", "did not make", "empty folder", NULL);
    assert_int_equal(cli_count("mine"), 1);
    cli_run(&cli, "prepare v.mp4 -o mine/thesis.txt --size 160%s", i == 0 ? "" : " -y");
    cli_expect(&cli, 1, "mine/thesis.txt", NULL);
    cli_run(&cli, "prepare v.mp4 -o v.mp4%s", i == 0 ? "" : " -y");
    cli_expect(&cli, 1, "v.mp4", NULL);
    cli_run(&cli, "prepare v.mp4 -o truth%s", i == 0 ? "" : " -y"); /* a clip, but none of prepare's */
    cli_expect(&cli, 1, "truth", "did not make", NULL);
  }
  assert_int_equal(system("printf mine | cmp - mine/thesis.txt"), 0);
  support_write_text("mine/prepare.json", "{\"version\": 7}");
  cli_run(&cli, "prepare v.mp4 -o mine -y");
  cli_expect(&cli, 1, "mine/prepare.json", "version 2", NULL);
  cli_run(&cli, "prepare v.mp4");
  cli_expect(&cli, 2, "-o CLIP is missing", NULL);
  cli_run(&cli, "prepare v.mp4 -o clip --from 2 --to 1");
  cli_expect(&cli, 2, "--from", "--to", NULL);
  cli_run(&cli, "prepare v.mp4 -o clip --from 9");
  cli_expect(&cli, 1, "v.mp4", "the part --from 9 of a video of 1.20 s is 0.00 s long", NULL);
  support_clear("clip");
  cli_run(&cli, "prepare v.mp4 -o clip --from 0.1 --to 0.4");
  cli_expect(&cli, 1, "v.mp4", "the part --from 0.1 --to 0.4 is 0.32 s long", NULL);
  cli_run(&cli, "prepare v.mp4 -o clip --size 100");
  cli_expect(&cli, 2, "--size", NULL);
  cli_run(&cli, "prepare v.mp4 -o clip --focal 7");
  cli_expect(&cli, 1, "focal is 7", NULL);
  cli_run(&cli, "prepare v.mp4 -o clip --focal 600 --poses truth/transforms_train.json");
  cli_expect(&cli, 2, "--focal and --poses exclude each other", NULL);
  support_clear("mine");
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_verdicts),        cmocka_unit_test(test_small_person),
                                     cmocka_unit_test(test_light_long),      cmocka_unit_test(test_inputs_and_links),
                                     cmocka_unit_test(test_files_of_others), cmocka_unit_test(test_muted),
                                     cmocka_unit_test(test_silent_long),     cmocka_unit_test(test_no_detector),
                                     cmocka_unit_test(test_no_videos),       cmocka_unit_test(test_folders_long)};
  return cmocka_run_group_tests(tests, make, NULL);
}
