/* SPDX-License-Identifier: MIT
 * live.h: what its functions do with bad arguments (base.h, "Arguments"). */
#include "arguments.h"

#include <math.h>

#include "ernerf/live.h"
#include "ernerf/stream.h"

static struct {
  ern_context *context;
  ern_live *live, *windows;
} w;

CHECK(ern_live_options_fill) {
  ern_live_options_fill(NULL, sizeof(ern_live_options));
  const ern_live_options options = ern_live_options_default();
  assert_int_equal(options.rate, ern_sound_reader_options_default().rate); /* what is read is pushed */
}
CHECK(ern_live_setting) {
  assert_non_null(ern_live_setting(0));
  assert_null(ern_live_setting(SIZE_MAX));
}
CHECK(ern_live_options_default) { assert_int_equal(ern_live_options_default().channels, 1); }
CHECK(ern_live_open) {
  ern_live *live = (ern_live *)(void *)&w;
  ern_live_options options = ern_live_options_default();
  REFUSED_ALONE(ern_live_open(NULL, &options, &live));
  assert_null(live);
  REFUSED(w.context, "live is NULL", ern_live_open(w.context, &options, NULL));
  options.rate = 999;
  REFUSED(w.context, "rate is 999, expected 1000 to 384000", ern_live_open(w.context, &options, &live));
  options = ern_live_options_default();
  options.width = 13;
  REFUSED(w.context, "window_length is 0, expected 1 to 16", ern_live_open(w.context, &options, &live));
  options = ern_live_options_default();
  options.look_ahead = 1;
  REFUSED(w.context, "look_ahead is 1, expected 2 to 7", ern_live_open(w.context, &options, &live));
  options = ern_live_options_default();
  options.rate_numerator = 101;
  REFUSED(w.context, "101/1 frames a second, expected 1 to 100", ern_live_open(w.context, &options, &live));
  options = ern_live_options_default();
  options.rate_numerator = 1;
  options.capacity = 24; /* a frame of one second has 25 */
  REFUSED(w.context, "capacity is 24, expected 25 to 1000", ern_live_open(w.context, &options, &live));
  options.rate_numerator = 1000;
  options.rate_denominator = 999;
  options.capacity = 25; /* a frame that begins within 1/25 s has parts of 26 */
  REFUSED(w.context, "capacity is 25, expected 26 to 1000", ern_live_open(w.context, &options, &live));
  options = ern_live_options_default();
  float code[32] = {0};
  code[3] = NAN;
  options.silence_code = code;
  assert_int_equal(ern_live_open(w.context, &options, &live), ERN_E_NONFINITE);
  options = (ern_live_options){.rate = 16000};
  REFUSED(w.context, "ern_live_options_default", ern_live_open(w.context, &options, &live));
}
CHECK(ern_live_free) {
  ern_live *none = NULL;
  ern_live_free(NULL);
  ern_live_free(&none);
}
CHECK(ern_live_push) {
  const float sample = 0;
  REFUSED_ALONE(ern_live_push(NULL, &sample, 1));
  REFUSED(w.context, "samples is NULL", ern_live_push(w.live, NULL, 1));
  support_ok(w.context, ern_live_push(w.live, NULL, 0));
}
CHECK(ern_live_push_windows) {
  const float values[2] = {0, 1e31f};
  REFUSED_ALONE(ern_live_push_windows(NULL, values, 1));
  REFUSED(w.context, "windows is NULL", ern_live_push_windows(w.windows, NULL, 1));
  support_expect(w.context, ern_live_push_windows(w.windows, values, 1), ERN_E_FORMAT, "place 1", NULL);
  support_expect(w.context, ern_live_push_windows(w.live, values, 1), ERN_E_STATE, "expected sound", NULL);
}
CHECK(ern_live_insert_silence) { REFUSED_ALONE(ern_live_insert_silence(NULL)); }
CHECK(ern_live_flush) { REFUSED_ALONE(ern_live_flush(NULL)); }
CHECK(ern_live_cancel) { REFUSED_ALONE(ern_live_cancel(NULL)); }
CHECK(ern_live_samples) { assert_int_equal(ern_live_samples(NULL), 0); }
CHECK(ern_live_end) { REFUSED_ALONE(ern_live_end(NULL)); }
CHECK(ern_live_pull) {
  const ern_live_frame *frame = (const ern_live_frame *)(const void *)&w;
  bool ended = true;
  REFUSED_ALONE(ern_live_pull(NULL, 0, &frame, &ended));
  assert_true(frame == NULL && !ended);
  REFUSED(w.context, "frame is NULL", ern_live_pull(w.live, 0, NULL, &ended));
  REFUSED(w.context, "ended is NULL", ern_live_pull(w.live, 0, &frame, NULL));
  REFUSED(w.context, "wait is nan", ern_live_pull(w.live, NAN, &frame, &ended));
  REFUSED(w.context, "wait is -1", ern_live_pull(w.live, -1, &frame, &ended));
}
CHECK(ern_live_draw_sized) {
  const ern_live_frame frame = {0};
  const ern_frame_input input = {0};
  const ern_frame_output output = {0};
  ern_renderer *renderer = (ern_renderer *)(void *)&w; /* not looked at */
  REFUSED_ALONE(ern_live_draw_sized(NULL, renderer, &input, sizeof input, &output, sizeof output, NULL, 0));
  REFUSED_ALONE(ern_live_draw_sized(&frame, NULL, &input, sizeof input, &output, sizeof output, NULL, 0));
}
CHECK(ern_live_draw) {
  const ern_live_frame frame = {0};
  REFUSED_ALONE(ern_live_draw(&frame, NULL, &(ern_frame_input){0}, &(ern_frame_output){0}, NULL));
}

static const struct arguments_check table[] = {
    ROW(ern_live_options_fill), ROW(ern_live_setting),        ROW(ern_live_options_default),
    ROW(ern_live_open),         ROW(ern_live_free),           ROW(ern_live_push),
    ROW(ern_live_push_windows), ROW(ern_live_insert_silence), ROW(ern_live_flush),
    ROW(ern_live_cancel),       ROW(ern_live_samples),        ROW(ern_live_end),
    ROW(ern_live_pull),         ROW(ern_live_draw_sized),     ROW(ern_live_draw)};
enum { CHECKS = sizeof table / sizeof *table };

static void test_every_function_has_a_check(void **state) {
  (void)state;
  assert_int_equal(arguments_cover("include/ernerf/live.h", table, CHECKS), CHECKS);
}

static void test_arguments(void **state) {
  (void)state;
  ern_live_options options = ern_live_options_default();
  w.context = support_context();
  support_ok(w.context, ern_live_open(w.context, NULL, &w.live));
  options.window_length = 1;
  options.width = 2;
  support_ok(w.context, ern_live_open(w.context, &options, &w.windows));
  arguments_run(table, CHECKS);
  ern_live_free(&w.live);
  ern_live_free(&w.windows);
  ern_context_free(&w.context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_every_function_has_a_check),
                                     cmocka_unit_test(test_arguments)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
