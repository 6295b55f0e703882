/* SPDX-License-Identifier: MIT
 * Faces of a made-up person, in square pixels and others; pictures without a face; cascades that are not there. All on
 * a machine whose OpenCL driver ends the process: no face needs it. */
#include "ernerf-lab/synth.h"
#include "ernerf/media.h"
#include "io/landmarks.h"
#include "prepare/face_detector.h"
#include "prepare_test.h"

enum { SIDE = 192, FACES = 8 };
static ern_context *context;

static void make_driver(void) {
  char place[1024];
  if (getenv("ERNERF_DIES") == NULL) return; /* built without OpenCL */
  mkdir("vendors", 0777);
  assert_non_null(getcwd(place, sizeof place - 16));
  strcat(place, "/vendors/");
  support_write_text("vendors/dies.icd", getenv("ERNERF_DIES"));
  setenv("OCL_ICD_VENDORS", place, 1);
  setenv("ERNERF_TEST_DEATH", "abort", 1);
}

static int make(void **state) {
  (void)state;
  make_driver();
  ern_synth_options options = ern_synth_options_default();
  context = support_context();
  options.size = SIDE;
  options.frames = 8;
  options.seed = 5;
  support_clear("clip");
  support_ok(context, ern_synth_write(context, "clip", &options));
  return 0;
}

static int unmake(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

static void middle_of(const float points[ERN_LANDMARKS][2], int begin, int end, double middle[2]) {
  middle[0] = middle[1] = 0;
  for (int p = begin; p < end; p++)
    for (int c = 0; c < 2; c++) middle[c] += (double)points[p][c] / (end - begin);
}

/* Both eyes where the truth has them, to a fifth of their distance, however wide the pixels are. */
static void test_found(void **state) {
  (void)state;
  static const double aspects[] = {1, 2, 0.5, 64.0 / 45, 0.75};
  struct ern_face_detector *detector = NULL;
  struct ern_found_face faces[FACES];
  ern_image picture = {0};
  float points[ERN_LANDMARKS][2];
  double eyes[2][2];
  size_t count = 0;
  support_ok(context, ern_face_detector_make(context, NULL, &detector));
  support_ok(context, ern_image_read(context, "clip/gt_imgs/0.jpg", 3, &picture));
  support_ok(context, ern_landmarks_read(context, "clip/ori_imgs/0.lms", points));
  middle_of(points, 36, 42, eyes[0]);
  middle_of(points, 42, 48, eyes[1]);
  const double distance = hypot(eyes[0][0] - eyes[1][0], eyes[0][1] - eyes[1][1]);
  for (size_t i = 0; i < sizeof aspects / sizeof *aspects; i++) {
    ern_image squeezed = {0};
    const int width = (int)lround(SIDE / aspects[i]);
    support_ok(context, ern_image_resize(context, &picture, width, SIDE, &squeezed));
    support_ok(context, ern_face_detector_find(detector, &squeezed, (double)SIDE / width, faces, FACES, &count));
    if (count == 0 || !faces[0].has_eyes) fail_msg("aspect %.2f: %zu faces, or no eyes", aspects[i], count);
    const double across = (double)SIDE / width;
    assert_true(fabs((double)faces[0].width * across - (double)faces[0].height) < 3);
    for (int e = 0; e < 2; e++) {
      const double away =
          hypot((double)faces[0].eyes[e][0] * across - eyes[e][0], (double)faces[0].eyes[e][1] - eyes[e][1]);
      if (away > 0.2 * distance) fail_msg("aspect %.2f: an eye is %.1f pixels off", aspects[i], away);
    }
    ern_image_free(context, &squeezed);
  }
  support_ok(context, ern_face_detector_find(detector, &picture, 1, faces, 0, &count)); /* no room */
  assert_int_equal(count, 0);
  ern_image_free(context, &picture);
  ern_face_detector_free(&detector);
  assert_null(detector);
}

/* A face that fills a small picture, a ninth of which is less than cascades see. */
static void test_small(void **state) {
  (void)state;
  struct ern_face_detector *detector = NULL;
  struct ern_found_face faces[FACES];
  ern_image picture = {0}, small = {0};
  size_t count = 0;
  support_ok(context, ern_face_detector_make(context, NULL, &detector));
  support_ok(context, ern_image_read(context, "clip/gt_imgs/0.jpg", 3, &picture));
  for (int side = 160; side >= 96; side -= 32) {
    support_ok(context, ern_image_resize(context, &picture, side, side, &small));
    support_ok(context, ern_face_detector_find(detector, &small, 1, faces, FACES, &count));
    if (count != 1) fail_msg("%d pixels: %zu faces", side, count);
    assert_true(faces[0].width > 0.25f * (float)side && faces[0].width < 0.8f * (float)side);
    ern_image_free(context, &small);
  }
  ern_image_free(context, &picture);
  ern_face_detector_free(&detector);
}

static void test_none(void **state) {
  (void)state;
  static const struct {
    int width, height;
    double aspect;
  } pictures[] = {{1, 1, 1},       {1, 4000, 1},     {4000, 1, 1},   {200, 200, 1},
                  {200, 200, 1e9}, {200, 200, 1e-9}, {19, 300, 1.5}, {200, 200, 3}};
  struct ern_face_detector *detector = NULL;
  struct ern_found_face faces[FACES];
  size_t count = 99;
  support_ok(context, ern_face_detector_make(context, NULL, &detector));
  for (size_t i = 0; i < sizeof pictures / sizeof *pictures; i++) {
    const size_t bytes = 3 * (size_t)pictures[i].width * (size_t)pictures[i].height;
    uint8_t *data = malloc(bytes);
    assert_non_null(data);
    memset(data, 90, bytes);
    const ern_image picture = {.width = pictures[i].width, .height = pictures[i].height, .channels = 3, .data = data};
    support_ok(context, ern_face_detector_find(detector, &picture, pictures[i].aspect, faces, FACES, &count));
    assert_int_equal(count, 0);
    free(data);
  }
  ern_face_detector_free(&detector);
}

static void test_cascades(void **state) {
  (void)state;
  struct ern_face_detector *detector = NULL;
  assert_int_equal(setenv("ERNERF_CASCADES", "nowhere", 1), 0);
  support_expect(context, ern_face_detector_make(context, NULL, &detector), ERN_E_MISSING,
                 "nowhere/haarcascade_frontalface_default.xml", "opencv-data", "ERNERF_CASCADES", NULL);
  ern_face_detector_free(&detector);
  support_clear("odd");
  assert_int_equal(mkdir("odd", 0777), 0);
  support_write_text("odd/haarcascade_frontalface_default.xml", "<?xml version=\"1.0\"?><opencv_storage><a>");
  assert_int_equal(setenv("ERNERF_CASCADES", "odd", 1), 0);
  assert_int_not_equal(ern_face_detector_make(context, NULL, &detector), ERN_OK);
  assert_true(strlen(ern_last_error(context)) > 0);
  ern_face_detector_free(&detector);
  ern_face_detector_free(NULL);
  assert_int_equal(unsetenv("ERNERF_CASCADES"), 0);
}

/* A part of a picture as a square: its own pixels where nothing is scaled, and never what lies outside. */
static void test_crop(void **state) {
  (void)state;
  static uint8_t data[3 * 64 * 48];
  const ern_image picture = {.width = 64, .height = 48, .channels = 3, .data = data};
  for (int i = 0; i < 64 * 48; i++) {
    data[3 * i] = (uint8_t)(i % 64);
    data[3 * i + 1] = (uint8_t)(i / 64);
    data[3 * i + 2] = 7;
  }
  ern_image crop = {0};
  support_ok(context, ern_picture_crop(context, &picture, (const double[4]){10, 5, 32, 32}, 32, &crop));
  assert_true(crop.width == 32 && crop.height == 32 && crop.channels == 3);
  for (int i = 0; i < 32 * 32; i++)
    assert_true(crop.data[3 * i] == 10 + i % 32 && crop.data[3 * i + 1] == 5 + i / 32 && crop.data[3 * i + 2] == 7);
  ern_image_free(context, &crop);
  support_ok(context, ern_picture_crop(context, &picture, (const double[4]){16, 0, 48, 48}, 12, &crop)); /* means */
  for (int i = 0; i < 12 * 12; i++) {
    assert_in_range(crop.data[3 * i], 16 + 4 * (i % 12) + 1, 16 + 4 * (i % 12) + 2);
    assert_int_equal(crop.data[3 * i + 2], 7);
  }
  ern_image_free(context, &crop);
}

/* Of waves in both directions, of `shortest` to 48 pixels, of one amplitude. */
static double sharpness_of(double shortest, int width) {
  static uint8_t rgb[3 * SIDE * SIDE];
  const ern_image picture = {.width = SIDE, .height = SIDE, .channels = 3, .data = rgb};
  struct ern_found_face face = {.x = 2, .y = -5, .width = (float)width, .height = (float)width};
  for (int y = 0; y < SIDE; y++)
    for (int x = 0; x < SIDE; x++) {
      double value = 128;
      for (double length = shortest; length < 48; length *= 1.4)
        value += 8 * (sin(6.2832 * x / length + length) + cos(6.2832 * y / length));
      memset(rgb + 3 * (y * SIDE + x), (int)fmin(fmax(value, 0), 255), 3);
    }
  support_ok(context, ern_face_sharpness(context, &picture, &face));
  return (double)face.sharpness;
}

static void test_sharpness(void **state) {
  (void)state;
  const double sharp = sharpness_of(5, 180), soft = sharpness_of(24, 180), beyond = sharpness_of(5, 4 * SIDE);
  if (!(sharp > 0.2 && sharp < 1 && beyond > 0.2 && beyond < 1)) fail_msg("sharp %g, beyond %g", sharp, beyond);
  if (!(soft > 0 && soft < 0.15)) fail_msg("soft %g, sharp %g", soft, sharp);
  assert_true(sharpness_of(5, 47) == 0); /* too small to tell */
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_found), cmocka_unit_test(test_small),
                                     cmocka_unit_test(test_none),  cmocka_unit_test(test_cascades),
                                     cmocka_unit_test(test_crop),  cmocka_unit_test(test_sharpness)};
  return cmocka_run_group_tests(tests, make, unmake);
}
