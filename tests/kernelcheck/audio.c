/* SPDX-License-Identifier: MIT
 * The audio networks: the float reference against the double one, a device against the float one; instruction
 * sets give its bits. */
#include "harness.h"
#include "mlp/audio_ops.h"

enum { WINDOWS = ERN_AUDIO_WINDOWS, MARGIN = 5 };

/* Relative to the largest value of the result. A sum of K terms, in either order, is off by about sqrt(K) u of its
 * size, errors adding like a random walk: the first layer has K <= 3 D, the eleven others K <= 192. Both sides are off.
 */
static double audio_tolerance(const struct ern_audio_net *net) {
  return 2 * (sqrt(3.0 * net->width) + 11 * sqrt(192.0)) * 0x1p-24;
}

static size_t advance(size_t *end, size_t count) {
  const size_t at = *end;
  *end += count;
  return at;
}

static struct ern_audio_net lay_out(int width, int length, int code) {
  static const int conv[] = {32, 32, 64, 64}, att[] = {16, 8, 4, 2, 1};
  struct ern_audio_net net = {.width = width, .window_length = length, .code = code, .first = 7};
  size_t end = net.first;
  for (int l = 0, ins = width; l < ERN_AUDIO_CONVS; ins = conv[l], l++) {
    net.conv_weight[l] = advance(&end, (size_t)(conv[l] * ins * 3));
    net.conv_bias[l] = advance(&end, (size_t)conv[l]);
  }
  for (int l = 0; l < 2; l++) {
    net.fc_weight[l] = advance(&end, (size_t)((l == 0 ? 64 : code) * 64));
    net.fc_bias[l] = advance(&end, (size_t)(l == 0 ? 64 : code));
  }
  for (int l = 0, ins = code; l < ERN_AUDIO_ATT_CONVS; ins = att[l], l++) {
    net.att_conv_weight[l] = advance(&end, (size_t)(att[l] * ins * 3));
    net.att_conv_bias[l] = advance(&end, (size_t)att[l]);
  }
  net.att_fc_weight = advance(&end, 64);
  net.att_fc_bias = advance(&end, 8);
  net.count = end - net.first;
  return net;
}

/* Host values of a case; the caller may spoil some before it is run. */
struct values {
  struct ern_audio_net net;
  size_t inputs, parameters;
  float *windows, *block, *dblock, *dcode, *codes;
};

/* The double build, as mlp.h declares it there. */
void ern_audio_fwd_ref64(double *code, const double *windows, const double *parameters,
                         const struct ern_audio_net *net);
void ern_audio_bwd_ref64(double *dparameters, const double *dcode, const double *windows, const double *parameters,
                         const struct ern_audio_net *net);

static double *widened(const float *values, size_t count) {
  double *wide = held_memory(count, sizeof *wide);
  for (size_t i = 0; i < count; i++) wide[i] = (double)values[i];
  return wide;
}

static struct values values_make(int width, int length, int code, float loud) {
  struct values v = {.net = lay_out(width, length, code)};
  v.inputs = (size_t)(WINDOWS * width * length);
  v.parameters = v.net.first + v.net.count + MARGIN; /* a margin on both sides that no gradient may touch */
  v.windows = floats(v.inputs), v.block = floats(v.parameters), v.dblock = floats(v.parameters);
  v.dcode = floats((size_t)code), v.codes = floats((size_t)(WINDOWS * code));
  fill_random(v.windows, v.inputs, 1, loud);
  fill_random(v.dcode, (size_t)code, 2, 1);
  fill_random(v.codes, (size_t)(WINDOWS * code), 4, 1);
  for (size_t i = 0; i < v.parameters; i++) {
    /* of the size that torch draws for 3 x 32 inputs; the first convolution's by its own width */
    v.block[i] = random_at(3, i, 1.5f / sqrtf(i < v.net.conv_bias[0] ? 3 * (float)width : 96));
    v.dblock[i] = i < v.net.first || i >= v.net.first + v.net.count ? 7.5f : 0;
  }
  return v;
}

static double largest_of(const float *values, size_t count) {
  double most = 0;
  for (size_t i = 0; i < count; i++)
    if (isfinite(values[i])) most = fmax(most, fabs((double)values[i]));
  return most;
}

static void expect_same(const char *what, const struct ern_audio_net *net, struct many span) {
  EACH_OTHER (k) {
    const double tolerance = is_device(k) ? audio_tolerance(net) : 0;
    expect_near_on(k, what, span, 0, tolerance * largest_of(floats_of(0, span), span.on[0].count));
  }
}

struct layer {
  const char *name;
  size_t begin, count;
};

/* What float costs the reference at each layer: the largest error over DRAWS networks and inputs that differ in their
 * last bits, so that luck has no part in it. Inputs alone would not do: windows of zeros have no last bits. */
static void prices_of(const struct values *v, const struct layer *layers, int count, double *price) {
  enum { DRAWS = 4 };
  double *dcode = widened(v->dcode, (size_t)v->net.code);
  float *windows = floats(v->inputs), *block = floats(v->parameters);
  for (int l = 0; l < count; l++) price[l] = 0;
  for (int draw = 0; draw < DRAWS; draw++) {
    for (size_t i = 0; i < v->inputs; i++) windows[i] = v->windows[i] * (1 + (float)draw * random_at(6, i, 0x1p-22f));
    for (size_t i = 0; i < v->parameters; i++) block[i] = v->block[i] * (1 + (float)draw * random_at(7, i, 0x1p-22f));
    double *wide = widened(windows, v->inputs), *wide_block = widened(block, v->parameters);
    double *exact = widened(v->dblock, v->parameters);
    float *found = floats(v->parameters);
    memcpy(found, v->dblock, v->parameters * sizeof *found);
    for (int twice = 0; twice < 2; twice++) {
      ern_audio_bwd_ref(found, v->dcode, windows, block, &v->net);
      ern_audio_bwd_ref64(exact, dcode, wide, wide_block, &v->net);
    }
    for (int l = 0; l < count; l++)
      for (size_t i = layers[l].begin; i < layers[l].begin + layers[l].count; i++)
        if (isfinite(found[i])) price[l] = fmax(price[l], fabs((double)found[i] - exact[i]));
  }
}

/* A layer's gradients are held against the largest of them. Those of AudioAttNet go by differences between windows,
 * which cancel where codes are alike: float then costs the reference more than the tolerance. The device adds in
 * another order and is granted twice that; the two are compared with each other: three times. */
static void expect_layer(int k, const struct values *v, const struct layer *layer, const float *found,
                         const float *reference, double price) {
  double most = 0;
  for (size_t i = layer->begin; i < layer->begin + layer->count; i++)
    if (isfinite(reference[i])) most = fmax(most, fabs((double)reference[i]));
  const double allowed = fmax(audio_tolerance(&v->net) * most, 3 * price);
  for (size_t i = layer->begin; i < layer->begin + layer->count; i++)
    if (!is_near(found[i], reference[i], 0, is_device(k) ? allowed : 0))
      fail_msg("%s: width %d, length %d, code %d: %s [%zu]: %.9g, reference %.9g, largest %g, allowed %g",
               machines.name[k], v->net.width, v->net.window_length, v->net.code, layer->name, i - layer->begin,
               (double)found[i], (double)reference[i], most, allowed);
}

static void expect_gradient(const struct values *v, struct many dblock) {
  const struct ern_audio_net *net = &v->net;
  const size_t code = (size_t)net->code, width = (size_t)net->width;
  enum { ATTENTION = 7, LAYERS = 14 }; /* the first of AudioAttNet's */
  const struct layer layers[LAYERS] = {{"before", 0, net->first},
                                       {"convolution 0", net->conv_weight[0], 96 * width + 32},
                                       {"convolution 1", net->conv_weight[1], 96 * 32 + 32},
                                       {"convolution 2", net->conv_weight[2], 192 * 32 + 64},
                                       {"convolution 3", net->conv_weight[3], 192 * 64 + 64},
                                       {"hidden layer", net->fc_weight[0], 64 * 64 + 64},
                                       {"last layer", net->fc_weight[1], 64 * code + code},
                                       {"attention convolution 0", net->att_conv_weight[0], 48 * code + 16},
                                       {"attention convolution 1", net->att_conv_weight[1], 24 * 16 + 8},
                                       {"attention convolution 2", net->att_conv_weight[2], 12 * 8 + 4},
                                       {"attention convolution 3", net->att_conv_weight[3], 6 * 4 + 2},
                                       {"attention convolution 4", net->att_conv_weight[4], 3 * 2 + 1},
                                       {"attention layer", net->att_fc_weight, 72},
                                       {"behind", net->first + net->count, MARGIN}};
  const float *reference = floats_of(0, dblock);
  double price[LAYERS];
  prices_of(v, layers, LAYERS, price);
  EACH_OTHER (k) {
    const float *found = floats_of(k, dblock);
    size_t end = 0;
    for (int l = 0; l < LAYERS; l++) {
      assert_int_equal(layers[l].begin, end);
      end += layers[l].count;
      expect_layer(k, v, &layers[l], found, reference, l >= ATTENTION ? price[l] : 0);
    }
    assert_int_equal(end, v->parameters);
    for (size_t i = 0; i < v->net.first; i++) assert_true(found[i] == v->dblock[i]);
    for (size_t i = v->parameters - MARGIN; i < v->parameters; i++) assert_true(found[i] == v->dblock[i]);
  }
}

/* The float reference against the double one, |float - double| relative to the largest value of the tensor. Twelve
 * layers in a row, each a sum of K <= 3 D terms that is off by at most K u of its absolute sum, are a worst case that
 * no data meets; errors of sums add like a random walk, sqrt(K) u. 12 layers of sqrt(3 * 1024) u make 4e-5; a LeakyReLU
 * flipped by it moves a gradient by 0.98 of a value that is itself that small. */
static const double double_tolerance = 4e-5;

static void expect_double(const char *what, const float *found, const double *expected, size_t count) {
  double largest = 0;
  for (size_t i = 0; i < count; i++) largest = fmax(largest, fabs(expected[i]));
  for (size_t i = 0; i < count; i++)
    if (!(fabs((double)found[i] - expected[i]) <= double_tolerance * largest))
      fail_msg("%s [%zu]: %.9g, double %.9g, largest %.3g", what, i, (double)found[i], expected[i], largest);
}

/* And window by window and then mixed: the same bits as in one go. */
static void check_double(const struct values *v) {
  const struct ern_audio_net *net = &v->net;
  const size_t code = (size_t)net->code;
  const double *windows = widened(v->windows, v->inputs), *block = widened(v->block, v->parameters);
  double *exact = held_memory(code, sizeof *exact), *gradient = widened(v->dblock, v->parameters);
  float *whole = floats(code), *codes = floats(WINDOWS * code), *mixed = floats(code), *found = floats(v->parameters);
  ern_audio_fwd_ref(whole, v->windows, v->block, net);
  ern_audio_fwd_ref64(exact, windows, block, net);
  expect_double("code", whole, exact, code);
  for (int t = 0; t < WINDOWS; t++)
    ern_audio_window_ref(codes + t * net->code, v->windows + t * net->window_length * net->width, v->block, net);
  ern_audio_mix_ref(mixed, codes, v->block, net);
  assert_memory_equal(mixed, whole, code * sizeof *whole);
  memcpy(found, v->dblock, v->parameters * sizeof *found);
  ern_audio_bwd_ref(found, v->dcode, v->windows, v->block, net);
  ern_audio_bwd_ref64(gradient, widened(v->dcode, code), windows, block, net);
  expect_double("dparameters", found + net->first, gradient + net->first, net->count);
  for (size_t i = 0; i < v->parameters; i++)
    assert_true((i >= net->first && i < net->first + net->count) || found[i] == v->dblock[i]);
}

static void test_double(void **state) {
  (void)state;
  static const int shapes[][3] = {{29, 16, 32}, {44, 16, 32}, {1024, 2, 32}, {1, 1, 1}, {7, 9, ERN_AUDIO_MAX_CODE}};
  for (size_t i = 0; i < COUNT_OF(shapes); i++) {
    const struct values v = values_make(shapes[i][0], shapes[i][1], shapes[i][2], 1);
    check_double(&v);
    machines_clear();
  }
}

static void check(const struct values *v) {
  const struct machines_mark mark = machines_mark();
  const size_t code_count = (size_t)v->net.code;
  const struct many windows = many_reals(v->windows, v->inputs);
  const struct many block = many_reals(v->block, v->parameters);
  const struct many dblock = many_reals(v->dblock, v->parameters);
  const struct many dcode = many_reals(v->dcode, code_count);
  const struct many code = many_empty(code_count);
  struct ern_audio_fwd_args forward[MACHINES];
  struct ern_audio_bwd_args backward[MACHINES];
  EACH_MACHINE (b) {
    forward[b] = (struct ern_audio_fwd_args){
        .code = code.on[b], .windows = windows.on[b], .parameters = block.on[b], .net = v->net};
    backward[b] = (struct ern_audio_bwd_args){.dparameters = dblock.on[b], .dcode = dcode.on[b], .forward = forward[b]};
    backward[b].forward.code = (ern_span){0};
  }
  RUN(audio_fwd, forward);
  expect_same("code", &v->net, code);
  for (int twice = 0; twice < 2; twice++) RUN(audio_bwd, backward); /* gradients accumulate */
  expect_gradient(v, dblock);
  expect_near("parameters", block, 0, 0);
  machines_clear_to(mark);
}

static void check_shape(int width, int length, int code) {
  struct values v = values_make(width, length, code, 1);
  check(&v);
  machines_clear();
}

static void test_lengths(void **state) {
  (void)state;
  for (int length = 1; length <= 16; length += is_small() ? 15 : is_emulated() ? 5 : 1) {
    check_shape(29, length, 32);
    if (!is_small()) check_shape(44, length, 32);
  }
  if (is_small()) return;
  check_shape(1024, 2, 32);
  check_shape(1024, 16, 32);
}

/* Around blocks of eight channels. */
static void test_widths(void **state) {
  (void)state;
  static const int widths[] = {1, 2, 7, 8, 9, 15, 16, 17, 64, 129}, codes[] = {1, 3, 8, 9, 31, 64, 65, 256};
  const size_t step = is_small() ? 5 : 1;
  for (size_t k = 0; k < COUNT_OF(widths); k += step) check_shape(widths[k], 16 - (int)k, 32);
  for (size_t k = 0; k < COUNT_OF(codes); k += step) check_shape(5, 9, codes[k]);
  check_shape(1, 1, 1);
  check_shape(7, 9, ERN_AUDIO_MAX_CODE);
}

/* Values past the count of windows that the mask calls known are taken as they are, the others are made. */
static void check_frame(int width, int length, unsigned known, int nan_at) {
  struct values v = values_make(width, length, 32, 1);
  if (nan_at >= 0) v.windows[nan_at * width * length] = NAN;
  const struct many windows = many_reals(v.windows, v.inputs);
  const struct many block = many_reals(v.block, v.parameters);
  const struct many codes = many_reals(v.codes, WINDOWS * 32);
  const struct many code = many_empty(32);
  struct ern_audio_frame_args args[MACHINES];
  EACH_MACHINE (b)
    args[b] = (struct ern_audio_frame_args){
        .audio = {.code = code.on[b], .windows = windows.on[b], .parameters = block.on[b], .net = v.net},
        .codes = codes.on[b],
        .known = known};
  RUN(audio_frame, args);
  EACH_MACHINE (k) {
    const float *found = floats_of(k, codes);
    for (int t = 0; t < WINDOWS; t++) /* those known keep their bits */
      for (int a = 0; a < 32 && (known >> t & 1) != 0; a++) assert_true(found[t * 32 + a] == v.codes[t * 32 + a]);
  }
  expect_same("codes", &v.net, codes);
  expect_same("code of the frame", &v.net, code);
  machines_clear();
}

static void test_frame(void **state) {
  (void)state;
  static const unsigned known[] = {0, 0xFF, 0x7F, 0x01, 0xFE, 0xA5, 0x5A, 0x10};
  for (size_t k = 0; k < COUNT_OF(known); k += is_small() ? 5 : 1) {
    check_frame(29, 16, known[k], -1);
    if (!is_small()) check_frame(1024, 2, known[k], -1);
  }
  check_frame(44, 16, 0x08, 3); /* a NaN in a window that nobody looks at, and in one that is looked at */
  check_frame(44, 16, 0x00, 3);
}

static void test_zeros(void **state) {
  (void)state;
  struct values v = values_make(44, 16, 32, 1);
  memset(v.windows, 0, v.inputs * sizeof(float));
  check(&v);
  memset(v.block, 0, v.parameters * sizeof(float)); /* all values at the corner of the LeakyReLU */
  check(&v);
  memset(v.dcode, 0, 32 * sizeof(float));
  check(&v);
}

/* Scores of thousands and of 1e30: the softmax neither overflows nor divides by zero. */
static void test_loud(void **state) {
  (void)state;
  const float loud[] = {1e4f, 1e30f, 1e-30f, 0x1p-140f};
  for (size_t k = 0; k < COUNT_OF(loud); k += is_small() ? 2 : 1) {
    struct values v = values_make(29, 16, 32, loud[k]);
    check(&v);
    machines_clear();
  }
}

/* NaN and infinities: in a window, in a weight, and in weights of taps that never meet a value. */
static void test_not_a_number(void **state) {
  (void)state;
  struct values v = values_make(29, 16, 32, 1);
  v.windows[5 * 29 * 16 + 100] = NAN;
  check(&v);
  v.windows[5 * 29 * 16 + 100] = INFINITY;
  check(&v);
  v = values_make(29, 16, 32, 1);
  v.dcode[3] = NAN;
  check(&v);
  v.dcode[3] = 0;
  v.block[v.net.conv_weight[2] + 50] = NAN;
  check(&v);
  v = values_make(29, 1, 32, 1); /* one position: only middle taps count */
  for (int o = 0; o < 32; o++) {
    v.block[v.net.conv_weight[0] + (size_t)o * 87] = NAN;
    v.block[v.net.conv_weight[1] + (size_t)o * 96 + 5] = INFINITY;
  }
  check(&v);
}

/* The same bytes on every run. */
static void test_again(void **state) {
  (void)state;
  const struct values v = values_make(44, 16, 32, 1);
  const struct many windows = many_reals(v.windows, v.inputs), block = many_reals(v.block, v.parameters),
                    dblock = many_reals(v.dblock, v.parameters), dcode = many_reals(v.dcode, 32);
  EACH_OTHER (k) {
    const float *first = NULL;
    for (int run = 0; run < 3; run++) {
      struct ern_audio_bwd_args args = {.dparameters = dblock.on[k],
                                        .dcode = dcode.on[k],
                                        .forward = {.windows = windows.on[k], .parameters = block.on[k], .net = v.net}};
      machines_fill(k, dblock.on[k], v.dblock, ERN_ELEMENT_REAL);
      RUN_ON(k, audio_bwd, &args);
      const float *found = floats_of(k, dblock);
      if (first != NULL) assert_memory_equal(first, found, v.parameters * sizeof *found);
      first = found;
    }
  }
  machines_clear();
}

static void bench(void) {
  static const int form[][2] = {{29, 16}, {44, 16}, {1024, 2}};
  for (size_t f = 0; f < COUNT_OF(form); f++) {
    const struct values v = values_make(form[f][0], form[f][1], 32, 1);
    const struct many windows = many_reals(v.windows, v.inputs), block = many_reals(v.block, v.parameters),
                      dblock = many_reals(v.dblock, v.parameters), codes = many_reals(v.codes, WINDOWS * 32),
                      code = many_reals(v.dcode, 32);
    struct ern_audio_fwd_args forward[MACHINES];
    struct ern_audio_bwd_args backward[MACHINES];
    struct ern_audio_frame_args frame[MACHINES];
    EACH_MACHINE (k) {
      forward[k] = (struct ern_audio_fwd_args){
          .code = code.on[k], .windows = windows.on[k], .parameters = block.on[k], .net = v.net};
      backward[k] =
          (struct ern_audio_bwd_args){.dparameters = dblock.on[k], .dcode = code.on[k], .forward = forward[k]};
      frame[k] = (struct ern_audio_frame_args){.audio = forward[k], .codes = codes.on[k], .known = 0x7F};
    }
    printf("[%d, %d]\n", form[f][1], form[f][0]);
    BENCH("forward", 1, audio_fwd, forward);
    BENCH("backward", 1, audio_bwd, backward);
    BENCH("a frame with one new window", 1, audio_frame, frame);
    machines_clear();
  }
}

static const struct CMUnitTest tests[] = {cmocka_unit_test(test_double),       cmocka_unit_test(test_lengths),
                                          cmocka_unit_test(test_widths),       cmocka_unit_test(test_frame),
                                          cmocka_unit_test(test_zeros),        cmocka_unit_test(test_loud),
                                          cmocka_unit_test(test_not_a_number), cmocka_unit_test(test_again)};
NOUN(audio, bench, .isa = NULL)
