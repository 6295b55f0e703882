/* SPDX-License-Identifier: MIT
 * Speech features by networks: small ones that are made here, against plain computations in double. */
#include "../made_onnx.h"

#include <math.h>
#include <unistd.h>

#include "ernerf/media.h"
#include "ernerf/speech.h"

enum { RATE = 16000, HOP = 320, SPAN = 400, WIDTH = 3, MOST_SAMPLES = 70000, MOST_ROWS = 300 };

static ern_context *context;
static float wave[MOST_SAMPLES];
static float weight[1024 * SPAN];

static float noise(size_t i, uint32_t seed) {
  uint32_t x = (uint32_t)i * 2654435761u + seed * 40503u;
  x = (x ^ x >> 15) * 2246822519u;
  x = (x ^ x >> 13) * 3266489917u;
  return (float)(x >> 8) / (1 << 23) - 1;
}

/* A sound of that many samples, and `wave` as it will be heard. It is not centred, so that a mean counts. */
static void make_sound(const char *path, size_t samples) {
  ern_sound sound = {.rate = RATE, .channels = 1, .frames = samples};
  int16_t *data = calloc(samples, sizeof *data);
  assert_non_null(data);
  for (size_t i = 0; i < samples; i++) {
    data[i] = (int16_t)(4000 * noise(i, 1) * (float)(1 + i % 5000) / 5000 + 900);
    wave[i] = (float)data[i] / 32768;
  }
  sound.data = data;
  support_ok(context, ern_sound_write_wav(context, path, &sound));
  free(data);
}

/* rows[r][q] = sum_k weight[q][k] x[r HOP + k] */
static void make_network(const char *path, size_t samples, size_t width) {
  struct made_message graph = {0};
  for (size_t i = 0; i < width * SPAN; i++) weight[i] = noise(i, 2) / 20;
  made_convolve(&graph, &(struct made_convolution){samples, HOP, SPAN, width, weight}, "rows");
  made_onnx(path, &graph);
}

static double plain_row(const double *x, size_t row, size_t q) {
  double sum = 0;
  for (size_t k = 0; k < SPAN; k++) sum += (double)weight[q * SPAN + k] * x[row * HOP + k];
  return sum;
}

/* (x - mean)/sqrt(variance + 1e-7) of x[count] */
static void normalise(double *x, size_t count) {
  double mean = 0, variance = 0;
  for (size_t i = 0; i < count; i++) mean += x[i] / (double)count;
  for (size_t i = 0; i < count; i++) variance += (x[i] - mean) * (x[i] - mean) / (double)count;
  for (size_t i = 0; i < count; i++) x[i] = (x[i] - mean) / sqrt(variance + 1e-7);
}

static char *description(const char *normalisation, int piece, int around, int width, int window) {
  static char text[512];
  snprintf(text, sizeof text,
           "{\"kind\":\"mine\",\"rate\":16000,\"normalisation\":\"%s\",\"piece_samples\":%d,\"context_samples\":%d,"
           "\"row_samples\":400,\"width\":%d,\"window_rows\":%d}",
           normalisation, piece, around, width, window);
  return text;
}

static ern_speech_network *open_network(const char *path, const char *text) {
  ern_speech_network *network = NULL;
  support_ok(context, ern_speech_network_open(context, path, text, &network));
  return network;
}

/* Row r out of windows; of 16 it is that of place r - 2t + 8 in each window t where that is 0..15. */
static const float *row_of(const ern_features *f, size_t r) {
  const size_t t = r / 2, place = f->window_length == 2 ? r % 2 : r % 2 + 8;
  assert_true(t < f->windows);
  return f->data + (t * (size_t)f->window_length + place) * (size_t)f->width;
}

static void expect_row(const ern_features *f, size_t r, const double *x, double tolerance) {
  for (size_t q = 0; q < (size_t)f->width; q++) {
    const double expected = plain_row(x, r, q), found = (double)row_of(f, r)[q];
    if (!(fabs(found - expected) < tolerance)) fail_msg("row %zu, value %zu: %g, expected %g", r, q, found, expected);
  }
}

/* Rounding of sums of 400 products, of the order of 1 in float. */
static const double tolerance = 1e-4;

/* ---- rows -------------------------------------------------------------------------------------------------------- */

/* Sounds that end before, at and behind the ends of pieces; a context does not change the rows of a convolution. */
static void test_rows(void **state) {
  (void)state;
  static const size_t lengths[] = {400, 719, 720, 8000, 8079, 8080, 8081, 16000, 24080, 24400, 30001};
  static const int around[] = {0, 640};
  static double x[MOST_SAMPLES];
  make_network("rows.onnx", 8080, WIDTH);
  for (size_t c = 0; c < 2; c++) {
    ern_speech_network *network = open_network("rows.onnx", description("none", 8080, around[c], WIDTH, 16));
    for (size_t l = 0; l < sizeof lengths / sizeof *lengths; l++) {
      ern_features features;
      make_sound("rows.wav", lengths[l]);
      for (size_t i = 0; i < lengths[l]; i++) x[i] = (double)wave[i];
      support_ok(context, ern_speech_network_features(network, "rows.wav", &features));
      const size_t rows = (lengths[l] - SPAN) / HOP + 1;
      assert_int_equal(features.windows, rows / 2 + 1);
      assert_true(features.window_length == 16 && features.width == WIDTH);
      for (size_t r = 0; r < rows; r++) expect_row(&features, r, x, tolerance);
      ern_features_free(context, &features);
    }
    ern_speech_network_free(&network);
  }
}

/* Window t is rows 2t-8 .. 2t+7, zeros past the ends. */
static void test_windows(void **state) {
  (void)state;
  ern_features features;
  make_network("windows.onnx", 8080, WIDTH);
  ern_speech_network *network = open_network("windows.onnx", description("none", 8080, 0, WIDTH, 16));
  make_sound("windows.wav", 400 + 320 * 20); /* 21 rows */
  support_ok(context, ern_speech_network_features(network, "windows.wav", &features));
  assert_int_equal(features.windows, 11);
  for (size_t t = 0; t < 11; t++)
    for (size_t k = 0; k < 16; k++) {
      const float *row = features.data + (t * 16 + k) * WIDTH;
      if (2 * t + k < 8 || 2 * t + k - 8 >= 21)
        for (size_t q = 0; q < WIDTH; q++) assert_true(row[q] == 0);
      else
        assert_memory_equal(row, row_of(&features, 2 * t + k - 8), WIDTH * sizeof *row);
    }
  ern_features_free(context, &features);
  ern_speech_network_free(&network);
}

/* The whole sound is normalised once; where its rows are odd the last one is left out of windows of two. */
static void test_normalised_sound(void **state) {
  (void)state;
  enum { SAMPLES = 20000, ROWS = (SAMPLES - SPAN) / HOP + 1 };
  static double x[SAMPLES];
  ern_features features;
  make_network("sound.onnx", 8080, WIDTH);
  make_sound("sound.wav", SAMPLES);
  for (size_t i = 0; i < SAMPLES; i++) x[i] = (double)wave[i];
  normalise(x, SAMPLES);
  ern_speech_network *network = open_network("sound.onnx", description("sound", 8080, 0, WIDTH, 2));
  support_ok(context, ern_speech_network_features(network, "sound.wav", &features));
  assert_true(features.window_length == 2 && ROWS == 62 && features.windows == 31);
  for (size_t r = 0; r < ROWS; r++) expect_row(&features, r, x, 10 * tolerance); /* values are 10 times as large */
  ern_features_free(context, &features);
  make_sound("sound.wav", SAMPLES - HOP);
  support_ok(context, ern_speech_network_features(network, "sound.wav", &features));
  assert_int_equal(features.windows, 30);
  ern_features_free(context, &features);
  ern_speech_network_free(&network);
}

/* Each piece is normalised: zeros before the sound count, those behind it do not and stay zero. A piece begins 21 rows
 * after the one before, (8080 - 2*640)/320, and 640 samples earlier; the last one so early that it ends with the
 * sound. */
static void test_normalised_pieces(void **state) {
  (void)state;
  enum { PIECE = 8080, AROUND = 640, SAMPLES = 20000 };
  static double x[PIECE];
  ern_features features;
  make_network("pieces.onnx", PIECE, WIDTH);
  ern_speech_network *network = open_network("pieces.onnx", description("piece", PIECE, AROUND, WIDTH, 16));
  make_sound("pieces.wav", 3000);
  memset(x, 0, sizeof x);
  for (size_t i = 0; i < 3000; i++) x[AROUND + i] = (double)wave[i];
  normalise(x, AROUND + 3000);
  support_ok(context, ern_speech_network_features(network, "pieces.wav", &features));
  assert_int_equal(features.windows, ((3000 - SPAN) / HOP + 1) / 2 + 1);
  for (size_t r = 0; r < (3000 - SPAN) / HOP + 1; r++) expect_row(&features, r, x + AROUND, 10 * tolerance);
  ern_features_free(context, &features);
  make_sound("pieces.wav", SAMPLES);
  support_ok(context, ern_speech_network_features(network, "pieces.wav", &features));
  static const struct {
    size_t begin, first, end; /* rows: of the piece, and those that are taken of it */
  } pieces[] = {{0, 0, 21}, {21, 21, 42}, {40, 42, 62}};
  for (size_t j = 0; j < 3; j++) {
    const size_t first = pieces[j].begin * HOP, there = SAMPLES - first + AROUND; /* samples, to the sound's end */
    for (size_t i = 0; i < PIECE; i++) x[i] = first + i < AROUND || i >= there ? 0 : (double)wave[first + i - AROUND];
    normalise(x, there < PIECE ? there : PIECE);
    for (size_t r = pieces[j].first; r < pieces[j].end; r++)
      expect_row(&features, r, x + AROUND - (ptrdiff_t)first, 10 * tolerance);
  }
  ern_features_free(context, &features);
  ern_speech_network_free(&network);
}

/* A network whose rows look at two rows before and after: as in one pass over the whole sound, wherever pieces end. */
static void test_borders(void **state) {
  (void)state;
  enum { PIECE = 8080, ROWS_OF_PIECE = 25, REACH = 2, TAPS = 2 * REACH + 1 };
  static const size_t lengths[] = {3000, 8000, 9000, 25000, 60000, 65536};
  static const float taps[TAPS] = {0.5f, -1, 2, 0.75f, -0.25f};
  struct made_message graph = {0};
  for (size_t i = 0; i < SPAN; i++) weight[i] = noise(i, 3) / 20;
  made_weight(&graph, "W", (const size_t[]){1, 1, SPAN, 0}, weight);
  made_weight(&graph, "V", (const size_t[]){1, 1, TAPS, 0}, taps);
  made_node(&graph, "Conv", "wave W", "first",
            (const struct made_attribute[]){{"kernel_shape", 1, {SPAN}}, {"strides", 1, {HOP}}, {NULL, 0, {0}}});
  made_node(&graph, "Conv", "first V", "second",
            (const struct made_attribute[]){{"kernel_shape", 1, {TAPS}}, {"pads", 2, {REACH, REACH}}, {NULL, 0, {0}}});
  made_node(&graph, "Transpose", "second", "rows",
            (const struct made_attribute[]){{"perm", 3, {0, 2, 1}}, {NULL, 0, {0}}});
  made_value(&graph, 11, "wave", (const size_t[]){1, 1, PIECE, 0});
  made_value(&graph, 12, "rows", (const size_t[]){1, ROWS_OF_PIECE, 1, 0});
  made_onnx("borders.onnx", &graph);
  ern_speech_network *network = open_network("borders.onnx", description("none", PIECE, REACH * HOP, 1, 16));
  for (size_t l = 0; l < sizeof lengths / sizeof *lengths; l++) {
    static double x[MOST_SAMPLES], first[MOST_ROWS];
    ern_features features;
    make_sound("borders.wav", lengths[l]);
    for (size_t i = 0; i < lengths[l]; i++) x[i] = (double)wave[i];
    const size_t rows = (lengths[l] - SPAN) / HOP + 1;
    for (size_t r = 0; r < rows; r++) first[r] = plain_row(x, r, 0);
    support_ok(context, ern_speech_network_features(network, "borders.wav", &features));
    /* the very first rows hear, in the zeros before the sound, what a pass over it alone would not */
    for (size_t r = l == 0 ? 4 : REACH; r + REACH < rows; r++) {
      double expected = 0;
      for (size_t k = 0; k < TAPS; k++) expected += (double)taps[k] * first[r + k - REACH];
      if (!(fabs((double)row_of(&features, r)[0] - expected) < tolerance))
        fail_msg("%zu samples, row %zu of %zu: %g, expected %g", lengths[l], r, rows, (double)row_of(&features, r)[0],
                 expected);
    }
    ern_features_free(context, &features);
  }
  ern_speech_network_free(&network);
}

/* ---- presets ----------------------------------------------------------------------------------------------------- */

/* 1.4 s pieces, of which 1 s is kept; 1 + floor(floor((samples - 80)/320)/2) windows. */
static void test_esperanto(void **state) {
  (void)state;
  static const size_t lengths[] = {400, 3000, 19200, 22400, 35201, 48000};
  make_network("esperanto.onnx", 22400, 44);
  ern_speech_network *network = open_network("esperanto.onnx", ern_speech_preset("esperanto"));
  assert_string_equal(ern_speech_network_kind(network), "esperanto");
  for (size_t l = 0; l < sizeof lengths / sizeof *lengths; l++) {
    ern_features features;
    make_sound("esperanto.wav", lengths[l]);
    support_ok(context, ern_speech_network_features(network, "esperanto.wav", &features));
    assert_true(features.windows == (lengths[l] - 80) / 320 / 2 + 1 && features.window_length == 16);
    assert_string_equal(ern_speech_kind(&features), "esperanto");
    for (size_t i = 0; i < 8 * 44; i++) assert_true(features.data[i] == 0);
    ern_features_free(context, &features);
  }
  ern_speech_network_free(&network);
}

/* 20 s pieces that give 1000 rows, windows of two. */
static void test_hubert(void **state) {
  (void)state;
  ern_features features;
  const size_t samples = 400 + 320 * 1010; /* 1011 rows */
  ern_sound sound = {.rate = RATE, .channels = 1, .frames = samples};
  sound.data = calloc(samples, sizeof *sound.data);
  assert_non_null(sound.data);
  for (size_t i = 0; i < samples; i++) sound.data[i] = (int16_t)(8000 * noise(i, 4));
  support_ok(context, ern_sound_write_wav(context, "hubert.wav", &sound));
  make_network("hubert.onnx", 320080, 1024);
  ern_speech_network *network = open_network("hubert.onnx", ern_speech_preset("hubert"));
  support_ok(context, ern_speech_network_features(network, "hubert.wav", &features));
  assert_true(features.windows == 505 && features.window_length == 2 && features.width == 1024);
  double mean = 0, variance = 0;
  for (size_t i = 0; i < samples; i++) mean += sound.data[i] / 32768.0 / (double)samples;
  for (size_t i = 0; i < samples; i++) variance += pow(sound.data[i] / 32768.0 - mean, 2) / (double)samples;
  static const size_t looked[] = {0, 998, 999, 1000, 1009}; /* of both pieces */
  for (size_t k = 0; k < 5; k++) {
    static double x[SPAN];
    for (size_t i = 0; i < SPAN; i++) x[i] = (sound.data[looked[k] * HOP + i] / 32768.0 - mean) / sqrt(variance + 1e-7);
    for (size_t q = 0; q < 1024; q++)
      assert_true(fabs((double)row_of(&features, looked[k])[q] - plain_row(x, 0, q)) < 10 * tolerance);
  }
  free(sound.data);
  ern_features_free(context, &features);
  ern_speech_network_free(&network);
  assert_null(ern_speech_preset("deepspeech"));
}

/* ---- other sound ------------------------------------------------------------------------------------------------- */

/* The mean of the channels, at the network's rate. A tone of 200 Hz is the same at both. */
static void test_forms(void **state) {
  (void)state;
  ern_features features[2];
  const double pi = 3.14159265358979323846;
  make_network("forms.onnx", 8080, WIDTH);
  ern_speech_network *network = open_network("forms.onnx", description("none", 8080, 0, WIDTH, 16));
  for (int form = 0; form < 2; form++) {
    const int rate = form == 0 ? RATE : 44100, channels = 1 + form;
    ern_sound sound = {.rate = rate, .channels = channels, .frames = (size_t)rate};
    sound.data = calloc(sound.frames * 2, sizeof *sound.data);
    assert_non_null(sound.data);
    for (size_t i = 0; i < sound.frames; i++)
      for (int c = 0; c < channels; c++) /* one channel twice as loud, the other silent */
        sound.data[i * (size_t)channels + (size_t)c] =
            (int16_t)lrint((c == 0 ? channels : 0) * 8000 * sin(2 * pi * 200 * (double)i / rate));
    support_ok(context, ern_sound_write_wav(context, "forms.wav", &sound));
    free(sound.data);
    support_ok(context, ern_speech_network_features(network, "forms.wav", &features[form]));
  }
  assert_int_equal(features[0].windows, features[1].windows);
  for (size_t r = 1; r < 48; r++) /* the resampler's filter reaches over the ends */
    for (size_t q = 0; q < WIDTH; q++)
      assert_true(fabs((double)(row_of(&features[0], r)[q] - row_of(&features[1], r)[q])) < 2e-3);
  ern_features_free(context, &features[0]);
  ern_features_free(context, &features[1]);
  ern_speech_network_free(&network);
}

static int stop_at_second(void *user, size_t done, size_t pieces) {
  *(size_t *)user = pieces;
  return done == 1;
}

static void test_arguments(void **state) {
  (void)state;
  ern_features features = {.width = 1};
  make_network("arguments.onnx", 8080, WIDTH);
  ern_speech_network *network = open_network("arguments.onnx", description("none", 8080, 0, WIDTH, 16));
  support_expect(context, ern_speech_network_features(network, NULL, &features), ERN_E_ARGUMENT, "path is NULL", NULL);
  assert_int_equal(features.width, 0);
  support_expect(context, ern_speech_network_features(network, "x.wav", NULL), ERN_E_ARGUMENT, "features is NULL",
                 NULL);
  ern_speech_network_free(&network);
}

static void test_watch(void **state) {
  (void)state;
  ern_features features;
  size_t pieces = 0;
  make_network("watch.onnx", 8080, WIDTH);
  make_sound("watch.wav", 20000);
  ern_speech_network *network = open_network("watch.onnx", description("none", 8080, 0, WIDTH, 16));
  ern_speech_network_watch(network, stop_at_second, &pieces);
  support_expect(context, ern_speech_network_features(network, "watch.wav", &features), ERN_E_CANCELLED,
                 "stopped after 1 of 3 pieces", NULL);
  assert_int_equal(pieces, 3);
  assert_null(features.data);
  ern_speech_network_free(&network);
}

/* ---- refusals ---------------------------------------------------------------------------------------------------- */

static void refuse(const char *path, const char *text, ern_status status, const char *first, const char *second) {
  ern_speech_network *network = (ern_speech_network *)(void *)&wave;
  support_expect(context, ern_speech_network_open(context, path, text, &network), status, path, first, second, NULL);
  assert_null(network);
}

static void test_bad_networks(void **state) {
  (void)state;
  const char *fine = description("none", 8080, 0, WIDTH, 16);
  struct made_message graph = {0};
  support_write("nothing.onnx", "", 0);
  refuse("nothing.onnx", fine, ERN_E_FORMAT, "no ONNX file", "0 bytes");
  support_write_text("text.onnx", "no network\n");
  refuse("text.onnx", fine, ERN_E_FORMAT, "no ONNX file", NULL);
  refuse("missing.onnx", fine, ERN_E_MISSING, "missing.onnx", NULL);
  make_network("other.onnx", 4080, WIDTH);
  refuse("other.onnx", fine, ERN_E_SHAPE, "\"wave\" is [1, 1, 4080]", "torch.zeros(1, 8080)");
  const struct made_convolution convolution = {8080, HOP, SPAN, WIDTH, weight};
  made_convolve(&graph, &convolution, "rows");
  made_node(&graph, "Einsum", "rows", "more", NULL);
  made_value(&graph, 12, "more", (const size_t[]){1, 25, WIDTH, 0});
  made_onnx("operator.onnx", &graph);
  char named[512];
  snprintf(named, sizeof named, "%.*s,\"output\":\"more\"}", (int)strlen(fine) - 1, fine);
  refuse("operator.onnx", fine, ERN_E_MISSING, "\"rows\", \"more\"", "names one");
  refuse("operator.onnx", named, ERN_E_UNSUPPORTED, "operator Einsum (node more)", "docs/speech.md");
  /* OpenCV's reason stands below its code and function here */
  made_convolve(&graph, &convolution, "rows");
  made_node(&graph, "Clip", "rows W W", "more", NULL);
  made_onnx("clip.onnx", &graph);
  refuse("clip.onnx", fine, ERN_E_UNSUPPORTED, "operator Clip (node more): (expected: 'node_proto.input_size() == 1')",
         "is 3 must be equal to '1' is 1");
  make_network("output.onnx", 8080, WIDTH);
  refuse("output.onnx", named, ERN_E_MISSING, "no output \"more\"", "expected \"rows\"");
}

static void refuse_rows(const char *path, const char *text, ern_status status, const char *first, const char *second) {
  ern_features features = {.width = 1};
  ern_speech_network *network = open_network(path, text);
  support_expect(context, ern_speech_network_features(network, "refuse.wav", &features), status, path, first, second,
                 NULL);
  assert_true(features.data == NULL && features.width == 0);
  ern_speech_network_free(&network);
}

static void test_bad_rows(void **state) {
  (void)state;
  struct made_message graph = {0};
  make_sound("refuse.wav", 8080);
  make_network("rows.onnx", 8080, WIDTH);
  refuse_rows("rows.onnx", description("none", 8080, 0, WIDTH + 1, 16), ERN_E_SHAPE, "[1, 25, 3], expected [1, 25, 4]",
              "(width)");
  char *text = description("none", 8080, 0, WIDTH, 16), *row = strstr(text, "\"row_samples\":400");
  memcpy(row + 14, "800", 3);
  refuse_rows("rows.onnx", text, ERN_E_SHAPE, "[1, 25, 3], expected [1, 23, 3]", "(row_samples)");
  const struct made_convolution convolution = {8080, HOP, SPAN, WIDTH, weight};
  weight[SPAN] = NAN;
  made_convolve(&graph, &convolution, "rows");
  made_onnx("nan.onnx", &graph);
  refuse_rows("nan.onnx", description("none", 8080, 0, WIDTH, 16), ERN_E_NONFINITE, "nan in place 1", "at 0.00 s");
}

static void test_bad_sound(void **state) {
  (void)state;
  ern_features features;
  make_network("sound.onnx", 8080, WIDTH);
  ern_speech_network *network = open_network("sound.onnx", description("none", 8080, 0, WIDTH, 2));
  make_sound("short.wav", 719); /* one row */
  support_expect(context, ern_speech_network_features(network, "short.wav", &features), ERN_E_SHAPE, "short.wav",
                 "719 samples", "row_samples 400", NULL);
  support_write_text("text.wav", "no sound");
  support_expect(context, ern_speech_network_features(network, "text.wav", &features), ERN_E_FORMAT, "text.wav", NULL);
  support_write_text("features.npy", "");
  support_expect(context, ern_speech_network_features(network, "features.npy", &features), ERN_E_ARGUMENT,
                 "holds features", "sound.onnx", NULL);
  assert_null(features.data);
  ern_speech_network_free(&network);
}

/* ---- descriptions ------------------------------------------------------------------------------------------------ */

static void test_descriptions(void **state) {
  (void)state;
  make_network("told.onnx", 8080, WIDTH);
  support_clear("told.json");
  refuse("told.onnx", NULL, ERN_E_MISSING, "expected a preset", "told.json");
  support_write_text("told.json", description("none", 8080, 0, WIDTH, 16));
  ern_speech_network *network = open_network("told.onnx", NULL);
  char known[512], changed[512];
  snprintf(known, sizeof known, "%s", ern_speech_network_description(network));
  assert_non_null(strstr(known, "\"sha256\":\""));
  ern_speech_network_free(&network);
  network = open_network("told.onnx", known); /* all that it takes */
  assert_string_equal(ern_speech_network_description(network), known);
  ern_speech_network_free(&network);
  make_network("told.onnx", 8080, WIDTH + 1); /* another network */
  refuse("told.onnx", known, ERN_E_MISMATCH, "\"mine\"", "SHA-256");
  static const struct {
    const char *from, *to, *word, *found;
  } wrong[] = {{"\"mine\"", "\"cepstra-2\"", "kind is \"cepstra-2\"", "built-in"},
               {"\"mine\"", "\"articulatory\"", "kind is \"articulatory\"", "built-in"},
               {"\"mine\"", "\"My kind\"", "kind is", "a-z"},
               {"16000", "16001", "rate is 16001", "multiple of 50"},
               {"16000", "\"16000\"", "rate is \"16000\"", "expected"},
               {"\"none\"", "\"some\"", "normalisation is \"some\"", "\"piece\""},
               {"8080", "100", "piece_samples is 100", "expected"},
               {":0", ":100", "context_samples is 100", "multiple of 320"},
               {":0", ":4000", "context_samples is 4000", "expected"},
               {"400", "8081", "row_samples is 8081", "1 to 8080"},
               {":3", ":4097", "width is 4097", "1 to 4096"},
               {":16}", ":8}", "window_rows is 8", "16 or 2"},
               {":16}", ":16,\"output\":\"\"}", "output is \"\"", "1 to 127"},
               {":16}", ":16,\"sha256\":\"12\"}", "sha256 is \"12\"", "64 digits"},
               {":16}", ":16,\"layers\":3}", "layers", "no field"},
               {",\"width\":3", "", "width is missing", "expected"},
               {"}", "", "line 1", "end of file"}};
  for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
    const char *fine = description("none", 8080, 0, WIDTH, 16), *at = strstr(fine, wrong[i].from);
    assert_non_null(at);
    snprintf(changed, sizeof changed, "%.*s%s%s", (int)(at - fine), fine, wrong[i].to, at + strlen(wrong[i].from));
    refuse("told.onnx", changed, ERN_E_FORMAT, wrong[i].word, wrong[i].found);
  }
  support_write_text("told.json", "{}");
  ern_speech_network *none = NULL;
  support_expect(context, ern_speech_network_open(context, "told.onnx", "told.json", &none), ERN_E_FORMAT, "told.json",
                 "kind is missing", NULL);
}

/* ---- memory ------------------------------------------------------------------------------------------------------ */

static ern_status hear(ern_context *metered) {
  ern_speech_network *network = NULL;
  ern_features features = {0};
  ern_status status =
      ern_speech_network_open(metered, "memory.onnx", description("sound", 8080, 0, WIDTH, 16), &network);
  if (status == ERN_OK) status = ern_speech_network_features(network, "memory.wav", &features);
  ern_features_free(metered, &features);
  ern_speech_network_free(&network);
  return status;
}

static void test_memory(void **state) {
  (void)state;
  make_network("memory.onnx", 8080, WIDTH);
  make_sound("memory.wav", 9000);
  support_refuse_each(hear);
}

/* What a build without OpenCV's DNN module says. */
static void test_no_library(void **state) {
  (void)state;
  make_network("none.onnx", 8080, WIDTH);
  refuse("none.onnx", description("none", 8080, 0, WIDTH, 16), ERN_E_UNSUPPORTED, "libernerf-vision", "ERNERF_VISION");
}

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

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_rows),
                                     cmocka_unit_test(test_windows),
                                     cmocka_unit_test(test_normalised_sound),
                                     cmocka_unit_test(test_normalised_pieces),
                                     cmocka_unit_test(test_borders),
                                     cmocka_unit_test(test_esperanto),
                                     cmocka_unit_test(test_hubert),
                                     cmocka_unit_test(test_forms),
                                     cmocka_unit_test(test_watch),
                                     cmocka_unit_test(test_arguments),
                                     cmocka_unit_test(test_bad_networks),
                                     cmocka_unit_test(test_bad_rows),
                                     cmocka_unit_test(test_bad_sound),
                                     cmocka_unit_test(test_descriptions),
                                     cmocka_unit_test(test_memory)},
                          without[] = {cmocka_unit_test(test_no_library)};
  return ERN_VISION ? cmocka_run_group_tests(tests, set_up, tear_down)
                    : cmocka_run_group_tests(without, set_up, tear_down);
}
