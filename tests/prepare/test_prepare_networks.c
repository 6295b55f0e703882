/* SPDX-License-Identifier: MIT
 * Landmarks by a network: small ones made by hand, whose points depend on how they get their colours and their square;
 * and files that are no such network. */
#include "../made_onnx.h"
#include "ernerf/media.h"
#include "prepare/landmarks/landmarks_supplied.h"
#include "prepare_test.h"

enum { SIDE = 256, FRAMES = 12, POINTS = ERN_LANDMARKS, INPUT = 32, MOST = 98 };

static const uint8_t colour[3] = {200, 100, 50};

/* The point of WFLW that stands for a point of 300-W: 33 along the jaw, 9 of each brow, the nose, 8 of each eye. */
static size_t wflw_of(size_t k) {
  static const size_t lids[] = {0, 1, 3, 4, 5, 7};
  if (k < 17) return 2 * k;
  if (k < 22) return 33 + k - 17;
  if (k < 27) return 42 + k - 22;
  if (k < 36) return 51 + k - 27;
  if (k < 48) return 60 + 8 * ((k - 36) / 6) + lids[(k - 36) % 6];
  return 76 + k - 48;
}

static struct ern_head_pose pose_at(size_t frame) {
  return made_pose(0, 0, 0, 0.004 * (double)(frame % 5), -0.003 * (double)(frame % 3), 0.75 + 0.01 * (double)frame);
}

/* points + (gain of the red channel's mean - its value), which is nothing for RGB as 0..1 alone. `units` is 1 or the
 * input's side; `shift` moves all points. */
static void make_network(const struct made_job *m, const char *path, size_t count, float units, float shift) {
  struct made_message graph = {0};
  float weights[2 * MOST * 3] = {0}, bias[2 * MOST], guess[POINTS][2], low[2] = {1e9f, 1e9f}, high[2] = {-1e9f, -1e9f};
  const struct ern_head_pose pose = pose_at(0);
  assert_true(ern_landmarks_at_pose(&m->job, &pose, guess));
  for (size_t k = 0; k < 2 * POINTS; k++) {
    low[k % 2] = fminf(low[k % 2], guess[k / 2][k % 2]);
    high[k % 2] = fmaxf(high[k % 2], guess[k / 2][k % 2]);
  }
  const float side = 1.25f * fmaxf(high[0] - low[0], high[1] - low[1]);
  for (size_t k = 0; k < 2 * count; k++) {
    weights[3 * k] = units;
    bias[k] = units * (7 - 200 / 255.0f); /* points that 300-W does not have */
  }
  for (size_t k = 0; k < POINTS && count >= POINTS; k++)
    for (size_t c = 0; c < 2; c++) {
      const float share = 0.5f + (guess[k][c] - 0.5f * (low[c] + high[c])) / side;
      bias[2 * (count == 98 ? wflw_of(k) : k) + c] = units * (share + shift - 200 / 255.0f);
    }
  made_weight(&graph, "W", (const size_t[]){2 * count, 3, 1, 1, 0}, weights);
  made_weight(&graph, "B", (const size_t[]){2 * count, 0}, bias);
  made_node(&graph, "GlobalAveragePool", "face", "mean", NULL);
  const struct made_attribute kernel[] = {{"kernel_shape", 2, {1, 1}}, {NULL, 0, {0}}};
  made_node(&graph, "Conv", "mean W B", "wide", kernel);
  made_node(&graph, "Flatten", "wide", "points", NULL);
  made_value(&graph, 11, "face", (const size_t[]){1, 3, INPUT, INPUT, 0});
  made_value(&graph, 12, "points", (const size_t[]){1, 2 * count, 0});
  made_onnx(path, &graph);
}

static void open_clip(struct made_job *m) {
  static uint8_t pixels[3 * SIDE * SIDE];
  struct ern_head_pose poses[FRAMES];
  const ern_image image = {.width = SIDE, .height = SIDE, .channels = 3, .data = pixels};
  made_job_open(m, "clip", SIDE, FRAMES);
  for (size_t i = 0; i < sizeof pixels; i++) pixels[i] = colour[i % 3];
  assert_int_equal(mkdir("clip/ori_imgs", 0777), 0);
  for (size_t i = 0; i < FRAMES; i++) {
    char path[64];
    poses[i] = pose_at(i);
    snprintf(path, sizeof path, "clip/ori_imgs/%zu.jpg", i);
    support_ok(m->job.context, ern_image_write(m->job.context, path, &image, 98));
  }
  support_ok(m->job.context, ern_prepare_poses_write(&m->job, poses));
}

/* Every frame's points are where its pose has the template: mean over neighbours, but for the mouth. */
static void expect_points(const struct made_job *m) {
  float guess[FRAMES][POINTS][2];
  for (size_t i = 0; i < FRAMES; i++) {
    const struct ern_head_pose pose = pose_at(i);
    assert_true(ern_landmarks_at_pose(&m->job, &pose, guess[i]));
  }
  for (size_t i = 0; i < FRAMES; i++) {
    char path[64];
    float points[POINTS][2];
    snprintf(path, sizeof path, "clip/ori_imgs/%zu.lms", i);
    support_ok(m->job.context, ern_landmarks_read(m->job.context, path, points));
    for (size_t k = 0; k < 2 * POINTS; k++) {
      const size_t before = i > 0 ? i - 1 : i, after = i + 1 < FRAMES ? i + 1 : i, p = k / 2, c = k % 2;
      const float expected =
          p < 48 ? 0.25f * (guess[before][p][c] + 2 * guess[i][p][c] + guess[after][p][c]) : guess[i][p][c];
      /* the square's place and side are whole pixels, and the frame is a JPEG */
      if (!(fabsf(points[p][c] - expected) < 1.8f))
        fail_msg("frame %zu, point %zu: %g, expected %g", i, p, (double)points[p][c], (double)expected);
    }
  }
}

static void test_points(void **state) {
  (void)state;
  static const struct {
    size_t count;
    float units;
  } networks[] = {{98, 1}, {68, 1}, {68, INPUT}, {98, INPUT}};
  for (size_t n = 0; n < sizeof networks / sizeof *networks; n++) {
    struct made_job m;
    open_clip(&m);
    make_network(&m, "points.onnx", networks[n].count, networks[n].units, 0);
    m.options.landmarks = "points.onnx";
    support_ok(m.job.context, ern_prepare_landmarks(&m.job));
    assert_int_equal(m.verdict.grade, ERN_PREPARE_GOOD);
    expect_points(&m);
    made_job_close(&m);
  }
}

/* The eyes of faces come from the network, also where the cascades found none. */
static void test_eyes(void **state) {
  (void)state;
  struct made_job m;
  struct ern_found_face faces[2] = {{.frame = 2, .x = 80, .y = 70, .width = 100, .height = 100},
                                    {.frame = 7, .x = 80, .y = 70, .width = 100, .height = 100, .has_eyes = true}};
  struct ern_found_face *again = NULL;
  static const float eyes[2][2] = {{112, 110}, {152, 110}};
  size_t count = 0;
  memcpy(faces[1].eyes, eyes, sizeof eyes);
  open_clip(&m);
  make_network(&m, "points.onnx", 98, 1, 0);
  support_ok(m.job.context, ern_prepare_faces_write(&m.job, faces, 2));
  m.options.landmarks = "points.onnx";
  support_ok(m.job.context, ern_prepare_faces_read(&m.job, &again, &count));
  assert_int_equal(count, 2);
  for (size_t i = 0; i < 2; i++) {
    assert_true(again[i].has_eyes);
    for (size_t k = 0; k < 4; k++) {
      const float expected = i == 0 ? (k % 2 != 0 ? 110 : k < 2 ? 110 : 150) : eyes[k / 2][k % 2];
      assert_true(fabsf(again[i].eyes[k / 2][k % 2] - expected) < 2);
    }
  }
  ern_release(m.job.context, again);
  made_job_close(&m);
}

static void expect_refused(struct made_job *m, ern_status status, const char *word, const char *other) {
  m->options.landmarks = "bad.onnx";
  support_expect(m->job.context, ern_prepare_landmarks(&m->job), status, "bad.onnx", word, other, NULL);
  assert_int_not_equal(access("clip/ori_imgs/0.lms", F_OK), 0); /* nothing half-written */
}

static void test_refused(void **state) {
  (void)state;
  struct made_job m;
  struct made_message graph = {0};
  static uint8_t bytes[1 << 16];
  open_clip(&m);
  make_network(&m, "bad.onnx", 68, 1, 2); /* beside the face */
  expect_refused(&m, ERN_E_UNSUPPORTED, "eye distances from", "expected 0.4 at most");
  make_network(&m, "bad.onnx", 50, 1, 0);
  expect_refused(&m, ERN_E_UNSUPPORTED, "no output has 68 or 98 points", NULL);
  made_value(&graph, 11, "face", (const size_t[]){1, 3, INPUT, INPUT, 0});
  for (int i = 0; i < 40; i++) { /* more outputs than are kept by name */
    char name[16];
    snprintf(name, sizeof name, "flat_%d", i);
    made_node(&graph, "Flatten", "face", name, NULL);
    made_value(&graph, 12, name, (const size_t[]){1, 3 * INPUT * INPUT, 0});
  }
  made_onnx("bad.onnx", &graph);
  expect_refused(&m, ERN_E_UNSUPPORTED, "no output has 68 or 98 points", NULL);
  made_node(&graph, "Flatten", "face", "points", NULL);
  made_value(&graph, 11, "face", (const size_t[]){1, 3, INPUT, 2 * INPUT, 0});
  made_value(&graph, 12, "points", (const size_t[]){1, 6 * INPUT * INPUT, 0});
  made_onnx("bad.onnx", &graph);
  expect_refused(&m, ERN_E_UNSUPPORTED, "64 x 32", "expected a square");
  made_node(&graph, "Flatten", "face", "points", NULL);
  made_value(&graph, 11, "face", (const size_t[]){1, 1, INPUT, INPUT, 0});
  made_value(&graph, 12, "points", (const size_t[]){1, INPUT * INPUT, 0});
  made_onnx("bad.onnx", &graph);
  expect_refused(&m, ERN_E_UNSUPPORTED, "[1, 1, 32, 32]", "expected [1, 3, height, width]");
  made_node(&graph, "NoSuchNode", "face", "points", NULL);
  made_value(&graph, 11, "face", (const size_t[]){1, 3, INPUT, INPUT, 0});
  made_value(&graph, 12, "points", (const size_t[]){1, 136, 0});
  made_onnx("bad.onnx", &graph);
  expect_refused(&m, ERN_E_UNSUPPORTED, "OpenCV", "does not read the network");
  /* cut: no crash, and never a result */
  make_network(&m, "whole.onnx", 68, 1, 0);
  FILE *file = fopen("whole.onnx", "rb");
  assert_non_null(file);
  const size_t length = fread(bytes, 1, sizeof bytes, file);
  fclose(file);
  for (size_t n = 1; n < 10; n++) {
    support_write("bad.onnx", bytes, n * length / 10);
    assert_int_not_equal(ern_prepare_landmarks(&m.job), ERN_OK);
  }
  support_write_text("bad.onnx", "");
  assert_int_not_equal(ern_prepare_landmarks(&m.job), ERN_OK);
  m.options.landmarks = "nowhere.onnx";
  support_expect(m.job.context, ern_prepare_landmarks(&m.job), ERN_E_MISSING, "nowhere.onnx", NULL);
  made_job_close(&m);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_points), cmocka_unit_test(test_eyes),
                                     cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
