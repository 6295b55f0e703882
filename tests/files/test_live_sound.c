/* SPDX-License-Identifier: MIT
 * Utterances of `live --control`: which frames each of them begins and ends with. */
#include "../support.h"

#include <stdbool.h>

#include "ernerf/media.h"

/* In place of the program's. */
#define session_interrupted live_sound_interrupted
#define session_fail_with live_sound_fail_with
#include "../../tools/ernerf-cli/live/live_sound.c"

enum { RATE = 48000, FRAME = RATE / 25, SAMPLES = RATE / 2 /* of said.wav: 12.5 frames */ };

static ern_context *context;
static ern_live *live;
static struct live_sound sound;
static uint64_t heard;

bool session_interrupted(void) { return false; }

int session_fail_with(struct session *session, const char *format, ...) {
  (void)session;
  fail_msg("%s", format);
  return EXIT_FAILURE;
}

static int set_up(void **state) {
  (void)state;
  ern_live_options options = ern_live_options_default();
  static struct session session;
  int16_t said[SAMPLES];
  context = support_context();
  for (size_t i = 0; i < SAMPLES; i++) said[i] = (int16_t)(i % 100 * 100);
  const ern_sound file = {.data = said, .frames = SAMPLES, .channels = 1, .rate = RATE};
  remove("said.wav");
  support_ok(context, ern_sound_write_wav(context, "said.wav", &file));
  options.insert_silence = true;
  support_ok(context, ern_live_open(context, &options, &live));
  session.context = context;
  sound = (struct live_sound){.keeps_running = true};
  heard = 0;
  return live_sound_start(&sound, &session, live, RATE, 1);
}

static int tear_down(void **state) {
  (void)state;
  live_sound_stop(&sound);
  ern_live_free(&live);
  ern_context_free(&context);
  return 0;
}

static void nap(void) { (void)nanosleep(&(struct timespec){.tv_nsec = 2000000}, NULL); }

static void await_pushed(uint64_t samples) {
  for (int i = 0; i < 5000 && atomic_load(&sound.samples_pushed) < samples; i++) nap();
  assert_true(atomic_load(&sound.samples_pushed) >= samples);
  for (size_t waiting = 1; waiting > 0;) (void)live_sound_speaking(&sound, &waiting);
}

static void pull(void) {
  const ern_live_frame *frame = NULL;
  bool ended = false;
  support_ok(context, ern_live_pull(live, 0, &frame, &ended));
  assert_non_null(frame);
  heard += frame->samples;
}

/* Pulls frames until one has an event. */
static void expect(enum live_event event, unsigned id) {
  enum live_event got = LIVE_NONE;
  unsigned whose = 0;
  for (int i = 0; i < 500 && (got = live_sound_event(&sound, heard, &whose)) == LIVE_NONE; i++) {
    pull();
    nap();
  }
  assert_int_equal(got, event);
  assert_int_equal(whose, id);
}

static void test_begin_and_end(void **state) {
  size_t waiting = 0;
  (void)state;
  for (int i = 0; i < 3; i++) pull(); /* silence */
  const uint64_t begin = ern_live_samples(live);
  assert_int_equal(live_sound_say(&sound, false, "said.wav"), 1);
  assert_int_equal(live_sound_say(&sound, false, "gone.wav"), 2);
  assert_int_equal(live_sound_say(&sound, false, "said.wav"), 3);
  await_pushed(2 * SAMPLES);
  assert_int_equal(live_sound_speaking(&sound, &waiting), 0);
  expect(LIVE_STARTED, 1);
  assert_int_equal(heard, (begin / FRAME + 1) * FRAME);
  assert_int_equal(live_sound_speaking(&sound, &waiting), 1);
  expect(LIVE_ENDED, 1);
  assert_true(heard >= begin + SAMPLES && heard < begin + SAMPLES + FRAME);
  expect(LIVE_FAILED, 2);
  expect(LIVE_STARTED, 3);
  assert_true(heard > begin + SAMPLES && heard <= begin + SAMPLES + FRAME);
  expect(LIVE_ENDED, 3);
  assert_true(heard >= begin + 2 * SAMPLES && heard < begin + 2 * SAMPLES + FRAME);
  assert_int_equal(live_sound_speaking(&sound, &waiting), 0);
}

/* What is heard fades out within 80 ms; what waits has no events. */
static void test_cancel(void **state) {
  (void)state;
  assert_int_equal(live_sound_say(&sound, false, "said.wav"), 1);
  assert_int_equal(live_sound_say(&sound, false, "said.wav"), 2);
  await_pushed(2 * SAMPLES);
  expect(LIVE_STARTED, 1);
  live_sound_cancel(&sound);
  const uint64_t at = heard;
  expect(LIVE_ENDED, 1);
  assert_true(heard <= at + 2 * FRAME);
  assert_int_equal(live_sound_say(&sound, false, "said.wav"), 3);
  expect(LIVE_STARTED, 3);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test_setup_teardown(test_begin_and_end, set_up, tear_down),
                                     cmocka_unit_test_setup_teardown(test_cancel, set_up, tear_down)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
