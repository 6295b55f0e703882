/* SPDX-License-Identifier: MIT
 * Live speech: the same frames as from a file, however sound is cut; pauses, inserted silence, and what happens when
 * one side is slow. */
#include <math.h>
#include <pthread.h>
#include <time.h>

#include "core/rng.h"
#include "ernerf/backend.h"
#include "ernerf/live.h"
#include "ernerf/media.h"
#include "ernerf/speech.h"
#include "model/model.h"
#include "support.h"

enum { RATE = 22050, CHANNELS = 2, SECONDS = 3, WINDOW = 16, WIDTH = 13, WINDOW_VALUES = 8 * WINDOW * WIDTH };

static ern_context *context;

static int set_up(void **state) {
  (void)state;
  context = support_context();
  return 0;
}

static int tear_down(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

static void nap(long milliseconds) { (void)nanosleep(&(struct timespec){.tv_nsec = milliseconds * 1000000}, NULL); }

static double uniform(uint32_t seed, size_t i) {
  return (double)ern_uniform(ern_random_at(seed, (uint32_t)i, 0, ERN_RNG_INIT).word[0]);
}

/* Syllables of noise, of changing loudness. */
static ern_sound babble(size_t frames, uint32_t seed) {
  ern_sound sound = {.rate = RATE, .channels = CHANNELS, .frames = frames};
  sound.data = malloc(frames * CHANNELS * sizeof *sound.data);
  assert_non_null(sound.data);
  for (size_t i = 0; i < frames * CHANNELS; i++) {
    const double loud = 0.02 + 0.3 * pow(sin((double)i / RATE * 9), 2);
    sound.data[i] = (int16_t)(32767 * loud * (2 * uniform(seed, i) - 1));
  }
  return sound;
}

static float *as_floats(const ern_sound *sound) {
  float *samples = malloc(sound->frames * CHANNELS * sizeof *samples);
  assert_non_null(samples);
  for (size_t i = 0; i < sound->frames * CHANNELS; i++) samples[i] = (float)sound->data[i] / 32768;
  return samples;
}

static ern_live_options options_of_sound(void) {
  ern_live_options options = ern_live_options_default();
  options.rate = RATE;
  options.channels = CHANNELS;
  return options;
}

static const ern_live_frame *pull(ern_live *live) {
  const ern_live_frame *frame;
  bool ended;
  support_ok(context, ern_live_pull(live, 0, &frame, &ended));
  return frame;
}

/* windows of frame n of a file's features, at num/den frames a second. */
static void windows_of_file(const ern_features *features, uint64_t n, int num, int den, ern_audio_pad pad, float *out) {
  static float second[WINDOW_VALUES];
  const uint64_t place = n * (uint64_t)den * 25;
  const float toward = (float)((double)(place % (uint64_t)num) / num);
  int64_t rows[500];
  for (int64_t i = 0; i < 500; i++) rows[i] = i;
  float *to[2] = {out, second};
  for (int k = 0; k < 2; k++) {
    const int64_t tick = (int64_t)(place / (uint64_t)num) + k;
    if (pad == ERN_AUDIO_PAD_ZERO)
      ern_audio_windows_of_rows(to[k], features, rows, features->windows, tick);
    else
      ern_audio_windows(to[k], features, tick, ERN_AUDIO_PAD_EDGE);
  }
  for (int i = 0; i < WINDOW_VALUES && toward > 0; i++) out[i] += toward * (second[i] - out[i]);
}

/* Pushes the sound in pieces of any size, pulls when it likes, and holds every frame against the file's. */
static void check_against_file(const ern_features *features, const float *samples, size_t frames, int num, int den,
                               ern_audio_pad pad, uint32_t seed) {
  ern_live_options options = options_of_sound();
  ern_live *live = NULL;
  static float expected[WINDOW_VALUES];
  options.rate_numerator = num;
  options.rate_denominator = den;
  options.pad = pad;
  options.capacity = 200;
  support_ok(context, ern_live_open(context, &options, &live));
  size_t pushed = 0, heard = 0, given = 0;
  for (uint32_t turn = 0;; turn++) {
    size_t piece = (size_t)(uniform(seed, turn) * 4000);
    if (piece > frames - pushed) piece = frames - pushed;
    if (pushed < frames) support_ok(context, ern_live_push(live, samples + pushed * CHANNELS, piece));
    pushed += piece;
    if (pushed == frames) support_ok(context, ern_live_end(live));
    if (pushed < frames && turn % 3 != 0) continue;
    for (const ern_live_frame *f = pull(live); f != NULL; f = pull(live)) {
      assert_int_equal(f->number, given);
      windows_of_file(features, given, num, den, pad, expected);
      assert_memory_equal(f->windows, expected, sizeof expected);
      assert_memory_equal(f->sound, samples + heard * CHANNELS, f->samples * CHANNELS * sizeof(float));
      heard += f->samples;
      given++;
      assert_int_equal(
          heard, given * (size_t)den * RATE / (size_t)num < frames ? given * (size_t)den * RATE / (size_t)num : frames);
    }
    if (pushed == frames) break;
  }
  assert_int_equal(heard, frames);
  const ern_live_frame *frame;
  bool ended;
  support_ok(context, ern_live_pull(live, 0, &frame, &ended));
  assert_true(ended && frame == NULL);
  ern_live_free(&live);
}

static void test_the_same_as_from_a_file(void **state) {
  (void)state;
  const size_t lengths[] = {(size_t)SECONDS * RATE + 1234, RATE / 2 + 1, 100};
  for (size_t i = 0; i < 3; i++) {
    ern_sound sound = babble(lengths[i], 7);
    ern_features features;
    support_ok(context, ern_sound_write_wav(context, i == 0 ? "long.wav" : i == 1 ? "half.wav" : "short.wav", &sound));
    support_ok(context, ern_speech_features(context,
                                            i == 0   ? "long.wav"
                                            : i == 1 ? "half.wav"
                                                     : "short.wav",
                                            1, &features));
    float *samples = as_floats(&sound);
    check_against_file(&features, samples, sound.frames, 25, 1, ERN_AUDIO_PAD_EDGE, 1);
    check_against_file(&features, samples, sound.frames, 25, 1, ERN_AUDIO_PAD_ZERO, 2);
    if (i == 0) check_against_file(&features, samples, sound.frames, 10, 1, ERN_AUDIO_PAD_EDGE, 3);
    free(samples);
    free(sound.data);
    ern_features_free(context, &features);
  }
}

/* With a small look-ahead a frame comes early, and what follows does not change it. */
static void test_look_ahead(void **state) {
  (void)state;
  ern_sound sound = babble(2 * RATE, 3);
  float *samples = as_floats(&sound);
  for (int ahead = ERN_LIVE_LEAST_LOOK_AHEAD; ahead <= ERN_LIVE_LOOK_AHEAD; ahead++) {
    ern_live_options options = options_of_sound();
    ern_live *one = NULL, *other = NULL;
    options.look_ahead = ahead;
    support_ok(context, ern_live_open(context, &options, &one));
    support_ok(context, ern_live_open(context, &options, &other));
    support_ok(context, ern_live_push(other, samples, (size_t)sound.frames)); /* all at once */
    for (int t = 0; t < 30; t++) {
      const size_t needed = (size_t)(t + ahead + 1) * RATE / 25, before = (size_t)(t + ahead) * RATE / 25;
      if (t == 0) support_ok(context, ern_live_push(one, samples, before));
      support_ok(context, ern_live_push(one, samples + before * CHANNELS, needed - before - 1));
      assert_null(pull(one));
      support_ok(context, ern_live_push(one, samples + (needed - 1) * CHANNELS, 1));
      const ern_live_frame *early = pull(one), *late = pull(other);
      assert_non_null(early);
      assert_memory_equal(early->windows, late->windows, WINDOW_VALUES * sizeof(float));
    }
    ern_live_free(&one);
    ern_live_free(&other);
  }
  free(samples);
  free(sound.data);
}

/* ---- inserted silence, pauses, cancelling --------------------------------------------------------------------------
 */

static void test_rest(void **state) {
  (void)state;
  float code[32], sound[RATE / 5 * CHANNELS];
  for (int i = 0; i < 32; i++) code[i] = (float)i;
  for (size_t i = 0; i < RATE / 5 * CHANNELS; i++) sound[i] = 0.1f * (float)(uniform(5, i) - 0.5);
  ern_live_options options = options_of_sound();
  ern_live *live = NULL;
  options.silence_code = code;
  support_ok(context, ern_live_open(context, &options, &live));
  for (int i = 0; i < 20; i++) support_ok(context, ern_live_insert_silence(live));
  support_ok(context, ern_live_push(live, sound, RATE / 5)); /* five ticks */
  support_ok(context, ern_live_flush(live));
  for (int i = 0; i < 12; i++) support_ok(context, ern_live_insert_silence(live));
  float last = 1;
  bool seen_speech = false, silent_again = false;
  size_t given = 0;
  for (const ern_live_frame *f = pull(live); f != NULL; f = pull(live), given++) {
    assert_int_equal(f->number, given);
    assert_memory_equal(f->silence_code, code, sizeof code);
    assert_true(f->silence_weight - last <= 0.2001f && last - f->silence_weight <= 0.3334f); /* no jump */
    if (given >= 20 && given < 25) assert_true(f->silence_weight < 1e-6f && !f->inserted_silence);
    if (given < 16) assert_true(f->silence_weight >= 1 && f->inserted_silence);
    seen_speech |= !f->inserted_silence;
    silent_again |= seen_speech && f->silence_weight >= 1;
    last = f->silence_weight;
  }
  assert_true(given >= 25 && silent_again);
  ern_live_free(&live);
}

/* A picture that must go on: a frame at each pull, whatever comes; sound that comes late by less than the look-ahead
 * leaves no gap in the sound, and what is said after inserted silence is heard whole. */
static void test_goes_on(void **state) {
  (void)state;
  enum { TICK = RATE / 25, SPOKEN = 20 };
  ern_live_options options = options_of_sound();
  ern_live *live = NULL;
  float sound[TICK * SPOKEN * CHANNELS];
  for (size_t i = 0; i < TICK * SPOKEN * CHANNELS; i++) sound[i] = 0.5f + 0.4f * (float)uniform(5, i);
  options.insert_silence = true;
  support_ok(context, ern_live_open(context, &options, &live));
  size_t pushed = 0, heard = 0;
  bool gap = false;
  for (uint64_t t = 0; t < 60; t++) {
    const ern_live_frame *f = pull(live);
    assert_non_null(f);
    assert_int_equal(f->number, t);
    for (size_t i = 0; i < f->samples * CHANNELS; i++) {
      if (f->sound[i] == 0) gap |= heard > 0 && heard < TICK * SPOKEN * CHANNELS;
      if (f->sound[i] != 0) assert_true(f->sound[i] == sound[heard++]);
    }
    const size_t late = t % 7 == 3 ? 0 : t % 7 == 4 ? 2 : 1; /* ticks that come now */
    if (t >= 10 && pushed + late <= SPOKEN) {
      support_ok(context, ern_live_push(live, sound + pushed * TICK * CHANNELS, late * TICK));
      pushed += late;
    }
  }
  assert_int_equal(heard, TICK * SPOKEN * CHANNELS);
  assert_false(gap);
  ern_live_free(&live);
}

/* Where the loudest row of the windows lies, as a tick; -1 where none stands out. */
static int tick_of_burst(ern_live *live, float threshold) {
  for (const ern_live_frame *f = pull(live); f != NULL; f = pull(live))
    for (size_t i = 0; i < f->samples * CHANNELS; i++)
      if (fabsf(f->sound[i]) > threshold) {
        /* the row of its own sound in the window of its tick: coefficient 0 is the level */
        const float *own = f->windows + 4 * WINDOW * WIDTH, *before = own + 4 * WIDTH, *now = own + 9 * WIDTH;
        assert_true(now[0] > before[0] + 0.5f);
        return (int)f->number;
      }
  return -1;
}

/* What follows a cancel is heard when it is seen: sound and features stay on one clock. */
static void test_cancel(void **state) {
  (void)state;
  enum { QUIET = RATE, BURST = RATE / 5 };
  ern_sound sound = babble(2 * RATE, 3);
  float *samples = as_floats(&sound), *next = calloc((QUIET + BURST) * CHANNELS, sizeof *next);
  assert_non_null(next);
  for (size_t i = 0; i < (QUIET + BURST) * CHANNELS; i++)
    next[i] = (float)(i < QUIET * CHANNELS ? 1e-4 : 0.8) * (float)(2 * uniform(9, i) - 1);
  for (int cancels = 1; cancels <= 2; cancels++) {
    ern_live_options options = options_of_sound();
    ern_live *live = NULL;
    options.capacity = 200;
    support_ok(context, ern_live_open(context, &options, &live));
    uint64_t number = 0;
    for (int turn = 0; turn < cancels; turn++) {
      support_ok(context, ern_live_push(live, samples, RATE + 333));
      for (int i = 0; i < 9; i++) {
        const ern_live_frame *f = pull(live);
        assert_non_null(f);
        assert_int_equal(f->number, number++);
      }
      support_ok(context, ern_live_cancel(live));
      support_ok(context, ern_live_cancel(live)); /* nothing is left to forget */
    }
    assert_null(pull(live));
    support_ok(context, ern_live_push(live, next, QUIET + BURST));
    support_ok(context, ern_live_end(live));
    assert_int_equal(tick_of_burst(live, 0.5f), (int)number + 1 + 25);
    ern_live_free(&live);
  }
  free(next);
  free(samples);
  free(sound.data);
}

/* ---- slow sides -------------------------------------------------------------------------------------------------- */

struct producer {
  ern_live *live;
  const float *samples;
  size_t frames;
  ern_status status;
};

static void *produce(void *user) {
  struct producer *p = user;
  p->status = ern_live_push(p->live, p->samples, p->frames);
  if (p->status == ERN_OK) p->status = ern_live_end(p->live);
  return NULL;
}

static void test_policies(void **state) {
  (void)state;
  ern_sound sound = babble(4 * RATE, 3);
  float *samples = as_floats(&sound);
  for (int policy = ERN_LIVE_WAIT; policy <= ERN_LIVE_REPEAT; policy++) {
    ern_live_options options = options_of_sound();
    ern_live *live = NULL;
    options.capacity = 40;
    options.policy = policy;
    support_ok(context, ern_live_open(context, &options, &live));
    struct producer producer = {live, samples, sound.frames, ERN_E_STATE};
    pthread_t thread;
    assert_int_equal(pthread_create(&thread, NULL, produce, &producer), 0);
    if (policy == ERN_LIVE_DROP) assert_int_equal(pthread_join(thread, NULL), 0); /* it waits for nobody */
    size_t given = 0, repeats = 0, heard = 0;
    uint64_t dropped = 0;
    for (bool ended = false; !ended;) {
      const ern_live_frame *f;
      support_ok(context, ern_live_pull(live, 5, &f, &ended));
      if (f == NULL) continue;
      given++;
      repeats += f->repeat;
      heard += f->samples;
      dropped = f->dropped;
      assert_true(f->waiting <= 40 * 0.041);
      if (given == 1) nap(100); /* the sound fills the room */
    }
    if (policy != ERN_LIVE_DROP) assert_int_equal(pthread_join(thread, NULL), 0);
    assert_int_equal(producer.status, ERN_OK);
    assert_int_equal(given + dropped, 100);
    assert_int_equal(dropped > 0, policy == ERN_LIVE_DROP);
    assert_int_equal(repeats > 0, policy == ERN_LIVE_REPEAT);
    if (policy != ERN_LIVE_DROP) assert_int_equal(heard, sound.frames);
    ern_live_free(&live);
  }
  free(samples);
  free(sound.data);
}

/* A push that waits is ended by a cancel, from another thread. */
static void test_cancel_ends_a_wait(void **state) {
  (void)state;
  ern_sound sound = babble(4 * RATE, 3);
  float *samples = as_floats(&sound);
  ern_live_options options = options_of_sound();
  ern_live *live = NULL;
  options.capacity = 20;
  support_ok(context, ern_live_open(context, &options, &live));
  struct producer producer = {live, samples, sound.frames, ERN_OK};
  pthread_t thread;
  assert_int_equal(pthread_create(&thread, NULL, produce, &producer), 0);
  const ern_live_frame *f;
  bool ended;
  support_ok(context, ern_live_pull(live, 5, &f, &ended));
  nap(50);
  support_ok(context, ern_live_cancel(live));
  assert_int_equal(pthread_join(thread, NULL), 0);
  assert_int_equal(producer.status, ERN_E_CANCELLED);
  support_ok(context, ern_live_push(live, samples, RATE / 2)); /* it goes on */
  assert_non_null(pull(live));
  ern_live_free(&live);
  free(samples);
  free(sound.data);
}

static void test_windows(void **state) {
  (void)state;
  enum { LENGTH = 2, WIDE = 5, COUNT = 30 };
  float windows[COUNT * LENGTH * WIDE], expected[8 * LENGTH * WIDE];
  for (int i = 0; i < COUNT * LENGTH * WIDE; i++) windows[i] = (float)i;
  const ern_features features = {.data = windows, .windows = COUNT, .window_length = LENGTH, .width = WIDE};
  ern_live_options options = ern_live_options_default();
  ern_live *live = NULL;
  options.window_length = LENGTH;
  options.width = WIDE;
  support_ok(context, ern_live_open(context, &options, &live));
  support_expect(context, ern_live_push(live, windows, 1), ERN_E_STATE, "expected windows", NULL);
  support_ok(context, ern_live_push_windows(live, windows, 3));
  assert_null(pull(live));
  support_ok(context, ern_live_push_windows(live, windows + 3 * LENGTH * WIDE, COUNT - 3));
  support_ok(context, ern_live_end(live));
  int given = 0;
  for (const ern_live_frame *f = pull(live); f != NULL; f = pull(live), given++) {
    ern_audio_windows(expected, &features, given, ERN_AUDIO_PAD_EDGE);
    assert_memory_equal(f->windows, expected, sizeof expected);
    assert_true(f->sound == NULL && f->samples == 0);
  }
  assert_int_equal(given, COUNT);
  ern_live_free(&live);
}

/* Windows that nobody pulls: dropped without an end, or no more than the capacity. */
static void test_windows_that_wait(void **state) {
  (void)state;
  enum { LENGTH = 2, WIDE = 3 };
  float window[LENGTH * WIDE] = {0};
  ern_live_options options = ern_live_options_default();
  ern_live *live = NULL;
  options.window_length = LENGTH;
  options.width = WIDE;
  options.policy = ERN_LIVE_DROP;
  support_ok(context, ern_live_open(context, &options, &live));
  for (int k = 0; k < 500; k++) support_ok(context, ern_live_push_windows(live, window, 1));
  ern_live_free(&live);
  options.policy = ERN_LIVE_WAIT;
  support_ok(context, ern_live_open(context, &options, &live));
  for (int k = 0; k < options.capacity; k++) support_ok(context, ern_live_push_windows(live, window, 1));
  support_expect(context, ern_live_insert_silence(live), ERN_E_STATE, "no room", NULL);
  ern_live_free(&live);
}

/* A flush makes room for the look-ahead of the last frame that has sound, however long a frame is. */
static void test_flush_at_each_rate(void **state) {
  (void)state;
  static const int rates[][2] = {{1, 1}, {2, 1}, {7, 3}, {6, 1}, {24, 1}, {25, 1}, {60, 1}, {100, 1}};
  float sound[RATE * CHANNELS] = {0};
  for (size_t i = 0; i < sizeof rates / sizeof *rates; i++)
    for (int ahead = ERN_LIVE_LEAST_LOOK_AHEAD; ahead <= ERN_LIVE_LOOK_AHEAD; ahead += 5) {
      ern_live_options options = options_of_sound();
      ern_live *live = NULL;
      options.rate_numerator = rates[i][0];
      options.rate_denominator = rates[i][1];
      options.look_ahead = ahead;
      support_ok(context, ern_live_open(context, &options, &live));
      support_ok(context, ern_live_push(live, sound, RATE / 9));
      support_ok(context, ern_live_flush(live));
      size_t samples = 0;
      for (const ern_live_frame *f = pull(live); f != NULL; f = pull(live)) samples += f->samples;
      if (samples < RATE / 9) fail_msg("%d/%d frames a second: %zu samples came", rates[i][0], rates[i][1], samples);
      ern_live_free(&live);
    }
}

/* A model of other features than the session's 13: refused, as its windows are longer. */
static void test_model_of_other_features(void **state) {
  (void)state;
  enum { SIDE = 8 };
  const struct ern_model_config config = {
      .levels = 2, .feature_width = 29, .window_length = WINDOW, .head = true, .bound = 1};
  ern_model *model = NULL;
  ern_backend *backend = NULL;
  ern_renderer *renderer = NULL;
  ern_live *live = NULL;
  uint8_t rgba[SIDE * SIDE * 4];
  const ern_frame_input input = {.camera = {.pose = {[0] = 1, [5] = 1, [10] = 1, [15] = 1},
                                            .focal = SIDE,
                                            .cx = SIDE / 2,
                                            .cy = SIDE / 2,
                                            .width = SIDE,
                                            .height = SIDE}};
  const ern_frame_output output = {.rgba = rgba};
  support_ok(context, ern_model_make(&model, context, &config));
  support_ok(context, ern_backend_create(&backend, context, NULL));
  support_ok(context, ern_renderer_create(&renderer, backend, model, NULL));
  support_ok(context, ern_live_open(context, NULL, &live));
  support_ok(context, ern_live_flush(live));
  for (int i = 0; i < 9; i++) support_ok(context, ern_live_insert_silence(live));
  const ern_live_frame *f = pull(live);
  assert_non_null(f);
  support_expect(context, ern_live_draw(f, renderer, &input, &output, NULL), ERN_E_MISMATCH, "live", "13 wide",
                 "expected 29", NULL);
  support_expect(context, ern_live_draw_sized(f, renderer, NULL, 0, &output, sizeof output, NULL, 0), ERN_E_ARGUMENT,
                 "input is NULL", NULL);
  support_expect(context, ern_live_draw_sized(f, renderer, &input, sizeof input + 8, &output, sizeof output, NULL, 0),
                 ERN_E_UNSUPPORTED, "a later version", NULL);
  ern_live_free(&live);
  ern_renderer_free(&renderer);
  ern_model_free(&model);
  ern_backend_free(&backend);
}

static void test_hostile_sound(void **state) {
  (void)state;
  ern_live_options options = options_of_sound();
  ern_live *live = NULL;
  float samples[100 * CHANNELS] = {0};
  support_ok(context, ern_live_open(context, &options, &live));
  samples[51] = NAN;
  support_expect(context, ern_live_push(live, samples, 100), ERN_E_NONFINITE, "sample 25", "nan", NULL);
  samples[51] = 2e6f;
  support_expect(context, ern_live_push(live, samples, 100), ERN_E_FORMAT, "sample 25", NULL);
  samples[51] = 0;
  support_ok(context, ern_live_push(live, samples, 100));
  support_ok(context, ern_live_end(live));
  support_expect(context, ern_live_push(live, samples, 1), ERN_E_STATE, "has ended", NULL);
  support_expect(context, ern_live_push(live, NULL, 0), ERN_E_STATE, "has ended", NULL);
  support_expect(context, ern_live_insert_silence(live), ERN_E_STATE, "has ended", NULL);
  support_expect(context, ern_live_flush(live), ERN_E_STATE, "has ended", NULL);
  const ern_live_frame *f = pull(live); /* the refused calls left nothing behind */
  assert_non_null(f);
  assert_int_equal(f->samples, 100);
  assert_null(pull(live));
  ern_live_free(&live);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_the_same_as_from_a_file),
                                     cmocka_unit_test(test_look_ahead),
                                     cmocka_unit_test(test_rest),
                                     cmocka_unit_test(test_goes_on),
                                     cmocka_unit_test(test_cancel),
                                     cmocka_unit_test(test_policies),
                                     cmocka_unit_test(test_cancel_ends_a_wait),
                                     cmocka_unit_test(test_windows),
                                     cmocka_unit_test(test_windows_that_wait),
                                     cmocka_unit_test(test_flush_at_each_rate),
                                     cmocka_unit_test(test_model_of_other_features),
                                     cmocka_unit_test(test_hostile_sound)};
  return cmocka_run_group_tests(tests, set_up, tear_down);
}
