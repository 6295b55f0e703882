/* SPDX-License-Identifier: MIT
 * `ernerf dub` on a made-up clip with its video: size, rate, length and sound of the output, which is the recorded
 * video outside the lower face; and what is refused. */
#include <math.h>
#include <time.h>

#include "dub/recorded_clip.h"

enum { SIDE = 96, FRAMES = 16, LONGER = 40, SHORTER = 9 };

static struct cli cli;

static void write_record(const char *hash, double from, int x) { recorded_clip_write(hash, from, x, SIDE, FRAMES); }

static int make_all(void **state) {
  (void)state;
  cli_run(&cli, "synth clip --size %d --frames %d --seed 3 --parsing --video clip.mp4 --quiet", SIDE, FRAMES);
  cli_expect(&cli, 0, NULL);
  write_record(NULL, 0, 0);
  cli_run(&cli,
          "train clip -o h.safetensors --iters 200 --rays 128 --lr 0.03 --lr_net 0.005 --levels 2 --validate-frames 1 "
          "--asr_model cepstra --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "synth longer --size 64 --frames %d --seed 4 --quiet", LONGER);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "synth shorter --size 64 --frames %d --seed 4 --quiet", SHORTER);
  cli_expect(&cli, 0, NULL);
  return 0;
}

/* Number of frames of the output; each is the recorded one, from frame `first` on, in its upper quarter. */
static size_t compare(const char *path, double rate, int first) {
  ern_context *context = support_context();
  ern_video_reader *readers[2] = {0};
  ern_image images[2] = {0};
  double seconds = 0;
  bool end = false;
  size_t k = 0, sum = 0;
  support_ok(context, ern_video_reader_open(context, path, &readers[0]));
  support_ok(context, ern_video_reader_open(context, "clip.mp4", &readers[1]));
  support_ok(context, ern_video_reader_seek(readers[1], first / rate));
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
  assert_int_equal(compare("out.mp4", 25, 0), FRAMES);
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

/* A head for dubbing says so; what renders it warns; it is no head of a portrait. */
static void test_for_dub(void **state) {
  (void)state;
  cli_run(&cli,
          "train clip -o for.safetensors --for dub --iters 5 --rays 256 --levels 2 --validate-frames 1 --asr_model "
          "cepstra --json for.json");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "info for.safetensors");
  cli_expect(&cli, 0, NULL);
  assert_non_null(strstr(cli.out, "use it for       dub"));
  cli_run(&cli, "eval for.safetensors clip --frames 0:1");
  cli_expect(&cli, 0, "was trained for `ernerf dub`: outside the lower face it is blurred", NULL);
  cli_run(&cli, "dub for.safetensors clip.mp4 --clip clip --audio clip/aud.wav -o for.mp4 --frames 0:1");
  cli_expect(&cli, 0, NULL);
  assert_null(strstr(cli.err, "blurred"));
  cli_run(&cli, "train clip -o for.safetensors --for dub --time 10s --torso_shrink 0.7");
  cli_expect(&cli, 2, "--torso_shrink is about the torso, which --for dub lacks", NULL);
  cli_run(&cli, "train clip -o for.safetensors --for dub --ray-sampling uniform");
  cli_expect(&cli, 2, "--ray-sampling and --for both choose rays", NULL);
}

/* `eval --compose dub`: the recorded picture outside the lower face, and figures of its own. The clip's pictures serve
 * as recorded ones. */
static void test_eval(void **state) {
  (void)state;
  cli_run(&cli, "eval h.safetensors clip --compose dub --split all --asr_model cepstra");
  cli_expect(&cli, 1, "ori_imgs/0.jpg", NULL);
  for (int i = 0; i < FRAMES; i++) {
    char from[64], to[64];
    snprintf(from, sizeof from, "../gt_imgs/%d.jpg", i);
    snprintf(to, sizeof to, "clip/ori_imgs/%d.jpg", i);
    assert_int_equal(symlink(from, to), 0);
  }
  cli_run(&cli, "eval h.safetensors clip --compose dub --split all --asr_model cepstra --json e.json --video e.mp4");
  cli_expect(&cli, 0, NULL);
  assert_non_null(strstr(cli.out, "dubbed: lower face PSNR"));
  json_t *all = cli_json(&cli, "e.json"), *dubbed = json_object_get(all, "dubbed");
  const double whole = json_number_value(json_object_get(all, "psnr")),
               lower = json_number_value(json_object_get(dubbed, "psnr_lower_face")),
               seam = json_number_value(json_object_get(dubbed, "seam_gradient"));
  assert_true(lower > 10 && lower < 40 && whole > lower + 3 &&
              json_is_number(json_object_get(dubbed, "psnr_jaw_band")));
  assert_true(seam > 0.5 && seam < 1.5 && json_is_number(json_object_get(dubbed, "flicker")));
  assert_int_equal(json_integer_value(json_object_get(dubbed, "left")), 0);
  json_decref(all);
  cli_run(&cli, "eval h.safetensors clip --compose dub --split all --asr_model cepstra --frames 0:1 --json one.json");
  cli_expect(&cli, 0, NULL);
  json_t *one = cli_json(&cli, "one.json");
  assert_true(json_is_null(json_object_get(json_object_get(one, "dubbed"), "flicker"))); /* it is of two frames */
  json_decref(one);
  cli_run(&cli,
          "train clip -o none.safetensors --iters 1 --rays 64 --levels 2 --validate-frames 1 --asr_model cepstra");
  cli_run(&cli, "eval none.safetensors clip --compose dub --split all --asr_model cepstra --json none.json");
  cli_expect(&cli, 0, "16 of 16 frames are left as recorded", NULL);
  json_t *none = cli_json(&cli, "none.json");
  assert_true(json_is_null(json_object_get(json_object_get(none, "dubbed"), "psnr_lower_face")));
  json_decref(none);
  cli_run(&cli, "eval h.safetensors clip --compose dub --refine-poses");
  cli_expect(&cli, 2, "--refine-poses is about frames that are rendered whole", NULL);
}

/* The first picture of `path` from second `seconds` on, in its upper quarter: grey levels. */
static void read_top(const char *path, double seconds, uint8_t top[SIDE * SIDE / 4 * 3]) {
  ern_context *context = support_context();
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  bool end = false;
  support_ok(context, ern_video_reader_open(context, path, &reader));
  support_ok(context, ern_video_reader_seek(reader, seconds));
  support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
  assert_false(end);
  memcpy(top, image.data, SIDE * SIDE / 4 * 3);
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
  ern_context_free(&context);
}

static int report_number(const char *name) {
  json_t *report = cli_json(&cli, NULL);
  const int value = (int)json_integer_value(json_object_get(report, name));
  json_decref(report);
  return value;
}

/* Longer words: the video turns, and never leaves a recorded frame out. */
static void test_longer(void **state) {
  (void)state;
  static uint8_t recorded[FRAMES][SIDE * SIDE / 4 * 3], top[SIDE * SIDE / 4 * 3];
  write_record(NULL, 0, 0);
  cli_run(&cli, "dub h.safetensors clip.mp4 --clip clip --audio longer/aud.wav -o turns.mp4 -y --json - --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(report_number("frames"), LONGER);
  assert_true(report_number("turns") >= LONGER / FRAMES);
  for (int k = 0; k < FRAMES; k++) read_top("clip.mp4", k / 25.0, recorded[k]);
  for (int k = 0, last = 0; k < LONGER; k++) {
    size_t least = SIZE_MAX;
    int shown = 0;
    read_top("turns.mp4", k / 25.0, top);
    for (int j = last - 1; j <= last + 1; j++) { /* which of the neighbours is it like most? */
      size_t sum = 0;
      if (j < 0 || j >= FRAMES) continue;
      for (size_t i = 0; i < sizeof top; i++) sum += (size_t)abs(top[i] - recorded[j][i]);
      if (sum < least) least = sum, shown = j;
    }
    assert_true(least < sizeof top * 4); /* 4 grey levels: H.264 coded twice */
    last = shown;
  }
}

/* Shorter words: the rest as recorded, with its sound, and known as not synthetic; or nothing. */
static void test_shorter(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_sound sound = {0}, recorded = {0};
  double loud = 0, apart = 0;
  write_record(NULL, 0, 0);
#define SHORT_DUB "dub h.safetensors clip.mp4 --clip clip --audio shorter/aud.wav -y --quiet --json - "
  cli_run(&cli, SHORT_DUB "-o rest.mp4");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(report_number("frames"), FRAMES);
  assert_int_equal(report_number("rest"), FRAMES - SHORTER);
  json_t *about = cli_json(&cli, "rest.mp4.provenance.json");
  const json_t *part = json_array_get(json_object_get(about, "synthetic_seconds"), 0);
  assert_true(json_number_value(json_array_get(part, 1)) == SHORTER / 25.0);
  json_decref(about);
  assert_int_equal(compare("rest.mp4", 25, 0), FRAMES);
  support_ok(context, ern_sound_read(context, "rest.mp4", &sound));
  support_ok(context, ern_sound_read(context, "clip.mp4", &recorded));
  assert_int_equal(sound.rate, recorded.rate);
  const size_t from = (size_t)(sound.rate * (SHORTER / 25.0 + 0.03)), to = (size_t)(sound.rate * 0.6);
  for (size_t i = from; i < to && i < sound.frames && i < recorded.frames; i++) {
    loud += recorded.data[i] * recorded.data[i];
    apart += (sound.data[i] - recorded.data[i]) * (sound.data[i] - recorded.data[i]);
  }
  assert_true(loud > 0 && apart < 0.1 * loud); /* AAC coded twice: 10 dB */
  ern_sound_free(context, &sound);
  ern_sound_free(context, &recorded);
  ern_context_free(&context);
  cli_run(&cli, SHORT_DUB "-o cut.webm --rest cut");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(report_number("frames"), SHORTER);
  cli_run(&cli, SHORT_DUB "-o rest.mkv --codec ffv1"); /* of RGB, so no frame is coded as it was decoded */
  cli_expect(&cli, 0, NULL);
  assert_int_equal(report_number("frames"), FRAMES);
#undef SHORT_DUB
}

static void test_part(void **state) {
  (void)state;
#define PART_DUB "dub h.safetensors clip.mp4 --clip clip --audio shorter/aud.wav -o part.mp4 -y --json - --quiet "
  write_record(NULL, 0, 0);
  cli_run(&cli, PART_DUB "--from 0.12 --to 0.56");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(report_number("frames"), 11);
  assert_int_equal(compare("part.mp4", 25, 3), 11);
  cli_run(&cli, PART_DUB "--from 0.4");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(report_number("frames"), SHORTER); /* of the six from there on, forward and backward */
  cli_run(&cli, PART_DUB "--from 0.4 --to 0.4");
  cli_expect(&cli, 2, "--from 0.40 --to 0.40, expected a part of the seconds 0.00 to 0.64 of clip.mp4", NULL);
  cli_run(&cli, PART_DUB "--to 0.7");
  cli_expect(&cli, 2, "--to 0.70, expected a part", NULL);
  cli_run(&cli, PART_DUB "--to 0.4 --frames 0:3");
  cli_expect(&cli, 2, "--frames", NULL);
#undef PART_DUB
}

/* A clip that begins between two recorded frames: its frames are the nearest ones, as `prepare` chooses them. The
 * output's pixels have the shape of the video's. */
static void test_between(void **state) {
  (void)state;
  static uint8_t top[SIDE * SIDE / 4 * 3];
  ern_context *context = support_context();
  ern_video_reader *reader = NULL;
  ern_video_info info;
  char hash[65];
  recorded_clip_grey("steps.mp4", 4.0 / 3, SIDE, SIDE, FRAMES);
  support_ok(context, ern_file_sha256(context, "steps.mp4", hash));
  write_record(hash, 0.03, 0);
  cli_run(&cli, "dub h.safetensors steps.mp4 --clip clip --audio shorter/aud.wav -o between.mp4 --rest cut -y --quiet");
  cli_expect(&cli, 0, NULL);
  for (int k = 0; k < SHORTER; k++) {
    read_top("between.mp4", k / 25.0, top);
    assert_in_range(top[0], 15 * (k + 1) - 4, 15 * (k + 1) + 4);
  }
  support_ok(context, ern_video_reader_open(context, "between.mp4", &reader));
  ern_video_reader_info(reader, &info);
  assert_true(fabs(info.pixel_aspect - 4.0 / 3) < 1e-9);
  ern_video_reader_free(&reader);
  ern_context_free(&context);
}

/* A video that gets another's name while the program starts: the prepared one is dubbed, or none. */
static void test_replaced(void **state) {
  (void)state;
  write_record(NULL, 0, 0);
  recorded_clip_grey("grey.mp4", 1, SIDE, SIDE, FRAMES);
  for (int tenths = 0; tenths < 4; tenths++) {
    char command[256];
    support_clear("moved.mp4");
    support_clear("moved_out.mp4");
    snprintf(command, sizeof command,
             "cp clip.mp4 moved.mp4; cp grey.mp4 next.mp4; { sleep 0.%d; mv next.mp4 moved.mp4; } &", tenths);
    assert_int_equal(system(command), 0);
    cli_run(&cli, "dub h.safetensors moved.mp4 --clip clip --audio clip/aud.wav -o moved_out.mp4 -y --quiet");
    if (cli_there("moved_out.mp4"))
      assert_int_equal(compare("moved_out.mp4", 25, 0), FRAMES);
    else
      cli_expect(&cli, 1, "moved.mp4: is not the video of clip", NULL);
    for (int i = 0; i < 1000 && cli_there("next.mp4"); i++)
      (void)nanosleep(&(struct timespec){.tv_nsec = 1000000}, NULL);
  }
}

/* A clip that lacks a frame: the poses after it would be those of other frames of the video. */
static void test_frame_lacks(void **state) {
  (void)state;
  write_record(NULL, 0, 0);
  assert_int_equal(system("rm -rf gap && cp -r clip gap"), 0);
  json_t *train = cli_json(&cli, "gap/transforms_train.json");
  assert_int_equal(json_array_remove(json_object_get(train, "frames"), 3), 0);
  assert_int_equal(json_dump_file(train, "gap/transforms_train.json", 0), 0);
  json_decref(train);
  cli_run(&cli, "dub h.safetensors clip.mp4 --clip gap --audio clip/aud.wav -o no.mp4 --force");
  cli_expect(&cli, 1, "gap: transforms_train.json and transforms_val.json: frame 3 has img_id 4, expected 3", NULL);
  assert_false(cli_there("no.mp4"));
}

static void test_refused(void **state) {
  (void)state;
#define DUB "dub h.safetensors clip.mp4 --clip clip --audio "
  write_record(NULL, 0, 0);
  cli_run(&cli, DUB "clip/aud.wav -o no%%d.png");
  cli_expect(&cli, 2, "expected a video", NULL);
  cli_run(&cli, DUB "clip/aud_ds.npy -o no.mp4");
  cli_expect(&cli, 2, "expected a sound", NULL);
  cli_run(&cli, DUB "clip/aud.wav -o clip.mp4 -y"); /* the video is an input */
  cli_expect(&cli, 1, "clip.mp4", NULL);
  write_record("0000000000000000000000000000000000000000000000000000000000000000", 0, 0);
  cli_run(&cli, DUB "clip/aud.wav -o no.mp4");
  cli_expect(&cli, 1, "clip.mp4: is not the video of clip", "expected 000000000000", NULL);
  cli_run(&cli, DUB "clip/aud.wav -o no.mp4 --torso model");
  cli_expect(&cli, 2, "--torso is about the torso, which stays as recorded", NULL);
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
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_dub),         cmocka_unit_test(test_replaced),
                                     cmocka_unit_test(test_for_dub),     cmocka_unit_test(test_eval),
                                     cmocka_unit_test(test_longer),      cmocka_unit_test(test_shorter),
                                     cmocka_unit_test(test_part),        cmocka_unit_test(test_between),
                                     cmocka_unit_test(test_frame_lacks), cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, make_all, NULL);
}
