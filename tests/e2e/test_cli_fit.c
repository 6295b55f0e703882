/* SPDX-License-Identifier: MIT
 * A --size of another aspect: head, torso and background stay as they are to each other. Held against the picture of
 * the same scale in the clip's own aspect, byte by byte: rays and torso coordinates are those of the same numbers
 * there. */
#include "cli.h"

#include "ernerf/ernerf.h"
#include "ernerf/media.h"

enum { SIDE = 64, MOST = 4 * 2 * SIDE * 2 * SIDE };

static struct cli cli;

static int make_models(void **state) {
  (void)state;
  static const char *const old[] = {"clip",         "head.safetensors", "head.run", "portrait.safetensors",
                                    "portrait.run", "raw.bin"};
  for (size_t i = 0; i < sizeof old / sizeof old[0]; i++) support_clear(old[i]);
  cli_run(&cli, "synth clip --size %d --frames 12 --seed 3 --quiet", SIDE);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli,
          "train clip -o head.safetensors --iters 60 --rays 256 --levels 4 --lr-net 0.004 --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli,
          "train clip --torso --head head.safetensors -o portrait.safetensors --iters 30 --rays 256 --validate-frames "
          "1 --quiet");
  cli_expect(&cli, 0, NULL);
  return 0;
}

/* Frame 3 as RGBA; the caller frees it. */
static uint8_t *drawn(const char *model, int width, int height, const char *words) {
  uint8_t *pixels = malloc(MOST + 1);
  const size_t bytes = 4 * (size_t)width * (size_t)height;
  assert_non_null(pixels);
  support_clear("raw.bin");
  snprintf(cli.line, sizeof cli.line,
           "render %s.safetensors --clip clip --frames 3:4 --size %dx%d %s -o - --quiet --isa ref", model, width,
           height, words);
  cli_start(&cli, "raw.bin", 0);
  cli_wait(&cli);
  cli_expect(&cli, 0, NULL);
  FILE *file = fopen("raw.bin", "rb");
  assert_non_null(file);
  assert_int_equal(fread(pixels, 1, MOST + 1, file), bytes);
  fclose(file);
  return pixels;
}

/* Pixel (row, column) of `part`, of the given width, is pixel (row + top, column + left) of `whole`. */
static void expect_part(const char *what, const uint8_t *whole, int whole_width, int top, int left, const uint8_t *part,
                        int width, int height) {
  for (int row = 0; row < height; row++)
    for (int column = 0; column < width; column++) {
      const uint8_t *a = whole + 4 * ((row + top) * whole_width + column + left),
                    *b = part + 4 * (row * width + column);
      if (memcmp(a, b, 4) != 0)
        fail_msg("%s: pixel %d, %d is %d %d %d, expected %d %d %d", what, row, column, a[0], a[1], a[2], b[0], b[1],
                 b[2]);
    }
}

/* Beside the frame, SIDE x SIDE from (top, left) on, go on its edges: background, torso, and the head, of which no
 * training has seen what is there. */
static void expect_edges(const uint8_t *whole, int width, int height, int top, int left) {
  for (int row = 0; row < height; row++)
    for (int column = 0; column < width; column++) {
      const int y = row < top ? top : row < top + SIDE ? row : top + SIDE - 1;
      const int x = column < left ? left : column < left + SIDE ? column : left + SIDE - 1;
      assert_memory_equal(whole + 4 * (row * width + column), whole + 4 * (y * width + x), 4);
    }
}

static void test_nothing_is_distorted_long(void **state) {
  (void)state;
  static const char *const models[] = {"head", "portrait"};
  for (size_t m = 0; m < 2; m++) {
    uint8_t *frame = drawn(models[m], SIDE, SIDE, ""), *large = drawn(models[m], 2 * SIDE, 2 * SIDE, "--fit cover");
    uint8_t *tall = drawn(models[m], SIDE, 2 * SIDE, ""), *wide = drawn(models[m], 2 * SIDE, SIDE, "--fit contain");
    expect_part("tall", tall, SIDE, SIDE / 2, 0, frame, SIDE, SIDE);
    expect_part("wide", wide, 2 * SIDE, 0, SIDE / 2, frame, SIDE, SIDE);
    expect_edges(tall, SIDE, 2 * SIDE, SIDE / 2, 0);
    expect_edges(wide, 2 * SIDE, SIDE, 0, SIDE / 2);
    free(tall), free(wide);
    tall = drawn(models[m], SIDE, 2 * SIDE, "--fit cover"), wide = drawn(models[m], 2 * SIDE, SIDE, "--fit cover");
    expect_part("tall, filled", large, 2 * SIDE, 0, SIDE / 2, tall, SIDE, 2 * SIDE);
    expect_part("wide, filled", large, 2 * SIDE, SIDE / 2, 0, wide, 2 * SIDE, SIDE);
    free(tall), free(wide), free(frame), free(large);
  }
  cli_run(&cli, "render head.safetensors --clip clip -o x.mp4 --fit cover");
  cli_expect(&cli, 2, "--fit", "--size", NULL);
}

/* What a still picture keeps is of the same rays. */
static void test_still_edges_long(void **state) {
  (void)state;
  static const char *const words[] = {"--set reuse-rays=0", "--set reuse-rays=-1"};
  size_t count[2];
  uint8_t *pixels[2];
  for (int k = 0; k < 2; k++) {
    support_clear("raw.bin");
    snprintf(
        cli.line, sizeof cli.line,
        "render head.safetensors --clip clip --size %dx%d --set hold-pose=3 --frames 0:3 %s -o - --quiet --isa ref",
        2 * SIDE, SIDE, words[k]);
    cli_start(&cli, "raw.bin", 0);
    cli_wait(&cli);
    cli_expect(&cli, 0, NULL);
    pixels[k] = cli_bytes("raw.bin", &count[k]);
  }
  assert_int_equal(count[0], count[1]);
  assert_memory_equal(pixels[0], pixels[1], count[0]);
  expect_edges(pixels[0] + count[0] - 8 * SIDE * SIDE, 2 * SIDE, SIDE, 0, SIDE / 2);
  free(pixels[0]), free(pixels[1]);
}

/* A background of its own aspect goes the same way. The head is drawn from so far away that no edge has anything of it.
 */
static void test_background_is_not_stretched(void **state) {
  (void)state;
  static uint8_t pixels[3 * 32 * 16];
  FILE *file = fopen("half.ppm", "wb");
  assert_non_null(file);
  for (int i = 0; i < 32 * 16; i++) pixels[3 * i] = i % 32 < 16 ? 200 : 40; /* left half bright */
  fprintf(file, "P6\n32 16\n255\n");
  assert_int_equal(fwrite(pixels, 1, sizeof pixels, file), sizeof pixels);
  fclose(file);
  uint8_t *wide = drawn("head", 2 * SIDE, SIDE, "--bg-img half.ppm --scale 100"),
          *cut = drawn("head", 16, SIDE, "--bg-img half.ppm --scale 100");
  assert_int_equal(wide[0], 200);
  assert_int_equal(wide[4 * (2 * SIDE - 1)], 40);
  assert_int_equal(cut[0], 200); /* its first row goes on upward */
  assert_int_equal(cut[4 * 15], 40);
  free(wide), free(cut);
}

/* A strip that would be 16,000 pixels wide at the picture's height, more than an image may have. The head is far away.
 */
static void test_background_that_is_cut_before_it_is_scaled(void **state) {
  (void)state;
  static uint8_t pixels[3 * 1000 * 4];
  const ern_image image = {.width = 1000, .height = 4, .channels = 3, .data = pixels};
  ern_context *context = support_context();
  for (int i = 0; i < 1000 * 4; i++) pixels[3 * i] = i % 1000 < 500 ? 200 : 40; /* left half bright */
  support_clear("strip.png");
  support_ok(context, ern_image_write(context, "strip.png", &image, 100));
  uint8_t *found = drawn("head", SIDE, SIDE, "--scale 100 --fit cover --bg-img strip.png");
  assert_int_equal(found[0], 200);
  assert_int_equal(found[4 * (SIDE - 1)], 40);
  free(found);
  ern_context_free(&context);
}

/* Where a background is transparent the clip's own shows. The head is far away. */
static void test_clear_background(void **state) {
  (void)state;
  static uint8_t pixels[4 * 8 * 8];
  const ern_image image = {.width = 8, .height = 8, .channels = 4, .data = pixels};
  ern_context *context = support_context();
  uint8_t *plain = drawn("head", SIDE, SIDE, "--scale 100");
  for (int alpha = 0; alpha < 255; alpha += 127) {
    for (size_t i = 0; i < sizeof pixels; i++) pixels[i] = i % 4 < 3 ? 250 : (uint8_t)alpha;
    support_clear("clear.png");
    support_ok(context, ern_image_write(context, "clear.png", &image, 100));
    uint8_t *found = drawn("head", SIDE, SIDE, "--scale 100 --bg-img clear.png");
    assert_non_null(strstr(cli.err, "clear.png: is transparent in places: they show the clip's background"));
    const int expected = (250 * alpha + plain[0] * (255 - alpha)) / 255;
    if (abs(found[0] - expected) > 1 || found[3] != 255)
      fail_msg("alpha %d: %d over %d, expected %d", alpha, found[0], plain[0], expected); /* rounded in two orders */
    if (alpha == 0) assert_memory_equal(found, plain, 4 * SIDE * SIDE);
    free(found);
  }
  free(plain);
  ern_context_free(&context);
}

static void test_boxes(void **state) {
  (void)state;
  static const struct {
    int from[2], to[2];
    ern_fit fit;
    ern_box box;
  } rows[] = {{{450, 450}, {450, 450}, ERN_FIT_CONTAIN, {0, 450, 0, 450}},
              {{450, 450}, {180, 320}, ERN_FIT_CONTAIN, {70, 250, 0, 180}},
              {{450, 450}, {180, 320}, ERN_FIT_COVER, {0, 320, -70, 250}},
              {{1920, 1080}, {854, 480}, ERN_FIT_CONTAIN, {0, 480, 0, 854}}, /* less than a pixel is no bar */
              {{1920, 1080}, {854, 480}, ERN_FIT_COVER, {0, 480, 0, 854}},
              {{64, 48}, {48, 64}, ERN_FIT_CONTAIN, {14, 50, 0, 48}},
              {{8192, 1}, {1, 8192}, ERN_FIT_CONTAIN, {4095, 4096, 0, 1}}};
  for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
    const ern_box box = ern_fit_box(rows[i].from[0], rows[i].from[1], rows[i].to[0], rows[i].to[1], rows[i].fit);
    if (memcmp(&box, &rows[i].box, sizeof box) != 0)
      fail_msg("row %zu: [%d, %d) x [%d, %d)", i, box.top, box.bottom, box.left, box.right);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_nothing_is_distorted_long),
                                     cmocka_unit_test(test_still_edges_long),
                                     cmocka_unit_test(test_background_is_not_stretched),
                                     cmocka_unit_test(test_background_that_is_cut_before_it_is_scaled),
                                     cmocka_unit_test(test_clear_background),
                                     cmocka_unit_test(test_boxes)};
  return cmocka_run_group_tests(tests, make_models, NULL);
}
