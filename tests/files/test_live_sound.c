/* SPDX-License-Identifier: MIT
 * Utterances of `live --control` and `serve`: which frames each of them begins and ends with, programs that make sound
 * of a text, and sound from a pipe. */
#include "../support.h"

#include <signal.h>
#include <stdbool.h>
#include <sys/stat.h>

#include "ernerf/media.h"

/* In place of the program's. */
#define session_interrupted live_sound_interrupted
#define session_fail_with live_sound_fail_with
#include "../../tools/ernerf-cli/live/live_sound.c"
#include "../../tools/ernerf-cli/live/live_tts.c"

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

/* Until the utterances that wait are read; then another program may be named. */
static void await_read(void) {
  for (bool reads = true; reads; nap()) {
    (void)pthread_mutex_lock(&sound.mutex);
    reads = sound.current > 0 || sound.utterance_count > 0;
    (void)pthread_mutex_unlock(&sound.mutex);
  }
}

static void pull(void) {
  const ern_live_frame *frame = NULL;
  bool ended = false;
  support_ok(context, ern_live_pull(live, 0, &frame, &ended));
  assert_non_null(frame);
  heard += frame->samples;
}

/* Pulls frames until one has an event, which has a reason with these words, or none (NULL). */
static void expect_with(enum live_event event, unsigned id, const char *words) {
  enum live_event got = LIVE_NONE;
  unsigned whose = 0;
  char *why = NULL;
  for (int i = 0; i < 500 && (got = live_sound_event(&sound, heard, &whose, &why)) == LIVE_NONE; i++) {
    pull();
    nap();
  }
  assert_int_equal(got, event);
  assert_int_equal(whose, id);
  if (words == NULL) assert_null(why);
  if (words != NULL && (why == NULL || strstr(why, words) == NULL)) fail_msg("\"%s\" is not in: %s", words, why);
  free(why);
}

static void expect(enum live_event event, unsigned id) { expect_with(event, id, NULL); }

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
  expect_with(LIVE_FAILED, 2, "gone.wav");
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

/* ---- programs that make sound of a text, and pipes ----------------------------------------------------------------
 */

/* A program in this folder that runs `line` of the shell. */
static void make_program(const char *name, const char *line) {
  FILE *file = fopen(name, "w");
  assert_non_null(file);
  fprintf(file, "#!/bin/sh\n%s\n", line);
  (void)fclose(file);
  assert_int_equal(chmod(name, 0700), 0);
}

static void read_text(const char *path, char text[256]) {
  FILE *file = fopen(path, "r");
  assert_non_null(file);
  text[fread(text, 1, 255, file)] = 0;
  (void)fclose(file);
}

static void speak_by(const char *program, const char *argument) {
  sound.tts.program = program;
  sound.tts.arguments = (struct text_list){.text = {argument}, .count = argument != NULL};
}

/* The text is on its standard input, and no shell sees it or the argument. */
static void test_tts(void **state) {
  (void)state;
  make_program("./tts.sh", "cat > text.txt; echo \"$1\" >> text.txt; cat said.wav");
  speak_by("./tts.sh", "a b; $HOME");
  assert_int_equal(live_sound_say(&sound, true, "say `this` $(and) \"that\";"), 1);
  expect(LIVE_STARTED, 1);
  expect(LIVE_ENDED, 1);
  assert_int_equal(atomic_load(&sound.samples_pushed), SAMPLES);
  char text[256];
  read_text("text.txt", text);
  assert_string_equal(text, "say `this` $(and) \"that\";a b; $HOME\n");
}

static void expect_error(const char *what) {
  char *error = live_sound_take_error(&sound);
  assert_non_null(error);
  if (strstr(error, what) == NULL) fail_msg("\"%s\" is not in: %s", what, error);
  free(error);
}

static void test_tts_fails(void **state) {
  (void)state;
  make_program("./fails.sh", "exit 3");
  make_program("./text.sh", "echo this is no sound");
  speak_by("./gone.sh", NULL);
  assert_int_equal(live_sound_say(&sound, true, "a"), 1);
  expect_with(LIVE_FAILED, 1, "gone.sh");
  expect_error("--tts ./gone.sh: cannot be started: No such file");
  speak_by("./fails.sh", NULL);
  assert_int_equal(live_sound_say(&sound, true, "a"), 2);
  expect_with(LIVE_FAILED, 2, "exit status 3");
  expect_error("--tts ./fails.sh: ended with exit status 3");
  speak_by("./text.sh", NULL);
  assert_int_equal(live_sound_say(&sound, true, "a"), 3);
  expect_with(LIVE_FAILED, 3, "is no sound");
  expect_error("./text.sh: is no sound");
}

/* Sound that is heard in part fails where that ends, each with its own reason, also where the next one was read then.
 */
static void test_tts_breaks_off(void **state) {
  (void)state;
  make_program("./exits.sh", "cat said.wav; exit 3");
  make_program("./killed.sh", "cat said.wav; kill -9 $$");
  make_program("./cut.sh", "head -c 20000 said.wav");
  static const char *const programs[] = {"./exits.sh", "./killed.sh", "./cut.sh"};
  static const char *const words[] = {"exit status 3", "exit status 137", "cut short"};
  for (unsigned i = 0; i < 3; i++) {
    speak_by(programs[i], NULL);
    assert_int_equal(live_sound_say(&sound, true, "a"), i + 1);
    await_read();
  }
  for (unsigned i = 0; i < 3; i++) {
    expect(LIVE_STARTED, i + 1);
    expect_with(LIVE_FAILED, i + 1, words[i]);
  }
}

/* What is written into a pipe does not know its size, and is heard while it comes. */
static void test_tts_of_no_known_size(void **state) {
  (void)state;
  for (unsigned i = 0; i < 2; i++) {
    static const char *const sizes[] = {"\\000\\360\\377\\177", "\\377\\377\\377\\377"};
    char line[256];
    snprintf(line, sizeof line, "head -c 40 said.wav; printf '%s'; tail -c +45 said.wav; sleep 0.2", sizes[i]);
    make_program("./open.sh", line);
    speak_by("./open.sh", NULL);
    assert_int_equal(live_sound_say(&sound, true, "a"), i + 1);
    expect(LIVE_STARTED, i + 1);
    expect(LIVE_ENDED, i + 1);
    assert_int_equal(atomic_load(&sound.samples_pushed), (i + 1) * SAMPLES);
  }
  for (unsigned i = 0; i < 2; i++) { /* it is heard while its program goes on, also where its header came alone */
    make_program("./stays.sh", i == 0 ? "head -c 20000 said.wav; exec sleep 600"
                                      : "head -c 44 said.wav; sleep 0.2; tail -c +45 said.wav; exec sleep 600");
    speak_by("./stays.sh", NULL);
    assert_int_equal(live_sound_say(&sound, true, "a"), 3 + i);
    expect(LIVE_STARTED, 3 + i);
    live_sound_cancel(&sound);
    expect(LIVE_ENDED, 3 + i);
    await_read();
  }
}

static unsigned dropped[8];
static size_t dropped_count;
static void note_dropped(void *user, unsigned id) {
  (void)user;
  dropped[dropped_count++] = id;
}

/* A cancel ends the program that is speaking, with what that has started, and tells of each utterance once. */
static void test_cancel_ends_tts(void **state) {
  (void)state;
  struct stat there;
  sound.dropped = note_dropped;
  dropped_count = 0;
  (void)remove("pid.txt");
  make_program("./hangs.sh", "sleep 600 & echo $! > pid.tmp; mv pid.tmp pid.txt; wait");
  speak_by("./hangs.sh", NULL);
  for (unsigned id = 1; id <= 3; id++) assert_int_equal(live_sound_say(&sound, true, "a"), id);
  for (int i = 0; i < 5000 && stat("pid.txt", &there) != 0; i++) nap();
  live_sound_cancel(&sound);
  assert_int_equal(dropped_count, 3);
  for (unsigned id = 1; id <= 3; id++) assert_int_equal(dropped[id - 1], id);
  char text[256];
  read_text("pid.txt", text);
  const pid_t pid = (pid_t)atoi(text);
  assert_true(pid > 1);
  for (int i = 0; i < 5000 && kill(pid, 0) == 0; i++) nap();
  speak_by("./tts.sh", NULL);
  assert_int_equal(live_sound_say(&sound, true, "b"), 4);
  expect(LIVE_STARTED, 4);
  live_sound_cancel(&sound);
  assert_int_equal(dropped_count, 4);
  assert_int_equal(dropped[3], 4);
  assert_int_equal(live_sound_say(&sound, true, "c"), 5);
  expect(LIVE_STARTED, 5);
  expect(LIVE_ENDED, 5);
  live_sound_cancel(&sound); /* of nothing */
  assert_int_equal(dropped_count, 4);
}

/* Samples that come in pieces, the first of which are heard before the last have come. */
static void test_pipe(void **state) {
  (void)state;
  int16_t samples[SAMPLES];
  int made[2];
  for (size_t i = 0; i < SAMPLES; i++) samples[i] = (int16_t)(i % 100 * 100);
  assert_true(live_tts_pipe(made));
  const struct live_pipe pipe = {"it", made[0], "s16le", RATE, 1};
  assert_int_equal(live_sound_pipe(&sound, &pipe), 1);
  assert_int_equal(write(made[1], samples, sizeof samples / 2), sizeof samples / 2);
  expect(LIVE_STARTED, 1);
  assert_int_equal(write(made[1], samples + SAMPLES / 2, sizeof samples / 2), sizeof samples / 2);
  (void)close(made[1]);
  expect(LIVE_ENDED, 1);
  assert_int_equal(atomic_load(&sound.samples_pushed), SAMPLES);
  for (int i = 0; i < 5000 && fcntl(made[0], F_GETFD) != -1; i++) nap(); /* it is closed */
  assert_int_equal(fcntl(made[0], F_GETFD), -1);
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)
int main(void) {
  (void)signal(SIGPIPE, SIG_IGN);
  const struct CMUnitTest tests[] = {TEST(test_begin_and_end),
                                     TEST(test_cancel),
                                     TEST(test_tts),
                                     TEST(test_tts_fails),
                                     TEST(test_cancel_ends_tts),
                                     TEST(test_pipe),
                                     TEST(test_tts_breaks_off),
                                     TEST(test_tts_of_no_known_size)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
