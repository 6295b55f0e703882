/* SPDX-License-Identifier: MIT
 * Sharpness and the seam at the neck, on pictures whose figures are known. */
#include "../support.h"

#include <math.h>

#include "evaluation/picture_measures.h"
#include "evaluation/tremble.h"

enum { WIDTH = 60, HEIGHT = 50 };

/* The central difference of sin(w x) is sin(w) cos(w x), that of a slope is the slope. */
static void test_gradient(void **state) {
  (void)state;
  static float waves[WIDTH * HEIGHT];
  const double w = 0.3, slope = 0.01;
  const ern_box box = {.top = 10, .bottom = 30, .left = 5, .right = 45}, wide = {-5, 1000, -5, 1000};
  double expected = 0;
  for (int j = 0; j < HEIGHT; j++)
    for (int i = 0; i < WIDTH; i++) waves[j * WIDTH + i] = (float)(0.5 + 0.2 * sin(w * i) + slope * j);
  for (int i = box.left; i < box.right; i++)
    expected += (box.bottom - box.top) * (pow(0.2 * sin(w) * cos(w * i), 2) + slope * slope);
  assert_true(fabs(gradient_energy(waves, WIDTH, HEIGHT, &box) / expected - 1) < 1e-4); /* rounding to float */
  for (int i = 0; i < WIDTH * HEIGHT; i++) waves[i] = (float)(slope * (i / WIDTH));
  expected = (WIDTH - 2) * (HEIGHT - 2) * slope * slope; /* the inner pixels */
  assert_true(fabs(gradient_energy(waves, WIDTH, HEIGHT, &wide) / expected - 1) < 1e-4);
}

/* A flat jaw at y = 20 from x = 10 to 50, eyes 20 apart: the band is 40 columns of 7 rows. */
static void test_neck(void **state) {
  (void)state;
  static float truth[WIDTH * HEIGHT], rendered[WIDTH * HEIGHT];
  ern_clip_frame frame = {.has_landmarks = true};
  double sum = 0;
  size_t count = 0;
  for (int i = 0; i < 68; i++) {
    frame.landmarks[i][0] = i < 4 || i > 12 ? 30 : 10 + 5.0f * (float)(i - 4);
    frame.landmarks[i][1] = 20;
    if (i >= 36) frame.landmarks[i][0] = i < 42 ? 20 : 40;
  }
  for (int j = 0; j < HEIGHT; j++)
    for (int i = 0; i < WIDTH; i++) rendered[j * WIDTH + i] = j >= 20 && j < 27 ? 0.1f : 0.7f;
  assert_true(neck_difference(&frame, truth, rendered, WIDTH, HEIGHT, &sum, &count));
  assert_int_equal(count, 280);
  assert_true(fabs(sqrt(sum / 280) - 0.1) < 1e-6);
  frame.has_landmarks = false;
  assert_false(neck_difference(&frame, truth, rendered, WIDTH, HEIGHT, &sum, &count));
  frame.has_landmarks = true;
  for (int i = 0; i < 68; i++) frame.landmarks[i][0] += 1000; /* beside the picture */
  assert_false(neck_difference(&frame, truth, rendered, WIDTH, HEIGHT, &sum, &count));
  assert_int_equal(count, 280);
}

static void test_grey(void **state) {
  (void)state;
  const uint8_t bytes[] = {255, 0, 0, 0, 255, 0, 0, 0, 255, 51, 51, 51};
  float colours[12], one[4], other[4];
  for (int i = 0; i < 12; i++) colours[i] = (float)bytes[i] / 255;
  grey_of_bytes(one, bytes, 4);
  grey_of_colours(other, colours, 4);
  const double expected[] = {0.299, 0.587, 0.114, 0.2};
  for (int i = 0; i < 4; i++)
    assert_true(fabs((double)one[i] - expected[i]) < 1e-6 && fabs((double)(one[i] - other[i])) < 1e-6);
}

/* A pattern without a period, moved by `dx`. */
static void draw_moved(float *grey, double dx) {
  for (int y = 0; y < 96; y++)
    for (int x = 0; x < 96; x++) {
      const double u = x - dx, v = y;
      grey[96 * y + x] = (float)(0.5 + 0.15 * sin(0.31 * u + 0.07 * v) + 0.15 * sin(0.23 * v - 0.11 * u) +
                                 0.1 * sin(0.043 * u * v / 9));
    }
}

/* Places of a true and a rendered head whose second differences have the ratio 3; then one that stands still. */
static void test_tremble(void **state) {
  (void)state;
  static const double place[] = {0, 1, 0, 1.2, 0.4, 1.4, 0.2, 0.8, -0.2, 1.0};
  static float truth[96 * 96], rendered[96 * 96];
  ern_context *context = support_context();
  ern_clip_frame frame = {.has_landmarks = true};
  for (int i = 0; i < 68; i++) {
    frame.landmarks[i][0] = (float)(16 + i % 2 * 64);
    frame.landmarks[i][1] = (float)(16 + i / 2 % 2 * 64);
  }
  for (int i = 36; i < 68; i++) frame.landmarks[i][0] = frame.landmarks[i][1] = 40; /* eyes and mouth: a place */
  for (int way = 0; way < 4; way++) {
    struct tremble tremble = {0};
    const double times[] = {3, 1, 0, 3};
    ern_status status = ERN_OK;
    for (int t = 0; t < 10 && status == ERN_OK; t++) {
      draw_moved(truth, place[t] / 3);
      draw_moved(rendered, times[way] * place[t] / 3);
      frame.pose.aud_id = way == 3 ? 2 * t : t; /* the last: not in a row */
      status = tremble_add(&tremble, context, &frame, 96, 96, truth, rendered);
    }
    if (status == ERN_E_UNSUPPORTED) {
      tremble_free(&tremble);
      ern_context_free(&context);
      skip();
    }
    support_ok(context, status);
    const double ratio = tremble_ratio(&tremble);
    if (way == 3 ? !isnan(ratio) : fabs(ratio - times[way]) > 0.1 + 0.05 * times[way])
      fail_msg("way %d: %g", way, ratio);
    frame.has_landmarks = false;
    support_ok(context, tremble_add(&tremble, context, &frame, 96, 96, truth, rendered));
    assert_int_equal(tremble.frames, 0);
    frame.has_landmarks = true;
    tremble_free(&tremble);
  }
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_gradient), cmocka_unit_test(test_neck),
                                     cmocka_unit_test(test_grey), cmocka_unit_test(test_tremble)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
