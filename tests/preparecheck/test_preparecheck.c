/* SPDX-License-Identifier: MIT
 * The measures of a prepared clip: of the truth itself, and of known changes to it. */
#include "../support.h"

#include <jansson.h>
#include <math.h>
#include <sys/stat.h>

#include "ernerf-lab/synth.h"
#include "ernerf/media.h"
#include "io/landmarks.h"
#include "prepare_measures.h"

enum { LONG = 2000 };
static const double pi = 3.14159265358979323846;

/* ---- paths ------------------------------------------------------------------------------------------------------- */

/* xorshift64*, in [-1, 1). */
static double chance(uint64_t *state) {
  *state ^= *state >> 12, *state ^= *state << 25, *state ^= *state >> 27;
  return (double)((*state * 0x2545F4914F6CDD1Du) >> 11) * 0x1p-52 - 1;
}

static void random_axis(uint64_t *state, double axis[3]) {
  double size = 0;
  do {
    for (int k = 0; k < 3; k++) axis[k] = chance(state);
    size = sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
  } while (size > 1 || size < 0.1);
  for (int k = 0; k < 3; k++) axis[k] /= size;
}

/* Rodrigues. */
static void rotation_about(const double axis[3], double degrees, double r[3][3]) {
  const double c = cos(degrees * pi / 180), s = sin(degrees * pi / 180), x = axis[0], y = axis[1], z = axis[2];
  const double made[3][3] = {{c + x * x * (1 - c), x * y * (1 - c) - z * s, x * z * (1 - c) + y * s},
                             {y * x * (1 - c) + z * s, c + y * y * (1 - c), y * z * (1 - c) - x * s},
                             {z * x * (1 - c) - y * s, z * y * (1 - c) + x * s, c + z * z * (1 - c)}};
  memcpy(r, made, sizeof made);
}

/* a = b c; `a` may be one of the two. */
static void multiply(double a[3][3], double b[3][3], double c[3][3]) {
  double made[3][3] = {{0}};
  for (int i = 0; i < 27; i++) made[i / 9][i / 3 % 3] += b[i / 9][i % 3] * c[i % 3][i / 3 % 3];
  memcpy(a, made, sizeof made);
}

static void transform(double y[3], double a[3][3], const double x[3]) {
  for (int i = 0; i < 3; i++) y[i] = a[i][0] * x[0] + a[i][1] * x[1] + a[i][2] * x[2];
}

/* A head that turns, nods and sways as a speaker's does. */
static void make_path(struct head_pose *poses, size_t count) {
  for (size_t i = 0; i < count; i++) {
    const double t = (double)i / 25;
    double yaw[3][3], pitch[3][3];
    rotation_about((const double[3]){0, 1, 0}, 12 * sin(t) + 4 * sin(2.3 * t), yaw);
    rotation_about((const double[3]){1, 0, 0}, 6 * sin(1.4 * t + 1), pitch);
    poses[i].frame = (int64_t)i;
    multiply(poses[i].rotation, yaw, pitch);
    poses[i].place[0] = 0.02 * sin(0.9 * t), poses[i].place[1] = 0.01 * sin(1.1 * t);
    poses[i].place[2] = -0.9 + 0.03 * sin(0.7 * t);
  }
}

static void path_of_the_truth_itself(void **state) {
  (void)state;
  static struct head_pose poses[LONG];
  struct path_alignment alignment;
  struct path_errors errors;
  make_path(poses, LONG);
  assert_true(compare_paths(poses, poses, LONG, 1, &alignment, &errors));
  /* double rounding through an arc tangent: about 1e-8 radians at worst */
  assert_true(errors.rotation_median < 1e-6 && errors.rotation_p95 < 1e-6 && errors.camera_turn < 1e-5);
  assert_true(errors.place_median < 1e-6);
  assert_true(fabs(errors.rotation_tremble_ratio - 1) < 1e-9 && fabs(errors.place_tremble_ratio - 1) < 1e-4);
  assert_int_equal(errors.seconds, LONG - 2);
  assert_false(compare_paths(poses, poses, 2, 1, &alignment, &errors));
}

/* Another frame of the head, another axis of the camera, another scale and focal length are no error. */
static void choices_are_no_error(void **state) {
  (void)state;
  enum { COUNT = 500 }; /* frames, each exact */
  static struct head_pose truth[COUNT], prepared[COUNT];
  struct path_alignment alignment;
  struct path_errors errors;
  double camera[3][3], head[3][3];
  const double origin[3] = {0.01, -0.03, 0.02}, scale = 0.25, focal_ratio = 1.1;
  const double axis[2][3] = {{0.6, 0.8, 0}, {0, 0.6, 0.8}};
  rotation_about(axis[0], 3, camera);
  rotation_about(axis[1], 14, head);
  make_path(truth, COUNT);
  make_path(prepared, COUNT);
  for (size_t i = 0; i < COUNT; i++) {
    double at[3];
    transform(at, truth[i].rotation, origin);
    for (int k = 0; k < 3; k++) at[k] += truth[i].place[k];
    transform(prepared[i].place, camera, at);
    for (int k = 0; k < 3; k++) prepared[i].place[k] *= scale * (k == 2 ? focal_ratio : 1);
    multiply(prepared[i].rotation, camera, truth[i].rotation);
    multiply(prepared[i].rotation, prepared[i].rotation, head);
  }
  assert_true(compare_paths(truth, prepared, COUNT, focal_ratio, &alignment, &errors));
  print_message("rotation %.2g degrees, place %.2g, camera %.4f degrees, scale %.6f\n", errors.rotation_median,
                errors.place_median, errors.camera_turn, alignment.scale);
  /* the alternation stops where a round moves the camera by 1e-9 degrees, a hundred rounds or so before its end */
  assert_true(errors.rotation_p95 < 1e-5 && fabs(errors.camera_turn - 3) < 1e-4);
  /* the pull of a millionth on the origin */
  assert_true(errors.place_median < 1e-4 && fabs(alignment.scale * scale - 1) < 1e-3);
  assert_true(fabs(errors.rotation_tremble_ratio - 1) < 1e-6 && fabs(errors.place_tremble_ratio - 1) < 1e-2);
}

static void a_degree_is_a_degree(void **state) {
  (void)state;
  static struct head_pose truth[LONG], prepared[LONG];
  struct path_alignment alignment;
  struct path_errors errors;
  uint64_t seed = 5;
  make_path(truth, LONG);
  make_path(prepared, LONG);
  for (size_t i = 0; i < LONG; i++) {
    double axis[3], turn[3][3];
    random_axis(&seed, axis);
    rotation_about(axis, 1, turn);
    multiply(prepared[i].rotation, prepared[i].rotation, turn);
  }
  assert_true(compare_paths(truth, prepared, LONG, 1, &alignment, &errors));
  print_message("median %.4f, 95th %.4f, tremble %.4f of %.4f degrees\n", errors.rotation_median, errors.rotation_p95,
                errors.rotation_tremble[1], errors.rotation_tremble[0]);
  /* the alignment takes the mean of the axes away, 1/sqrt(2000) = 0.022 degrees of a component, 0.04 in all */
  assert_true(fabs(errors.rotation_median - 1) < 0.02 && fabs(errors.rotation_p95 - 1) < 0.08);
  /* |e1 - 2 e2 + e3| of random unit vectors is 2 + E|e1 + e3|^2 / 6 = 7/3 in the mean; four deviations of the mean of
   * 2,000, and the truth's own 0.05 at a right angle */
  assert_true(fabs(errors.rotation_tremble[1] - 7.0 / 3.0) < 0.1);
  assert_true(errors.rotation_tremble_ratio > 20);
  /* a step of the place of 0.002 up in every second frame: second differences of 4 x 0.001 */
  make_path(prepared, LONG);
  for (size_t i = 0; i < LONG; i++) {
    truth[i].place[0] = truth[i].place[1] = 0, truth[i].place[2] = -0.9;
    prepared[i].place[0] = 0, prepared[i].place[1] = i % 2 == 0 ? 0.001 : -0.001, prepared[i].place[2] = -0.9;
  }
  assert_true(compare_paths(truth, prepared, LONG, 1, &alignment, &errors));
  assert_true(fabs(errors.place_tremble[1] - 0.004) < 1e-5);
  assert_true(fabs(errors.place_median - 0.001 / 0.9) < 1e-5);
}

/* Second differences are those of frames that follow each other. */
static void gaps_do_not_tremble(void **state) {
  (void)state;
  static struct head_pose poses[100];
  struct path_alignment alignment;
  struct path_errors errors;
  make_path(poses, 100);
  for (size_t i = 50; i < 100; i++) poses[i].frame += 7, poses[i].place[0] += 0.5;
  assert_true(compare_paths(poses, poses, 100, 1, &alignment, &errors));
  assert_int_equal(errors.seconds, 96);
  assert_true(errors.place_tremble[1] < 0.01);
}

/* ---- pixels ------------------------------------------------------------------------------------------------------ */

static void mouth_is_in_eye_distances(void **state) {
  (void)state;
  const struct crop whole = {0, 0, 512, 512}, part = {100, 40, 256, 512};
  float truth[68][2], prepared[68][2];
  for (int k = 0; k < 68; k++) truth[k][0] = 250 + (float)(k % 5), truth[k][1] = 300;
  for (int k = 36; k < 48; k++) truth[k][0] = k < 42 ? 200 : 260, truth[k][1] = 200;
  assert_true(mouth_error(truth, truth, &whole) == 0);
  memcpy(prepared, truth, sizeof truth);
  for (int k = 48; k < 68; k++) prepared[k][1] += 3;
  assert_true(fabs(mouth_error(truth, prepared, &whole) - 3.0 / 60) < 1e-6);
  for (int k = 0; k < 68; k++) {
    prepared[k][0] = (truth[k][0] - 100) * 2;
    prepared[k][1] = (truth[k][1] - 40) * 2;
  }
  assert_true(mouth_error(truth, prepared, &part) < 1e-6);
  for (int k = 48; k < 68; k++) prepared[k][0] += 3; /* 1.5 pixels of the video */
  assert_true(fabs(mouth_error(truth, prepared, &part) - 1.5 / 60) < 1e-6);
}

/* A box of a head over a box of a torso: [left, right) x [top, bottom). */
static void draw_map(uint8_t *rgb, int side, const int head[4], const int torso[4]) {
  memset(rgb, 255, (size_t)side * (size_t)side * 3);
  for (int y = 0; y < side; y++)
    for (int x = 0; x < side; x++) {
      uint8_t *pixel = rgb + 3 * (y * side + x);
      if (x >= torso[0] && x < torso[2] && y >= torso[1] && y < torso[3]) pixel[0] = 255, pixel[1] = pixel[2] = 0;
      if (x >= head[0] && x < head[2] && y >= head[1] && y < head[3]) pixel[2] = 255, pixel[0] = pixel[1] = 0;
    }
}

static void layers_overlap(void **state) {
  (void)state;
  enum { SIDE = 100 };
  static uint8_t truth[SIDE * SIDE * 3], prepared[SIDE * SIDE * 3];
  const struct layer_map a = {truth, SIDE, SIDE}, b = {prepared, SIDE, SIDE};
  const struct crop whole = {0, 0, SIDE, SIDE}, part = {20, 10, 50, SIDE};
  double person, head;
  draw_map(truth, SIDE, (const int[4]){30, 20, 70, 60}, (const int[4]){10, 60, 90, 100});
  compare_layers(a, a, &whole, &person, &head);
  assert_true(person == 1 && head == 1);
  /* the head a pixel smaller all round, then the person too */
  draw_map(prepared, SIDE, (const int[4]){31, 21, 69, 59}, (const int[4]){10, 60, 90, 100});
  compare_layers(a, b, &whole, &person, &head);
  assert_true(fabs(head - 38.0 * 38 / 1600) < 1e-12);
  assert_true(fabs(person - (38.0 * 38 + 3200) / 4800) < 1e-12);
  /* a head of the torso's colour is a person all the same */
  draw_map(prepared, SIDE, (const int[4]){0, 0, 0, 0}, (const int[4]){30, 20, 70, 60});
  compare_layers(a, b, &whole, &person, &head);
  assert_true(head == 0 && fabs(person - 1600.0 / 4800) < 1e-12);
  /* twice as large, of the crop alone: columns 20 to 70, rows 10 to 60 */
  draw_map(prepared, SIDE, (const int[4]){20, 20, 100, 100}, (const int[4]){0, 0, 0, 0});
  compare_layers(a, b, &part, &person, &head);
  assert_true(head == 1 && person == 1);
  draw_map(prepared, SIDE, (const int[4]){22, 20, 100, 100}, (const int[4]){0, 0, 0, 0});
  compare_layers(a, b, &part, &person, &head);
  assert_true(fabs(head - 39.0 / 40) < 1e-12);
  assert_int_equal(layer_of((const uint8_t[3]){0, 255, 0}), LAYER_NECK);
  assert_int_equal(layer_of((const uint8_t[3]){0, 254, 0}), LAYER_OTHER);
}

static void blinks_are_paired(void **state) {
  (void)state;
  enum { FRAMES = 200 };
  float truth[FRAMES] = {0}, found[FRAMES] = {0};
  struct blink a[FRAMES / 2 + 1], b[FRAMES / 2 + 1];
  for (int k = 0; k < 4; k++)
    for (int t = 0; t < 4; t++) truth[20 + 50 * k + t] = 2;
  assert_int_equal(find_blinks(truth, FRAMES, a), 4);
  assert_int_equal(a[1].first, 70);
  assert_int_equal(a[1].last, 73);
  assert_int_equal(match_blinks(a, 4, a, 4), 4);
  /* one two frames late, one missed, one that is in two with a frame between, one that is none */
  for (int t = 0; t < 4; t++) found[22 + t] = 3;
  found[70] = found[72] = 3;
  found[150] = 3;
  for (int t = 0; t < 4; t++) found[174 + t] = 3;
  assert_int_equal(find_blinks(found, FRAMES, b), 4);
  assert_int_equal(b[1].first, 70);
  assert_int_equal(b[1].last, 72);
  assert_int_equal(match_blinks(a, 4, b, 4), 3); /* the last one begins in the frame after the truth's */
  /* eyes that are always shut find one of four, not all */
  for (int t = 0; t < FRAMES; t++) found[t] = 1;
  assert_int_equal(find_blinks(found, FRAMES, b), 1);
  assert_int_equal(match_blinks(a, 4, b, 1), 1);
  for (int t = 0; t < FRAMES; t++) found[t] = 0;
  assert_int_equal(find_blinks(found, FRAMES, b), 0);
  assert_int_equal(find_blinks(found, 0, b), 0);
}

static void quantiles(void **state) {
  (void)state;
  double values[] = {4, 1, 3, 2};
  assert_true(quantile(values, 4, 0.5) == 2.5 && quantile(values, 4, 1) == 4 && quantile(values, 1, 0.99) == 1);
  assert_true(isnan(quantile(values, 0, 0.5)));
}

/* ---- the program ------------------------------------------------------------------------------------------------- */

static double said(const json_t *object, const char *name) {
  const json_t *value = json_object_get(object, name);
  if (!json_is_number(value)) fail_msg("%s is no number", name);
  return json_number_value(value);
}

static json_t *run(const char *clip) {
  const char *program = getenv("ERNERF_PREPARECHECK");
  char line[1024];
  assert_non_null(program);
  snprintf(line, sizeof line, "'%s' truth %s --json out.json > out.txt", program, clip);
  assert_int_equal(system(line), 0);
  json_t *object = json_load_file("out.json", 0, NULL);
  assert_non_null(object);
  return object;
}

/* truth's frame as a crop of columns and rows 8 to 56 has it, at twice the size. */
static void write_cropped(ern_context *context, int frame) {
  enum { FROM = 8, SIDE = 48, SIZE = 96 };
  static uint8_t bytes[SIZE * SIZE * 3];
  char path[64];
  ern_image truth = {0};
  const ern_image image = {SIZE, SIZE, 3, bytes};
  float points[ERN_LANDMARKS][2];
  snprintf(path, sizeof path, "truth/parsing/%d.png", frame);
  support_ok(context, ern_image_read(context, path, 3, &truth));
  for (int y = 0; y < SIZE; y++)
    for (int x = 0; x < SIZE; x++)
      memcpy(bytes + 3 * (y * SIZE + x), truth.data + 3 * ((FROM + y / 2) * truth.width + FROM + x / 2), 3);
  ern_image_free(context, &truth);
  snprintf(path, sizeof path, "cropped/parsing/%d.png", frame);
  support_ok(context, ern_image_write(context, path, &image, 100));
  snprintf(path, sizeof path, "truth/ori_imgs/%d.lms", frame);
  support_ok(context, ern_landmarks_read(context, path, points));
  snprintf(path, sizeof path, "cropped/ori_imgs/%d.lms", frame);
  FILE *file = fopen(path, "w");
  assert_non_null(file);
  for (int k = 0; k < ERN_LANDMARKS; k++)
    fprintf(file, "%.6f %.6f\n", 2 * ((double)points[k][0] - FROM), 2 * ((double)points[k][1] - FROM));
  assert_int_equal(fclose(file), 0);
}

static void program_reads_clips(void **state) {
  (void)state;
  enum { FRAMES = 30 };
  ern_context *context = support_context();
  ern_synth_options options = ern_synth_options_default();
  options.size = 64;
  options.frames = FRAMES;
  options.seed = 3;
  options.parsing = true;
  support_clear("truth");
  support_ok(context, ern_synth_write(context, "truth", &options));
  json_t *itself = run("truth");
  assert_true(said(itself, "rotation_p95") < 1e-6 && fabs(said(itself, "rotation_tremble") - 1) < 1e-9);
  assert_true(said(itself, "mouth") == 0 && said(itself, "person_iou") == 1 && said(itself, "head_iou") == 1);
  assert_true(said(itself, "blinks_found") == 1 && said(itself, "blinks_false") == 0);
  assert_true(said(itself, "frames") == FRAMES && said(itself, "truth_blinks") >= 1);
  json_decref(itself);
  /* the same through a crop; another focal length in pixels is the same in the video's */
  support_clear("cropped");
  assert_int_equal(system("mkdir -p cropped/parsing cropped/ori_imgs && cp truth/au.csv cropped"), 0);
  for (int frame = 0; frame < FRAMES; frame++) write_cropped(context, frame);
  assert_int_equal(
      system("for f in train val; do sed -e 's/\"w\": 64/\"w\": 96/' -e 's/\"h\": 64/\"h\": 96/' -e "
             "'s/\"c\\([xy]\\)\": 32.0/\"c\\1\": 48.0/' -e 's/\"focal_len\": [0-9.]*/\"focal_len\": 307.2/' "
             "truth/transforms_$f.json > cropped/transforms_$f.json; done"),
      0);
  support_write_text("cropped/prepare.json", "{\"crop\": {\"x\": 8, \"y\": 8, \"side\": 48, \"size\": 96}}");
  json_t *cropped = run("cropped");
  assert_true(fabs(said(cropped, "focal_ratio") - 1) < 1e-6 && said(cropped, "rotation_p95") < 1e-6);
  assert_true(said(cropped, "mouth") < 1e-5 && said(cropped, "person_iou") == 1 && said(cropped, "head_iou") == 1);
  json_decref(cropped);
  support_write_text("cropped/prepare.json", "{\"crop\": {\"x\": 11, \"y\": 8, \"side\": 48, \"size\": 96}}");
  json_t *shifted = run("cropped");
  assert_true(said(shifted, "mouth") > 0.1 && said(shifted, "head_iou") < 0.95);
  json_decref(shifted);
  support_write_text("cropped/prepare.json", "{\"crop\": {\"x\": 8, \"y\": 8, \"side\": 48, \"size\": 64}}");
  assert_int_not_equal(system("\"$ERNERF_PREPARECHECK\" truth cropped 2> error.txt"), 0);
  assert_int_equal(system("grep -q 'prepare.json: crop.size is 64, expected the pictures. 96 x 96' error.txt"), 0);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(path_of_the_truth_itself),  cmocka_unit_test(choices_are_no_error),
      cmocka_unit_test(a_degree_is_a_degree),      cmocka_unit_test(gaps_do_not_tremble),
      cmocka_unit_test(mouth_is_in_eye_distances), cmocka_unit_test(layers_overlap),
      cmocka_unit_test(blinks_are_paired),         cmocka_unit_test(quantiles),
      cmocka_unit_test(program_reads_clips),
  };
  return cmocka_run_group_tests_name("preparecheck", tests, NULL, NULL);
}
