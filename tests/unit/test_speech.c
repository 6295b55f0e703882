/* SPDX-License-Identifier: MIT
 * Speech features from sound: against a plain computation, for any cut, rate, form and loudness, and from bad sound. */
#include "../support.h"

#include <math.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/memory.h"
#include "ernerf/media.h"
#include "ernerf/speech.h"
#include "ernerf/stream.h"
#include "media/speech_network.h"

enum { WIDTH = ERN_SPEECH_WIDTH, HOP = 320, FRAME = 400, MOST_ROWS = 1000 };
static const double pi = 3.14159265358979323846;

/* Something like speech: a pitch that glides, two formants that move, syllables with pauses. t: seconds. */
static double voice(double t) {
  const double syllable = fmax(0, sin(2 * pi * 2.3 * t)) * (fmod(t, 1.9) < 1.5), glide = 120 * t + 8 * sin(3 * t);
  double sum = 0;
  for (int k = 1; k <= 24; k++) {
    const double f = 120.0 * k, first = 450 + 250 * sin(5 * t), second = 1500 + 500 * cos(4 * t);
    const double weight = exp(-pow((f - first) / 150, 2)) + 0.5 * exp(-pow((f - second) / 200, 2)) + 0.01;
    sum += weight * sin(2 * pi * k * glide);
  }
  return 0.15 * syllable * sum;
}

static size_t rows_of(ern_context *context, const float *samples, size_t frames, int rate, int channels, size_t step,
                      float *rows) {
  ern_speech_stream *stream = NULL;
  size_t count = 0;
  support_ok(context, ern_speech_stream_open(context, rate, channels, 1, &stream));
  for (size_t at = 0; at < frames;) {
    const size_t part = step == 0 ? 1 + (at * 7919) % 997 : step, now = part < frames - at ? part : frames - at;
    support_ok(context, ern_speech_stream_push(stream, samples + at * (size_t)channels, now));
    at += now;
    count += ern_speech_stream_pull(stream, rows + count * WIDTH, MOST_ROWS - count);
  }
  support_ok(context, ern_speech_stream_end(stream));
  count += ern_speech_stream_pull(stream, rows + count * WIDTH, MOST_ROWS - count);
  ern_speech_stream_free(&stream);
  return count;
}

static float *make_voice(int rate, double seconds, int channels, double gain, size_t *frames) {
  *frames = (size_t)(seconds * rate);
  float *samples = calloc(*frames * (size_t)channels, sizeof *samples);
  assert_non_null(samples);
  for (size_t i = 0; i < *frames; i++)
    for (int c = 0; c < channels; c++)
      samples[i * (size_t)channels + (size_t)c] = (float)(gain * voice((double)i / rate));
  return samples;
}

/* ---- the plain computation, in double and by the sum of a Fourier transform ---------------------------------------
 */

static double hertz(double mel) { return 700 * (pow(10, mel / 2595) - 1); }

static void plain_bands(const double frame[FRAME], double level, double log_band[40]) {
  double power[257], edge[42];
  for (int k = 0; k < 257; k++) {
    double re = 0, im = 0;
    for (int i = 0; i < FRAME; i++) {
      const double x = frame[i] * (0.5 - 0.5 * cos(2 * pi * i / FRAME));
      re += x * cos(2 * pi * k * i / 512);
      im -= x * sin(2 * pi * k * i / 512);
    }
    power[k] = (re * re + im * im) / (0.375 * FRAME) / level;
  }
  const double low = 2595 * log10(1 + 60 / 700.0), high = 2595 * log10(1 + 7600 / 700.0);
  for (int i = 0; i < 42; i++) edge[i] = hertz(low + (high - low) * i / 41);
  for (int b = 0; b < 40; b++) {
    double sum = 0, weights = 0;
    for (int k = 0; k < 257; k++) {
      const double f = k * 31.25;
      const double w =
          fmax(0, fmin((f - edge[b]) / (edge[b + 1] - edge[b]), (edge[b + 2] - f) / (edge[b + 2] - edge[b + 1])));
      sum += w * power[k];
      weights += w;
    }
    log_band[b] = log(sum / weights + 1e-3);
  }
}

/* Constants of docs/speech.md. */
static void plain_row(const double log_band[40], double row[WIDTH]) {
  static const double mean[WIDTH] = {-42.9, 7.71,  2.48,  2.73, -0.89, -0.84, -0.64,
                                     -1.43, -0.54, -0.21, 0.1,  -0.32, -0.42},
                      deviation[WIDTH] = {11.8, 6.04, 2.92, 4.11, 3.39, 2.74, 2.88, 2.27, 1.88, 1.86, 1.58, 1.81, 1.65};
  for (int q = 0; q < WIDTH; q++) {
    double sum = 0;
    for (int b = 0; b < 40; b++) sum += sqrt(2 / 40.0) * cos(pi * q * (b + 0.5) / 40) * log_band[b];
    row[q] = (sum - mean[q]) / deviation[q];
  }
}

/* Single precision of sums of 400 terms, through a logarithm whose argument is at least 1e-3: 1e-4 is ten times what
 * was seen. */
static void test_plain(void **state) {
  (void)state;
  ern_context *context = support_context();
  size_t frames = 0;
  static float rows[MOST_ROWS * WIDTH];
  float *samples = make_voice(16000, 2, 1, 1, &frames);
  const size_t count = rows_of(context, samples, frames, 16000, 1, 1000, rows);
  assert_int_equal(count, 100);
  double level = 1e-5;
  for (size_t r = 0; r < 60; r++) {
    double frame[FRAME], middle = 0, power = 0, log_band[40], expected[WIDTH];
    for (int i = 0; i < FRAME; i++) {
      const long at = (long)(r * HOP) - 40 + i;
      frame[i] = at >= 0 ? (double)samples[at] : 0;
      middle += frame[i] / FRAME;
    }
    for (int i = 0; i < FRAME; i++) frame[i] -= middle, power += frame[i] * frame[i] / FRAME;
    if (power > 1e-3 * level) level *= exp(-0.02 / 10);
    level = fmax(fmax(level, power), 1e-5);
    plain_bands(frame, level, log_band);
    plain_row(log_band, expected);
    for (int q = 0; q < WIDTH; q++)
      if (!(fabs(expected[q] - (double)rows[r * WIDTH + (size_t)q]) < 1e-4))
        fail_msg("row %zu, value %d: %g, expected %g", r, q, (double)rows[r * WIDTH + (size_t)q], expected[q]);
  }
  free(samples);
  ern_context_free(&context);
}

/* ---- how the sound comes ----------------------------------------------------------------------------------------- */

static void test_any_cut(void **state) {
  (void)state;
  ern_context *context = support_context();
  static float whole[MOST_ROWS * WIDTH], cut[MOST_ROWS * WIDTH];
  const int rates[] = {8000, 16000, 22050, 44100};
  for (size_t k = 0; k < 4; k++) {
    size_t frames = 0;
    float *samples = make_voice(rates[k], 3.217, 1, 1, &frames);
    const size_t count = rows_of(context, samples, frames, rates[k], 1, frames, whole);
    assert_int_equal(count, 161);
    for (size_t step = 0; step < 3; step++) {
      assert_int_equal(rows_of(context, samples, frames, rates[k], 1, step == 2 ? 4801 : step, cut), count);
      assert_memory_equal(whole, cut, count * WIDTH * sizeof *cut);
    }
    free(samples);
  }
  ern_context_free(&context);
}

static double distance(const float *a, const float *b, size_t count) {
  double sum = 0;
  for (size_t i = 0; i < count; i++) sum += pow((double)(a[i] - b[i]), 2);
  return sqrt(sum / (double)count);
}

/* The root of the mean square of the differences, of values about 1: resampling filters end near 8 kHz, where the
 * highest band is; 8 kHz sound lacks the bands above 4 kHz; the quiet one is over the least level. */
static void test_any_form_long(void **state) {
  (void)state;
  ern_context *context = support_context();
  static const struct {
    int rate, channels;
    double gain, tolerance;
    bool quantised; /* to 16 bits */
  } forms[] = {{48000, 1, 1, 0, false},    {48000, 2, 1, 1e-6, false},   {16000, 1, 1, 0.02, false},
               {22050, 1, 1, 0.02, false}, {44100, 1, 1, 0.02, false},   {96000, 1, 1, 0.02, false},
               {48000, 1, 3, 1e-3, false}, {48000, 1, 0.2, 1e-3, false}, {48000, 1, 1, 0.02, true},
               {8000, 1, 1, 0.5, false},   {11025, 1, 1, 0.5, false}};
  static float first[MOST_ROWS * WIDTH], rows[MOST_ROWS * WIDTH];
  for (size_t k = 0; k < sizeof forms / sizeof *forms; k++) {
    size_t frames = 0;
    float *samples = make_voice(forms[k].rate, 4, forms[k].channels, forms[k].gain, &frames);
    for (size_t i = 0; forms[k].quantised && i < frames; i++) samples[i] = rintf(samples[i] * 32768) / 32768;
    const size_t count =
        rows_of(context, samples, frames, forms[k].rate, forms[k].channels, 4096, k == 0 ? first : rows);
    assert_int_equal(count, 200);
    const double away = k == 0 ? 0 : distance(first, rows, count * WIDTH);
    if (!(away <= forms[k].tolerance))
      fail_msg("%d Hz, %d channels, gain %g: off by %g", forms[k].rate, forms[k].channels, forms[k].gain, away);
    free(samples);
  }
  ern_context_free(&context);
}

/* Speech in the centre of 5.1 is that speech, also where it is quiet: nothing is divided by the number of channels. */
static void test_centre(void **state) {
  (void)state;
  enum { RATE = 16000, CHANNELS = 6, CENTRE = 2 };
  ern_context *context = support_context();
  size_t frames = 0;
  static float rows[2][200 * WIDTH];
  float *alone = make_voice(RATE, 1, 1, 0.02, &frames), *all = calloc(frames * CHANNELS, sizeof *all);
  for (size_t i = 0; i < frames; i++) all[CHANNELS * i + CENTRE] = alone[i];
  const size_t count = rows_of(context, alone, frames, RATE, 1, 4096, rows[0]);
  assert_int_equal(rows_of(context, all, frames, RATE, CHANNELS, 4096, rows[1]), count);
  assert_memory_equal(rows[0], rows[1], count * WIDTH * sizeof(float));
  free(alone), free(all);
  ern_context_free(&context);
}

/* ---- bad sound ----------------------------------------------------------------------------------------------- */

/* right = -left: the mean is silence, so the features are those of a channel, in every reader of sound, and a warning
 * says so. Half of the mean's energy lost is no reason: a channel that is silent. */
static void test_cancelled(void **state) {
  (void)state;
  enum { RATE = 16000 };
  char said[SUPPORT_LINES] = "";
  ern_context_config config = ern_context_config_default();
  config.log = support_keep_warnings;
  config.user = said;
  ern_context *context = NULL;
  support_ok(context, ern_context_create(&context, &config));
  size_t frames = 0, count = 0;
  float *left = make_voice(RATE, 1, 1, 0.5, &frames), *both = make_voice(RATE, 1, 2, 0.5, &frames), *wave = NULL;
  static float rows[2][200 * WIDTH];
  for (size_t i = 0; i < frames; i++) both[2 * i + 1] = -both[2 * i];
  const size_t expected = rows_of(context, left, frames, RATE, 1, 4096, rows[0]);
  assert_int_equal(rows_of(context, both, frames, RATE, 2, 77, rows[1]), expected);
  assert_memory_equal(rows[0], rows[1], expected * WIDTH * sizeof(float));
  assert_non_null(strstr(said, "cancel each other"));
  ern_sound sound = {.rate = RATE, .channels = 2, .frames = frames, .data = calloc(2 * frames, sizeof *sound.data)};
  for (int silent = 0; silent < 2; silent++) {
    for (size_t i = 0; i < 2 * frames; i++)
      sound.data[i] = (int16_t)lrintf(both[i] * (silent == 1 && i % 2 == 1 ? 0 : 32767));
    said[0] = 0;
    remove("two.wav");
    support_ok(context, ern_sound_write_wav(context, "two.wav", &sound));
    support_ok(context, ern_speech_wave(context, "two.wav", RATE, &wave, &count));
    assert_true(count == frames);
    for (size_t i = 0; i < frames; i++) assert_true(fabsf(wave[i] - left[i] / (float)(1 + silent)) < 1e-4f);
    assert_int_equal(strstr(said, "two.wav: the channels of the sound cancel") != NULL, silent == 0);
    ern_release(context, wave);
    said[0] = 0;
    ern_sound_reader *reader = NULL;
    ern_sound_reader_options options = ern_sound_reader_options_default();
    options.rate = RATE;
    float part[512];
    size_t at = 0, got = 0;
    support_ok(context, ern_sound_reader_open(context, "two.wav", &options, &reader));
    do {
      support_ok(context, ern_sound_reader_read(reader, part, 512, &got));
      for (size_t i = 0; i < got; i++, at++) assert_true(fabsf(part[i] - left[at] / (float)(1 + silent)) < 1e-4f);
    } while (got > 0);
    assert_true(at == frames);
    assert_int_equal(strstr(said, "cancel") != NULL, silent == 0);
    ern_sound_reader_free(&reader);
  }
  free(sound.data);
  free(left);
  free(both);
  ern_context_free(&context);
}

static void test_refusals(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_speech_stream *stream = NULL;
  float samples[4] = {0.1f, NAN, 0, 0};
  support_expect(context, ern_speech_stream_open(context, 999, 1, 1, &stream), ERN_E_ARGUMENT, "999", "1000", NULL);
  support_expect(context, ern_speech_stream_open(context, 16000, 9, 1, &stream), ERN_E_ARGUMENT, "9 channels", NULL);
  support_expect(context, ern_speech_stream_open(context, 16000, 1, NAN, &stream), ERN_E_ARGUMENT, "warp", NULL);
  assert_null(stream);
  support_ok(context, ern_speech_stream_open(context, 16000, 1, 1, &stream));
  support_expect(context, ern_speech_stream_push(stream, samples, 4), ERN_E_NONFINITE, "nan", NULL);
  samples[0] = 1e7f;
  support_expect(context, ern_speech_stream_push(stream, samples, 1), ERN_E_FORMAT, "1e+07", NULL);
  support_ok(context, ern_speech_stream_end(stream));
  support_expect(context, ern_speech_stream_push(stream, samples + 2, 1), ERN_E_STATE, "has ended", NULL);
  ern_speech_stream_free(&stream);
  ern_context_free(&context);
}

static void *allocate_or_not(void *user, size_t bytes, size_t alignment) {
  const bool *refuse = user;
  return *refuse ? NULL : aligned_alloc(alignment, (bytes + alignment - 1) / alignment * alignment);
}

static void release(void *user, void *memory) {
  (void)user;
  free(memory);
}

/* An error stays one: what has left rows out does not end well when it is asked again. */
static void test_failed_stream(void **state) {
  (void)state;
  static float samples[16000];
  bool refuse = false;
  ern_context_config config = ern_context_config_default();
  ern_context *context = NULL;
  config.allocate = allocate_or_not;
  config.release = release;
  config.user = &refuse;
  assert_int_equal(ern_context_create(&context, &config), ERN_OK);
  for (int at_end = 0; at_end < 2; at_end++) {
    ern_speech_stream *stream = NULL;
    support_ok(context, ern_speech_stream_open(context, 16000, 1, 1, &stream));
    if (at_end == 1) support_ok(context, ern_speech_stream_push(stream, samples, 159));
    refuse = true;
    support_expect(context,
                   at_end == 1 ? ern_speech_stream_end(stream) : ern_speech_stream_push(stream, samples, 16000),
                   ERN_E_NO_MEMORY, NULL);
    refuse = false;
    support_expect(context, ern_speech_stream_end(stream), ERN_E_STATE, "an earlier call failed", "ERN_E_NO_MEMORY",
                   NULL);
    support_expect(context, ern_speech_stream_push(stream, samples, 1), ERN_E_STATE, "an earlier call failed", NULL);
    ern_speech_stream_free(&stream);
  }
  ern_context_free(&context);
}

/* ---- files ------------------------------------------------------------------------------------------------------- */

static void test_files(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_features features, again;
  ern_sound sound = {.rate = 44100, .channels = 2, .frames = 44100};
  sound.data = calloc(sound.frames * 2, sizeof *sound.data);
  assert_non_null(sound.data);
  for (size_t i = 0; i < sound.frames; i++)
    sound.data[2 * i] = sound.data[2 * i + 1] = (int16_t)(20000 * voice((double)i / 44100));
  support_ok(context, ern_sound_write_wav(context, "voice.wav", &sound));
  free(sound.data);
  support_ok(context, ern_speech_open(context, "voice.wav", NULL, &features));
  assert_true(features.windows == 25 && features.window_length == 16 && features.width == WIDTH);
  assert_string_equal(ern_speech_kind(&features), ""); /* of 13 numbers the width tells nothing */
  /* window t is rows 2t-8 .. 2t+7, the nearest beyond the ends */
  const size_t row = WIDTH * sizeof(float);
  for (size_t k = 0; k < 8; k++) assert_memory_equal(features.data, features.data + k * WIDTH, row);
  assert_memory_equal(features.data + (5 * 16 + 2) * WIDTH, features.data + 6 * 16 * WIDTH, 14 * row);
  support_ok(context, ern_speech_features(context, "voice.wav", 1.1f, &again)); /* another throat */
  assert_true(again.windows == 25 && distance(features.data, again.data, 25 * 16 * WIDTH) > 0.1);
  ern_features_free(context, &again);
  support_ok(context, ern_features_save(context, "voice.npy", &features));
  assert_true(ern_speech_is_sound("voice.wav") && !ern_speech_is_sound("voice.npy"));
  support_ok(context, ern_speech_open(context, "voice.npy", ERN_SPEECH_CEPSTRA, &again));
  assert_memory_equal(features.data, again.data, 25 * 16 * row);
  ern_features_free(context, &features);
  ern_features_free(context, &again);
  support_expect(context, ern_speech_open(context, "voice.wav", "hubert", &again), ERN_E_UNSUPPORTED, "voice.wav",
                 "hubert", "expected a .npy", NULL);
  support_expect(context, ern_speech_open(context, "voice.wav", "", &again), ERN_E_UNSUPPORTED, "voice.wav",
                 "an unknown kind", NULL);
  support_expect(context, ern_speech_open(context, "missing.wav", NULL, &again), ERN_E_MISSING, "missing.wav", NULL);
  assert_int_equal(mkfifo("pipe.wav", 0600), 0);
  (void)alarm(10); /* a pipe is not waited for */
  assert_true(ern_speech_is_sound("pipe.wav"));
  (void)alarm(0);
  support_write_text("text.wav", "no sound");
  support_expect(context, ern_speech_open(context, "text.wav", NULL, &again), ERN_E_FORMAT, "text.wav", NULL);
  support_write("empty.wav", "RIFF\44\0\0\0WAVEfmt \20\0\0\0\1\0\1\0\200>\0\0\0}\0\0\2\0\20\0data\0\0\0\0", 44);
  support_expect(context, ern_speech_open(context, "empty.wav", NULL, &again), ERN_E_SHAPE, "empty.wav", "0 samples",
                 NULL);
  assert_null(again.data);
  const ern_sound slow = {.rate = 999, .channels = 1, .frames = 2, .data = (int16_t[]){1, 2}};
  support_ok(context, ern_sound_write_wav(context, "slow.wav", &slow));
  support_expect(context, ern_speech_open(context, "slow.wav", NULL, &again), ERN_E_SHAPE, "slow.wav", "999",
                 "at least 1000", NULL);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_plain),         cmocka_unit_test(test_any_cut),
                                     cmocka_unit_test(test_any_form_long), cmocka_unit_test(test_centre),
                                     cmocka_unit_test(test_cancelled),     cmocka_unit_test(test_refusals),
                                     cmocka_unit_test(test_failed_stream), cmocka_unit_test(test_files)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
