/* SPDX-License-Identifier: MIT
 * The composite of a dubbed frame on a made-up face: what is drawn, what stays as recorded, and hard inputs. */
#include "../support.h"

#include <math.h>
#include <stdbool.h>

#include "core/rng.h"
#include "ernerf/media.h"

enum { WIDTH = 150, HEIGHT = 190, SQUARE = 120, LEFT = 20, TOP = 30, FACE = 60 };

static ern_context *context;
static uint8_t recorded[HEIGHT * WIDTH * 3], head[HEIGHT * WIDTH * 4], out[HEIGHT * WIDTH * 4], wanted[HEIGHT * WIDTH];

/* A face of FACE pixels: an ellipse for the jaw from ear to ear, the nose's tip above the lips. */
static ern_dub_input face_at(float x, float y, float width) {
  ern_dub_input in = {.recorded = recorded,
                      .width = WIDTH,
                      .height = HEIGHT,
                      .square = {LEFT, TOP, SQUARE, SQUARE},
                      .head = head,
                      .head_scale = {1, 1}};
  for (int i = 0; i < 68; i++) {
    const float angle = 3.14159265F * (float)(i < 17 ? i : i % 12) / (i < 17 ? 16.0F : 6.0F);
    const bool jaw = i < 17, lips = i >= 48;
    const float wide = jaw ? 0.5F : lips ? 0.16F : 0.05F, tall = jaw ? 0.65F : lips ? 0.07F : 0.02F;
    const float down = jaw ? 0 : lips ? 0.3F : 0.05F;
    in.landmarks[i][0] = (x - LEFT - width * wide * cosf(angle)) / SQUARE;
    in.landmarks[i][1] = (y - TOP + width * (down + tall * sinf(angle))) / SQUARE;
  }
  return in;
}

static void find_box(ern_dub_input *in) {
  support_ok(context, ern_dub_box(context, in, in->box));
  in->head_width = in->box[2];
  in->head_height = in->box[3];
}

/* The recorded skin has noise and a slope of light; the head has one colour and one opacity. */
static void paint(const uint8_t colour[3], uint8_t opacity) {
  for (size_t i = 0; i < (size_t)HEIGHT * WIDTH; i++) {
    const uint32_t noise = ern_random_at(1, 2, (uint32_t)i, ERN_RNG_INIT).word[0];
    for (size_t c = 0; c < 3; c++)
      recorded[3 * i + c] = (uint8_t)(130 + 10 * c + i % WIDTH / 5 + (noise >> (8 * c)) % 4);
    for (size_t c = 0; c < 3; c++) head[4 * i + c] = colour[c];
    head[4 * i + 3] = opacity;
  }
}

static int difference(size_t i) {
  int most = 0;
  for (size_t c = 0; c < 3; c++) most = (int)fmax(most, abs(out[4 * i + c] - recorded[3 * i + c]));
  assert_int_equal(out[4 * i + 3], 255);
  return most;
}

static void test_drawn(void **state) {
  (void)state;
  bool drawn = false;
  ern_dub_input in = face_at(80, 80, FACE);
  paint((const uint8_t[3]){40, 20, 20}, 255);
  find_box(&in);
  assert_true(in.box[2] > FACE / 2 && in.box[3] > FACE / 2);
  assert_true(in.box[0] >= LEFT && in.box[1] >= TOP && in.box[0] + in.box[2] <= LEFT + SQUARE);
  support_ok(context, ern_dub_frame(context, &in, out, &drawn));
  assert_true(drawn);
  size_t changed = 0;
  for (size_t i = 0; i < (size_t)HEIGHT * WIDTH; i++) {
    const int x = (int)(i % WIDTH), y = (int)(i / WIDTH);
    const bool in_box = x >= in.box[0] && x < in.box[0] + in.box[2] && y >= in.box[1] && y < in.box[1] + in.box[3];
    if (!in_box) assert_int_equal(difference(i), 0);
    const double jaw = hypot((x - 80) / (0.5 * FACE), (y - 80) / (0.65 * FACE));
    if (jaw > 1.15) assert_true(difference(i) <= 1); /* four standard deviations of the mask's edge from its middle */
    changed += difference(i) > 40;
  }
  assert_true(changed > 300);
  /* the lips' middle has the head's colour, but for the light that is matched, 15 grey levels at most */
  const size_t lips = (size_t)(80 + 0.3 * FACE) * WIDTH + 80;
  assert_true(out[4 * lips] >= 40 && out[4 * lips] <= 40 + 16);
  assert_true(out[4 * lips + 1] >= 20 && out[4 * lips + 1] <= 20 + 16);
}

/* Below the rendered head's outline the chin stays as recorded; a hole in the head is filled. */
static void test_outline(void **state) {
  (void)state;
  bool drawn = false;
  ern_dub_input in = face_at(80, 80, FACE);
  paint((const uint8_t[3]){40, 20, 20}, 255);
  find_box(&in);
  const int hole_x = 80 + FACE / 5, hole_y = (int)(80 + 0.4 * FACE);
  for (int y = 0; y < in.head_height; y++)
    for (int x = 0; x < in.head_width; x++)
      if (y + in.box[1] >= 80 + 0.5 * FACE || (x + in.box[0] == hole_x && y + in.box[1] == hole_y))
        head[4 * (y * in.head_width + x) + 3] = 0;
  support_ok(context, ern_dub_frame(context, &in, out, &drawn));
  assert_true(drawn && difference((size_t)(80 + 0.56 * FACE) * WIDTH + 80) <= 1);
  assert_true(difference((size_t)hole_y * WIDTH + (size_t)hole_x) > 40);
}

/* A rendered chin that ends within the recorded one leaves no line: from its outline on the head's share rises by 2
 * erf, so by at most 2 / (sqrt(2 pi) 0.05 FACE) = 0.27 a pixel, of 130 grey levels that the two differ by, matching
 * included. Noise adds 3. */
static void test_no_line(void **state) {
  (void)state;
  bool drawn = false;
  ern_dub_input in = face_at(80, 80, FACE);
  paint((const uint8_t[3]){40, 20, 20}, 255);
  find_box(&in);
  for (int y = (int)(80 + 0.52 * FACE) - in.box[1]; y < in.head_height; y++)
    for (int x = 0; x < in.head_width; x++) head[4 * (y * in.head_width + x) + 3] = 0;
  support_ok(context, ern_dub_frame(context, &in, out, &drawn));
  assert_true(drawn);
  int most = 0;
  for (size_t y = 80 + FACE / 2 - 10; y < 80 + FACE / 2 + 10; y++)
    most = (int)fmax(most, abs(out[4 * ((y + 1) * WIDTH + 80)] - out[4 * (y * WIDTH + 80)]));
  assert_in_range(most, 1, 0.27 * 130 + 3);
}

/* The nose stays as recorded, the skin below it does not. */
static void test_nose(void **state) {
  (void)state;
  enum { X = 80, Y = 80, NOSE_Y = Y + 9 };
  bool drawn = false;
  ern_dub_input in = face_at(X, Y, FACE);
  paint((const uint8_t[3]){40, 20, 20}, 255);
  for (int i = 30; i < 36; i++) {
    in.landmarks[i][0] = (float)(X + 2 * (i - 33) - LEFT) / SQUARE;
    in.landmarks[i][1] = (float)(NOSE_Y - TOP) / SQUARE;
  }
  find_box(&in);
  support_ok(context, ern_dub_frame(context, &in, out, &drawn));
  assert_true(drawn && difference((size_t)NOSE_Y * WIDTH + X) <= 12); /* of 100: the mask's edge is soft */
  assert_true(difference((size_t)(NOSE_Y + 9) * WIDTH + X + 9) > 80);
}

/* A head that is darker than the recorded skin by less than is matched is not seen. */
static void test_matched(void **state) {
  (void)state;
  bool drawn = false;
  ern_dub_input in = face_at(80, 80, FACE);
  paint((const uint8_t[3]){140, 150, 160}, 255);
  find_box(&in);
  support_ok(context, ern_dub_frame(context, &in, out, &drawn));
  assert_true(drawn);
  double sum = 0, count = 0;
  for (size_t i = 0; i < (size_t)HEIGHT * WIDTH; i++) {
    if (difference(i) == 0) continue;
    for (size_t c = 0; c < 3; c++) sum += out[4 * i + c] - recorded[3 * i + c];
    count += 3;
  }
  /* at the face's middle the recorded skin is 7.5 grey levels brighter: 10 of the slope at the right, 4 at the left */
  assert_true(count > 0 && fabs(sum / count) < 2.5);
}

/* A head of another size than the box is scaled: one of half the pixels gives the same but for rounding. */
static void test_scaled(void **state) {
  (void)state;
  static uint8_t whole[HEIGHT * WIDTH * 4];
  bool drawn = false;
  ern_dub_input in = face_at(80, 80, FACE);
  paint((const uint8_t[3]){40, 20, 20}, 255);
  find_box(&in);
  support_ok(context, ern_dub_frame(context, &in, out, &drawn));
  memcpy(whole, out, sizeof whole);
  in.head_width = (in.box[2] + 1) / 2;
  in.head_height = (in.box[3] + 1) / 2;
  in.head_scale[0] = in.head_scale[1] = 0.5F;
  support_ok(context, ern_dub_frame(context, &in, out, &drawn));
  assert_true(drawn);
  for (size_t i = 0; i < sizeof whole; i++) assert_true(abs(out[i] - whole[i]) <= 1);
}

/* Of the rendered head only what is asked for matters, also where the head covers a part of the mask alone: with
 * nothing at the other pixels the frame is the same. */
static void test_wanted(void **state) {
  (void)state;
  static uint8_t whole[HEIGHT * WIDTH * 4];
  bool drawn = false;
  ern_dub_input in = face_at(80, 80, FACE);
  find_box(&in);
  support_ok(context, ern_dub_wanted(context, &in, wanted));
  const size_t wide = (size_t)in.head_width, pixels = wide * (size_t)in.head_height;
  for (size_t part = 0; part < 2; part++) { /* then with a hole in the middle */
    paint((const uint8_t[3]){40, 20, 20}, 255);
    for (size_t i = 0; i < pixels; i++) {
      if (wanted[i] == 0) memset(head + 4 * i, 255, 4);
      if (part == 1 && i % wide > wide * 2 / 5 && i % wide < wide * 3 / 5) memset(head + 4 * i, 0, 4);
    }
    support_ok(context, ern_dub_frame(context, &in, whole, &drawn));
    assert_true(drawn);
    size_t left_out = 0;
    for (size_t i = 0; i < pixels; i++) {
      if (wanted[i] == 0) memset(head + 4 * i, 0, 4);
      left_out += wanted[i] == 0;
    }
    assert_true(left_out > pixels / 8 && left_out < pixels * 3 / 4);
    support_ok(context, ern_dub_frame(context, &in, out, &drawn));
    assert_true(drawn);
    assert_memory_equal(out, whole, sizeof whole);
  }
}

/* Pixels of the head from a point in it to the nearest one that is not wanted. */
static double to_unwanted(const ern_dub_input *in, double x, double y) {
  double nearest = HUGE_VAL;
  for (int i = 0; i < in->head_width * in->head_height; i++)
    if (wanted[i] == 0) nearest = fmin(nearest, hypot(i % in->head_width - x, i / in->head_width - y));
  return nearest;
}

/* Each colour that the frame shows is rendered, and not continued from beside it, also in a head of a quarter of the
 * pixels: of the 2 pixels on each side that cubic interpolation takes, all but the farthest are more than 1.5 from what
 * is not wanted, so they are certain. */
static void test_wanted_of_a_small_head(void **state) {
  (void)state;
  const double scale = 0.25;
  for (int n = 0; n < 8; n++) {
    bool drawn = false;
    ern_dub_input in = face_at(80 + 0.4F * (float)n, 80 + 0.3F * (float)n, FACE - (float)n);
    paint((const uint8_t[3]){40, 20, 20}, 255);
    find_box(&in);
    in.head_scale[0] = in.head_scale[1] = (float)scale;
    in.head_width = (int)ceil(in.box[2] * scale);
    in.head_height = (int)ceil(in.box[3] * scale);
    support_ok(context, ern_dub_wanted(context, &in, wanted));
    support_ok(context, ern_dub_frame(context, &in, out, &drawn));
    assert_true(drawn);
    for (int i = 0; i < in.box[2] * in.box[3]; i++) {
      const int x = i % in.box[2], y = i / in.box[2];
      if (difference((size_t)(in.box[1] + y) * WIDTH + (size_t)(in.box[0] + x)) == 0) continue;
      assert_true(to_unwanted(&in, (x + 0.5) * scale - 0.5, (y + 0.5) * scale - 0.5) >= 3);
    }
  }
}

/* Of the frame only the box is handed over: the same pixels. */
static void test_part(void **state) {
  (void)state;
  static uint8_t part[HEIGHT * WIDTH * 3], drawn_part[HEIGHT * WIDTH * 4];
  bool drawn = false;
  ern_dub_input in = face_at(80, 80, FACE);
  paint((const uint8_t[3]){40, 20, 20}, 255);
  find_box(&in);
  support_ok(context, ern_dub_frame(context, &in, out, &drawn));
  const size_t left = (size_t)in.box[0], top = (size_t)in.box[1], width = (size_t)in.box[2], height = (size_t)in.box[3];
  for (size_t y = 0; y < height; y++)
    memcpy(part + 3 * y * width, recorded + 3 * ((top + y) * WIDTH + left), 3 * width);
  in.recorded = part;
  in.width = in.box[2];
  in.height = in.box[3];
  for (int c = 0; c < 2; c++) in.square[c] -= in.box[c];
  find_box(&in);
  assert_true(in.box[0] == 0 && in.box[1] == 0 && in.box[2] == in.width && in.box[3] == in.height);
  support_ok(context, ern_dub_frame(context, &in, drawn_part, &drawn));
  assert_true(drawn);
  for (size_t y = 0; y < height; y++)
    assert_memory_equal(drawn_part + 4 * y * width, out + 4 * ((top + y) * WIDTH + left), 4 * width);
}

/* What the recorded head does not cover, such as a hand before the mouth, stays as recorded. */
static void test_recorded_head(void **state) {
  (void)state;
  uint8_t there[32 * 32];
  bool drawn = false;
  ern_dub_input in = face_at(80, 80, FACE);
  const ern_image picture = {.width = 32, .height = 32, .channels = 1, .data = there};
  in.recorded_head = &picture;
  paint((const uint8_t[3]){40, 20, 20}, 255);
  find_box(&in);
  memset(there, 255, sizeof there);
  support_ok(context, ern_dub_frame(context, &in, out, &drawn));
  assert_true(drawn);
  for (int y = 0; y < 32; y++) memset(there + 32 * y + 16, 0, 16); /* the right half is something else */
  support_ok(context, ern_dub_frame(context, &in, out, &drawn));
  assert_true(drawn);
  for (size_t i = 0; i < (size_t)HEIGHT * WIDTH; i++)
    if (i % WIDTH > LEFT + SQUARE / 2 + 3) assert_int_equal(difference(i), 0);
  memset(there, 0, sizeof there);
  support_ok(context, ern_dub_frame(context, &in, out, &drawn));
  assert_false(drawn);
  const ern_image empty = {.width = 32, .channels = 1, .data = there};
  in.recorded_head = &empty;
  support_expect(context, ern_dub_frame(context, &in, out, &drawn), ERN_E_SHAPE, "32 x 0 pixels, 1 channels", NULL);
}

static void expect_recorded(const ern_dub_input *in) {
  bool drawn = true;
  memset(out, 7, sizeof out);
  support_ok(context, ern_dub_frame(context, in, out, &drawn));
  assert_false(drawn);
  for (size_t i = 0; i < (size_t)HEIGHT * WIDTH; i++) assert_int_equal(difference(i), 0);
}

static void test_left_as_recorded(void **state) {
  (void)state;
  paint((const uint8_t[3]){40, 20, 20}, 255);
  const float places[][3] = {{80, 80, 10},   {25, 80, FACE},   {80, 148, FACE},
                             {80, 20, FACE}, {-500, 80, FACE}, {80, 80, 1e3F}};
  for (size_t i = 0; i < sizeof places / sizeof *places; i++) {
    ern_dub_input in = face_at(places[i][0], places[i][1], places[i][2]);
    find_box(&in);
    assert_int_equal(in.box[2], 0);
    in.head = NULL;
    expect_recorded(&in);
  }
  ern_dub_input in = face_at(80, 80, FACE);
  find_box(&in);
  paint((const uint8_t[3]){40, 20, 20}, 100); /* the head is not there */
  expect_recorded(&in);
  paint((const uint8_t[3]){40, 20, 20}, 230); /* nor opaque enough anywhere for its colours */
  expect_recorded(&in);
}

/* Landmarks anywhere: a status, and nothing outside the box. */
static void test_any_landmarks(void **state) {
  (void)state;
  paint((const uint8_t[3]){40, 20, 20}, 255);
  for (uint64_t run = 0; run < 60; run++) {
    bool drawn = false;
    ern_dub_input in = face_at(80, 80, FACE);
    for (size_t i = 0; i < 68; i++) {
      for (size_t c = 0; c < 2; c++) {
        const float u = ern_uniform(ern_random_at(run, 3, (uint32_t)(2 * i + c), ERN_RNG_INIT).word[0]);
        in.landmarks[i][c] = run < 40 ? u : in.landmarks[i][c] + 0.3F * (u - 0.5F);
      }
    }
    find_box(&in);
    if (in.box[2] > 0) support_ok(context, ern_dub_wanted(context, &in, wanted));
    support_ok(context, ern_dub_frame(context, &in, out, &drawn));
    for (size_t i = 0; i < (size_t)HEIGHT * WIDTH; i++) {
      const int x = (int)(i % WIDTH), y = (int)(i / WIDTH);
      if (x < in.box[0] || x >= in.box[0] + in.box[2] || y < in.box[1] || y >= in.box[1] + in.box[3])
        assert_int_equal(difference(i), 0);
    }
  }
}

static void test_refused(void **state) {
  (void)state;
  bool drawn = true;
  ern_dub_input in = face_at(80, 80, FACE);
  in.landmarks[33][1] = NAN;
  assert_int_equal(ern_dub_box(context, &in, in.box), ERN_E_NONFINITE);
  assert_non_null(strstr(ern_last_error(context), "landmark 33"));
  assert_int_equal(ern_dub_frame(context, &in, out, &drawn), ERN_E_NONFINITE);
  assert_false(drawn);
  in = face_at(80, 80, FACE);
  for (int i = 0; i < 68; i++)
    for (int c = 0; c < 2; c++) in.landmarks[i][c] *= SQUARE; /* pixels */
  assert_int_equal(ern_dub_box(context, &in, in.box), ERN_E_ARGUMENT);
  assert_non_null(strstr(ern_last_error(context), "expected shares of the square (0..1), not pixels"));
  in = face_at(80, 80, 1e30F);
  assert_int_equal(ern_dub_box(context, &in, in.box), ERN_E_ARGUMENT);
  in = face_at(80, 80, FACE);
  in.square[0] = INT32_MIN;
  assert_int_equal(ern_dub_box(context, &in, in.box), ERN_E_SHAPE);
  in = face_at(80, 80, FACE);
  find_box(&in);
  in.box[2] = INT32_MAX;
  assert_int_equal(ern_dub_frame(context, &in, out, &drawn), ERN_E_SHAPE);
  find_box(&in);
  in.width = in.box[0] + in.box[2] - 1; /* in the square, but not in the frame */
  assert_int_equal(ern_dub_frame(context, &in, out, &drawn), ERN_E_SHAPE);
  in.width = WIDTH;
  find_box(&in);
  in.head_width--; /* less than the box */
  assert_int_equal(ern_dub_frame(context, &in, out, &drawn), ERN_E_SHAPE);
  find_box(&in);
  in.head_scale[1] = 0;
  assert_int_equal(ern_dub_frame(context, &in, out, &drawn), ERN_E_ARGUMENT);
  in.head_scale[1] = 1;
  in.head = NULL;
  assert_int_equal(ern_dub_frame(context, &in, out, &drawn), ERN_E_ARGUMENT);
}

static int open_context(void **state) {
  (void)state;
  context = support_context();
  return 0;
}

static int close_context(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_drawn),
                                     cmocka_unit_test(test_outline),
                                     cmocka_unit_test(test_no_line),
                                     cmocka_unit_test(test_nose),
                                     cmocka_unit_test(test_matched),
                                     cmocka_unit_test(test_scaled),
                                     cmocka_unit_test(test_part),
                                     cmocka_unit_test(test_wanted),
                                     cmocka_unit_test(test_wanted_of_a_small_head),
                                     cmocka_unit_test(test_recorded_head),
                                     cmocka_unit_test(test_left_as_recorded),
                                     cmocka_unit_test(test_any_landmarks),
                                     cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, open_context, close_context);
}
