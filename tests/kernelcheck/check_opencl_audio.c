/* SPDX-License-Identifier: MIT
 * The audio networks on an OpenCL device against the reference. */
#include "kernelcheck.h"
#include "twin.h"

#if defined(ERN_OPENCL)
#include "mlp/audio_ops.h"

static ern_context *context;
static struct twin twin;

enum { WINDOWS = ERN_AUDIO_WINDOWS, MARGIN = 5 };

/* Relative to the largest value of the result: both sums of each layer, K <= 3 D terms in different orders, are off by
 * about sqrt(K) u; twelve layers in a row with K = 3 * 1024 make 4e-5 (check_audio.c holds the reference's two builds
 * to it), and here both sides are off. */
static const double audio_tolerance = 8e-5;

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
    v.dblock[i] = twin_random(5, i, 0.01f); /* gradients accumulate */
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

static void expect_same(const char *what, struct twin_span span) {
  twin_same(&twin, what, span, 0, audio_tolerance * largest_of(span));
}

/* Parts whose values are of their own size are held against their own largest. */
static void expect_gradient(const struct values *v, struct twin_span dblock) {
  const struct ern_audio_net *net = &v->net;
  const size_t borders[] = {0,
                            net->first,
                            net->conv_weight[1],
                            net->conv_weight[2],
                            net->conv_weight[3],
                            net->fc_weight[0],
                            net->fc_weight[1],
                            net->att_conv_weight[0],
                            net->att_fc_weight,
                            net->first + net->count,
                            v->parameters};
  float *expected = twin_down(&twin, 0, dblock.on[0]), *found = twin_down(&twin, 1, dblock.on[1]);
  for (size_t b = 0; b + 1 < sizeof borders / sizeof *borders; b++) {
    double most = 0;
    const bool margin = borders[b] < net->first || borders[b] >= net->first + net->count;
    for (size_t i = borders[b]; i < borders[b + 1]; i++)
      if (isfinite(expected[TWIN_GUARD + i])) most = fmax(most, fabs((double)expected[TWIN_GUARD + i]));
    for (size_t i = borders[b]; i < borders[b + 1]; i++)
      if (!twin_near(found[TWIN_GUARD + i], expected[TWIN_GUARD + i], 0, margin ? 0 : audio_tolerance * most))
        fail_msg("width %d, length %d, code %d: dparameters [%zu] of part %zu: device %.9g, reference %.9g, largest %g",
                 net->width, net->window_length, net->code, i, b, (double)found[TWIN_GUARD + i],
                 (double)expected[TWIN_GUARD + i], most);
  }
  for (size_t i = 0; i < TWIN_GUARD; i++)
    assert_true(found[i] == TWIN_POISON && found[TWIN_GUARD + v->parameters + i] == TWIN_POISON);
  free(expected), free(found);
}

static void check(const struct values *v) {
  const size_t code_count = (size_t)v->net.code;
  const struct twin_span windows = twin_reals(&twin, v->windows, v->inputs);
  const struct twin_span block = twin_reals(&twin, v->block, v->parameters);
  const struct twin_span dblock = twin_reals(&twin, v->dblock, v->parameters);
  const struct twin_span dcode = twin_reals(&twin, v->dcode, code_count);
  const struct twin_span code = twin_take(&twin, ERN_ELEMENT_REAL, code_count);
  struct ern_audio_args forward[2];
  struct ern_audio_bwd_args backward[2];
  for (int b = 0; b < 2; b++) {
    forward[b] =
        (struct ern_audio_args){.code = code.on[b], .windows = windows.on[b], .parameters = block.on[b], .net = v->net};
    backward[b] = (struct ern_audio_bwd_args){.dparameters = dblock.on[b], .dcode = dcode.on[b], .forward = forward[b]};
    backward[b].forward.code = (ern_span){0};
  }
  TWIN_RUN(&twin, audio_fwd, forward);
  expect_same("code", code);
  TWIN_RUN(&twin, audio_bwd, backward);
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
  expect_same("codes", codes);
  expect_same("code of the frame", code);
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
      struct ern_audio_args forward = {
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
#else
int main(void) { return 0; }
#endif
