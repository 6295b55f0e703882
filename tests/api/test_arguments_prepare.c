/* SPDX-License-Identifier: MIT
 * What prepare does with NULL, with options out of range and with structures that nobody initialised (base.h). */
#include <math.h>
#include <unistd.h>

#include "arguments.h"
#include "ernerf/prepare.h"
#include "made_onnx.h"

static ern_context *context;
static const char *const junk = "no such file";

static int cancel(void *user, const char *step, size_t done, size_t total) {
  (void)user, (void)step, (void)done, (void)total;
  return 1;
}

CHECK(ern_prepare_options_fill) { FILLS(ern_prepare_options, ern_prepare_options_fill); }
CHECK(ern_prepare_setting) {
  size_t end = offsetof(ern_prepare_options, size) + sizeof(uint32_t), i = 0;
  for (const ern_setting *s; (s = ern_prepare_setting(i)) != NULL; i++) { /* in the order of the struct */
    assert_true(s->at >= end && s->at - end < 8);
    end = s->at + (s->type == ERN_SETTING_BOOL ? 1 : s->type == ERN_SETTING_INT ? 4 : 8);
  }
  assert_true(i > 0 && sizeof(ern_prepare_options) - end < 8);
}
CHECK(ern_prepare_options_default) {
  const ern_prepare_options options = ern_prepare_options_default();
  assert_true(options.side == 512 && options.focal == 0 && options.from == 0 && options.to == 0);
  assert_true(options.only == NULL && options.progress == NULL && !options.anew && !options.head_only);
}
CHECK(ern_prepare) {
  const ern_prepare_options good = ern_prepare_options_default();
  ern_prepare_options options = good;
  ern_prepare_result result;
  REFUSED_ALONE(ern_prepare(NULL, junk, "clip", &options, &result));
  REFUSED(context, "ern_prepare_sized: video is NULL", ern_prepare(context, NULL, "clip", &options, &result));
  REFUSED(context, "ern_prepare_sized: folder is NULL", ern_prepare(context, junk, NULL, &options, &result));
  REFUSED(context, "ern_prepare_sized: options is NULL", ern_prepare(context, junk, "clip", NULL, &result));
  REFUSED(context, "ern_prepare_sized: result is NULL", ern_prepare(context, junk, "clip", &options, NULL));
  REFUSED(context, "ern_prepare_options_default",
          ern_prepare(context, junk, "clip", &(ern_prepare_options){.side = 512}, &result));
#define WRONG(member, value, words)                                                      \
  do {                                                                                   \
    options = good;                                                                      \
    options.member = value;                                                              \
    REFUSED(context, words, ern_prepare(context, junk, "clip", &options, &result));      \
    assert_true(result.frames == 0 && result.verdicts[ERN_PREPARE_STEPS - 1].step == 0); \
  } while (0)
  WRONG(only, "mouth", "only is \"mouth\", expected face, pose");
  WRONG(only, "", "only is \"\"");
  WRONG(side, 127, "side is 127");
  WRONG(side, 1025, "side is 1025");
  WRONG(side, -1, "side is -1");
  WRONG(from, -1, "from is -1");
  WRONG(from, NAN, "from is nan");
  WRONG(from, INFINITY, "from is inf");
  WRONG(to, -0.5, "to is -0.5");
  WRONG(to, NAN, "to is nan");
  WRONG(to, INFINITY, "to is inf");
  WRONG(focal, 1, "focal is 1,");
  WRONG(focal, -1, "focal is -1");
  WRONG(focal, NAN, "focal is nan");
  WRONG(focal, 1e9, "focal is 1e+09");
  WRONG(detector, "", "detector is \"\"");
  WRONG(landmarks, "", "landmarks is \"\"");
  options = good;
  options.from = options.to = 2;
  REFUSED(context, "from 2 to 2", ern_prepare(context, junk, "clip", &options, &result));
  options = good;
  options.focal = 600;
  options.poses = "own.json";
  REFUSED(context, "focal is 600 beside poses", ern_prepare(context, junk, "clip", &options, &result));
  options = good;
  support_expect(context, ern_prepare(context, junk, "clip", &options, &result), ERN_E_MISSING, junk, NULL);
  static char longest[8192];
  memset(longest, 'a', sizeof longest - 1);
  assert_int_not_equal(ern_prepare(context, junk, longest, &options, &result), ERN_OK);
  assert_int_not_equal(access("clip", 0), 0); /* none of these made a folder */
}
CHECK(ern_prepare_sized) {
  ern_prepare_options options = ern_prepare_options_default();
  support_write_text("made.mp4", "no video");
  KEEPS_TO(ern_prepare_result, {
    assert_int_not_equal(ern_prepare_sized(context, "made.mp4", "clip", &options, it, bytes), ERN_OK);
    it->frames = bytes >= sizeof it->frames ? 7 : it->frames; /* it is 0 */
  });
  options.progress = cancel;
  ern_prepare_result result;
  support_expect(context, ern_prepare(context, "made.mp4", "clip", &options, &result), ERN_E_CANCELLED, "clip", "face",
                 NULL);
  assert_int_not_equal(access("clip", 0), 0);
  options = ern_prepare_options_default();
  options.size = sizeof options + 8;
  REFUSED_LATER(context, ern_prepare_options, ern_prepare(context, "made.mp4", "clip", &options, &result));
}

/* A network of the least kind: points that do not depend on the picture. */
static ern_landmark_network *made_network(void) {
  struct made_message graph = {0};
  static float weights[136 * 3], bias[136];
  ern_landmark_network *network = NULL;
  for (size_t k = 0; k < 136; k++) bias[k] = 0.5f;
  made_weight(&graph, "W", (const size_t[]){136, 3, 1, 1, 0}, weights);
  made_weight(&graph, "B", (const size_t[]){136, 0}, bias);
  made_node(&graph, "GlobalAveragePool", "face", "mean", NULL);
  made_node(&graph, "Conv", "mean W B", "wide",
            (const struct made_attribute[]){{"kernel_shape", 2, {1, 1}}, {NULL, 0, {0}}});
  made_node(&graph, "Flatten", "wide", "points", NULL);
  made_value(&graph, 11, "face", (const size_t[]){1, 3, 16, 16, 0});
  made_value(&graph, 12, "points", (const size_t[]){1, 136, 0});
  made_onnx("points.onnx", &graph);
  support_ok(context, ern_landmark_network_open(context, "points.onnx", &network));
  return network;
}

static uint8_t pixels[16 * 16 * 3];
static float guess[68][2], points[68][2];

CHECK(ern_landmark_network_open) {
  ern_landmark_network *network = (ern_landmark_network *)&context;
  REFUSED_ALONE(ern_landmark_network_open(NULL, junk, &network));
  assert_null(network);
  REFUSED(context, "ern_landmark_network_open: path is NULL", ern_landmark_network_open(context, NULL, &network));
  REFUSED(context, "ern_landmark_network_open: network is NULL", ern_landmark_network_open(context, junk, NULL));
  network = (ern_landmark_network *)&context;
  support_expect(context, ern_landmark_network_open(context, junk, &network), ERN_E_MISSING, junk, NULL);
  assert_null(network);
}
CHECK(ern_landmark_network_free) {
  ern_landmark_network *network = NULL;
  ern_landmark_network_free(NULL);
  ern_landmark_network_free(&network);
  network = made_network();
  ern_landmark_network_free(&network);
  assert_null(network);
}
CHECK(ern_landmark_network_learn) {
  ern_landmark_network *network = made_network();
  const float(*at)[2] = (const float(*)[2])guess;
  REFUSED_ALONE(ern_landmark_network_learn(NULL, pixels, 16, 16, at));
  REFUSED(context, "rgb is NULL", ern_landmark_network_learn(network, NULL, 16, 16, at));
  REFUSED(context, "guess is NULL", ern_landmark_network_learn(network, pixels, 16, 16, NULL));
  REFUSED(context, "0 x 16", ern_landmark_network_learn(network, pixels, 0, 16, at));
  REFUSED(context, "16 x 8193", ern_landmark_network_learn(network, pixels, 16, 8193, at));
  guess[7][1] = NAN;
  REFUSED(context, "point 7", ern_landmark_network_learn(network, pixels, 16, 16, at));
  guess[7][1] = 1e30f;
  support_expect(context, ern_landmark_network_learn(network, pixels, 16, 16, at), ERN_E_UNSUPPORTED,
                 "outside the picture", NULL);
  guess[7][1] = 0;
  ern_landmark_network_free(&network);
}
CHECK(ern_landmark_network_decide) {
  ern_landmark_network *network = made_network();
  REFUSED_ALONE(ern_landmark_network_decide(NULL));
  support_expect(context, ern_landmark_network_decide(network), ERN_E_UNSUPPORTED, "no picture", NULL);
  ern_landmark_network_free(&network);
}
CHECK(ern_landmark_network_find) {
  ern_landmark_network *network = made_network();
  const float(*at)[2] = (const float(*)[2])guess;
  REFUSED_ALONE(ern_landmark_network_find(NULL, pixels, 16, 16, at, points));
  REFUSED(context, "ern_landmark_network_find: points is NULL",
          ern_landmark_network_find(network, pixels, 16, 16, at, NULL));
  support_expect(context, ern_landmark_network_find(network, pixels, 16, 16, at, points), ERN_E_STATE, "points.onnx",
                 NULL);
  for (size_t k = 0; k < 68; k++) guess[k][0] = guess[k][1] = k % 2 != 0 ? 4 : 12;
  support_ok(context, ern_landmark_network_learn(network, pixels, 16, 16, at)); /* all points in the middle: no face */
  support_expect(context, ern_landmark_network_decide(network), ERN_E_UNSUPPORTED, "eye distances", NULL);
  support_expect(context, ern_landmark_network_find(network, pixels, 16, 16, at, points), ERN_E_STATE, NULL);
  ern_landmark_network_free(&network);
}

static const struct arguments_check table[] = {ROW(ern_prepare_options_fill),    ROW(ern_prepare_setting),
                                               ROW(ern_prepare_options_default), ROW(ern_prepare),
                                               ROW(ern_prepare_sized),           ROW(ern_landmark_network_open),
                                               ROW(ern_landmark_network_free),   ROW(ern_landmark_network_learn),
                                               ROW(ern_landmark_network_decide), ROW(ern_landmark_network_find)};
enum { CHECKS = sizeof table / sizeof *table };

static void test_every_function_has_a_check(void **state) {
  (void)state;
  assert_int_equal(arguments_cover("include/ernerf/prepare.h", table, CHECKS), CHECKS);
}

static void test_arguments(void **state) {
  (void)state;
  context = support_context();
  arguments_run(table, CHECKS);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_every_function_has_a_check),
                                     cmocka_unit_test(test_arguments)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
