/* SPDX-License-Identifier: MIT
 * How late a sound is against a mouth, and how much of it is speech. */
#include "ernerf/media.h"
#include "io/speech_share.h"
#include "prepare/clip_sound.h"
#include "prepare/jaw_weights.h"
#include "prepare_test.h"

enum { FRAMES = 300, WINDOW = 16 * 13 };

/* A jaw that opens and closes four times a second or so, never twice alike. */
static void make_jaw(double *jaw, size_t count, uint64_t seed) {
  double speed = 0, place = 0;
  for (size_t i = 0; i < count; i++) {
    speed = 0.7 * speed + made_random(&seed) - 0.5 * place;
    place += 0.6 * speed;
    jaw[i] = place;
  }
}

/* Cepstra whose jaw, as the map of `prepare` tells it, is jaw[t]. */
static ern_features heard(const double *jaw, size_t count) {
  static float data[FRAMES * WINDOW];
  for (size_t i = 0; i < count * WINDOW; i++)
    data[i] = (float)(10 * jaw[i / WINDOW] * (double)(&ern_jaw_weights[0][0])[i % WINDOW]);
  return (ern_features){.windows = count, .window_length = 16, .width = 13, .data = data};
}

static struct ern_sound_lag measure(const double *jaw, const float *opening, size_t count) {
  ern_context *context = support_context();
  struct ern_sound_lag lag;
  const ern_features cepstra = heard(jaw, count);
  support_ok(context, ern_sound_lag_measure(context, &cepstra, opening, count, &lag));
  ern_context_free(&context);
  return lag;
}

static void test_lag(void **state) {
  (void)state;
  enum { ROOM = 32 };
  double jaw[FRAMES + 2 * ROOM], other[FRAMES + 2 * ROOM];
  float opening[FRAMES];
  make_jaw(jaw, FRAMES + 2 * ROOM, 77);
  make_jaw(other, FRAMES + 2 * ROOM, 78);
  for (int late = -28; late <= 28; late += 4) {
    uint64_t noise = 5;
    /* the mouth also smiles for seconds, and the landmarks tremble */
    for (int i = 0; i < FRAMES; i++)
      opening[i] = (float)(0.1 + 0.02 * jaw[ROOM + late + i] + 0.05 * sin(i / 40.0) + 0.01 * made_random(&noise));
    const struct ern_sound_lag lag = measure(jaw + ROOM, opening, FRAMES);
    assert_true(lag.certain && fabs(lag.seconds - late / 25.0) < 0.01 && lag.correlation > 0.8);
  }
  for (int i = 0; i < FRAMES; i++) opening[i] = (float)jaw[ROOM + 20 + i];
  assert_true(measure(jaw + ROOM, opening, 200).certain);
  assert_false(measure(jaw + ROOM, opening, 150).certain); /* 6 s: a lag of 0.72 s at most */
  for (int i = 0; i < FRAMES; i++) opening[i] = (float)other[i];
  assert_false(measure(jaw, opening, FRAMES).certain); /* another's words */
  for (int i = 0; i < FRAMES; i++) opening[i] = (float)jaw[i];
  assert_false(measure(jaw, opening, 99).certain); /* too short */
  for (int i = 0; i < FRAMES; i++) opening[i] = 0.25f;
  const struct ern_sound_lag none = measure(jaw, opening, FRAMES); /* a shut mouth */
  assert_true(!none.certain && none.correlation == 0);
}

static void test_speech_share(void **state) {
  (void)state;
  static int16_t data[10 * ERN_PREPARE_SOUND_RATE];
  const size_t count = sizeof data / sizeof *data;
  const ern_sound sound = {.rate = ERN_PREPARE_SOUND_RATE, .channels = 1, .frames = count, .data = data};
  assert_true(ern_speech_share(&sound) == 0);
  uint64_t seed = 3;
  for (size_t i = 0; i < count; i++) data[i] = (int16_t)lrint(20 * made_random(&seed)); /* noise, and 1 s of speech */
  assert_true(ern_speech_share(&sound) == 0); /* hiss alone is no speech, however loud it is */
  for (size_t i = count / 2; i < count / 2 + ERN_PREPARE_SOUND_RATE; i++)
    data[i] = (int16_t)lrint(9000 * made_random(&seed));
  assert_true(fabs(ern_speech_share(&sound) - 0.1) < 0.01);
  data[1000] = 32767; /* a click is no speech */
  assert_true(fabs(ern_speech_share(&sound) - 0.1) < 0.01);
}

static void test_offset(void **state) {
  (void)state;
  ern_context *context = support_context();
  static const char *const wrong[] = {"", "x", "0,1", "2.01", "-3", "0.1 s", "nan"};
  double seconds = 7;
  bool automatic = false;
  support_ok(context, ern_sound_offset_read(context, NULL, &seconds, &automatic));
  assert_true(automatic && seconds == 0);
  support_ok(context, ern_sound_offset_read(context, "-0.12", &seconds, &automatic));
  assert_true(!automatic && seconds == -0.12);
  for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++)
    support_expect(context, ern_sound_offset_read(context, wrong[i], &seconds, &automatic), ERN_E_ARGUMENT,
                   "expected \"auto\"", NULL);
  ern_context_free(&context);
}

static void write_video(ern_context *context, const char *path, size_t frames, const ern_sound *sound) {
  static uint8_t rgba[64 * 64 * 4];
  ern_video_options shape = ern_video_options_default(64, 64);
  ern_video_writer *writer = NULL;
  shape.sound = sound;
  support_ok(context, ern_video_writer_open(context, path, &shape, &writer));
  for (size_t i = 0; i < frames; i++) support_ok(context, ern_video_writer_frame(writer, rgba));
  support_ok(context, ern_video_writer_close(&writer));
}

/* A video without sound has none to move, and its features are not said to stay behind. */
static void test_offset_without_sound(void **state) {
  (void)state;
  double jaw[8] = {0};
  ern_features features = heard(jaw, 8);
  struct made_job m;
  made_job_open(&m, "clip", 64, 8);
  support_ok(m.job.context, ern_features_save(m.job.context, "own.npy", &features));
  write_video(m.job.context, "mute.mp4", 8, NULL);
  m.job.video = "mute.mp4";
  m.options.features = "own.npy";
  m.options.sound_offset = "0.3";
  support_ok(m.job.context, ern_prepare_features(&m.job));
  assert_string_equal(m.verdict.words, "the video has no sound that --sound-offset could move");
  made_job_close(&m);
}

/* Landmarks of a face of 100 pixels, whose lips open and close by `gap` of its width. */
static void write_lips(size_t frames, double gap) {
  char path[64];
  for (size_t i = 0; i < frames; i++) {
    snprintf(path, sizeof path, "clip/ori_imgs/%zu.lms", i);
    FILE *file = fopen(path, "w");
    assert_non_null(file);
    for (int k = 0; k < 68; k++) {
      const double lower = k >= 65 ? 50 * gap * (1 + sin((double)i)) : 0;
      fprintf(file, "%d %.4f\n", k == 16 ? 100 : 0, lower);
    }
    assert_int_equal(fclose(file), 0);
  }
}

/* Lips that do not move are those of a person who does not speak, whatever is heard, and say nothing of a lag. */
static void test_still_lips(void **state) {
  (void)state;
  enum { COUNT = 120, RATE = 16000 };
  static int16_t samples[COUNT * RATE / 25];
  const ern_sound sound = {.rate = RATE, .channels = 1, .frames = sizeof samples / sizeof *samples, .data = samples};
  for (size_t i = 0; i < sound.frames; i++) samples[i] = (int16_t)(i / 3000 % 2 * (i % 160) * 100);
  for (int moves = 0; moves < 2; moves++) {
    struct made_job m;
    made_job_open(&m, "clip", 64, COUNT);
    assert_int_equal(mkdir("clip/ori_imgs", 0777), 0);
    write_lips(COUNT, moves ? 0.03 : 0.01);
    unlink("voice.mp4");
    write_video(m.job.context, "voice.mp4", COUNT, &sound);
    m.job.video = "voice.mp4";
    support_ok(m.job.context, ern_prepare_features(&m.job));
    if ((strstr(m.verdict.words, "the lips open by 1.0 % of the face's width") != NULL) != !moves)
      fail_msg("%s", m.verdict.words);
    made_job_close(&m);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_lag), cmocka_unit_test(test_speech_share),
                                     cmocka_unit_test(test_offset), cmocka_unit_test(test_offset_without_sound),
                                     cmocka_unit_test(test_still_lips)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
