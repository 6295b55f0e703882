/* SPDX-License-Identifier: MIT
 * `ernerf compare`: its figures are those of `eval`, a portrait is equal to itself and to a video of its own frames,
 * every file holds what it says, and a folder gets all files or stays as it was. */
#include "../made_lpips.h"
#include "cli.h"

#include <math.h>

#include "ernerf/media.h"
#include "ernerf/render.h"

static struct cli cli;
static ern_context *context;
enum { SIDE = 64, FIRST = 60 /* of the validation frames */, FRAMES = 6, FIGURES = 4 + ERN_PERCEPTUAL, COLUMNS = 5 };
static const char *const figures[] = {"psnr", "ssim", "psnr_head", "psnr_mouth", "lpips"};
#define WEIGHTS (ERN_PERCEPTUAL ? "--lpips-network n.safetensors --lpips-heads h.safetensors" : "")
static const char *const files[] = {"best.png",    "median.png", "worst.png", "compare.json",
                                    "compare.mp4", "frames.csv", "index.html"};
enum { FILES = sizeof files / sizeof *files };

/* ---- an uncompressed video --------------------------------------------------------------------------------------- */

struct avi {
  uint8_t *bytes;
  size_t count;
};

static void put(struct avi *avi, const void *bytes, size_t count) {
  memcpy(avi->bytes + avi->count, bytes, count);
  avi->count += count;
}

static void put_number(struct avi *avi, uint32_t value) {
  const uint8_t bytes[4] = {(uint8_t)value, (uint8_t)(value >> 8), (uint8_t)(value >> 16), (uint8_t)(value >> 24)};
  put(avi, bytes, 4);
}

static void put_list(struct avi *avi, const char *kind, size_t bytes, const char *name) {
  put(avi, kind, 4);
  put_number(avi, (uint32_t)bytes);
  if (name[0] != 0) put(avi, name, 4);
}

static void put_numbers(struct avi *avi, const uint32_t *values, size_t count) {
  for (size_t i = 0; i < count; i++) put_number(avi, values[i]);
}

/* Bottom row first, blue before red: 24 bits a pixel, and so without loss. rgb: [count][side][side][3]. */
static void write_avi(const char *path, const uint8_t *rgb, size_t count, size_t side, uint32_t rate) {
  const size_t picture = 3 * side * side, movi = 4 + count * (8 + picture), header = 4 + 64 + 12 + 64 + 48;
  struct avi avi = {.bytes = malloc(4096 + movi)};
  const uint32_t s = (uint32_t)side, n = (uint32_t)count, bytes = (uint32_t)picture;
  assert_non_null(avi.bytes);
  put_list(&avi, "RIFF", 4 + 8 + header + 8 + movi, "AVI ");
  put_list(&avi, "LIST", header, "hdrl");
  put_list(&avi, "avih", 56, "");
  put_numbers(&avi, (const uint32_t[14]){1000000 / rate, bytes * rate, 0, 0, n, 0, 1, bytes, s, s}, 14);
  put_list(&avi, "LIST", 4 + 64 + 48, "strl");
  put_list(&avi, "strh", 56, "vids");
  put_numbers(&avi, (const uint32_t[13]){0, 0, 0, 0, 1, rate, 0, n, bytes, 0, 0, 0, s | s << 16}, 13);
  put_list(&avi, "strf", 40, "");
  put_numbers(&avi, (const uint32_t[10]){40, s, s, 1 | 24 << 16, 0, bytes}, 10);
  put_list(&avi, "LIST", movi, "movi");
  for (size_t k = 0; k < count; k++) {
    put_list(&avi, "00db", picture, "");
    for (size_t y = side; y-- > 0;)
      for (size_t x = 0; x < side; x++) {
        const uint8_t *at = rgb + ((k * side + y) * side + x) * 3;
        put(&avi, (const uint8_t[3]){at[2], at[1], at[0]}, 3);
      }
  }
  support_write(path, avi.bytes, avi.count);
  free(avi.bytes);
}

/* ---- what is compared -------------------------------------------------------------------------------------------- */

enum { PICTURE = SIDE * SIDE * 3 };
/* Frames of a.safetensors and b.safetensors, as `render` draws them. */
static uint8_t own[FRAMES * PICTURE], other[FRAMES * PICTURE];

static void render_all(const char *model, uint8_t *frames) {
  cli_run(&cli, "render %s --clip clip --split val -o f_%%d.png -y --quiet", model);
  cli_expect(&cli, 0, NULL);
  for (size_t k = 0; k < FRAMES; k++) {
    ern_image image = {0};
    char name[32];
    snprintf(name, sizeof name, "f_%zu.png", k);
    support_ok(context, ern_image_read(context, name, 3, &image));
    assert_true(image.width == SIDE && image.height == SIDE);
    memcpy(frames + k * PICTURE, image.data, PICTURE);
    ern_image_free(context, &image);
  }
}

static int make_all(void **state) {
  (void)state;
  static const char *const old[] = {"clip", "a.safetensors", "a.run", "b.safetensors", "b.run", "out",   "self", "film",
                                    "part", "mine",          "torn",  "full",          "left",  "plain", "late"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  context = support_context();
  cli_shared_clip("long", "clip");
  cli_shared_model("long_head", "a");
  cli_run(&cli, "train clip -o b.safetensors --iters 30 --rays 256 --levels 4 --seed 1 --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  render_all("a.safetensors", own);
  render_all("b.safetensors", other);
  write_avi("own.avi", own, FRAMES, SIDE, 25);
  if (ERN_PERCEPTUAL) made_lpips("n.safetensors", "h.safetensors", 0);
  return 0;
}

static int end_all(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

static const json_t *member(const json_t *object, const char *name) {
  const json_t *found = json_object_get(object, name);
  if (found == NULL) fail_msg("%s is missing", name);
  return found;
}

static double number(const json_t *object, const char *name) {
  const json_t *found = member(object, name);
  if (!json_is_number(found)) fail_msg("%s is no number", name);
  return json_number_value(found);
}

/* ---- figures ----------------------------------------------------------------------------------------------------- */

/* One side of compare.json is what eval says of that model, frame by frame too. */
static void expect_as_eval(const json_t *report, const char *side, const char *model) {
  static const char *const same[] = {"psnr", "ssim", "psnr_head", "psnr_mouth", "measures", "kind"};
  cli_run(&cli, "eval %s clip --json --quiet %s", model, WEIGHTS);
  cli_expect(&cli, 0, NULL);
  json_t *alone = cli_json(&cli, NULL);
  for (size_t i = 0; i < sizeof same / sizeof *same; i++)
    if (!json_equal(member(member(report, side), same[i]), member(alone, same[i])))
      fail_msg("%s of %s is not what eval says", same[i], model);
  const json_t *intervals = member(member(report, side), "interval95"), *lpips;
  for (size_t f = 0; f < 4; f++)
    assert_true(json_equal(member(intervals, figures[f]), member(member(alone, "interval95"), figures[f])));
  if (ERN_PERCEPTUAL) {
    lpips = member(member(alone, "metrics"), "lpips");
    assert_true(json_equal(member(member(report, side), "lpips"), member(lpips, "mean")));
    assert_true(json_equal(member(intervals, "lpips"), member(lpips, "interval95")));
    assert_true(json_equal(member(report, "lpips_network"), member(lpips, "network")));
  }
  const json_t *frames = member(report, "frames"), *single = member(alone, "frames");
  assert_int_equal(json_array_size(frames), FRAMES);
  assert_int_equal(json_array_size(single), FRAMES);
  for (size_t k = 0; k < FRAMES; k++) {
    const json_t *frame = json_array_get(frames, k), *one = json_array_get(single, k);
    assert_true(json_equal(member(frame, "id"), member(one, "id")));
    for (size_t f = 0; f < FIGURES; f++)
      assert_true(json_equal(member(member(frame, side), figures[f]), member(one, figures[f])));
  }
  json_decref(alone);
}

/* Differences, their mean and interval, and who wins, from the figures of the frames. */
static void expect_differences(const json_t *report) {
  const json_t *frames = member(report, "frames");
  for (size_t f = 0; f < FIGURES; f++) {
    const json_t *said = member(member(report, "difference"), figures[f]);
    double mean = 0, squares = 0, d[FRAMES];
    long wins[3] = {0};
    for (size_t k = 0; k < FRAMES; k++) {
      const json_t *frame = json_array_get(frames, k);
      const double a = number(member(frame, "a"), figures[f]), b = number(member(frame, "b"), figures[f]);
      d[k] = number(member(frame, "difference"), figures[f]);
      assert_true(d[k] == b - a);
      wins[a == b ? 2 : (a > b) == (f < 4) ? 0 : 1]++; /* of LPIPS the smaller is better */
      mean += d[k] / FRAMES;
    }
    for (size_t k = 0; k < FRAMES; k++) squares += (d[k] - mean) * (d[k] - mean);
    /* sums of 6 numbers below 100, in another order: some 1e-14 */
    assert_true(fabs(number(said, "mean") - mean) < 1e-10);
    assert_true(fabs(number(said, "interval95") - 1.96 * sqrt(squares / (FRAMES - 1) / FRAMES)) < 1e-10);
    assert_int_equal(json_integer_value(member(said, "frames_a_wins")), wins[0]);
    assert_int_equal(json_integer_value(member(said, "frames_b_wins")), wins[1]);
    assert_int_equal(json_integer_value(member(said, "frames_equal")), wins[2]);
  }
}

#define PLAIN                                                                                                      \
  "psnr_a,psnr_b,psnr_difference,ssim_a,ssim_b,ssim_difference,psnr_head_a,psnr_head_b,psnr_head_difference,psnr_" \
  "mouth_a,psnr_mouth_b,psnr_mouth_difference"

static void expect_csv(const json_t *report) {
  size_t bytes = 0, k = 0;
  char *text = (char *)cli_bytes("out/frames.csv", &bytes), *rest = NULL;
  assert_string_equal(strtok_r(text, "\n", &rest),
                      ERN_PERCEPTUAL ? "frame,split," PLAIN ",lpips_a,lpips_b,lpips_difference" : "frame,split," PLAIN);
  for (char *line; (line = strtok_r(NULL, "\n", &rest)) != NULL; k++) {
    const json_t *frame = json_array_get(member(report, "frames"), k);
    long id;
    int read = 0;
    assert_int_equal(sscanf(line, "%ld,val%n", &id, &read), 1);
    assert_int_equal(id, json_integer_value(member(frame, "id")));
    for (size_t f = 0; f < FIGURES; f++) {
      static const char *const of[] = {"a", "b", "difference"};
      for (size_t i = 0; i < 3; i++) {
        char *end = NULL;
        assert_int_equal(line[read], ',');
        const double value = strtod(line + read + 1, &end);
        assert_true(fabs(value - number(member(frame, of[i]), figures[f])) < 0.51e-4); /* 4 digits or more */
        read = (int)(end - line);
      }
    }
    assert_int_equal(line[read], 0);
  }
  assert_int_equal(k, FRAMES);
  free(text);
}

/* ---- files ------------------------------------------------------------------------------------------------------- */

/* The columns are A, B, the truth, and 4 times what is between them. */
static void expect_picture(const char *name, size_t k) {
  ern_image sheet = {0}, truth = {0};
  char path[64];
  support_ok(context, ern_image_read(context, name, 3, &sheet));
  assert_int_equal(sheet.width, COLUMNS * SIDE);
  assert_int_equal(sheet.height, SIDE);
  snprintf(path, sizeof path, "clip/gt_imgs/%zu.jpg", FIRST + k);
  support_ok(context, ern_image_read(context, path, 3, &truth));
  for (size_t y = 0; y < SIDE; y++) {
    const uint8_t *row = sheet.data + 3 * y * COLUMNS * SIDE;
    const size_t at = k * PICTURE + 3 * y * SIDE;
    assert_memory_equal(row, own + at, 3 * SIDE);
    assert_memory_equal(row + 3 * SIDE, other + at, 3 * SIDE);
    assert_memory_equal(row + 6 * SIDE, truth.data + 3 * y * SIDE, 3 * SIDE);
    for (size_t i = 0; i < 6 * SIDE; i++) {
      const int d = 4 * abs(row[i] - row[6 * SIDE + i % (3 * SIDE)]);
      assert_int_equal(row[9 * SIDE + i], d < 255 ? d : 255);
    }
  }
  ern_image_free(context, &sheet);
  ern_image_free(context, &truth);
}

static void expect_shown(const json_t *report) {
  const json_t *frames = member(report, "frames"), *shown = member(report, "shown");
  size_t best = 0, worst = 0, median = 0, above = 0;
  double d[FRAMES];
  for (size_t k = 0; k < FRAMES; k++) {
    d[k] = number(member(json_array_get(frames, k), "difference"), "psnr");
    if (d[k] > d[best]) best = k;
    if (d[k] < d[worst]) worst = k;
  }
  assert_true(best != worst);
  assert_int_equal(json_integer_value(member(shown, "best")), FIRST + best);
  assert_int_equal(json_integer_value(member(shown, "worst")), FIRST + worst);
  median = (size_t)json_integer_value(member(shown, "median")) - FIRST;
  assert_true(median < FRAMES);
  for (size_t k = 0; k < FRAMES; k++) above += d[k] > d[median];
  assert_int_equal(above, FRAMES / 2);
  expect_picture("out/best.png", best);
  expect_picture("out/median.png", median);
  expect_picture("out/worst.png", worst);
}

static void expect_video(const char *path, size_t expected) {
  ern_video_reader *reader = NULL;
  ern_video_info info;
  ern_image picture = {0};
  size_t count = 0;
  support_ok(context, ern_video_reader_open(context, path, &reader));
  ern_video_reader_info(reader, &info);
  assert_true(info.width == 3 * SIDE && info.height == SIDE && info.has_sound);
  for (bool end = false; !end; count += !end) {
    double seconds;
    support_ok(context, ern_video_reader_frame(reader, &picture, &seconds, &end));
  }
  assert_int_equal(count, expected);
  ern_image_free(context, &picture);
  ern_video_reader_free(&reader);
}

static void test_figures(void **state) {
  (void)state;
  cli_run(&cli, "compare a.safetensors b.safetensors clip -o out/ --json r.json -y --quiet %s", WEIGHTS);
  cli_expect_out(&cli, 0, "a.safetensors", "b.safetensors", "PSNR mouth", ERN_PERCEPTUAL ? "LPIPS" : "B better",
                 "out//index.html", NULL);
  assert_string_equal(cli.err, "");
  assert_int_equal(cli_count("out"), FILES);
  for (size_t i = 0; i < FILES; i++) {
    char path[64];
    snprintf(path, sizeof path, "out/%s", files[i]);
    assert_true(cli_there(path));
  }
  cli_same_bytes("r.json", "out/compare.json");
  json_t *report = cli_json(&cli, "r.json");
  expect_as_eval(report, "a", "a.safetensors");
  expect_as_eval(report, "b", "b.safetensors");
  expect_differences(report);
  expect_csv(report);
  expect_shown(report);
  expect_video("out/compare.mp4", FRAMES);
  json_decref(report);
}

/* Neither scripts nor anything that is not in the folder, and names are text. */
static void test_page(void **state) {
  (void)state;
  static const char *const inside[] = {"best.png", "median.png", "worst.png", "compare.mp4", "a&amp;b&lt;i&gt;.avi"};
  static const char *const outside[] = {"<script", "http", "//", "@import", "url(", "<i>", "data:"};
  size_t bytes = 0;
  write_avi("a&b<i>.avi", own, FRAMES, SIDE, 25);
  cli_run(&cli, "compare a&b<i>.avi a.safetensors clip -o out --frames 0:2 -y --quiet %s", WEIGHTS);
  cli_expect(&cli, 0, NULL);
  char *page = (char *)cli_bytes("out/index.html", &bytes);
  assert_true((strstr(page, "<td class=\"l\">LPIPS") != NULL) == ERN_PERCEPTUAL);
  for (size_t i = 0; i < sizeof inside / sizeof *inside; i++) assert_non_null(strstr(page, inside[i]));
  for (size_t i = 0; i < sizeof outside / sizeof *outside; i++) assert_null(strstr(page, outside[i]));
  free(page);
  expect_video("out/compare.mp4", 2);
}

static void test_self(void **state) {
  (void)state;
  cli_run(&cli, "compare b.safetensors b.safetensors clip -o self --json - --quiet %s", WEIGHTS);
  cli_expect(&cli, 0, NULL);
  json_t *report = cli_json(&cli, NULL);
  assert_true(json_equal(member(member(report, "a"), "measures"), member(member(report, "b"), "measures")));
  for (size_t f = 0; f < FIGURES; f++) {
    const json_t *said = member(member(report, "difference"), figures[f]);
    assert_true(number(said, "mean") == 0 && number(said, "interval95") == 0);
    assert_int_equal(json_integer_value(member(said, "frames_equal")), FRAMES);
  }
  json_decref(report);
}

/* Without weights LPIPS is in no table; with half of them, or wrong ones, nothing is compared. */
static void test_without_weights(void **state) {
  (void)state;
  size_t bytes = 0;
  cli_run(&cli, "compare a.safetensors b.safetensors clip -o plain --frames 0:2 --json - --quiet");
  cli_expect(&cli, 0, NULL);
  json_t *report = cli_json(&cli, NULL);
  assert_true(json_is_null(member(report, "lpips_network")));
  assert_string_equal(json_string_value(member(report, "against")), "clip");
  assert_null(json_object_get(member(report, "a"), "lpips"));
  json_decref(report);
  char *csv = (char *)cli_bytes("plain/frames.csv", &bytes), *page = (char *)cli_bytes("plain/index.html", &bytes);
  assert_null(strstr(csv, "lpips"));
  assert_null(strstr(page, "<td class=\"l\">LPIPS"));
  free(csv);
  free(page);
  cli_run(&cli, "compare a.safetensors b.safetensors clip -o none --lpips-network n.safetensors");
  cli_expect(&cli, 2, "--lpips-heads", NULL);
  cli_run(&cli,
          "compare a.safetensors b.safetensors clip -o none --lpips-network a.safetensors --lpips-heads a.safetensors");
  cli_expect(&cli, 1, ERN_PERCEPTUAL ? "features.0.weight" : "libernerf-perceptual", NULL);
  assert_false(cli_there("none"));
}

/* ---- videos ------------------------------------------------------------------------------------------------------ */

/* PSNR of a frame of `own` against the truth. */
static double own_psnr(size_t k) {
  static float rgb[PICTURE];
  ern_image truth = {0};
  char path[64];
  snprintf(path, sizeof path, "clip/gt_imgs/%zu.jpg", FIRST + k);
  support_ok(context, ern_image_read(context, path, 3, &truth));
  for (size_t i = 0; i < PICTURE; i++) rgb[i] = (float)own[k * PICTURE + i] / 255;
  const double psnr = ern_psnr(rgb, truth.data, SIDE, SIDE, NULL);
  ern_image_free(context, &truth);
  return psnr;
}

/* The pictures of a video are evaluated as they are. The model's own differ from them by the rounding to 8 bits: a
 * colour by half a step, so the root of the mean square by half a step at most. */
static void test_video(void **state) {
  (void)state;
  const double half_step = 0.5 / 255;
  cli_run(&cli, "compare a.safetensors own.avi clip -o film --json film.json -y --quiet");
  cli_expect(&cli, 0, NULL);
  assert_string_equal(cli.err, "");
  json_t *report = cli_json(&cli, "film.json");
  assert_string_equal(json_string_value(member(member(report, "b"), "kind")), "video");
  for (size_t k = 0; k < FRAMES; k++) {
    const json_t *frame = json_array_get(member(report, "frames"), k);
    const double a = number(member(frame, "a"), "psnr"), b = number(member(frame, "b"), "psnr");
    assert_true(fabs(b - own_psnr(k)) < 1e-9);
    assert_true(fabs(pow(10, -a / 20) - pow(10, -b / 20)) <= half_step);
  }
  /* the frames that --frames chooses are the same pictures, with a model and with a second video beside them */
  static const char *const lines[] = {"a.safetensors own.avi", "own.avi own.avi"};
  for (size_t i = 0; i < 2; i++) {
    cli_run(&cli, "compare %s clip -o part --frames 2:4 --json part.json -y --quiet", lines[i]);
    cli_expect(&cli, 0, NULL);
    json_t *part = cli_json(&cli, "part.json");
    assert_int_equal(json_array_size(member(part, "frames")), 2);
    for (size_t k = 0; k < 2; k++)
      assert_true(json_equal(member(json_array_get(member(part, "frames"), k), "b"),
                             member(json_array_get(member(report, "frames"), 2 + k), "b")));
    json_decref(part);
  }
  json_decref(report);
}

/* The sound begins where the speech of the first frame is: at its aud_id, which need not be its img_id. */
static void test_sound(void **state) {
  (void)state;
  enum { EARLIER = 30 /* windows before the frame's own */ };
  ern_sound sound = {0}, whole = {0};
  assert_int_equal(system("rm -rf late && cp -rL clip late"), 0);
  json_t *list = json_load_file("late/transforms_val.json", 0, NULL), *frame;
  size_t k;
  json_array_foreach(json_object_get(list, "frames"), k, frame) {
    const json_int_t aud_id = json_integer_value(member(frame, "aud_id")) - EARLIER;
    assert_int_equal(json_object_set_new(frame, "aud_id", json_integer(aud_id)), 0);
  }
  assert_int_equal(json_dump_file(list, "late/transforms_val.json", 0), 0);
  json_decref(list);
  cli_run(&cli, "compare a.safetensors own.avi late -o part -y --quiet --force");
  cli_expect(&cli, 0, NULL);
  support_ok(context, ern_sound_read(context, "part/compare.mp4", &sound));
  support_ok(context, ern_sound_read(context, "late/aud.wav", &whole));
  assert_int_equal(sound.rate, whole.rate);
  assert_true(sound.channels == 1 && whole.channels == 1 && sound.frames <= whole.frames);
  /* to a millisecond: no other place fits as well */
  const size_t step = (size_t)sound.rate / 1000;
  size_t best = 0;
  double least = INFINITY;
  for (size_t lag = 0; lag + sound.frames <= whole.frames; lag += step) {
    double sum = 0;
    for (size_t i = 0; i < sound.frames; i++) sum += pow((double)sound.data[i] - (double)whole.data[lag + i], 2);
    if (sum < least) {
      least = sum;
      best = lag;
    }
  }
  assert_int_equal(best / step, (FIRST - EARLIER) * 1000 / 25);
  ern_sound_free(context, &sound);
  ern_sound_free(context, &whole);
}

static void test_odd_videos(void **state) {
  (void)state;
  write_avi("small.avi", own, 2, SIDE / 2, 25);
  cli_run(&cli, "compare a.safetensors small.avi clip -o left");
  cli_expect(&cli, 1, "small.avi", "32 x 32", "expected 64 x 64", NULL);
  write_avi("short.avi", own, 3, SIDE, 25);
  cli_run(&cli, "compare short.avi a.safetensors clip -o left");
  cli_expect(&cli, 1, "short.avi", "has 3 pictures", "expected 6", NULL);
  cli_run(&cli, "compare short.avi own.avi clip --frames 2:5 -o left");
  cli_expect(&cli, 1, "short.avi", "has 3 pictures", "expected 5", NULL);
  support_write_text("none.mp4", "no video at all");
  cli_run(&cli, "compare a.safetensors none.mp4 clip -o left");
  cli_expect(&cli, 1, "none.mp4", NULL);
  cli_run(&cli, "compare a.safetensors absent.mkv clip -o left");
  cli_expect(&cli, 1, "absent.mkv", NULL);
  assert_false(cli_there("left"));
  static uint8_t more[sizeof own + sizeof own / FRAMES];
  memcpy(more, own, sizeof own);
  write_avi("more.avi", more, FRAMES + 1, SIDE, 30);
  cli_run(&cli, "compare a.safetensors more.avi clip -o part -y --quiet");
  cli_expect(&cli, 0, "more.avi: has more than the 6 pictures", "more.avi: has 30 pictures a second", NULL);
}

/* ---- folders ----------------------------------------------------------------------------------------------------- */

static void expect_text(const char *path, const char *expected) {
  size_t count = 0;
  uint8_t *bytes = cli_bytes(path, &count);
  assert_string_equal((const char *)bytes, expected);
  free(bytes);
}

static void test_foreign_folders(void **state) {
  (void)state;
  assert_int_equal(mkdir("mine", 0777), 0);
  support_write_text("mine/compare.json", "{\"format\": \"another\"}");
  for (int i = 0; i < 2; i++) {
    cli_run(&cli, "compare a.safetensors b.safetensors clip -o mine %s", i > 0 ? "-y" : "");
    cli_expect(&cli, 1, "mine", "did not make", "expected a new or an empty folder", NULL);
    assert_int_equal(cli_count("mine"), 1);
    expect_text("mine/compare.json", "{\"format\": \"another\"}");
  }
  cli_run(&cli, "compare a.safetensors b.safetensors clip -o clip -y");
  cli_expect(&cli, 1, "clip", "did not make", NULL);
  cli_run(&cli, "compare a.safetensors b.safetensors clip -o r.json -y");
  cli_expect(&cli, 1, "r.json: is no folder", NULL);
  cli_run(&cli, "compare a.safetensors b.safetensors clip -o left/deep");
  cli_expect(&cli, 1, "left/deep", "does not exist", NULL);
  cli_run(&cli, "compare out/compare.mp4 b.safetensors clip -o out -y");
  cli_expect(&cli, 1, "out/compare.mp4: is an input", NULL);
  cli_run(&cli, "compare a.safetensors b.safetensors clip -o out -y --json out/frames.json");
  cli_expect(&cli, 1, "out/frames.json", NULL);
  assert_false(cli_there("left") || cli_there("out/frames.json"));
}

/* A model that is cut short, and a disk that is full, in turn at each of the files. */
static void test_nothing_left_long(void **state) {
  (void)state;
  size_t bytes = 0;
  uint8_t *model = cli_bytes("b.safetensors", &bytes);
  support_write("torn.safetensors", model, bytes / 2);
  free(model);
  cli_run(&cli, "compare a.safetensors torn.safetensors clip -o torn");
  cli_expect(&cli, 1, "torn.safetensors", NULL);
  assert_false(cli_there("torn"));
  static const size_t most[] = {100, 2000, 9000, 20000};
  for (size_t i = 0; i < sizeof most / sizeof *most; i++) {
    cli_run_full(&cli, most[i], "compare a.safetensors b.safetensors clip -o full --quiet");
    cli_expect(&cli, 1, "full/", NULL);
    assert_false(cli_there("full"));
  }
}

static void test_earlier_folders_long(void **state) {
  (void)state;
  char path[64], kept[64];
  support_clear("full");
  cli_run(&cli, "compare a.safetensors b.safetensors clip -o full --quiet");
  cli_expect(&cli, 0, NULL);
  support_write_text("full/notes.txt", "mine");
  assert_int_equal(system("rm -rf kept && cp -r full kept"), 0);
  cli_run(&cli, "compare b.safetensors a.safetensors clip -o full --quiet");
  cli_expect(&cli, 1, "full/", "is there already", "--overwrite", NULL);
  cli_run_full(&cli, 20000, "compare b.safetensors a.safetensors clip -o full -y --quiet");
  cli_expect(&cli, 1, "full/", NULL);
  assert_int_equal(cli_count("full"), FILES + 1);
  for (size_t i = 0; i < FILES; i++) {
    snprintf(path, sizeof path, "full/%s", files[i]);
    snprintf(kept, sizeof kept, "kept/%s", files[i]);
    cli_same_bytes(path, kept);
  }
  cli_run(&cli, "compare b.safetensors a.safetensors clip -o full -y --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(system("cmp -s full/frames.csv kept/frames.csv"), 256);
  assert_int_equal(cli_count("full"), FILES + 1);
  expect_text("full/notes.txt", "mine");
}

/* What a process that was killed has left is no file of another: the mark of the program is the sticky bit. */
static void test_left_over(void **state) {
  (void)state;
  assert_int_equal(mkdir("left", 0777), 0);
  support_write_text("left/compare.mp4.new.ernerf-tmp", "half a video");
  assert_int_equal(chmod("left/compare.mp4.new.ernerf-tmp", 01644), 0);
  cli_run(&cli, "compare a.safetensors b.safetensors clip -o left --frames 0:2 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(cli_count("left"), FILES);
}

/* The video has its first name, and no file has its last: of a folder without the mark it is a file of another. */
static void test_killed_before_names(void **state) {
  (void)state;
  support_clear("left");
  assert_int_equal(mkdir("left", 0777), 0);
  support_write_text("left/compare.mp4.new", "a video");
  for (int i = 0; i < 2; i++) {
    cli_run(&cli, "compare a.safetensors b.safetensors clip -o left --frames 0:2 --quiet %s", i > 0 ? "-y" : "");
    cli_expect(&cli, 1, "left", "did not make", NULL);
  }
  expect_text("left/compare.mp4.new", "a video");
  support_write_text("left/compare.begun", "{\"format\": \"ernerf.compare\"}");
  cli_run(&cli, "compare a.safetensors b.safetensors clip -o left --frames 0:2 --quiet");
  cli_expect(&cli, 1, "left", "did not make", NULL);
  support_write_text("left/compare.begun", "{\"format\": \"ernerf.compare.begun\"}");
  cli_run(&cli, "compare a.safetensors torn.safetensors clip -o left --frames 0:2 --quiet");
  cli_expect(&cli, 1, "torn.safetensors", NULL);
  assert_int_equal(cli_count("left"), 2);
  cli_run(&cli, "compare a.safetensors b.safetensors clip -o left --frames 0:2 --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(cli_count("left"), FILES);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_figures),
                                     cmocka_unit_test(test_page),
                                     cmocka_unit_test(test_self),
                                     cmocka_unit_test(test_video),
                                     cmocka_unit_test(test_sound),
                                     cmocka_unit_test(test_odd_videos),
                                     cmocka_unit_test(test_foreign_folders),
                                     cmocka_unit_test(test_nothing_left_long),
                                     cmocka_unit_test(test_earlier_folders_long),
                                     cmocka_unit_test(test_left_over),
                                     cmocka_unit_test(test_killed_before_names),
                                     cmocka_unit_test(test_without_weights)};
  return cmocka_run_group_tests(tests, make_all, end_all);
}
