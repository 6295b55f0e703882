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
  double yaw[FRAMES], pitch[2][FRAMES], most = 0;
  read_curve(context, "more", "yaw", yaw);
  read_curve(context, "plain", "pitch", pitch[0]);
  read_curve(context, "more", "pitch", pitch[1]);
  for (int t = 0; t < FRAMES; ++t) most = fmax(most, fabs(yaw[t]));
  assert_true(fabs(most - 25) < 1e-4);
  /* six decimals in the file, and floats */
  for (int t = 0; t < FRAMES; ++t) assert_true(fabs(pitch[1][t] - pitch[0][t] * 25 / 12) < 1e-5);
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

/* ---- faults ------------------------------------------------------------------------------------------------------ */

/* A clip as `plain` is, with parsing and a fault. */
static void make_faulty(ern_context *context, const char *folder, enum ern_synth_fault fault, double strength) {
  ern_synth_options options = small_options();
  options.parsing = true;
  options.fault = fault;
  options.strength = strength;
  support_clear(folder);
  support_ok(context, ern_synth_write(context, folder, &options));
}

static bool same_picture(ern_context *context, const char *folder, const char *other, const char *part, int frame,
                         int other_frame) {
  ern_image a = read_image(context, in_folder(folder, part, frame), 3);
  ern_image b = read_image(context, in_folder(other, part, other_frame), 3);
  const bool same = memcmp(a.data, b.data, (size_t)SIZE * SIZE * 3) == 0;
  ern_image_free(context, &a);
  ern_image_free(context, &b);
  return same;
}

static void held_camera_moves_all_alike(void **state) {
  ern_context *context = *state;
  make_faulty(context, "held", ERN_SYNTH_CAMERA, 3);
  struct ern_synth_curve curves[FRAMES] = {{0}};
  struct ern_synth_speech speech = {0};
  ern_synth_options options = small_options();
  size_t cut = 0;
  options.fault = ERN_SYNTH_CAMERA;
  options.strength = 3;
  support_ok(context, ern_synth_fault_move(context, &options, &speech, curves, FRAMES, &cut));
  double furthest = 0;
  for (int t = 0; t < FRAMES; ++t) {
    float still[ERN_LANDMARKS][2], held[ERN_LANDMARKS][2];
    read_points(context, "plain", t, still);
    read_points(context, "held", t, held);
    assert_true(fabsf(curves[t].pan) <= 3 && fabsf(curves[t].nod) <= 3);
    for (int k = 0; k < ERN_LANDMARKS; ++k) {
      float u = held[k][0] / SIZE, v = held[k][1] / SIZE;
      furthest = fmax(furthest, hypot((double)(held[k][0] - still[k][0]), (double)(held[k][1] - still[k][1])));
      /* what room and torso are moved by undoes what the pose did to the head; six decimals and floats */
      ern_synth_camera_rest(&curves[t], &u, &v);
      assert_true(fabsf(u * SIZE - still[k][0]) < 1e-3f && fabsf(v * SIZE - still[k][1]) < 1e-3f);
    }
    assert_true(!same_picture(context, "plain", "held", "gt_imgs/%d.jpg", t, t));
  }
  /* at most 3 degrees each way: 64 x 2.4 x tan 3 x sqrt 2 = 11.4 pixels in the middle */
  assert_true(furthest > 2 && furthest < 12.5);
  ern_image plain = read_image(context, "plain/bc.jpg", 3), room = read_image(context, "held/bc.jpg", 3);
  assert_true(mean_difference(&plain, &room) == 0);
  ern_image_free(context, &plain);
  ern_image_free(context, &room);
}

static void rod_hides_in_the_middle_third(void **state) {
  ern_context *context = *state;
  make_faulty(context, "whole", ERN_SYNTH_NO_FAULT, 0);
  make_faulty(context, "hidden", ERN_SYNTH_OCCLUDE, 10);
  for (int t = 0; t < FRAMES; ++t) {
    const bool passes = t >= FRAMES / 3 && t < 2 * FRAMES / 3;
    assert_int_equal(same_picture(context, "whole", "hidden", "gt_imgs/%d.jpg", t, t), !passes);
  }
  /* frame 6 is near the middle: what the rod covers is cut out of the person */
  ern_image whole = read_image(context, "whole/parsing/6.png", 3),
            hidden = read_image(context, "hidden/parsing/6.png", 3);
  int gone = 0, other = 0;
  for (int y = 0; y < SIZE; ++y)
    for (int x = 0; x < SIZE; ++x) {
      const int was = layer_at(&whole, x, y), is = layer_at(&hidden, x, y);
      gone += was != 0 && is == 0;
      other += was != is && is != 0;
    }
  /* the rod is 6.4 pixels wide and 40 long: all of that, or the 16 rows that lie before the shoulders */
  assert_in_range(gone, 102, 256);
  assert_int_equal(other, 0);
  ern_image_free(context, &whole);
  ern_image_free(context, &hidden);
}

static void profile_still_and_cut_long(void **state) {
  ern_context *context = *state;
  double plain[FRAMES], yaw[FRAMES], most = 0;
  make_faulty(context, "profile", ERN_SYNTH_PROFILE, 60);
  read_curve(context, "plain", "yaw", plain);
  read_curve(context, "profile", "yaw", yaw);
  for (int t = 0; t < FRAMES; ++t) {
    most = fmax(most, yaw[t]);
    if (t <= FRAMES / 3 || t >= 2 * FRAMES / 3) assert_true(yaw[t] == plain[t]);
  }
  assert_true(fabs(most - 60) < 1e-4);
  make_faulty(context, "still", ERN_SYNTH_STILL, 50);
  for (int t = 1; t < FRAMES; ++t)
    assert_int_equal(same_picture(context, "still", "still", "gt_imgs/%d.jpg", t - 1, t), t > FRAMES / 2);
  make_faulty(context, "cut", ERN_SYNTH_CUT, 50);
  ern_synth_options options = small_options();
  ++options.seed;
  support_clear("other");
  support_ok(context, ern_synth_write(context, "other", &options));
  for (int t = 0; t < FRAMES; ++t) {
    assert_int_equal(same_picture(context, "cut", "plain", "gt_imgs/%d.jpg", t, t), t < FRAMES / 2);
    /* the other seed's torso lies as that one's head moves; its mouth says what the first one says */
    assert_int_equal(same_picture(context, "cut", "other", "torso_imgs/%d.png", t, t), t >= FRAMES / 2);
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
  options.fault = ERN_SYNTH_CUT;
  support_expect(context, ern_synth_write(context, "none", &options), ERN_E_ARGUMENT, "strength", "0.1 to 100", NULL);
  options = small_options();
  options.fault = (enum ern_synth_fault)6;
  support_expect(context, ern_synth_write(context, "none", &options), ERN_E_ARGUMENT, "fault", "6", "0 to 5", NULL);
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

static int write_beside(void *user, int done, int total) {
  (void)user;
  (void)total;
  if (done == 1) support_write_text("shared/transforms_val.json", "mine");
  return 0;
}

/* Where another program writes a file of that name meanwhile, it stays. */
static void keeps_files_of_others(void **state) {
  (void)state;
  char text[8] = "";
  ern_context_config config = ern_context_config_default();
  ern_context *context = NULL;
  ern_synth_options options = small_options();
  config.keep_files = true;
  options.progress = write_beside;
  support_ok(context, ern_context_create(&context, &config));
  support_expect(context, ern_synth_write(context, "shared", &options), ERN_E_EXISTS, "transforms_val.json", NULL);
  FILE *file = fopen("shared/transforms_val.json", "rb");
  assert_non_null(file);
  assert_int_equal(fread(text, 1, sizeof text, file), 4);
  assert_string_equal(text, "mine");
  fclose(file);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(is_still_a_clip),
      cmocka_unit_test(video_shows_the_frames),
      cmocka_unit_test(parsing_is_the_layers),
      cmocka_unit_test(turns_as_far_as_asked),
      cmocka_unit_test(rooms_differ),
      cmocka_unit_test(same_as_tiny),
      cmocka_unit_test(held_camera_moves_all_alike),
      cmocka_unit_test(rod_hides_in_the_middle_third),
      cmocka_unit_test(profile_still_and_cut_long),
      cmocka_unit_test(leaves_nothing_behind),
      cmocka_unit_test(keeps_files_of_others),
      cmocka_unit_test(refuses),
  };
  return cmocka_run_group_tests_name("synth_video", tests, make_clips, free_clips);
}
