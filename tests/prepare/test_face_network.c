/* SPDX-License-Identifier: MIT
 * Faces by a network with the outputs of YuNet: small ones made by hand, which find a face where a picture is red; and
 * files that are no such network. */
#include "../made_onnx.h"
#include "ernerf/media.h"
#include "io/npy.h"
#include "prepare/face_detector.h"
#include "prepare_test.h"

enum { INPUT = 64, FACES = 8, CELL = 8 };

/* Of the face that is found in a cell of the stride 8, in cells: its size, and its points from the cell's corner. */
static const float wide = 3, high = 4;
static const float frontal[10] = {-0.4f, -0.1f, 1.4f, 0.1f, 0.5f, 1, 0, 1.5f, 1, 1.5f};
static const float profile[10] = {-0.4f, -0.1f, 0.2f, 0.1f, 1.5f, 1, 0, 1.5f, 1, 1.5f};

/* outputs[name] = the cells of `stride`, width numbers each: bias + weight * mean red of the cell. */
static void add_output(struct made_message *graph, const char *name, size_t stride, size_t width, float weight,
                       const float *bias) {
  char kernel[64], offset[64], made[64], moved[64], shape[64], inputs[256];
  const size_t cells = (INPUT / stride) * (INPUT / stride);
  float *weights = calloc(width * 3 * stride * stride, sizeof *weights);
  assert_non_null(weights);
  for (size_t k = 0; k < width; k++) /* the third channel: colours are blue, green, red */
    for (size_t i = 0; i < stride * stride; i++)
      weights[(3 * k + 2) * stride * stride + i] = weight / (float)(stride * stride);
  snprintf(kernel, sizeof kernel, "%s.W", name);
  snprintf(offset, sizeof offset, "%s.B", name);
  snprintf(made, sizeof made, "%s.made", name);
  snprintf(moved, sizeof moved, "%s.moved", name);
  snprintf(shape, sizeof shape, "%s.shape", name);
  made_weight(graph, kernel, (const size_t[]){width, 3, stride, stride, 0}, weights);
  made_weight(graph, offset, (const size_t[]){width, 0}, bias);
  made_sizes(graph, shape, 3, (const int64_t[]){1, (int64_t)cells, (int64_t)width});
  snprintf(inputs, sizeof inputs, "picture %s %s", kernel, offset);
  const struct made_attribute size[] = {
      {"kernel_shape", 2, {stride, stride}}, {"strides", 2, {stride, stride}}, {NULL, 0, {0}}};
  made_node(graph, "Conv", inputs, made, size);
  made_node(graph, "Transpose", made, moved,
            (const struct made_attribute[]){{"perm", 4, {0, 2, 3, 1}}, {NULL, 0, {0}}});
  snprintf(inputs, sizeof inputs, "%s %s", moved, shape);
  made_node(graph, "Reshape", inputs, name, NULL);
  made_value(graph, 12, name, (const size_t[]){1, cells, width, 0});
  free(weights);
}

/* The outputs of a stride, in another order at each; `scores` of them have 1 number a cell. */
static void add_stride(struct made_message *graph, size_t stride, float weight, const float points[10], int scores) {
  const float box[4] = {0.5f, 0.5f, logf(wide), logf(high)}, none[1] = {0};
  char name[64];
  for (size_t k = 0; k < 4; k++) {
    const size_t which = (k + stride / 8) % 4;
    snprintf(name, sizeof name, "out_%zu_%zu", stride, which);
    if (which == 0) add_output(graph, name, stride, 4, 0, box);
    if (which == 1) add_output(graph, name, stride, 10, 0, points);
    if (which >= 2 && (int)which < 2 + scores) add_output(graph, name, stride, 1, weight, none);
  }
}

/* Faces of the stride 8 alone; the scores are red / 200. */
static void make_network(const char *path, float weight, const float points[10], int scores) {
  struct made_message graph = {0};
  made_value(&graph, 11, "picture", (const size_t[]){1, 3, INPUT, INPUT, 0});
  add_stride(&graph, 8, weight, points, scores);
  add_stride(&graph, 16, 0, points, 2);
  add_stride(&graph, 32, 0, points, 2);
  made_onnx(path, &graph);
}

/* A picture of `columns` x `rows` cells of the network, each of so many pixels, with a red and a blue cell. */
struct made_picture {
  int columns, rows, across, down, at[4];
};

static void make_picture(const struct made_picture *m, ern_image *picture) {
  *picture = (ern_image){.width = m->columns * m->across, .height = m->rows * m->down, .channels = 3};
  picture->data = calloc(1, 3 * (size_t)picture->width * (size_t)picture->height);
  assert_non_null(picture->data);
  for (int y = 0; y < picture->height; y++)
    for (int x = 0; x < picture->width; x++) {
      uint8_t *p = picture->data + 3 * (y * picture->width + x);
      for (int i = 0; i < 2; i++)
        if (x / m->across == m->at[2 * i] && y / m->down == m->at[2 * i + 1]) p[i == 0 ? 0 : 2] = 200;
    }
}

static void test_found(void **state) {
  (void)state;
  static const struct {
    struct made_picture picture;
    double aspect; /* of a pixel */
  } looks[] = {
      {{8, 8, 8, 8, {3, 2, 6, 6}}, 1},   /* at the network's size */
      {{8, 8, 24, 24, {5, 4, 1, 1}}, 1}, /* shrunk */
      {{8, 5, 16, 16, {2, 3, 6, 1}}, 1}, /* wider than high */
      {{6, 8, 16, 16, {4, 2, 1, 6}}, 1}, /* higher than wide */
      {{4, 4, 8, 8, {1, 2, 3, 3}}, 1},   /* smaller: not enlarged */
      {{8, 8, 12, 24, {3, 5, 6, 6}}, 2}, /* pixels twice as wide as high */
      {{8, 8, 24, 12, {3, 5, 6, 6}}, 0.5},
  };
  ern_context *context = support_context();
  struct ern_face_detector *detector = NULL;
  struct ern_found_face faces[FACES];
  size_t count = 0;
  make_network("faces.onnx", 1 / 200.0f, frontal, 2);
  support_ok(context, ern_face_detector_make(context, "faces.onnx", &detector));
  for (size_t i = 0; i < sizeof looks / sizeof *looks; i++) {
    const struct made_picture *m = &looks[i].picture;
    ern_image picture;
    make_picture(m, &picture);
    support_ok(context, ern_face_detector_find(detector, &picture, looks[i].aspect, faces, FACES, &count));
    assert_int_equal(count, 1);
    const struct ern_found_face *f = &faces[0];
    const double x = (m->at[0] + 0.5) * m->across, y = (m->at[1] + 0.5) * m->down;
    /* a square of about the box's area about its middle, as the cascades have it */
    const double side = sqrt((double)(wide * high));
    assert_true(fabs((double)f->width / m->across / side - 1) < 0.1);
    assert_true(fabs((double)f->height / m->down / side - 1) < 0.1);
    assert_true(fabs((double)(f->x + 0.5f * f->width) - x) < 0.01 * m->across);
    assert_true(fabs((double)(f->y + 0.5f * f->height) - y) < 0.2 * m->down);
    assert_true(f->has_eyes);
    for (int k = 0; k < 4; k++) {
      const double unit = k % 2 != 0 ? m->down : m->across;
      const double expected = (m->at[k % 2] + (double)frontal[k]) * unit;
      assert_true(fabs((double)f->eyes[k / 2][k % 2] - expected) < 0.01 * unit);
    }
    support_ok(context, ern_face_detector_find(detector, &picture, looks[i].aspect, faces, 0, &count)); /* no room */
    assert_int_equal(count, 0);
    free(picture.data);
  }
  ern_face_detector_free(&detector);
  ern_context_free(&context);
}

/* Cells side by side are one face, cells apart are two; what does not look into the camera is none. */
static void test_count(void **state) {
  (void)state;
  static const struct {
    int x[2], y[2];
    size_t count;
  } looks[] = {{{2, 3}, {3, 3}, 1}, {{1, 6}, {2, 5}, 2}, {{0, 7}, {0, 7}, 2}};
  ern_context *context = support_context();
  for (int turned = 0; turned < 2; turned++) {
    struct ern_face_detector *detector = NULL;
    struct ern_found_face faces[FACES];
    size_t count = 0;
    make_network("faces.onnx", 1 / 200.0f, turned != 0 ? profile : frontal, 2);
    support_ok(context, ern_face_detector_make(context, "faces.onnx", &detector));
    for (size_t i = 0; i < sizeof looks / sizeof *looks; i++) {
      uint8_t data[3 * INPUT * INPUT] = {0};
      const ern_image picture = {.width = INPUT, .height = INPUT, .channels = 3, .data = data};
      for (int p = 0; p < INPUT * INPUT; p++)
        for (int k = 0; k < 2; k++)
          if (p % INPUT / CELL == looks[i].x[k] && p / INPUT / CELL == looks[i].y[k]) data[3 * p] = 200;
      support_ok(context, ern_face_detector_find(detector, &picture, 1, faces, FACES, &count));
      assert_int_equal(count, turned != 0 ? 0 : looks[i].count);
    }
    ern_face_detector_free(&detector);
  }
  ern_context_free(&context);
}

/* Odd pictures give no face and no failure. */
static void test_none(void **state) {
  (void)state;
  static const struct {
    int width, height;
    double aspect;
  } pictures[] = {{1, 1, 1}, {1, 4000, 1}, {4000, 1, 1}, {200, 200, 1}, {200, 200, 1e9}, {200, 200, 1e-9}};
  ern_context *context = support_context();
  struct ern_face_detector *detector = NULL;
  struct ern_found_face faces[FACES];
  size_t count = 99;
  make_network("faces.onnx", 1 / 200.0f, frontal, 2);
  support_ok(context, ern_face_detector_make(context, "faces.onnx", &detector));
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
  ern_context_free(&context);
}

static void expect_refused(ern_context *context, ern_status status, const char *word, const char *other) {
  struct ern_face_detector *detector = NULL;
  support_expect(context, ern_face_detector_make(context, "bad.onnx", &detector), status, "bad.onnx", word, other,
                 NULL);
  ern_face_detector_free(&detector);
}

static void test_refused(void **state) {
  (void)state;
  ern_context *context = support_context();
  struct made_message graph = {0};
  static uint8_t bytes[1 << 20];
  make_network("bad.onnx", 1, frontal, 1);
  expect_refused(context, ERN_E_UNSUPPORTED, "the stride 8 has 1 outputs of scores", "expected YuNet");
  make_network("bad.onnx", INFINITY, frontal, 2);
  struct ern_face_detector *detector = NULL;
  support_ok(context, ern_face_detector_make(context, "bad.onnx", &detector));
  struct ern_found_face faces[FACES];
  size_t count = 99;
  memset(bytes, 200, 3 * INPUT * INPUT);
  const ern_image picture = {.width = INPUT, .height = INPUT, .channels = 3, .data = bytes};
  support_expect(context, ern_face_detector_find(detector, &picture, 1, faces, FACES, &count), ERN_E_UNSUPPORTED,
                 "bad.onnx", "not finite", NULL);
  assert_int_equal(count, 0);
  ern_face_detector_free(&detector);
  made_value(&graph, 11, "picture", (const size_t[]){1, 3, 48, INPUT, 0});
  made_node(&graph, "Flatten", "picture", "flat", NULL);
  made_value(&graph, 12, "flat", (const size_t[]){1, 3 * 48 * INPUT, 0});
  made_onnx("bad.onnx", &graph);
  expect_refused(context, ERN_E_UNSUPPORTED, "64 x 48", "multiples of 32");
  made_value(&graph, 11, "picture", (const size_t[]){1, 1, INPUT, INPUT, 0});
  made_node(&graph, "Flatten", "picture", "flat", NULL);
  made_value(&graph, 12, "flat", (const size_t[]){1, INPUT * INPUT, 0});
  made_onnx("bad.onnx", &graph);
  expect_refused(context, ERN_E_UNSUPPORTED, "[1, 1, 64, 64]", "expected [1, 3, height, width]");
  made_value(&graph, 11, "picture", (const size_t[]){1, 3, INPUT, INPUT, 0});
  made_node(&graph, "NoSuchNode", "picture", "faces", NULL);
  made_value(&graph, 12, "faces", (const size_t[]){1, 64, 4, 0});
  made_onnx("bad.onnx", &graph);
  expect_refused(context, ERN_E_UNSUPPORTED, "OpenCV", "does not read the network");
  /* cut: no crash, and never a detector that finds something */
  make_network("whole.onnx", 1, frontal, 2);
  FILE *file = fopen("whole.onnx", "rb");
  assert_non_null(file);
  const size_t length = fread(bytes, 1, sizeof bytes, file);
  fclose(file);
  for (size_t n = 0; n < 10; n++) {
    support_write("bad.onnx", bytes, n * length / 10);
    assert_int_not_equal(ern_face_detector_make(context, "bad.onnx", &detector), ERN_OK);
    ern_face_detector_free(&detector);
  }
  support_expect(context, ern_face_detector_make(context, "nowhere.onnx", &detector), ERN_E_MISSING, "nowhere.onnx",
                 NULL);
  ern_face_detector_free(&detector);
  ern_context_free(&context);
}

enum { SIDE = 128, FRAMES = 30, BLOCK = 16 };

static int column_of(size_t frame) { return 3 + (int)(frame / 10 % 2); }

/* A face that moves, after so many frames without one. */
static void make_video(ern_context *context, const char *path, size_t empty, size_t frames) {
  static uint8_t rgba[4 * SIDE * SIDE];
  ern_video_options video = ern_video_options_default(SIDE, SIDE);
  ern_video_writer *writer = NULL;
  support_clear(path);
  support_ok(context, ern_video_writer_open(context, path, &video, &writer));
  for (size_t f = 0; f < empty + frames; f++) {
    for (int i = 0; i < SIDE * SIDE; i++) {
      const bool face = f >= empty && i % SIDE / BLOCK == column_of(f - empty) && i / SIDE / BLOCK == 3;
      memcpy(rgba + 4 * i, (const uint8_t[4]){face ? 220 : 60, 60, 60, 255}, 4);
    }
    support_ok(context, ern_video_writer_frame(writer, rgba));
  }
  support_ok(context, ern_video_writer_close(&writer));
}

/* In place of sound, which the made videos have none of: a few windows that nothing here looks into. */
static void make_features(ern_context *context) {
  static const float silent[4 * 16 * 29];
  support_ok(context, ern_npy_write_f32(context, "any.npy", silent, 3, (const size_t[]){4, 16, 29}));
}

/* The step "face": what the network finds is what the clip's faces are, and another network is another setting. */
static void test_step(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_prepare_options options = ern_prepare_options_default();
  ern_prepare_result result;
  struct made_job m;
  make_video(context, "v.mp4", 0, FRAMES);
  make_features(context);
  options.side = SIDE;
  options.only = "face";
  options.features = "any.npy";
  options.detector = "faces.onnx";
  make_network("faces.onnx", 1 / 220.0f, frontal, 2);
  support_clear("clip");
  support_ok(context, ern_prepare(context, "v.mp4", "clip", &options, &result));
  assert_int_equal(result.frames, FRAMES);
  struct ern_found_face *faces = NULL;
  size_t count = 0;
  made_job_open(&m, "other", SIDE, FRAMES);
  m.job.folder = "clip";
  support_ok(context, ern_prepare_faces_read(&m.job, &faces, &count));
  assert_int_equal(count, FRAMES / 5);
  for (size_t i = 0; i < count; i++) {
    assert_true(faces[i].has_eyes);
    for (int k = 0; k < 4; k++) {
      const double at = k % 2 != 0 ? 3 : column_of(faces[i].frame);
      assert_true(fabs((double)faces[i].eyes[k / 2][k % 2] - BLOCK * (at + (double)frontal[k])) < 0.1);
    }
  }
  ern_release(m.job.context, faces);
  made_job_close(&m);
  /* the step counts as done with this network alone */
  options.only = "pose";
  options.detector = NULL;
  support_expect(context, ern_prepare(context, "v.mp4", "clip", &options, &result), ERN_E_STATE, "\"face\"",
                 "has not been done with these options", NULL);
  options.only = NULL;
  options.detector = "clip/faces.onnx";
  make_network("clip/faces.onnx", 1 / 220.0f, frontal, 2);
  support_expect(context, ern_prepare(context, "v.mp4", "clip", &options, &result), ERN_E_ARGUMENT, "clip/faces.onnx",
                 "is an input, and is in clip", NULL);
  ern_context_free(&context);
}

struct way {
  size_t last, times;
};

static int only_on(void *user, const char *step, size_t done, size_t total) {
  struct way *way = user;
  if (done < way->last || done > total) fail_msg("%s: %zu of %zu after %zu", step, done, total, way->last);
  way->last = done;
  way->times++;
  return 0;
}

/* A video whose first minute shows nobody has a best stretch none the less, and is refused without --segment. */
static void test_late_long(void **state) {
  (void)state;
  enum { EMPTY = 65 * ERN_PREPARE_RATE, SHOWN = 8 * ERN_PREPARE_RATE };
  ern_context *context = support_context();
  ern_prepare_options options = ern_prepare_options_default();
  ern_prepare_result result;
  make_features(context);
  options.side = SIDE;
  options.only = "face";
  options.features = "any.npy";
  options.detector = "faces.onnx";
  make_network("faces.onnx", 1 / 220.0f, frontal, 2);
  make_video(context, "late.mp4", EMPTY, SHOWN);
  support_clear("late");
  support_expect(context, ern_prepare(context, "late.mp4", "late", &options, &result), ERN_E_UNSUPPORTED,
                 "no face was found in 60 s", NULL);
  struct way way = {0};
  options.segment = "4";
  options.progress = only_on;
  options.user = &way;
  support_clear("late");
  support_ok(context, ern_prepare(context, "late.mp4", "late", &options, &result));
  assert_int_equal(result.frames, 4 * ERN_PREPARE_RATE);
  assert_true(way.times > EMPTY && way.last == EMPTY + SHOWN + 2 * result.frames);
  struct ern_found_face *faces = NULL;
  size_t count = 0;
  struct made_job m;
  made_job_open(&m, "other", SIDE, result.frames);
  m.job.folder = "late";
  support_ok(context, ern_prepare_faces_read(&m.job, &faces, &count));
  assert_int_equal(count, 4 * ERN_PREPARE_RATE / 5);
  ern_release(m.job.context, faces);
  made_job_close(&m);
  ern_context_free(&context);
}

static int append(void *user, const char *step, size_t done, size_t total) {
  (void)step, (void)total;
  FILE *file = done == 1 ? fopen(user, "ab") : NULL;
  if (file == NULL) return 0;
  assert_int_equal(fwrite("more", 1, 4, file), 4);
  assert_int_equal(fclose(file), 0);
  return 0;
}

/* A video that another program still writes would give pictures and sound of two files. */
static void test_written_to(void **state) {
  (void)state;
  char video[] = "grows.mp4";
  ern_context *context = support_context();
  ern_prepare_options options = ern_prepare_options_default();
  ern_prepare_result result;
  make_features(context);
  options.side = SIDE;
  options.only = "face";
  options.features = "any.npy";
  options.detector = "faces.onnx";
  make_network("faces.onnx", 1 / 220.0f, frontal, 2);
  make_video(context, video, 0, 2 * ERN_PREPARE_RATE);
  options.progress = append;
  options.user = video;
  support_clear("grown");
  support_expect(context, ern_prepare(context, video, "grown", &options, &result), ERN_E_STATE, "grows.mp4",
                 "was written to while it was read", "--overwrite", NULL);
  options.progress = NULL;
  support_expect(context, ern_prepare(context, video, "grown", &options, &result), ERN_E_EXISTS, "another video", NULL);
  options.anew = true;
  support_ok(context, ern_prepare(context, video, "grown", &options, &result));
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_found),     cmocka_unit_test(test_count),
                                     cmocka_unit_test(test_none),      cmocka_unit_test(test_refused),
                                     cmocka_unit_test(test_step),      cmocka_unit_test(test_late_long),
                                     cmocka_unit_test(test_written_to)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
