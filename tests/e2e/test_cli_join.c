/* SPDX-License-Identifier: MIT
 * Segments of 1 to 10 frames (render --frames A:B) against the whole: the pictures that are drawn are the same bytes,
 * and `join` makes one video of them whose pictures decode as the segments' do, at the whole's times and with its
 * sound, and a file beside it that says of what it was joined. What does not follow each other is refused. */
#include "cli.h"

#include <sys/stat.h>

#include "ernerf/media.h"

enum { SIDE = 64, CLIP_FRAMES = 22, MOST = 44, LENGTHS = 5 };
static const int lengths[LENGTHS] = {1, 2, 3, 10, MOST};

static struct cli cli;

/* Raw pictures to a file. */
static void draw_raw(const char *to, const char *frames) {
  support_clear(to);
  snprintf(cli.line, sizeof cli.line, "render h.safetensors --clip clip --split all --quiet %s -o -", frames);
  cli_start(&cli, to, 0);
  cli_wait(&cli);
  cli_expect(&cli, 0, NULL);
}

static int make_all(void **state) {
  (void)state;
  static const char *const old[] = {"clip", "h.safetensors", "h.run",     "parts",
                                    "none", "silent",        "whole.mp4", "whole.mp4.provenance.json"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  cli_run(&cli, "synth clip --size 64 --frames %d --seed 3 --quiet", CLIP_FRAMES);
  cli_expect(&cli, 0, NULL);
  cli_run(
      &cli,
      "train clip -o h.safetensors --iters 8 --rays 256 --levels 2 --validate-frames 1 --asr-model cepstra --quiet");
  cli_expect(&cli, 0, NULL);
  return 0;
}

static unsigned char *read_all(const char *path, size_t *count) {
  FILE *file = fopen(path, "rb");
  assert_non_null(file);
  fseek(file, 0, SEEK_END);
  *count = (size_t)ftell(file);
  rewind(file);
  unsigned char *bytes = malloc(*count + 1);
  assert_int_equal(fread(bytes, 1, *count, file), *count);
  fclose(file);
  return bytes;
}

/* Decoded pictures, from number `at` on; their times are those of frames of 1/25 s. Returns the number after the last.
 */
static size_t decode(const char *path, unsigned char *pictures, size_t at) {
  ern_context *context = support_context();
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  double seconds = 0;
  bool end = false;
  size_t k = 0;
  support_ok(context, ern_video_reader_open(context, path, &reader));
  for (;; k++) {
    support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
    if (end) break;
    assert_true(at + k < MOST && image.width == SIDE && image.height == SIDE && image.channels == 3);
    assert_true(seconds > (double)k / 25 - 1e-6 && seconds < (double)k / 25 + 1e-6); /* mp4 counts in 1/12800 s */
    memcpy(pictures + 3 * SIDE * SIDE * (at + k), image.data, 3 * SIDE * SIDE);
  }
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
  ern_context_free(&context);
  return at + k;
}

static void expect_same_sound(const char *one, const char *other) {
  ern_context *context = support_context();
  ern_sound a = {0}, b = {0};
  support_ok(context, ern_sound_read(context, one, &a));
  support_ok(context, ern_sound_read(context, other, &b));
  assert_int_equal(a.frames, b.frames);
  assert_true(a.frames > 0 && a.rate == b.rate && a.channels == b.channels);
  assert_memory_equal(a.data, b.data, a.frames * (size_t)a.channels * sizeof *a.data);
  ern_sound_free(context, &a);
  ern_sound_free(context, &b);
  ern_context_free(&context);
}

/* Returns the number of frames. */
static size_t render_parts(unsigned char *pictures) {
  static const char render[] = "render h.safetensors --clip clip --split all --quiet";
  size_t whole_bytes = 0, part_bytes = 0, decoded = 0;
  draw_raw("whole.rgba", "");
  cli_run(&cli, "%s -o whole.mp4", render);
  cli_expect(&cli, 0, NULL);
  unsigned char *whole = read_all("whole.rgba", &whole_bytes);
  const size_t each = 4 * SIDE * SIDE, count = whole_bytes / each;
  assert_int_equal(mkdir("parts", 0777), 0);
  size_t at = 0;
  for (size_t i = 0; i < LENGTHS; i++) {
    const size_t left = count - at, length = (size_t)lengths[i] < left ? (size_t)lengths[i] : left;
    char path[64];
    snprintf(path, sizeof path, "--frames %zu:%zu", at, at + length);
    draw_raw("part.rgba", path);
    snprintf(path, sizeof path, "parts/%03zu.mp4", at);
    cli_run(&cli, "%s --frames %zu:%zu -o %s", render, at, at + length, path);
    cli_expect(&cli, 0, NULL);
    unsigned char *part = read_all("part.rgba", &part_bytes);
    assert_int_equal(part_bytes, length * each);
    assert_memory_equal(part, whole + at * each, part_bytes);
    free(part);
    decoded = decode(path, pictures, decoded);
    at += length;
  }
  assert_int_equal(at, count);
  assert_int_equal(decoded, count);
  free(whole);
  return count;
}

static void test_join(void **state) {
  (void)state;
  const size_t bytes = (size_t)3 * SIDE * SIDE * MOST;
  unsigned char *parts = calloc(1, bytes), *joined = calloc(1, bytes), *whole = calloc(1, bytes);
  const size_t count = render_parts(parts);
  assert_int_equal(count, CLIP_FRAMES);
  cli_run(&cli, "join parts --wav clip/aud.wav -o joined.mp4 --overwrite");
  cli_expect(&cli, 0, "5 videos", NULL);
  assert_null(strstr(cli.err, "silent"));
  cli_run(&cli, "join parts --wav clip/aud.wav --wav-start 0.5 -o late.mp4 --overwrite");
  cli_expect(&cli, 0, "late.mp4: 0.38 s of sound from the first frame on, the pictures last 0.88 s: the rest is silent",
             NULL);
  assert_int_equal(decode("joined.mp4", joined, 0), count);
  assert_memory_equal(joined, parts, bytes);
  expect_same_sound("joined.mp4", "whole.mp4");
  /* coded in segments a picture has other neighbours than in the whole, and so other bits: both are within crf 15 of
   * what was drawn, which is 40 dB or more of such pictures, so within some 6 dB less of each other */
  double square = 0;
  assert_int_equal(decode("whole.mp4", whole, 0), count);
  for (size_t i = 0; i < 3 * SIDE * SIDE * count; i++) {
    const double difference = (double)joined[i] - (double)whole[i];
    square += difference * difference;
  }
  assert_true(square / (3.0 * SIDE * SIDE * (double)count) < 255 * 255 * 4e-4); /* 34 dB */
  size_t size = 0;
  unsigned char *file = read_all("joined.mp4", &size);
  const char mark[] = "AIGC"; /* in the tags and in XMP, as in each segment */
  int marks = 0;
  for (size_t i = 0; i + sizeof mark < size; i++) marks += memcmp(file + i, mark, sizeof mark - 1) == 0;
  assert_true(marks >= 2);
  free(file), free(parts), free(joined), free(whole);
}

/* The joined video's file says what all segments' files say, and of each what that one alone says. */
static void test_file_beside(void **state) {
  (void)state;
  char hex[65];
  ern_context *context = support_context();
  json_t *whole = cli_json(&cli, "whole.mp4.provenance.json"), *joined = cli_json(&cli, "joined.mp4.provenance.json");
  static const char *const same[] = {"made_by", "version",     "digital_source_type",
                                     "model",   "speech",      "clip",
                                     "consent", "first_frame", "frames",
                                     "rate",    "width",       "height",
                                     "sound",   "settings"};
  for (size_t i = 0; i < sizeof same / sizeof *same; i++)
    if (!json_equal(json_object_get(whole, same[i]), json_object_get(joined, same[i])))
      fail_msg("%s is not that of the whole", same[i]);
  assert_string_equal(json_string_value(json_object_get(joined, "output")), "joined.mp4");
  const json_t *sound = json_object_get(joined, "sound_file"), *segments = json_object_get(joined, "segments");
  support_ok(context, ern_file_sha256(context, "clip/aud.wav", hex));
  assert_string_equal(json_string_value(json_object_get(sound, "sha256")), hex);
  assert_int_equal(json_array_size(segments), LENGTHS);
  const json_t *fourth = json_array_get(segments, 3);
  support_ok(context, ern_file_sha256(context, "parts/006.mp4", hex));
  assert_string_equal(json_string_value(json_object_get(fourth, "sha256")), hex);
  assert_string_equal(json_string_value(json_object_get(fourth, "file")), "006.mp4");
  assert_int_equal(json_integer_value(json_object_get(fourth, "first_frame")), 6);
  assert_int_equal(json_integer_value(json_object_get(fourth, "frames")), lengths[3]);
  assert_null(json_object_get(fourth, "model")); /* said once for all */
  json_decref(whole);
  json_decref(joined);

  /* one of which nothing is said, then none of which anything is; a file of somebody else */
  assert_int_equal(rename("parts/001.mp4.provenance.json", "aside.json"), 0);
  cli_run(&cli, "join parts -o joined.mp4 --overwrite");
  cli_expect(&cli, 0, "001.mp4: no file beside it", NULL);
  joined = cli_json(&cli, "joined.mp4.provenance.json");
  segments = json_object_get(joined, "segments");
  assert_true(json_is_null(json_object_get(joined, "frames")) && json_object_get(joined, "model") == NULL);
  assert_non_null(json_object_get(json_array_get(segments, 3), "model"));
  assert_int_equal(json_object_size(json_array_get(segments, 1)), 2); /* file and sha256 */
  json_decref(joined);
  support_clear("joined.mp4");
  support_write_text("joined.mp4.provenance.json", "{\"mine\": 1}");
  cli_run(&cli, "join parts -o joined.mp4");
  cli_expect(&cli, 1, "joined.mp4.provenance.json: is there already", NULL);
  assert_int_not_equal(access("joined.mp4", F_OK), 0);
  support_clear("joined.mp4.provenance.json");
  assert_int_equal(mkdir("silent", 0777), 0);
  assert_int_equal(link("parts/000.mp4", "silent/000.MP4"), 0); /* as render takes it */
  cli_run(&cli, "join silent -o joined.mp4");
  cli_expect(&cli, 0, NULL);
  assert_int_not_equal(access("joined.mp4.provenance.json", F_OK), 0);
  assert_int_equal(rename("aside.json", "parts/001.mp4.provenance.json"), 0);
  ern_context_free(&context);
}

/* Numbers without leading zeros count as numbers. */
static void test_order(void **state) {
  (void)state;
  assert_int_equal(system("mkdir numbered && cp parts/000.mp4 numbered/part2.mp4 && cp parts/001.mp4 "
                          "numbered/part10.mp4 && cp parts/003.mp4 numbered/part010b.mp4"),
                   0);
  cli_run(&cli, "join numbered -o numbered.mp4");
  cli_expect(&cli, 0, "numbered/part2.mp4: no file", "taken as the first",
             "numbered/part10.mp4: no file beside it (.provenance.json) says which frames it has; they are taken to "
             "follow those of numbered/part2.mp4",
             "follow those of numbered/part10.mp4", NULL);
}

/* A segment that is missing, that is of another size, that is cut off, that there is no other of. */
static void test_refused(void **state) {
  (void)state;
  assert_int_equal(rename("parts/003.mp4", "aside.mp4"), 0);
  assert_int_equal(rename("parts/003.mp4.provenance.json", "aside.json"), 0);
  cli_run(&cli, "join parts -o refused.mp4");
  cli_expect(&cli, 1, "parts/006.mp4: begins with frame 6, expected 3", "parts/001.mp4", NULL);
  cli_run(&cli, "render h.safetensors --clip clip --split all --frames 3:6 --size 48x48 -o parts/003.mp4 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "join parts -o refused.mp4");
  cli_expect(&cli, 1, "parts/003.mp4: is of 48 x 48 pixels", NULL);
  support_write_text("parts/003.mp4", "no video"); /* made again, and its file is about the one before */
  cli_run(&cli, "join parts --wav clip/aud.wav -o refused.mp4");
  cli_expect(&cli, 1, "parts/003.mp4.provenance.json: sha256 is", "which was made again since", NULL);
  support_clear("parts/003.mp4.provenance.json");
  cli_run(&cli, "join parts -o refused.mp4");
  cli_expect(&cli, 1, "parts/003.mp4: cannot read it as sound or video", NULL);
  assert_int_equal(mkdir("none", 0777), 0);
  cli_run(&cli, "join none -o refused.mp4");
  cli_expect(&cli, 1, "none: has no .mp4", NULL);
  cli_run(&cli, "join absent -o refused.mp4");
  cli_expect(&cli, 1, "absent: is no folder", NULL);
  assert_int_not_equal(access("refused.mp4", F_OK), 0);
  cli_run(&cli, "join parts -o refused.mp4 --wav-start 3");
  cli_expect(&cli, 2, "--wav", NULL);
  assert_int_equal(rename("aside.mp4", "parts/003.mp4"), 0);
  assert_int_equal(rename("aside.json", "parts/003.mp4.provenance.json"), 0);
  cli_run(&cli, "join parts -o parts/003.mp4 --overwrite");
  cli_expect(&cli, 1, "is an input", NULL);
  cli_run(&cli, "join parts -o refused.mp4 --json parts/003.mp4.provenance.json --overwrite");
  cli_expect(&cli, 1, "parts/003.mp4.provenance.json: is in parts and is an input", NULL);
  cli_run(&cli, "join parts -o refused.webm");
  cli_expect(&cli, 2, "refused.webm", "expected a name that ends in .mp4", NULL);
  assert_int_not_equal(access("refused.mp4", F_OK), 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_join), cmocka_unit_test(test_file_beside),
                                     cmocka_unit_test(test_order), cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, make_all, NULL);
}
