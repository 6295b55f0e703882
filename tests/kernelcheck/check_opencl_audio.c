/* SPDX-License-Identifier: MIT
 * The audio networks on an OpenCL device against the reference. */
#include "kernelcheck.h"
#include "twin.h"

#include "core/kernels.h"
#include "mlp/audio_ops.h"

static ern_context *context;
static struct twin twin;

enum { WINDOWS = ERN_AUDIO_WINDOWS, MARGIN = 5 };

/* Relative to the largest value of the result. A sum of K terms, in either order, is off by about sqrt(K) u of its
 * size, errors adding like a random walk: the first layer has K <= 3 D, the eleven others K <= 192. Both sides are off.
 */
static double audio_tolerance(const struct ern_audio_net *net) {
  return 2 * (sqrt(3.0 * net->width) + 11 * sqrt(192.0)) * 0x1p-24;
}

/* For simulators: fewer shapes. */
static bool is_small(void) { return TWIN_SIZES < sizeof twin_sizes / sizeof *twin_sizes; }

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

void ern_audio_bwd_ref(float *dparameters, const float *dcode, const float *windows, const float *parameters,
                       const struct ern_audio_net *net);
void ern_audio_bwd_ref64(double *dparameters, const double *dcode, const double *windows, const double *parameters,
                         const struct ern_audio_net *net);

static double *widened(const float *values, size_t count) {
  double *wide = malloc((count + 1) * sizeof *wide);
  assert_non_null(wide);
  for (size_t i = 0; i < count; i++) wide[i] = (double)values[i];
  return wide;
}

static float *room(size_t count) {
  float *made = calloc(count, sizeof *made);
  assert_non_null(made);
  return made;
}

static struct values values_make(int width, int length, int code, float loud) {
  struct values v = {.net = lay_out(width, length, code)};
  v.inputs = (size_t)(WINDOWS * width * length);
  v.parameters = v.net.first + v.net.count + MARGIN; /* a margin on both sides that no gradient may touch */
  v.windows = room(v.inputs), v.block = room(v.parameters), v.dblock = room(v.parameters);
  v.dcode = room((size_t)code), v.codes = room((size_t)(WINDOWS * code));
  twin_fill(v.windows, v.inputs, 1, loud);
  twin_fill(v.dcode, (size_t)code, 2, 1);
  twin_fill(v.codes, (size_t)(WINDOWS * code), 4, 1);
  for (size_t i = 0; i < v.parameters; i++) {
    /* of the size that torch draws for 3 x 32 inputs; the first convolution's by its own width */
    v.block[i] = twin_random(3, i, 1.5f / sqrtf(i < v.net.conv_bias[0] ? 3 * (float)width : 96));
    v.dblock[i] = i < v.net.first || i >= v.net.first + v.net.count ? 7.5f : 0;
  }
  return v;
}

static void values_free(struct values *v) {
  free(v->windows), free(v->block), free(v->dblock), free(v->dcode), free(v->codes);
}

static double largest_of(struct twin_span span) {
  float *values = twin_down(&twin, 0, span.on[0]);
  double most = 0;
  for (size_t i = TWIN_GUARD; i < TWIN_GUARD + span.on[0].count; i++)
    if (isfinite(values[i])) most = fmax(most, fabs((double)values[i]));
  free(values);
  return most;
}

static void expect_same(const char *what, const struct ern_audio_net *net, struct twin_span span) {
  twin_same(&twin, what, span, 0, audio_tolerance(net) * largest_of(span));
}

struct layer {
  const char *name;
  size_t begin, count;
};

/* What float costs the reference at each layer: the largest error over DRAWS inputs that differ in their last bits, so
 * that luck has no part in it. */
static void prices_of(const struct values *v, const struct layer *layers, int count, double *price) {
  enum { DRAWS = 4 };
  double *block = widened(v->block, v->parameters), *dcode = widened(v->dcode, (size_t)v->net.code);
  float *windows = room(v->inputs);
  for (int l = 0; l < count; l++) price[l] = 0;
  for (int draw = 0; draw < DRAWS; draw++) {
    for (size_t i = 0; i < v->inputs; i++) windows[i] = v->windows[i] * (1 + (float)draw * twin_random(6, i, 0x1p-22f));
    double *wide = widened(windows, v->inputs), *exact = widened(v->dblock, v->parameters);
    float *found = room(v->parameters);
    memcpy(found, v->dblock, v->parameters * sizeof *found);
    for (int twice = 0; twice < 2; twice++) {
      ern_audio_bwd_ref(found, v->dcode, windows, v->block, &v->net);
      ern_audio_bwd_ref64(exact, dcode, wide, block, &v->net);
    }
    for (int l = 0; l < count; l++)
      for (size_t i = layers[l].begin; i < layers[l].begin + layers[l].count; i++)
        if (isfinite(found[i])) price[l] = fmax(price[l], fabs((double)found[i] - exact[i]));
    free(wide), free(exact), free(found);
  }
  free(block), free(dcode), free(windows);
}

/* A layer's gradients are held against the largest of them. Those of AudioAttNet go by differences between windows,
 * which cancel where codes are alike: float then costs the reference more than the tolerance. The device adds in
 * another order and is granted twice that; the two are compared with each other: three times. */
static void expect_layer(const struct values *v, const struct layer *layer, const float *found, const float *reference,
                         double price) {
  double most = 0;
  for (size_t i = layer->begin; i < layer->begin + layer->count; i++)
    if (isfinite(reference[i])) most = fmax(most, fabs((double)reference[i]));
  const double allowed = fmax(audio_tolerance(&v->net) * most, 3 * price);
  for (size_t i = layer->begin; i < layer->begin + layer->count; i++)
    if (!twin_near(found[i], reference[i], 0, allowed))
      fail_msg("width %d, length %d, code %d: %s [%zu]: device %.9g, reference %.9g, largest %g, allowed %g",
               v->net.width, v->net.window_length, v->net.code, layer->name, i - layer->begin, (double)found[i],
               (double)reference[i], most, allowed);
}

static void expect_gradient(const struct values *v, struct twin_span dblock) {
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
  float *reference = twin_down(&twin, 0, dblock.on[0]), *found = twin_down(&twin, 1, dblock.on[1]);
  double price[LAYERS];
  size_t end = 0;
  prices_of(v, layers, LAYERS, price);
  for (int l = 0; l < LAYERS; l++) {
    assert_int_equal(layers[l].begin, end);
    end += layers[l].count;
    expect_layer(v, &layers[l], found + TWIN_GUARD, reference + TWIN_GUARD, l >= ATTENTION ? price[l] : 0);
  }
  assert_int_equal(end, v->parameters);
  for (size_t i = 0; i < v->net.first; i++) assert_true(found[TWIN_GUARD + i] == v->dblock[i]);
  for (size_t i = v->parameters - MARGIN; i < v->parameters; i++) assert_true(found[TWIN_GUARD + i] == v->dblock[i]);
  for (size_t i = 0; i < TWIN_GUARD; i++)
    assert_true(found[i] == TWIN_POISON && found[TWIN_GUARD + v->parameters + i] == TWIN_POISON);
  free(reference), free(found);
}

static void check(const struct values *v) {
  const size_t code_count = (size_t)v->net.code;
  const struct twin_span windows = twin_reals(&twin, v->windows, v->inputs);
  const struct twin_span block = twin_reals(&twin, v->block, v->parameters);
  const struct twin_span dblock = twin_reals(&twin, v->dblock, v->parameters);
  const struct twin_span dcode = twin_reals(&twin, v->dcode, code_count);
  const struct twin_span code = twin_take(&twin, ERN_ELEMENT_REAL, code_count);
  struct ern_audio_fwd_args forward[2];
  struct ern_audio_bwd_args backward[2];
  for (int b = 0; b < 2; b++) {
    forward[b] = (struct ern_audio_fwd_args){
        .code = code.on[b], .windows = windows.on[b], .parameters = block.on[b], .net = v->net};
    backward[b] = (struct ern_audio_bwd_args){.dparameters = dblock.on[b], .dcode = dcode.on[b], .forward = forward[b]};
    backward[b].forward.code = (ern_span){0};
  }
  TWIN_RUN(&twin, audio_fwd, forward);
  expect_same("code", &v->net, code);
  for (int twice = 0; twice < 2; twice++) TWIN_RUN(&twin, audio_bwd, backward); /* gradients accumulate */
  expect_gradient(v, dblock);
  twin_same(&twin, "parameters", block, 0, 0);
  twin_clear(&twin);
}

static void check_shape(int width, int length, int code) {
  struct values v = values_make(width, length, code, 1);
  check(&v);
  values_free(&v);
}

static void test_lengths(void **state) {
  (void)state;
  for (int length = 1; length <= 16; length += is_small() ? 15 : 1) {
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
  for (size_t k = 0; k < sizeof widths / sizeof *widths; k += step) check_shape(widths[k], 16 - (int)k, 32);
  for (size_t k = 0; k < sizeof codes / sizeof *codes; k += step) check_shape(5, 9, codes[k]);
  check_shape(1, 1, 1);
  check_shape(7, 9, ERN_AUDIO_MAX_CODE);
}

/* Values past the count of windows that the mask calls known are taken as they are, the others are made. */
static void check_frame(int width, int length, unsigned known, int nan_at) {
  struct values v = values_make(width, length, 32, 1);
  if (nan_at >= 0) v.windows[nan_at * width * length] = NAN;
  const struct twin_span windows = twin_reals(&twin, v.windows, v.inputs);
  const struct twin_span block = twin_reals(&twin, v.block, v.parameters);
  const struct twin_span codes = twin_reals(&twin, v.codes, WINDOWS * 32);
  const struct twin_span code = twin_take(&twin, ERN_ELEMENT_REAL, 32);
  struct ern_audio_frame_args args[2];
  for (int b = 0; b < 2; b++)
    args[b] = (struct ern_audio_frame_args){
        .audio = {.code = code.on[b], .windows = windows.on[b], .parameters = block.on[b], .net = v.net},
        .codes = codes.on[b],
        .known = known};
  TWIN_RUN(&twin, audio_frame, args);
  float *found = twin_down(&twin, 1, codes.on[1]);
  for (int t = 0; t < WINDOWS; t++) /* those known keep their bits */
    for (int a = 0; a < 32 && (known >> t & 1) != 0; a++)
      assert_true(found[TWIN_GUARD + t * 32 + a] == v.codes[t * 32 + a]);
  free(found);
  expect_same("codes", &v.net, codes);
  expect_same("code of the frame", &v.net, code);
  twin_clear(&twin);
  values_free(&v);
}

static void test_frame(void **state) {
  (void)state;
  static const unsigned known[] = {0, 0xFF, 0x7F, 0x01, 0xFE, 0xA5, 0x5A, 0x10};
  for (size_t k = 0; k < sizeof known / sizeof *known; k += is_small() ? 5 : 1) {
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
  values_free(&v);
}

/* Scores of thousands and of 1e30: the softmax neither overflows nor divides by zero. */
static void test_loud(void **state) {
  (void)state;
  const float loud[] = {1e4f, 1e30f, 1e-30f, 0x1p-140f};
  for (size_t k = 0; k < sizeof loud / sizeof *loud; k += is_small() ? 2 : 1) {
    struct values v = values_make(29, 16, 32, loud[k]);
    check(&v);
    values_free(&v);
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
  values_free(&v);
  v = values_make(29, 16, 32, 1);
  v.dcode[3] = NAN;
  check(&v);
  v.dcode[3] = 0;
  v.block[v.net.conv_weight[2] + 50] = NAN;
  check(&v);
  values_free(&v);
  v = values_make(29, 1, 32, 1); /* one position: only middle taps count */
  for (int o = 0; o < 32; o++) {
    v.block[v.net.conv_weight[0] + (size_t)o * 87] = NAN;
    v.block[v.net.conv_weight[1] + (size_t)o * 96 + 5] = INFINITY;
  }
  check(&v);
  values_free(&v);
}

/* The same bytes on every run. */
static void test_again(void **state) {
  (void)state;
  struct values v = values_make(44, 16, 32, 1);
  struct ern_backend *device = twin.backend[1];
  float *first = NULL;
  for (int run = 0; run < 3; run++) {
    const struct twin_span windows = twin_reals(&twin, v.windows, v.inputs);
    const struct twin_span block = twin_reals(&twin, v.block, v.parameters);
    const struct twin_span dblock = twin_reals(&twin, v.dblock, v.parameters);
    const struct twin_span dcode = twin_reals(&twin, v.dcode, 32);
    struct ern_audio_bwd_args args = {.dparameters = dblock.on[1],
                                      .dcode = dcode.on[1],
                                      .forward = {.windows = windows.on[1], .parameters = block.on[1], .net = v.net}};
    support_ok(context, device->audio_bwd(twin.stream[1], &args));
    float *found = twin_down(&twin, 1, dblock.on[1]);
    if (first != NULL) assert_memory_equal(first, found, (v.parameters + 2 * TWIN_GUARD) * sizeof *found);
    if (first != NULL) free(found);
    if (first == NULL) first = found;
    twin_clear(&twin);
  }
  free(first);
  values_free(&v);
}

/* ---- measuring --------------------------------------------------------------------------------------------------- */

static int measure(void) {
  static const int form[][2] = {{29, 16}, {44, 16}, {1024, 2}};
  enum { REPEATS = 100 };
  context = support_context();
  twin_open(&twin, context);
  for (size_t f = 0; f < 3; f++) {
    struct values v = values_make(form[f][0], form[f][1], 32, 1);
    const struct twin_span windows = twin_reals(&twin, v.windows, v.inputs);
    const struct twin_span block = twin_reals(&twin, v.block, v.parameters);
    const struct twin_span dblock = twin_reals(&twin, v.dblock, v.parameters);
    const struct twin_span codes = twin_reals(&twin, v.codes, WINDOWS * 32);
    const struct twin_span code = twin_reals(&twin, v.dcode, 32);
    double least[2][3];
    for (int b = 0; b < 2; b++) {
      struct ern_audio_fwd_args forward = {
          .code = code.on[b], .windows = windows.on[b], .parameters = block.on[b], .net = v.net};
      struct ern_audio_bwd_args backward = {.dparameters = dblock.on[b], .dcode = code.on[b], .forward = forward};
      struct ern_audio_frame_args frame = {.audio = forward, .codes = codes.on[b], .known = 0x7F};
      struct ern_backend *backend = twin.backend[b];
      for (int what = 0; what < 3; what++) {
        least[b][what] = 1;
        for (int r = 0; r < REPEATS; r++) {
          float seen;
          const double begin = seconds_now();
          if (what == 0) support_ok(context, backend->audio_fwd(twin.stream[b], &forward));
          if (what == 1) support_ok(context, backend->audio_bwd(twin.stream[b], &backward));
          if (what == 2) support_ok(context, backend->audio_frame(twin.stream[b], &frame));
          support_ok(context, backend->download_reals(twin.stream[b], &seen, code.on[b], 1)); /* until it is done */
          least[b][what] = fmin(least[b][what], seconds_now() - begin);
        }
      }
    }
    printf(
        "audio of [%d, %d]: forward %.0f us (reference %.0f), backward %.0f (%.0f), a frame with one new window "
        "%.0f (%.0f)\n",
        form[f][1], form[f][0], 1e6 * least[1][0], 1e6 * least[0][0], 1e6 * least[1][1], 1e6 * least[0][1],
        1e6 * least[1][2], 1e6 * least[0][2]);
    twin_clear(&twin);
    values_free(&v);
  }
  twin_close(&twin);
  ern_context_free(&context);
  return 0;
}

static int set_up(void **state) {
  (void)state;
  context = support_context();
  twin_open(&twin, context);
  return 0;
}
static int tear_down(void **state) {
  (void)state;
  twin_close(&twin);
  ern_context_free(&context);
  return 0;
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) return measure();
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_lengths), cmocka_unit_test(test_widths),
                                     cmocka_unit_test(test_frame),   cmocka_unit_test(test_zeros),
                                     cmocka_unit_test(test_loud),    cmocka_unit_test(test_not_a_number),
                                     cmocka_unit_test(test_again)};
  return cmocka_run_group_tests_name("opencl audio", tests, set_up, tear_down);
}
