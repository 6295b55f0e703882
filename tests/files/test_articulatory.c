/* SPDX-License-Identifier: MIT
 * The features "articulatory": row by row against the same network over all rows at once in double, for sound that is
 * cut anywhere, in silence, and as files. */
#include "../support.h"

#include <math.h>

#include "core/memory.h"
#include "ernerf/media.h"
#include "ernerf/speech.h"
#include "io/safetensors.h"
#include "media/speech/articulatory.h"

enum {
  BEFORE = 40,
  ROWS = 120 + BEFORE,
  BANDS = ERN_CEPSTRA_BANDS,
  CHANNELS = 40,
  OUTPUTS = ERN_ARTICULATORY_OUTPUTS,
  WIDTH = ERN_SPEECH_MOST_WIDTH,
  MOST = 3 * 40 * 40
};

extern const unsigned char ern_weights_text_articulatory[];
extern const size_t ern_weights_bytes_articulatory;

static float random_value(uint32_t *state) { /* -1 to 1 */
  *state = *state * 1664525u + 1013904223u;
  return (float)*state / 2147483648.0f - 1;
}

/* Loud and faint rows, steps from one row to the next, and rows without speech. */
static void make_bands(float band[ROWS][BANDS], bool audible[ROWS]) {
  uint32_t state = 5;
  for (size_t r = 0; r < ROWS; r++) {
    const float loudness = 4 * random_value(&state);
    audible[r] = r >= BEFORE && r % 17 < 12; /* rows of silence precede the sound */
    for (size_t b = 0; b < BANDS; b++)
      band[r][b] = audible[r] ? fmaxf(-6.9f, -3 + loudness + 3 * random_value(&state)) : logf(1e-3f);
  }
}

/* ---- the network over all rows ----------------------------------------------------------------------------------- */

typedef double signal[ROWS][CHANNELS];

/* values [taps][inputs][outputs] of the tensor `name`. */
static void read_weights(ern_context *context, const struct ern_tensor_file *file, const char *name,
                         float values[MOST]) {
  const struct ern_tensor *tensor = ern_tensor_file_find(file, name);
  assert_non_null(tensor);
  assert_true(tensor->count <= MOST);
  support_ok(context, ern_tensor_to_float(context, tensor, values));
}

/* to = bias + sum over taps of weight^T from[row - (taps - 1 - tap) dilation]; rows before the first are zeros. */
static void convolve(ern_context *context, const struct ern_tensor_file *file, const char *name, int taps, int dilation,
                     int outputs, signal from, signal to) {
  static float values[MOST], bias[MOST];
  char bias_name[40];
  snprintf(bias_name, sizeof bias_name, "%s_bias", name);
  read_weights(context, file, name, values);
  read_weights(context, file, bias_name, bias);
  for (int r = 0; r < ROWS; r++)
    for (int o = 0; o < outputs; o++) {
      to[r][o] = (double)bias[o];
      for (int t = 0; t < taps; t++) {
        const int before = r - (taps - 1 - t) * dilation;
        for (int i = 0; i < CHANNELS && before >= 0; i++)
          to[r][o] += (double)values[(t * CHANNELS + i) * outputs + o] * from[before][i];
      }
    }
}

static void rectify(signal value) {
  for (int r = 0; r < ROWS; r++)
    for (int i = 0; i < CHANNELS; i++) value[r][i] = fmax(value[r][i], 0);
}

static void compute(ern_context *context, float band[ROWS][BANDS], const bool audible[ROWS], signal out) {
  static const int dilations[6] = {1, 2, 4, 1, 2, 4};
  static signal input, hidden, inner;
  static float mean[MOST];
  struct ern_tensor_file file;
  uint8_t *bytes = NULL;
  char name[40];
  support_ok(context, ERN_NEW(context, ern_weights_bytes_articulatory, &bytes));
  memcpy(bytes, ern_weights_text_articulatory, ern_weights_bytes_articulatory);
  support_ok(context, ern_safetensors_open(context, "weights", bytes, ern_weights_bytes_articulatory, &file));
  read_weights(context, &file, "mean", mean);
  for (int b = 0; b < BANDS; b++) { /* the mean of 50 rows before and of the audible ones, of which each fades */
    double sum = 50 * (double)mean[b], weight = 50;
    for (int r = 0; r < ROWS; r++) {
      if (audible[r]) sum = sum * exp(-1 / 500.0) + (double)band[r][b], weight = weight * exp(-1 / 500.0) + 1;
      input[r][b] = (double)band[r][b] - sum / weight;
    }
  }
  convolve(context, &file, "input", 3, 1, CHANNELS, input, hidden);
  rectify(hidden);
  for (int k = 0; k < 6; k++) {
    snprintf(name, sizeof name, "block.%d.wide", k);
    convolve(context, &file, name, 3, dilations[k], CHANNELS, hidden, inner);
    rectify(inner);
    snprintf(name, sizeof name, "block.%d.narrow", k);
    convolve(context, &file, name, 1, 1, CHANNELS, inner, input);
    for (int r = 0; r < ROWS; r++)
      for (int i = 0; i < CHANNELS; i++) hidden[r][i] += input[r][i];
  }
  convolve(context, &file, "output", 1, 1, OUTPUTS, hidden, out);
  for (int r = 0; r < ROWS; r++)
    for (int o = 0; o < OUTPUTS; o++) out[r][o] = 1.5 * tanh(out[r][o]);
  ern_tensor_file_free(context, &file);
}

static void test_against_the_whole(void **state) {
  (void)state;
  static float band[ROWS][BANDS], row[OUTPUTS];
  static signal expected;
  bool audible[ROWS];
  double spread = 0;
  ern_context *context = support_context();
  struct ern_articulatory *articulatory = NULL;
  make_bands(band, audible);
  compute(context, band, audible, expected);
  support_ok(context, ern_articulatory_make(context, &articulatory));
  for (int r = BEFORE; r < ROWS; r++) {
    ern_articulatory_row(articulatory, band[r], audible[r], row);
    /* float sums of 120 products, six blocks deep, of values up to 10 */
    for (int o = 0; o < OUTPUTS; o++) assert_true(fabs((double)row[o] - expected[r][o]) <= 1e-3);
    for (int o = 0; o < OUTPUTS; o++) spread += fabs((double)row[o]) / (ROWS * OUTPUTS);
  }
  assert_true(spread > 0.2); /* it tells something */
  ern_articulatory_free(context, articulatory);
  ern_context_free(&context);
}

/* ---- sound ------------------------------------------------------------------------------------------------------- */

/* Something like speech: harmonics of 120 Hz under a formant that moves, in syllables. */
static void make_sound(float *samples, size_t count) {
  for (size_t i = 0; i < count; i++) {
    const double t = (double)i / 16000, formant = 700 + 400 * sin(7 * t);
    double sum = 0;
    for (int k = 1; k <= 24; k++) sum += exp(-pow((120 * k - formant) / 250, 2)) * sin(2 * 3.14159265 * 120 * k * t);
    samples[i] = (float)(0.1 * fmax(0, sin(14 * t)) * sum);
  }
}

static size_t rows_of(ern_context *context, const float *samples, size_t count, size_t step, float rows[][WIDTH]) {
  ern_speech_stream *stream = NULL;
  size_t made = 0;
  support_ok(context, ern_speech_stream_open_kind(context, ERN_SPEECH_ARTICULATORY, 16000, 1, 1, &stream));
  for (size_t at = 0; at < count; at += step) {
    support_ok(context, ern_speech_stream_push(stream, samples + at, count - at < step ? count - at : step));
    made += ern_speech_stream_pull(stream, rows[made], ROWS - made);
  }
  support_ok(context, ern_speech_stream_end(stream));
  made += ern_speech_stream_pull(stream, rows[made], ROWS - made);
  ern_speech_stream_free(&stream);
  return made;
}

static void test_sound_in_pieces(void **state) {
  (void)state;
  enum { SAMPLES = 32000 };
  static float samples[SAMPLES], one[ROWS][WIDTH], other[ROWS][WIDTH];
  ern_context *context = support_context();
  assert_int_equal(ern_speech_width(ERN_SPEECH_ARTICULATORY), WIDTH);
  make_sound(samples, SAMPLES);
  assert_int_equal(rows_of(context, samples, SAMPLES, SAMPLES, one), 100);
  assert_int_equal(rows_of(context, samples, SAMPLES, 777, other), 100);
  assert_memory_equal(one, other, 100 * sizeof *one);
  for (size_t i = 0; i < SAMPLES; i++) samples[i] *= 0.25f; /* as loud as the speaker is far away */
  assert_int_equal(rows_of(context, samples, SAMPLES, SAMPLES, other), 100);
  for (size_t r = 0; r < 100; r++)
    for (size_t o = 0; o < WIDTH; o++) assert_true(fabsf(one[r][o] - other[r][o]) < 0.05f);
  /* what comes later changes no row */
  for (size_t i = SAMPLES / 2; i < SAMPLES; i++) samples[i] = 0;
  assert_int_equal(rows_of(context, samples, SAMPLES, SAMPLES, one), 100);
  assert_memory_equal(one, other, 49 * sizeof *one);
  memset(samples, 0, sizeof samples);
  assert_int_equal(rows_of(context, samples, SAMPLES, SAMPLES, one), 100);
  for (size_t r = 1; r < 100; r++) assert_memory_equal(one[r], one[0], sizeof one[0]); /* silence tells nothing */
  ern_context_free(&context);
}

static void test_files(void **state) {
  (void)state;
  enum { SAMPLES = 16000 };
  static float samples[SAMPLES];
  static int16_t data[SAMPLES];
  ern_context *context = support_context();
  ern_features features, again;
  make_sound(samples, SAMPLES);
  for (size_t i = 0; i < SAMPLES; i++) data[i] = (int16_t)lrintf(samples[i] * 32767);
  const ern_sound sound = {.rate = 16000, .channels = 1, .frames = SAMPLES, .data = data};
  support_ok(context, ern_sound_write_wav(context, "voice.wav", &sound));
  support_ok(context, ern_speech_open(context, "voice.wav", ERN_SPEECH_ARTICULATORY, &features));
  assert_true(features.windows == 25 && features.window_length == 16 && features.width == WIDTH);
  support_ok(context, ern_speech_features_kind(context, "voice.wav", ERN_SPEECH_ARTICULATORY, 1, &again));
  assert_memory_equal(features.data, again.data, sizeof(float) * 25 * 16 * WIDTH);
  ern_features_free(context, &again);
  support_expect(context, ern_speech_features_kind(context, "voice.wav", "phonemes", 1, &again), ERN_E_ARGUMENT,
                 "kind is \"phonemes\"", ERN_SPEECH_ARTICULATORY, NULL);
  ern_features_free(context, &features);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_against_the_whole), cmocka_unit_test(test_sound_in_pieces),
                                     cmocka_unit_test(test_files)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
