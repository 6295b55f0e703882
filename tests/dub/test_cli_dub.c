/* SPDX-License-Identifier: MIT
 * `ernerf dub` on a made-up clip with its video: size, rate, length and sound of the output, which is the recorded
 * video outside the lower face; and what is refused. The record of `ernerf prepare` is written here. */
#include <time.h>

#include "e2e/cli.h"

#include "ernerf/media.h"
#include "ernerf/model.h"

enum { SIDE = 96, FRAMES = 16 };

static struct cli cli;

static void write_record(const char *hash, double from, int x) {
  ern_context *context = support_context();
  static const char *const steps[] = {"face", "pose", "landmarks", "layers", "eyes", "features"};
  char text[2048], done[1024] = "", own[65];
  struct stat about;
  assert_int_equal(stat("clip.mp4", &about), 0);
  support_ok(context, ern_file_sha256(context, "clip.mp4", own));
  for (size_t i = 0; i < sizeof steps / sizeof *steps; i++)
    snprintf(done + strlen(done), sizeof done - strlen(done), "%s\"%s\": {\"verdict\": \"good\", \"words\": \"\"}",
             i > 0 ? ", " : "", steps[i]);
  const int bytes = snprintf(
      text, sizeof text,
      "{\"version\": 2, \"video\": \"clip.mp4\", \"source\": {\"bytes\": %lld, \"from\": %.1f}, \"frames\": %d,"
      " \"steps\": {%s}, \"crop\": {\"x\": %d, \"y\": 0, \"width\": %d, \"side\": %d, \"sha256\": \"%s\"}}",
      (long long)about.st_size, from, FRAMES, done, x, SIDE, SIDE, hash != NULL ? hash : own);
  cli_replace("clip/prepare.json", text, (size_t)bytes);
  ern_context_free(&context);
}

static int make_all(void **state) {
  (void)state;
  cli_run(&cli, "synth clip --size %d --frames %d --seed 3 --parsing --video clip.mp4 --quiet", SIDE, FRAMES);
  cli_expect(&cli, 0, NULL);
  write_record(NULL, 0, 0);
  cli_run(&cli,
          "train clip -o h.safetensors --iters 30 --rays 256 --levels 2 --validate-frames 1 --asr_model cepstra "
          "--quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "synth longer --size 64 --frames %d --seed 4 --quiet", FRAMES + 9);
  cli_expect(&cli, 0, NULL);
  return 0;
}

/* Number of frames of the output; each is the recorded one in its corners and at its upper edge. */
static size_t compare(const char *path, double rate) {
  ern_context *context = support_context();
  ern_video_reader *readers[2] = {0};
  ern_image images[2] = {0};
  double seconds = 0;
  bool end = false;
  size_t k = 0, sum = 0;
  support_ok(context, ern_video_reader_open(context, path, &readers[0]));
  support_ok(context, ern_video_reader_open(context, "clip.mp4", &readers[1]));
  for (;; k++) {
    support_ok(context, ern_video_reader_frame(readers[0], &images[0], &seconds, &end));
    if (end) break;
    assert_true(seconds > (double)k / rate - 1e-3 && seconds < (double)k / rate + 1e-3);
    support_ok(context, ern_video_reader_frame(readers[1], &images[1], &seconds, &end));
    assert_false(end);
    assert_true(images[0].width == SIDE && images[0].height == SIDE);
    for (size_t i = 0; i < (size_t)SIDE * SIDE / 4 * 3; i++) sum += (size_t)abs(images[0].data[i] - images[1].data[i]);
  }
  assert_true(sum < k * SIDE * SIDE / 4 * 3 * 4); /* 4 grey levels: H.264 coded twice */
  for (int i = 0; i < 2; i++) {
    ern_image_free(context, &images[i]);
    ern_video_reader_free(&readers[i]);
  }
  ern_context_free(&context);
  return k;
}

static void test_dub(void **state) {
  (void)state;
  write_record(NULL, 0, 0);
  cli_run(&cli, "dub h.safetensors clip.mp4 --clip clip --audio clip/aud.wav -o out.mp4 -y --json - --quiet");
  cli_expect(&cli, 0, NULL);
  json_t *report = cli_json(&cli, NULL);
  assert_int_equal(json_integer_value(json_object_get(report, "frames")), FRAMES);
  assert_int_equal(json_integer_value(json_object_get(report, "left")), 0);
  json_decref(report);
  assert_int_equal(compare("out.mp4", 25), FRAMES);
  json_t *about = cli_json(&cli, "out.mp4.provenance.json");
  const json_t *part = json_array_get(json_object_get(about, "synthetic_seconds"), 0);
  assert_true(json_number_value(json_array_get(part, 1)) == FRAMES / 25.0);
  assert_string_equal(json_string_value(json_object_get(about, "digital_source_type")),
                      "compositeWithTrainedAlgorithmicMedia");
  json_decref(about);
  ern_context *context = support_context();
  ern_sound sound = {0};
  support_ok(context, ern_sound_read(context, "out.mp4", &sound));
  assert_true(sound.frames > (size_t)sound.rate / 2);
  ern_sound_free(context, &sound);
  ern_context_free(&context);
}

static void write_black(const char *path) {
  static const uint8_t rgba[SIDE * SIDE * 4];
  ern_context *context = support_context();
  const ern_video_options options = ern_video_options_default(SIDE, SIDE);
  ern_video_writer *writer = NULL;
  support_ok(context, ern_video_writer_open(context, path, &options, &writer));
  for (int k = 0; k < FRAMES; k++) support_ok(context, ern_video_writer_frame(writer, rgba));
  support_ok(context, ern_video_writer_close(&writer));
  ern_context_free(&context);
}

/* A video that gets another's name while the program starts: the prepared one is dubbed, or none. */
static void test_replaced(void **state) {
  (void)state;
  write_record(NULL, 0, 0);
  write_black("black.mp4");
  for (int tenths = 0; tenths < 4; tenths++) {
    char command[256];
    support_clear("moved.mp4");
    support_clear("moved_out.mp4");
    snprintf(command, sizeof command,
             "cp clip.mp4 moved.mp4; cp black.mp4 next.mp4; { sleep 0.%d; mv next.mp4 moved.mp4; } &", tenths);
    assert_int_equal(system(command), 0);
    cli_run(&cli, "dub h.safetensors moved.mp4 --clip clip --audio clip/aud.wav -o moved_out.mp4 -y --quiet");
    if (cli_there("moved_out.mp4"))
      assert_int_equal(compare("moved_out.mp4", 25), FRAMES);
    else
      cli_expect(&cli, 1, "moved.mp4: is not the video of clip", NULL);
    for (int i = 0; i < 1000 && cli_there("next.mp4"); i++)
      (void)nanosleep(&(struct timespec){.tv_nsec = 1000000}, NULL);
  }
}

static void test_refused(void **state) {
  (void)state;
#define DUB "dub h.safetensors clip.mp4 --clip clip --audio "
  write_record(NULL, 0, 0);
  cli_run(&cli, DUB "longer/aud.wav -o no.mp4");
  cli_expect(&cli, 1, "longer/aud.wav: the new words last 1.00 s, expected at most the 0.64 s of clip", NULL);
  cli_run(&cli, DUB "clip/aud.wav -o no%%d.png");
  cli_expect(&cli, 2, "expected a video", NULL);
  cli_run(&cli, DUB "clip/aud_ds.npy -o no.mp4");
  cli_expect(&cli, 2, "expected a sound", NULL);
  cli_run(&cli, DUB "clip/aud.wav -o clip.mp4 -y"); /* the video is an input */
  cli_expect(&cli, 1, "clip.mp4", NULL);
  write_record("0000000000000000000000000000000000000000000000000000000000000000", 0, 0);
  cli_run(&cli, DUB "clip/aud.wav -o no.mp4");
  cli_expect(&cli, 1, "clip.mp4: is not the video of clip", "expected 000000000000", NULL);
  write_record(NULL, 0, 8);
  cli_run(&cli, DUB "clip/aud.wav -o no.mp4");
  cli_expect(&cli, 1, "the square ends at 104, 96, but clip.mp4 has 96 x 96 pixels", NULL);
  write_record(NULL, 0.2, 0);
  cli_run(&cli, DUB "clip/aud.wav -o no.mp4");
  cli_expect(&cli, 1, "clip.mp4: ends before frame 1", NULL);
  cli_replace("clip/prepare.json", "{}", 2);
  cli_run(&cli, DUB "clip/aud.wav -o no.mp4");
  cli_expect(&cli, 1, "clip/prepare.json: has no \"crop\"", NULL);
  support_clear("clip/prepare.json");
  cli_run(&cli, DUB "clip/aud.wav -o no.mp4");
  cli_expect(&cli, 1, "a clip that `ernerf prepare` made of the video is needed", NULL);
  assert_false(cli_there("no.mp4"));
#undef DUB
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_dub), cmocka_unit_test(test_replaced),
                                     cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, make_all, NULL);
}
