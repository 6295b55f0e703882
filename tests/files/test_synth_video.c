/* SPDX-License-Identifier: MIT
 * Made-up clips with more than a plain one has: a video, layers, another room, a wider turn. */
#include "../support.h"

#include <math.h>
#include <sys/stat.h>

#include "core/memory.h"
#include "ernerf-lab/synth.h"
#include "ernerf/media.h"
#include "io/csv.h"
#include "io/landmarks.h"
#include "lab/synth/synth_parts.h"

enum { SIZE = 64, FRAMES = 12 };

static ern_synth_options small_options(void) {
  ern_synth_options options = ern_synth_options_default();
  options.size = SIZE;
  options.frames = FRAMES;
  options.seed = 3;
  return options;
}

static const char *in_folder(const char *folder, const char *format, int frame) {
  static char path[4][512];
  static int turn = 0;
  char name[128];
  snprintf(name, sizeof name, format, frame);
  turn = (turn + 1) % 4;
  snprintf(path[turn], sizeof path[turn], "%s/%s", folder, name);
  return path[turn];
}

static bool there(const char *path) {
  struct stat about;
  return stat(path, &about) == 0;
}

/* One column of a clip's curves.csv. */
static void read_curve(ern_context *context, const char *folder, const char *name, double values[FRAMES]) {
  float *column = NULL;
  size_t count = 0;
  support_ok(context, ern_csv_read_column(context, in_folder(folder, "curves.csv", 0), name, &column, &count));
  assert_int_equal(count, FRAMES);
  for (int t = 0; t < FRAMES; ++t) values[t] = (double)column[t];
  ern_release(context, column);
}

static void read_points(ern_context *context, const char *folder, int frame, float points[ERN_LANDMARKS][2]) {
  support_ok(context, ern_landmarks_read(context, in_folder(folder, "ori_imgs/%d.lms", frame), points));
}

static ern_image read_image(ern_context *context, const char *path, int channels) {
  ern_image image = {0};
  support_ok(context, ern_image_read(context, path, channels, &image));
  return image;
}

static void count_bad(void *user, int ok, const char *sentence) {
  if (ok < 0) {
    print_error("%s\n", sentence);
    ++*(int *)user;
  }
}

/* Made once for all tests: with all that is new, and without. */
static int make_clips(void **state) {
  ern_context *context = support_context();
  ern_synth_options options = small_options();
  support_clear("plain");
  support_ok(context, ern_synth_write(context, "plain", &options));
  options.turn = 25;
  options.room = ERN_SYNTH_CLUTTERED;
  options.parsing = true;
  options.video = "more.mp4";
  support_clear("more");
  support_clear("more.mp4");
  support_ok(context, ern_synth_write(context, "more", &options));
  *state = context;
  return 0;
}

static int free_clips(void **state) {
  ern_context *context = *state;
  ern_context_free(&context);
  return 0;
}

static double mean_difference(const ern_image *a, const ern_image *b) {
  double sum = 0;
  assert_int_equal(a->width, b->width);
  assert_int_equal(a->height, b->height);
  for (int i = 0; i < a->width * a->height * 3; ++i) sum += abs(a->data[i] - b->data[i]);
  return sum / (a->width * a->height * 3);
}

/* Of BT.709's luma, which the video has a sample a pixel of; its chroma has one in four. */
static double luma_difference(const ern_image *a, const ern_image *b) {
  double sum = 0;
  for (int i = 0; i < a->width * a->height; ++i) {
    const uint8_t *p = a->data + 3 * i, *q = b->data + 3 * i;
    sum += fabs(0.2126 * (p[0] - q[0]) + 0.7152 * (p[1] - q[1]) + 0.0722 * (p[2] - q[2]));
  }
  return sum / (a->width * a->height);
}

static void video_shows_the_frames(void **state) {
  ern_context *context = *state;
  ern_video_reader *reader = NULL;
  ern_video_info info;
  ern_image image = {0};
  double seconds = 0;
  bool end = false;
  int frames = 0;
  support_ok(context, ern_video_reader_open(context, "more.mp4", &reader));
  ern_video_reader_info(reader, &info);
  assert_int_equal(info.width, SIZE);
  assert_int_equal(info.rate_numerator, 25 * info.rate_denominator);
  assert_true(info.has_sound && info.sound_rate == 16000);
  for (;; ++frames) {
    support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
    if (end) break;
    ern_image truth = read_image(context, in_folder("more", "gt_imgs/%d.jpg", frames), 3);
    ern_image other = read_image(context, in_folder("more", "gt_imgs/%d.jpg", (frames + 6) % FRAMES), 3);
    /* quantization at CRF 18 is below 4 levels of luma, and the other moment is much further away */
    const double apart = luma_difference(&image, &truth);
    assert_true(apart < 4 && apart < 0.6 * luma_difference(&image, &other));
    ern_image_free(context, &truth);
    ern_image_free(context, &other);
  }
  assert_int_equal(frames, FRAMES);
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
}

/* The layer at a pixel: 0 background, 1 head, 2 neck, 3 torso. */
static int layer_at(const ern_image *parsing, int x, int y) {
  static const uint8_t colours[4][3] = {{255, 255, 255}, {0, 0, 255}, {0, 255, 0}, {255, 0, 0}};
  for (int k = 0; k < 4; ++k)
    if (memcmp(parsing->data + 3 * (y * parsing->width + x), colours[k], 3) == 0) return k;
  fail_msg("a colour at %d, %d that is no layer's", x, y);
  return -1;
}

static void parsing_is_the_layers(void **state) {
  ern_context *context = *state;
  assert_true(there("more/parsing/0.png") && !there("plain/parsing"));
  ern_image room = read_image(context, "more/bc.jpg", 3);
  for (int t = 0; t < FRAMES; t += 5) {
    ern_image parsing = read_image(context, in_folder("more", "parsing/%d.png", t), 3);
    ern_image torso = read_image(context, in_folder("more", "torso_imgs/%d.png", t), 4);
    ern_image truth = read_image(context, in_folder("more", "gt_imgs/%d.jpg", t), 3);
    float points[ERN_LANDMARKS][2];
    int count[4] = {0}, apart = 0;
    read_points(context, "more", t, points);
    /* nose and mouth; the far eye's corner may lie on the outline */
    for (int k = 27; k < 36; ++k) assert_int_equal(layer_at(&parsing, (int)points[k][0], (int)points[k][1]), 1);
    for (int k = 48; k < ERN_LANDMARKS; ++k)
      assert_int_equal(layer_at(&parsing, (int)points[k][0], (int)points[k][1]), 1);
    for (int y = 0; y < SIZE; ++y)
      for (int x = 0; x < SIZE; ++x) {
        const int layer = layer_at(&parsing, x, y), at = y * SIZE + x, alpha = torso.data[4 * at + 3];
        ++count[layer];
        if (layer == 0) {
          assert_true(alpha < 128);
          for (int c = 0; c < 3; ++c) apart += abs(truth.data[3 * at + c] - room.data[3 * at + c]);
        }
        if (layer > 1) assert_true(alpha >= 128);
      }
    /* below the chin: neck, then cloth in the last row's corners */
    assert_int_equal(layer_at(&parsing, (int)points[8][0], (int)points[8][1] + 4), 2);
    assert_int_equal(layer_at(&parsing, SIZE / 5, SIZE - 1), 3);
    assert_in_range(count[1], SIZE * SIZE * 12 / 100, SIZE * SIZE * 35 / 100);
    assert_in_range(count[2], 20, SIZE * SIZE / 20);
    assert_true(apart / (3.0 * count[0]) < 12); /* two JPEGs, and edges that are less than half the person's */
    ern_image_free(context, &parsing);
    ern_image_free(context, &torso);
    ern_image_free(context, &truth);
  }
  ern_image_free(context, &room);
}

static void turns_as_far_as_asked(void **state) {
  ern_context *context = *state;
  double yaw[2][FRAMES], pitch[2][FRAMES], most = 0;
  read_curve(context, "plain", "yaw", yaw[0]);
  read_curve(context, "more", "yaw", yaw[1]);
  read_curve(context, "plain", "pitch", pitch[0]);
  read_curve(context, "more", "pitch", pitch[1]);
  for (int t = 0; t < FRAMES; ++t) most = fmax(most, fabs(yaw[1][t]));
  assert_true(fabs(most - 25) < 1e-4);
  /* six decimals in the file */
  for (int t = 0; t < FRAMES; ++t)
    assert_true(fabs(pitch[1][t] * yaw[0][0] - pitch[0][t] * yaw[1][0]) < 1e-5 * (1 + fabs(yaw[1][0])));
}

/* Steps of grey from a pixel to the next, in the mean. */
static double busyness(const ern_image *image) {
  double sum = 0;
  for (int y = 0; y < SIZE; ++y)
    for (int x = 0; x + 1 < SIZE; ++x)
      sum += abs(image->data[3 * (y * SIZE + x) + 1] - image->data[3 * (y * SIZE + x + 1) + 1]);
  return sum / (SIZE * (SIZE - 1));
}

static void rooms_differ(void **state) {
  (void)state;
  static const enum ern_synth_room rooms[3] = {ERN_SYNTH_PLAIN, ERN_SYNTH_BOOKS, ERN_SYNTH_CLUTTERED};
  struct ern_synth_person person;
  double busy[3];
  ern_synth_person_make(3, &person);
  for (int k = 0; k < 3; ++k) {
    static float pixels[SIZE * SIZE][4];
    static uint8_t bytes[SIZE * SIZE * 3];
    const ern_image image = {SIZE, SIZE, 3, bytes};
    ern_synth_room_draw(&person, 3, rooms[k], SIZE, pixels);
    for (int i = 0; i < SIZE * SIZE; ++i)
      for (int c = 0; c < 3; ++c) {
        assert_true(pixels[i][c] >= 0 && pixels[i][c] <= 1);
        bytes[3 * i + c] = (uint8_t)(255 * pixels[i][c]);
      }
    busy[k] = busyness(&image);
  }
  assert_true(busy[0] < 1 && busy[0] < 0.5 * busy[1] && busy[2] > 5 * busy[1]);
}

/* What the options of before give is what data/tiny has been all along. */
static void same_as_tiny(void **state) {
  ern_context *context = *state;
  const char *source = getenv("ERNERF_SOURCE");
  if (source == NULL || source[0] == 0) skip();
  ern_synth_options options = ern_synth_options_default();
  char path[2048];
  options.size = 128;
  options.frames = 8;
  options.seed = 1;
  support_clear("tiny");
  support_ok(context, ern_synth_write(context, "tiny", &options));
  static const char *const parts[] = {"bc.jpg", "gt_imgs/0.jpg", "torso_imgs/0.png", "torso_imgs/7.png"};
  for (int k = 0; k < 4; ++k) {
    snprintf(path, sizeof path, "%s/data/tiny/%s", source, parts[k]);
    ern_image was = read_image(context, path, 3), is = read_image(context, in_folder("tiny", parts[k], 0), 3);
    /* another machine's libm moves a value across the rounding of a byte here and there */
    assert_true(mean_difference(&was, &is) < 0.02);
    ern_image_free(context, &was);
    ern_image_free(context, &is);
  }
}

static int stop_at_three(void *user, int done, int total) {
  (void)user, (void)total;
  return done == 3;
}

static void leaves_nothing_behind(void **state) {
  ern_context *context = *state;
  ern_synth_options options = small_options();
  support_clear("stopped");
  support_clear("stopped.mp4");
  options.progress = stop_at_three;
  options.parsing = true;
  options.video = "stopped.mp4";
  support_expect(context, ern_synth_write(context, "stopped", &options), ERN_E_CANCELLED, "stopped", NULL);
  assert_false(there("stopped") || there("stopped.mp4") || there("stopped.mp4.ernerf-tmp"));
  /* a video that is not written costs the clip */
  options.progress = NULL;
  options.video = "nowhere/stopped.mp4";
  support_expect(context, ern_synth_write(context, "stopped", &options), ERN_E_MISSING, "nowhere/stopped.mp4", NULL);
  assert_false(there("stopped"));
}

static void refuses(void **state) {
  ern_context *context = *state;
  ern_synth_options options = small_options();
  options.turn = 41;
  support_expect(context, ern_synth_write(context, "none", &options), ERN_E_ARGUMENT, "turn", "41", "40", NULL);
  options = small_options();
  options.room = (enum ern_synth_room)3;
  support_expect(context, ern_synth_write(context, "none", &options), ERN_E_ARGUMENT, "room", "3", "0 to 2", NULL);
  options = small_options();
  options.video = "none.mp4";
  options.crf = 52;
  support_expect(context, ern_synth_write(context, "none", &options), ERN_E_ARGUMENT, "crf", "52", "51", NULL);
  assert_false(there("none.mp4"));
  assert_false(there("none") || there("none.mp4"));
  /* a video that is there is kept, and its clip is not made */
  ern_context_config config = ern_context_config_default();
  ern_context *keeper = NULL;
  config.keep_files = true;
  assert_int_equal(ern_context_create(&keeper, &config), ERN_OK);
  options = small_options();
  options.video = "mine.mp4";
  support_write_text("mine.mp4", "mine");
  support_expect(keeper, ern_synth_write(keeper, "none", &options), ERN_E_EXISTS, "mine.mp4", NULL);
  assert_false(there("none"));
  struct stat about;
  assert_int_equal(stat("mine.mp4", &about), 0);
  assert_int_equal(about.st_size, 4);
  ern_context_free(&keeper);
}

static void is_still_a_clip(void **state) {
  int bad = 0;
  support_ok(*state, ern_clip_check(*state, "more", count_bad, &bad));
  assert_int_equal(bad, 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(is_still_a_clip),       cmocka_unit_test(video_shows_the_frames),
      cmocka_unit_test(parsing_is_the_layers), cmocka_unit_test(turns_as_far_as_asked),
      cmocka_unit_test(rooms_differ),          cmocka_unit_test(same_as_tiny),
      cmocka_unit_test(leaves_nothing_behind), cmocka_unit_test(refuses),
  };
  return cmocka_run_group_tests_name("synth_video", tests, make_clips, free_clips);
}
