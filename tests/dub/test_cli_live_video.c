/* SPDX-License-Identifier: MIT
 * `ernerf live --video` on a made-up clip and a video: the frames are the recorded ones, forward and backward, with
 * another mouth; and what is refused. */
#include <math.h>

#include "dub/recorded_clip.h"

/* The clip's square is that of SIDE pixels at column LEFT of the video, which is WIDTH pixels wide. */
enum { SIDE = 96, WIDTH = 132, LEFT = 17, FRAMES = 16, LONGER = 40, BRIEF = 8, SOUND_RATE = 16000 };

static struct cli cli;

/* sound.pcm: a tone that comes and goes, LONGER frames long; brief.pcm: its first BRIEF frames. */
static void write_sound(void) {
  static int16_t samples[LONGER * SOUND_RATE / 25];
  for (int i = 0; i < LONGER * SOUND_RATE / 25; i++) samples[i] = (int16_t)(8000 * sin(0.09 * i) * sin(0.001 * i));
  cli_replace("sound.pcm", samples, sizeof samples);
  cli_replace("brief.pcm", samples, sizeof samples / LONGER * BRIEF);
}

static int make_all(void **state) {
  (void)state;
  recorded_clip_take(false);
  recorded_clip_grey("clip.mp4", 4.0 / 3, WIDTH, SIDE, FRAMES);
  recorded_clip_write(NULL, 0, LEFT, SIDE, FRAMES);
  write_sound();
  return 0;
}

/* The recorded frame that a picture shows: outside the square, and at its top, it is that frame, but for the lower
 * quarter, where a label is; within the square there is a mouth. */
static int shown_in(const ern_image *picture) {
  const int shown = (picture->data[0] + 7) / 15, grey = 15 * shown;
  int most = 0;
  assert_true(picture->width == WIDTH && picture->height == SIDE);
  for (int i = 0; i < WIDTH * SIDE * 3; i++) {
    const int x = i / 3 % WIDTH, y = i / 3 / WIDTH, apart = abs(picture->data[i] - grey);
    if (y < SIDE / 4 || (y < SIDE / 4 * 3 && (x < LEFT || x >= LEFT + SIDE)))
      assert_true(apart <= 5); /* H.264 coded twice */
    if (apart > most) most = apart;
  }
  assert_true(most > 15);
  return shown;
}

/* A video of LONGER frames, whose pixels have the recorded shape: it turns, and no recorded frame is left out or jumped
 * over. */
static void check_order(const char *path) {
  ern_context *context = support_context();
  ern_video_reader *reader = NULL;
  ern_image picture = {0};
  double seconds = 0;
  bool end = false;
  int count = 0, turns = 0, last = -1, way = 1;
  support_ok(context, ern_video_reader_open(context, path, &reader));
  ern_video_info info;
  ern_video_reader_info(reader, &info);
  assert_true(fabs(info.pixel_aspect - 4.0 / 3) < 1e-9);
  for (;; count++) {
    support_ok(context, ern_video_reader_frame(reader, &picture, &seconds, &end));
    if (end) break;
    const int shown = shown_in(&picture);
    if (last >= 0 && shown != last + way) {
      assert_int_equal(shown, last - way);
      way = -way;
      turns++;
    }
    last = shown;
  }
  assert_int_equal(count, LONGER);
  assert_in_range(turns, 2, LONGER / (FRAMES / 2)); /* the ends where it turns are within a quarter of the video */
  ern_image_free(context, &picture);
  ern_video_reader_free(&reader);
  ern_context_free(&context);
}

/* x264 says its settings in what it codes: superfast alone of its presets has this one. */
static void check_preset(const char *path) {
  static const char fast[] = " subme=1 ";
  size_t bytes = 0, at = 0;
  uint8_t *coded = cli_bytes(path, &bytes);
  while (at < bytes && strncmp((const char *)coded + at, fast, sizeof fast - 1) != 0) at++; /* a 0 follows the bytes */
  assert_true(at < bytes);
  free(coded);
}

/* A sound longer than the video; coded as decoded, and as RGB. */
static void test_frames(void **state) {
  (void)state;
#define LONG_LIVE "live h.safetensors --clip clip --video clip.mp4 --audio sound.pcm --audio-format s16le --as-fast "
  cli_run(&cli, LONG_LIVE "-o out.mp4 --json - --quiet");
  cli_expect(&cli, 0, NULL);
  json_t *report = cli_json(&cli, NULL), *about = cli_json(&cli, "out.mp4.provenance.json");
  assert_int_equal(json_integer_value(json_object_get(report, "drawn")), LONGER);
  assert_int_equal(json_integer_value(json_object_get(report, "as_recorded")), 0);
  assert_string_equal(json_string_value(json_object_get(about, "recorded")), "clip.mp4");
  json_decref(report);
  json_decref(about);
  check_order("out.mp4");
  check_preset("out.mp4");
  cli_run(&cli, LONG_LIVE "-o marked.mp4 --label . --quiet");
  cli_expect(&cli, 0, NULL);
  check_order("marked.mp4");
  cli_run(&cli, LONG_LIVE "--max-delay 0.04 -o short.mp4"); /* the speech that it skips is not lost in silence */
  cli_expect(&cli, 0, " frames written, 0 repeated, 0 left out, ", " skipped: short.mp4", NULL);
  assert_null(strstr(cli.err, " 0 skipped"));
#undef LONG_LIVE
}

/* More frames than the video has: in silence, frames that show the same recorded one are the same, as the mouth is
 * where the recorded one is, not where it would be between two of them. */
static void test_other_rate(void **state) {
  (void)state;
  enum { RESTS = 20 };
  static const int16_t silence[LONGER * SOUND_RATE / 25];
  static uint8_t before[3 * WIDTH * SIDE];
  ern_context *context = support_context();
  ern_video_reader *reader = NULL;
  ern_image picture = {0};
  double seconds = 0;
  bool end = false;
  int same = 0, count = 0;
  cli_replace("silence.pcm", silence, sizeof silence);
  cli_run(&cli,
          "live h.safetensors --clip clip --video clip.mp4 --audio silence.pcm --audio-format s16le --as-fast --fps 50 "
          "-o fast.y4m --quiet");
  cli_expect(&cli, 0, NULL);
  support_ok(context, ern_video_reader_open(context, "fast.y4m", &reader));
  for (int last = -1;; count++) {
    support_ok(context, ern_video_reader_frame(reader, &picture, &seconds, &end));
    if (end) break;
    const int shown = shown_in(&picture);
    assert_true(last < 0 || abs(shown - last) <= 1);
    if (count > RESTS && shown == last) {
      assert_memory_equal(picture.data, before, sizeof before);
      same++;
    }
    memcpy(before, picture.data, sizeof before);
    last = shown;
  }
  assert_int_equal(count, 2 * LONGER);
  assert_in_range(same, (2 * LONGER - RESTS) / 2 - 1, 2 * LONGER - RESTS);
  ern_image_free(context, &picture);
  ern_video_reader_free(&reader);
  ern_context_free(&context);
}

/* In real time, with a rate control, and lines of --control. */
static void test_control(void **state) {
  (void)state;
  static const char lines[] = "background white\neyes 0.5\nhold on\nstatistics\n";
  cli_replace("lines.txt", lines, sizeof lines - 1);
  assert_non_null(freopen("lines.txt", "r", stdin));
  cli_run(&cli,
          "live h.safetensors --clip clip --video clip.mp4 --control - --duration 0.4 --fps 30 -o control.mp4 --json - "
          "--quiet");
  cli_expect(&cli, 0, "error: background: is that of the recorded frames", "error: eyes: are those of the recorded",
             "\"as_recorded\":0", NULL);
  json_t *report = cli_json(&cli, NULL);
  assert_int_equal(json_integer_value(json_object_get(report, "written")), 12);
  json_decref(report);
}

static void test_refused(void **state) {
  (void)state;
#define LIVE "live h.safetensors --clip clip --video clip.mp4 --duration 1 -o no.mp4 "
  cli_run(&cli, LIVE "--bg-img white");
  cli_expect(&cli, 2, "--bg-img places what is not drawn with --video", NULL);
  cli_run(&cli, LIVE "--set hold-pose=3");
  cli_expect(&cli, 2, "--set hold-pose changes pose or eyes, which are as recorded with --video", NULL);
  cli_run(&cli, LIVE "--torso model");
  cli_expect(&cli, 2, "--torso is about the torso, which is as recorded with --video", NULL);
  static const char *const uncompressed[] = {"no.y4m", "no.rgba", "tcp://127.0.0.1:1", "no.mp4 --format nut"};
  for (size_t i = 0; i < sizeof uncompressed / sizeof uncompressed[0]; i++) {
    cli_run(&cli, "live h.safetensors --clip clip --duration 1 --crf 3 -o %s", uncompressed[i]);
    cli_expect(&cli, 2, "--crf is for a compressed stream", NULL);
  }
  cli_run(&cli, "live h.safetensors --clip clip --duration 1 --fit cover -o no.mp4");
  cli_expect(&cli, 2, "--fit needs --size", NULL);
  cli_run(&cli, "live h.safetensors --clip clip --duration 1 --set smooth_lips=yes -o no.mp4");
  cli_expect(&cli, 2, "there is no such setting, the nearest is smooth-eye", NULL);
  cli_run(&cli, LIVE "--size 48x48");
  cli_expect(&cli, 1, "--size is 48x48, expected 132x96, that of clip.mp4", NULL);
  cli_run(&cli, "live h.safetensors --clip clip --video clip.mp4 --duration 1 -o clip.mp4 -y");
  cli_expect(&cli, 1, "clip.mp4", NULL); /* it is an input */
  recorded_clip_write("0000000000000000000000000000000000000000000000000000000000000000", 0, LEFT, SIDE, FRAMES);
  cli_run(&cli, LIVE);
  cli_expect(&cli, 1, "clip.mp4: is not the video of clip", "expected 000000000000", NULL);
  recorded_clip_write(NULL, 0.2, LEFT, SIDE, FRAMES); /* the thread meets the end of the video */
  cli_run(&cli,
          "live h.safetensors --clip clip --video clip.mp4 --audio sound.pcm --audio-format s16le --as-fast -o no.mp4");
  cli_expect(&cli, 1, "clip.mp4: ends before the clip's frame ", NULL);
  assert_false(cli_there("no.mp4"));
  cli_run(
      &cli,
      "live h.safetensors --clip clip --video clip.mp4 --audio brief.pcm --audio-format s16le "
      "-o brief.mp4 --quiet"); /* at the pace of the sound: the thread meets the end before, and no frame needs it */
  cli_expect(&cli, 0, NULL);
  assert_null(strstr(cli.err, "ends before"));
#undef LIVE
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_frames), cmocka_unit_test(test_other_rate),
                                     cmocka_unit_test(test_control), cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, make_all, NULL);
}
