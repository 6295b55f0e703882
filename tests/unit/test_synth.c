/* SPDX-License-Identifier: MIT
 * Made-up clips: is everything there, does what the curves say show in the pictures, and is data/tiny what its MANIFEST
 * says. */
#include "../support.h"

#include <math.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/memory.h"
#include "ernerf-lab/synth.h"
#include "ernerf/media.h"
#include "io/csv.h"
#include "io/file.h"
#include "io/landmarks.h"
#include "lab/synth/synth_parts.h"

enum { SIZE = 64, FRAMES = 12, VAL = 2, TRAIN = FRAMES - VAL, FILE_LIMIT = 1 << 24 };

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

/* Made once for all tests: as the options are by default, and with each of them off. */
struct clips {
  ern_context *context;
};

static int make_clips(void **state) {
  static struct clips clips;
  clips.context = support_context();
  static const char *const names[] = {"plain", "again", "bare"};
  for (int k = 0; k < 3; ++k) {
    ern_synth_options options = small_options();
    options.blink = options.torso = options.moving_camera = k != 2;
    support_clear(names[k]);
    support_ok(clips.context, ern_synth_write(clips.context, names[k], &options));
  }
  *state = &clips;
  return 0;
}

static int free_clips(void **state) {
  struct clips *clips = *state;
  ern_context_free(&clips->context);
  return 0;
}

static double correlation(const double *a, const double *b, int count) {
  double ma = 0, mb = 0, aa = 0, bb = 0, ab = 0;
  for (int i = 0; i < count; ++i) {
    ma += a[i] / count;
    mb += b[i] / count;
  }
  for (int i = 0; i < count; ++i) {
    aa += (a[i] - ma) * (a[i] - ma);
    bb += (b[i] - mb) * (b[i] - mb);
    ab += (a[i] - ma) * (b[i] - mb);
  }
  return ab / sqrt(aa * bb + 1e-300);
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

static double distance(float points[ERN_LANDMARKS][2], int a, int b) {
  return hypot((double)(points[a][0] - points[b][0]), (double)(points[a][1] - points[b][1]));
}

/* Height of the eyes' openings over their widths. */
static double eye_opening(float points[ERN_LANDMARKS][2]) {
  const double left = distance(points, 37, 41) + distance(points, 38, 40), wide = distance(points, 36, 39);
  const double right = distance(points, 43, 47) + distance(points, 44, 46);
  return (left + right) / (2.0 * wide + 2.0 * distance(points, 42, 45));
}

static ern_image read_image(ern_context *context, const char *path, int channels) {
  ern_image image = {0};
  support_ok(context, ern_image_read(context, path, channels, &image));
  return image;
}

/* ---- what is there ----------------------------------------------------------------------------------------------- */

static void is_a_whole_clip(void **state) {
  ern_context *context = ((struct clips *)*state)->context;
  ern_clip *clip = NULL;
  ern_clip_info info;
  support_ok(context, ern_clip_open(context, "plain", NULL, &clip));
  ern_clip_describe(clip, &info);
  assert_int_equal(info.width, SIZE);
  assert_int_equal(info.height, SIZE);
  assert_int_equal(info.frames[ERN_SPLIT_TRAIN], TRAIN);
  assert_int_equal(info.frames[ERN_SPLIT_VAL], VAL);
  assert_true(info.has_blink && info.has_torso && info.has_sound && info.has_landmarks);
  assert_string_equal(info.features_file, "aud_ds.npy");
  assert_true(info.cx == SIZE / 2.0 && info.cy == SIZE / 2.0);
  const ern_features *features = ern_clip_features(clip);
  assert_int_equal(features->windows, FRAMES);
  assert_int_equal(features->window_length, 16);
  assert_int_equal(features->width, 29);
  for (int t = 0; t < FRAMES; ++t) {
    const ern_split split = t < TRAIN ? ERN_SPLIT_TRAIN : ERN_SPLIT_VAL;
    const ern_clip_frame *frame = ern_clip_frame_at(clip, split, (size_t)(t < TRAIN ? t : t - TRAIN));
    assert_int_equal(frame->pose.img_id, t);
    assert_int_equal(frame->pose.aud_id, t);
  }
  /* a window moves by two steps a frame */
  const size_t window = 16 * 29, step = 29;
  for (size_t t = 0; t + 1 < FRAMES; ++t)
    assert_memory_equal(features->data + t * window + 2 * step, features->data + (t + 1) * window,
                        (window - 2 * step) * sizeof(float));
  ern_clip_free(&clip);
  ern_sound sound;
  support_ok(context, ern_sound_read(context, "plain/aud.wav", &sound));
  assert_int_equal(sound.rate, 16000);
  assert_int_equal(sound.channels, 1);
  assert_int_equal(sound.frames, FRAMES * 640);
  int loudest = 0;
  for (size_t n = 0; n < sound.frames; ++n)
    if (abs(sound.data[n]) > loudest) loudest = abs(sound.data[n]);
  assert_in_range(loudest, 3000, 32767);
  ern_sound_free(context, &sound);
}

static void count_bad(void *user, int ok, const char *sentence) {
  if (ok < 0) {
    print_error("%s\n", sentence);
    ++*(int *)user;
  }
}

static void check_is_content(void **state) {
  ern_context *context = ((struct clips *)*state)->context;
  int bad = 0;
  support_ok(context, ern_clip_check(context, "plain", count_bad, &bad));
  support_ok(context, ern_clip_check(context, "bare", count_bad, &bad));
  assert_int_equal(bad, 0);
}

static void same_files(ern_context *context, const char *name) {
  uint8_t *bytes[2] = {NULL, NULL};
  size_t count[2] = {0, 0};
  support_ok(context, ern_file_read(context, in_folder("plain", name, 0), FILE_LIMIT, &bytes[0], &count[0]));
  support_ok(context, ern_file_read(context, in_folder("again", name, 0), FILE_LIMIT, &bytes[1], &count[1]));
  if (count[0] != count[1] || memcmp(bytes[0], bytes[1], count[0]) != 0) fail_msg("%s differs between two runs", name);
  ern_release(context, bytes[0]);
  ern_release(context, bytes[1]);
}

static void same_options_same_bytes(void **state) {
  ern_context *context = ((struct clips *)*state)->context;
  static const char *const whole[] = {
      "transforms_train.json", "transforms_val.json", "bc.jpg", "aud_ds.npy", "aud.wav", "au.csv", "curves.csv"};
  static const char *const parts[] = {"gt_imgs/%d.jpg", "torso_imgs/%d.png", "ori_imgs/%d.lms"};
  for (int k = 0; k < 7; ++k) same_files(context, whole[k]);
  for (int k = 0; k < 3; ++k)
    for (int t = 0; t < FRAMES; ++t) {
      char name[64];
      const char *percent = strchr(parts[k], '%');
      snprintf(name, sizeof name, "%.*s%d%s", (int)(percent - parts[k]), parts[k], t, percent + 2);
      same_files(context, name);
    }
}

static void another_seed_is_another_person(void **state) {
  (void)state;
  struct ern_synth_person a, b;
  ern_synth_person_make(3, &a);
  ern_synth_person_make(4, &b);
  assert_true(a.voice != b.voice && a.face_width != b.face_width && a.grain.x != b.grain.x);
  ern_synth_person_make(3, &b);
  assert_true(a.voice == b.voice && a.grain.z == b.grain.z && a.skin.x == b.skin.x);
}

/* ---- what shows -------------------------------------------------------------------------------------------------- */

static void mouth_follows_the_curve(void **state) {
  ern_context *context = ((struct clips *)*state)->context;
  double jaw[FRAMES], gap[FRAMES], dark[FRAMES];
  read_curve(context, "plain", "jaw", jaw);
  int closed = 0, open = 0;
  for (int t = 0; t < FRAMES; ++t) {
    float points[ERN_LANDMARKS][2];
    read_points(context, "plain", t, points);
    gap[t] = distance(points, 62, 66) / distance(points, 27, 30); /* over the nose, for the head moves */
    /* the darkest that is seen between the lips */
    ern_image image = read_image(context, in_folder("plain", "gt_imgs/%d.jpg", t), 3);
    const int x0 = (int)points[61][0], x1 = (int)points[63][0], y0 = (int)points[62][1] - 1,
              y1 = (int)points[66][1] + 1;
    int darkest = 3 * 255;
    for (int y = y0; y <= y1; ++y)
      for (int x = x0; x <= x1; ++x) {
        const uint8_t *p = image.data + 3 * (y * SIZE + x);
        const int light = p[0] + p[1] + p[2];
        if (light < darkest) darkest = light;
      }
    dark[t] = -darkest;
    ern_image_free(context, &image);
    if (jaw[t] < jaw[closed]) closed = t;
    if (jaw[t] > jaw[open]) open = t;
  }
  print_message("jaw %.2f..%.2f, lips apart %.3f..%.3f, correlation %.3f, with darkness %.3f\n", jaw[closed], jaw[open],
                gap[closed], gap[open], correlation(jaw, gap, FRAMES), correlation(jaw, dark, FRAMES));
  assert_true(jaw[closed] < 0.05 && jaw[open] > 0.5);
  assert_true(correlation(jaw, gap, FRAMES) > 0.97);
  assert_true(correlation(jaw, dark, FRAMES) > 0.7);
  assert_true(dark[open] > dark[closed] + 60);
}

/* The mouth is a function of the features alone: the same few logits, the same mouth; and it is no constant. */
static void mouth_is_in_the_features(void **state) {
  ern_context *context = ((struct clips *)*state)->context;
  enum { LONG = 1500, SILENCE = 0, A = 1, M = 13 };
  struct ern_synth_speech speech;
  support_ok(context, ern_synth_speech_make(context, 9, LONG, &speech));
  double open = 0, shut = 0, quiet = 0;
  int opens = 0, shuts = 0, quiets = 0;
  for (size_t k = 2; k + 2 < speech.steps; ++k) {
    int best[5];
    for (size_t j = 0; j < 5; ++j) {
      const float *logits = speech.logits[k + j - 2];
      best[j] = 0;
      for (int c = 1; c < 28; ++c)
        if (logits[c] > logits[best[j]]) best[j] = c;
    }
    bool steady = true;
    for (int j = 1; j < 5; ++j) steady = steady && best[j] == best[0];
    if (!steady) continue;
    if (best[0] == A) open += (double)speech.jaw[k], ++opens;
    if (best[0] == M) shut += (double)speech.jaw[k], ++shuts;
    if (best[0] == SILENCE) quiet += (double)speech.jaw[k], ++quiets;
    assert_true(speech.jaw[k] >= 0 && speech.jaw[k] <= 1 && fabsf(speech.width[k]) <= 1);
  }
  print_message("mean jaw: a %.2f (%d steps), m %.2f (%d), silence %.2f (%d)\n", open / opens, opens, shut / shuts,
                shuts, quiet / quiets, quiets);
  assert_true(opens > 20 && shuts > 0 && quiets > 100);
  assert_true(open / opens > 0.8 && shut / shuts < 0.1 && quiet / quiets < 0.03);
  ern_synth_speech_free(context, &speech);
}

static void head_is_where_the_landmarks_are(void **state) {
  ern_context *context = ((struct clips *)*state)->context;
  ern_image room = read_image(context, "bare/bc.jpg", 3);
  ern_image truth = read_image(context, "bare/gt_imgs/0.jpg", 3);
  float points[ERN_LANDMARKS][2];
  int head = 0, under = 0;
  for (int i = 0; i < SIZE * SIZE; ++i) {
    int apart = 0;
    for (int c = 0; c < 3; ++c) apart += abs(truth.data[3 * i + c] - room.data[3 * i + c]);
    head += apart > 30;
  }
  print_message("the head covers %.3f of the picture\n", (double)head / (SIZE * SIZE));
  assert_in_range(head, SIZE * SIZE * 12 / 100, SIZE * SIZE * 35 / 100);
  for (int t = 0; t < FRAMES; ++t) {
    read_points(context, "plain", t, points);
    for (int k = 0; k < ERN_LANDMARKS; ++k)
      assert_true(points[k][0] > 0 && points[k][0] < SIZE && points[k][1] > 0 && points[k][1] < SIZE);
  }
  /* but for the outline they lie on the head */
  read_points(context, "bare", 0, points);
  for (int k = 17; k < ERN_LANDMARKS; ++k) {
    const int at = 3 * ((int)points[k][1] * SIZE + (int)points[k][0]);
    int apart = 0;
    for (int c = 0; c < 3; ++c) apart += abs(truth.data[at + c] - room.data[at + c]);
    under += apart > 30;
  }
  assert_true(under >= 45);
  /* left is left and up is up: brows over eyes over nose over mouth over chin */
  assert_true(points[36][0] < points[39][0] && points[39][0] < points[42][0] && points[42][0] < points[45][0]);
  assert_true(points[19][1] < points[37][1] && points[37][1] < points[30][1] && points[30][1] < points[51][1] &&
              points[51][1] < points[57][1] && points[57][1] < points[8][1]);
  ern_image_free(context, &room);
  ern_image_free(context, &truth);
}

static void blinks_and_does_not(void **state) {
  ern_context *context = ((struct clips *)*state)->context;
  double blink[FRAMES], least = 9, most = 0;
  read_curve(context, "plain", "blink", blink);
  float *unit = NULL;
  size_t count = 0;
  support_ok(context, ern_csv_read_column(context, "plain/au.csv", "AU45_r", &unit, &count));
  assert_int_equal(count, FRAMES);
  int shut = 0;
  for (int t = 0; t < FRAMES; ++t) {
    float points[ERN_LANDMARKS][2];
    assert_true(fabs((double)unit[t] - 2 * blink[t]) < 0.006);
    if (blink[t] > blink[shut]) shut = t;
    read_points(context, "plain", t, points);
    const double opening = eye_opening(points);
    least = fmin(least, opening);
    most = fmax(most, opening);
  }
  ern_release(context, unit);
  assert_true(blink[0] == 0 && blink[shut] >= 1);
  assert_true(most > 0.2 && least < 0.1);
  /* without */
  assert_true(there("plain/au.csv"));
  assert_false(there("bare/au.csv"));
  read_curve(context, "bare", "blink", blink);
  for (int t = 0; t < FRAMES; ++t) {
    float points[ERN_LANDMARKS][2];
    read_points(context, "bare", t, points);
    assert_true(blink[t] == 0 && eye_opening(points) > 0.2);
  }
}

static void torso_is_there_or_not(void **state) {
  ern_context *context = ((struct clips *)*state)->context;
  ern_image room = read_image(context, "plain/bc.jpg", 3);
  for (int bare = 0; bare < 2; ++bare) {
    const char *folder = bare ? "bare" : "plain";
    ern_image torso = read_image(context, in_folder(folder, "torso_imgs/%d.png", 5), 4);
    ern_image truth = read_image(context, in_folder(folder, "gt_imgs/%d.jpg", 5), 3);
    int opaque = 0, clear = 0, apart = 0;
    for (int i = 0; i < SIZE * SIZE; ++i) {
      opaque += torso.data[4 * i + 3] == 255;
      clear += torso.data[4 * i + 3] == 0;
    }
    const int low = SIZE * (SIZE - 1) + SIZE / 2; /* the middle of the last row: the shirt, or the wall */
    for (int c = 0; c < 3; ++c) apart += abs(truth.data[3 * low + c] - room.data[3 * low + c]);
    if (bare) {
      assert_int_equal(clear, SIZE * SIZE);
      assert_true(apart < 12);
    } else {
      assert_in_range(opaque, SIZE * SIZE / 5, SIZE * SIZE / 2);
      assert_in_range(clear, SIZE * SIZE * 2 / 5, SIZE * SIZE * 4 / 5);
      assert_int_equal(torso.data[4 * low + 3], 255);
      /* head over torso over room: down there the frame is the torso */
      for (int c = 0; c < 3; ++c) assert_true(abs(truth.data[3 * low + c] - torso.data[4 * low + c]) < 16);
    }
    ern_image_free(context, &torso);
    ern_image_free(context, &truth);
  }
  ern_image_free(context, &room);
}

static void camera_moves_or_not(void **state) {
  ern_context *context = ((struct clips *)*state)->context;
  for (int bare = 0; bare < 2; ++bare) {
    ern_pose_list list;
    support_ok(context,
               ern_pose_list_load(context, bare ? "bare/transforms_train.json" : "plain/transforms_train.json", &list));
    double most = 0;
    for (size_t t = 0; t < list.count; ++t) {
      double norm = 0, turned = 0;
      for (int k = 0; k < 12; ++k)
        most = fmax(most, fabs((double)list.poses[t].matrix[k] - (double)list.poses[0].matrix[k]));
      for (int k = 0; k < 3; ++k) {
        norm += (double)list.poses[t].matrix[4 * k] * (double)list.poses[t].matrix[4 * k];
        turned += (double)list.poses[t].matrix[4 * k] * (double)list.poses[t].matrix[4 * k + 1];
      }
      assert_true(fabs(norm - 1) < 1e-5 && fabs(turned) < 1e-5);
      /* the camera is in front of the face, some 3.6 / 4 away */
      assert_true(list.poses[t].matrix[11] > 0.8f && list.poses[t].matrix[11] < 1.0f);
    }
    if (bare) assert_true(most == 0);
    if (!bare) assert_true(most > 0.01);
    ern_pose_list_free(context, &list);
  }
}

/* ---- what is refused -----------------------------------------------------------------------------------------------
 */

static int stop_at_three(void *user, int done, int total) {
  *(int *)user = done;
  assert_int_equal(total, FRAMES);
  return done == 3;
}

static void leaves_nothing_behind(void **state) {
  ern_context *context = ((struct clips *)*state)->context;
  ern_synth_options options = small_options();
  int last = 0;
  options.progress = stop_at_three;
  options.user = &last;
  support_clear("stopped");
  support_expect(context, ern_synth_write(context, "stopped", &options), ERN_E_CANCELLED, "stopped", "3 of 12", NULL);
  assert_int_equal(last, 3);
  assert_false(there("stopped"));
  /* a folder that was there and empty stays, empty */
  assert_int_equal(mkdir("stopped", 0777), 0);
  support_expect(context, ern_synth_write(context, "stopped", &options), ERN_E_CANCELLED, "stopped", NULL);
  assert_int_equal(rmdir("stopped"), 0);
}

static void refuses(void **state) {
  ern_context *context = ((struct clips *)*state)->context;
  ern_synth_options options = small_options();
  support_clear("full");
  assert_int_equal(mkdir("full", 0777), 0);
  support_write_text("full/mine.txt", "keep me");
  support_expect(context, ern_synth_write(context, "full", &options), ERN_E_STATE, "full", "mine.txt", "empty", NULL);
  assert_true(there("full/mine.txt"));
  assert_false(there("full/gt_imgs"));
  support_expect(context, ern_synth_write(context, "full/mine.txt", &options), ERN_E_IO, "full/mine.txt", NULL);
  options.size = 63;
  support_expect(context, ern_synth_write(context, "none", &options), ERN_E_ARGUMENT, "size", "63", "64", NULL);
  options.size = 1081;
  support_expect(context, ern_synth_write(context, "none", &options), ERN_E_ARGUMENT, "1081", "1080", NULL);
  options = small_options();
  options.frames = 7;
  support_expect(context, ern_synth_write(context, "none", &options), ERN_E_ARGUMENT, "frames", "7", "8", NULL);
  options = (ern_synth_options){.size = SIZE, .frames = FRAMES};
  support_expect(context, ern_synth_write(context, "none", &options), ERN_E_ARGUMENT, "ern_synth_options_default",
                 NULL);
  assert_false(there("none"));
}

/* ---- data/tiny
 * -------------------------------------------------------------------------------------------------------- */

/* Files below a folder, and their bytes. */
static void measure(const char *folder, size_t *files, size_t *bytes) {
  DIR *list = opendir(folder);
  assert_non_null(list);
  for (struct dirent *entry = readdir(list); entry != NULL; entry = readdir(list)) {
    char inside[2048];
    struct stat about;
    if (entry->d_name[0] == '.') continue;
    snprintf(inside, sizeof inside, "%s/%s", folder, entry->d_name);
    assert_int_equal(stat(inside, &about), 0);
    if (S_ISDIR(about.st_mode)) {
      measure(inside, files, bytes);
    } else {
      ++*files;
      *bytes += (size_t)about.st_size;
    }
  }
  closedir(list);
}

static void tiny_is_what_its_manifest_says(void **state) {
  ern_context *context = ((struct clips *)*state)->context;
  const char *source = getenv("ERNERF_SOURCE");
  if (source == NULL || source[0] == 0) skip();
  char folder[1024], path[2048], line[512], previous[512] = "";
  snprintf(folder, sizeof folder, "%s/data/tiny", source);
  snprintf(path, sizeof path, "%s/MANIFEST", folder);
  FILE *manifest = fopen(path, "r");
  assert_non_null(manifest);
  assert_non_null(fgets(line, sizeof line, manifest));
  assert_string_equal(line, "# ernerf synth data/tiny --size 128 --frames 66 --seed 1\n");
  size_t listed = 0, files = 0, bytes = 0;
  while (fgets(line, sizeof line, manifest) != NULL) {
    char expected[65], found[65], name[256];
    assert_int_equal(sscanf(line, "%64[0-9a-f]  %255s", expected, name), 2);
    assert_true(strcmp(previous, name) < 0);
    snprintf(previous, sizeof previous, "%s", name);
    snprintf(path, sizeof path, "%s/%s", folder, name);
    uint8_t *content = NULL;
    size_t count = 0;
    support_ok(context, ern_file_read(context, path, FILE_LIMIT, &content, &count));
    ern_sha256_hex(content, count, found);
    ern_release(context, content);
    if (strcmp(expected, found) != 0) fail_msg("%s: SHA-256 is %s, MANIFEST says %s", path, found, expected);
    ++listed;
  }
  fclose(manifest);
  measure(folder, &files, &bytes);
  assert_int_equal(files, listed + 1);
  assert_true(bytes < 3000000);
  ern_clip *clip = NULL;
  ern_clip_info info;
  support_ok(context, ern_clip_open(context, folder, NULL, &clip));
  ern_clip_describe(clip, &info);
  assert_int_equal(info.width, 128);
  assert_int_equal(info.frames[ERN_SPLIT_TRAIN], 60);
  assert_int_equal(info.frames[ERN_SPLIT_VAL], 6);
  /* there are two blinks to learn from */
  int blinks = 0;
  for (size_t t = 1; t < 60; ++t)
    blinks += ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, t)->eye > 0.5f &&
              ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, t - 1)->eye <= 0.5f;
  assert_true(blinks >= 2);
  ern_clip_free(&clip);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(is_a_whole_clip),
      cmocka_unit_test(check_is_content),
      cmocka_unit_test(same_options_same_bytes),
      cmocka_unit_test(another_seed_is_another_person),
      cmocka_unit_test(mouth_follows_the_curve),
      cmocka_unit_test(mouth_is_in_the_features),
      cmocka_unit_test(head_is_where_the_landmarks_are),
      cmocka_unit_test(blinks_and_does_not),
      cmocka_unit_test(torso_is_there_or_not),
      cmocka_unit_test(camera_moves_or_not),
      cmocka_unit_test(leaves_nothing_behind),
      cmocka_unit_test(refuses),
      cmocka_unit_test(tiny_is_what_its_manifest_says),
  };
  return cmocka_run_group_tests_name("synth", tests, make_clips, free_clips);
}
