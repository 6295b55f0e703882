/* SPDX-License-Identifier: MIT
 * The audio networks, harmonics and sines have no kernels but the reference: its two builds, float and double, are held
 * against each other, and nothing may be written but the results. */
#include "kernelcheck.h"

#include "core/kernels.h"

/* The double build, as mlp.h declares it there. */
void ern_audio_fwd_ref64(double *code, const double *windows, const double *parameters,
                         const struct ern_audio_net *net);
void ern_audio_bwd_ref64(double *dparameters, const double *dcode, const double *windows, const double *parameters,
                         const struct ern_audio_net *net);
void ern_sh_fwd_ref64(double *y, size_t y_stride, const double *d, size_t d_stride, size_t n);
void ern_freq_fwd_ref64(double *y, size_t y_stride, const double *x, size_t x_stride, int dims, int octaves, size_t n);
void ern_freq_bwd_ref64(double *dx, size_t dx_stride, const double *dy, size_t dy_stride, const double *x,
                        size_t x_stride, int dims, int octaves, size_t n);

enum { WINDOWS = ERN_AUDIO_WINDOWS };

static double *widened(const float *values, size_t count) {
  double *wide = malloc((count + 1) * sizeof *wide);
  assert_non_null(wide);
  for (size_t i = 0; i < count; i++) wide[i] = values[i];
  return wide;
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

/* |float - double| relative to the largest value of the tensor. Twelve layers in a row, each a sum of K <= 3 D terms
 * that is off by at most K u of its absolute sum, are a worst case that no data meets; errors of sums add like a random
 * walk, sqrt(K) u. 12 layers of sqrt(3 * 1024) u make 4e-5; a LeakyReLU flipped by it moves a slope by 0.98 of a value
 * that is itself that small. */
static const double audio_tolerance = 4e-5;

static void expect_close(const char *what, const float *found, const double *expected, size_t count, double relative) {
  double largest = 0;
  for (size_t i = 0; i < count; i++) largest = fmax(largest, fabs(expected[i]));
  for (size_t i = 0; i < count; i++) {
    if (fabs(found[i] - expected[i]) <= relative * largest) continue;
    fail_msg("%s [%zu]: %.9g, double %.9g, largest %.3g", what, i, found[i], expected[i], largest);
  }
}

/* Window by window and then mixed: the same bits as in one go. */
static void check_parts(const float *whole, const float *windows, const float *block, const struct ern_audio_net *net) {
  struct guarded codes = guarded_make((size_t)(WINDOWS * net->code)), out = guarded_make((size_t)net->code);
  for (int t = 0; t < WINDOWS; t++)
    ern_audio_window_ref(codes.data + t * net->code, windows + t * net->window_length * net->width, block, net);
  ern_audio_mix_ref(out.data, codes.data, block, net);
  assert_memory_equal(out.data, whole, (size_t)net->code * sizeof *whole);
  guarded_check(&codes, 0, 0, 0, "codes of the windows");
  guarded_check(&out, 0, 0, 0, "code");
  guarded_free(&codes), guarded_free(&out);
}

static void check_audio(int width, int length, int code) {
  const struct ern_audio_net net = lay_out(width, length, code);
  const size_t values = net.first + net.count + 5, codes = (size_t)code;
  const size_t inputs = (size_t)(WINDOWS * length * width);
  struct guarded windows = guarded_make(inputs), block = guarded_make(values), dcode = guarded_make(codes);
  struct guarded out = guarded_make(codes), dblock = guarded_make(values);
  random_rows(&windows, 1, 0, inputs, 1, 1);
  random_rows(&dcode, 1, 0, codes, 1, 2);
  for (size_t i = 0; i < net.count; i++) {
    /* of the size that torch draws for 3 x 32 inputs; the first convolution's by its own width */
    const bool first = net.first + i < net.conv_bias[0];
    block.data[net.first + i] = random_at(3, i, 1.5f / sqrtf(first ? 3 * (float)width : 96));
    dblock.data[net.first + i] = 0;
  }
  double *wide_windows = widened(windows.data, inputs), *wide_block = widened(block.data, values);
  double *wide_dcode = widened(dcode.data, codes), *wide_out = widened(dcode.data, codes);
  double *wide_dblock = calloc(values, sizeof *wide_dblock);
  assert_non_null(wide_dblock);
  ern_audio_fwd_ref(out.data, windows.data, block.data, &net);
  ern_audio_fwd_ref64(wide_out, wide_windows, wide_block, &net);
  expect_close("code", out.data, wide_out, codes, audio_tolerance);
  check_parts(out.data, windows.data, block.data, &net);
  ern_audio_bwd_ref(dblock.data, dcode.data, windows.data, block.data, &net);
  ern_audio_bwd_ref64(wide_dblock, wide_dcode, wide_windows, wide_block, &net);
  expect_close("dparameters", dblock.data + net.first, wide_dblock + net.first, net.count, audio_tolerance);
  for (size_t i = 0; i < values; i++) {
    assert_true((i >= net.first && i < net.first + net.count) || is_poison(dblock.data[i]));
  }
  guarded_check(&out, 0, 0, 0, "code");
  guarded_check(&dblock, 0, 0, 0, "dparameters");
  guarded_free(&windows), guarded_free(&block), guarded_free(&dcode), guarded_free(&out), guarded_free(&dblock);
  free(wide_windows), free(wide_block), free(wide_dcode), free(wide_out), free(wide_dblock);
}

static void test_audio(void **state) {
  (void)state;
  check_audio(29, 16, 32);
  check_audio(44, 16, 32);
  check_audio(1024, 2, 32);
  check_audio(1, 1, 1);
  check_audio(7, 9, ERN_AUDIO_MAX_CODE);
}

/* Scores of thousands: the softmax neither overflows nor divides by zero. */
static void test_loud(void **state) {
  (void)state;
  const struct ern_audio_net net = lay_out(5, 16, 32);
  const size_t values = net.first + net.count;
  struct guarded windows = guarded_make(WINDOWS * 16 * 5), block = guarded_make(values), dblock = guarded_make(values);
  float code[32], dcode[32];
  random_rows(&windows, 1, 0, windows.count, 1e4f, 1);
  for (size_t i = 0; i < net.count; i++) {
    block.data[net.first + i] = random_at(3, i, 0.5f);
    dblock.data[net.first + i] = 0;
  }
  for (size_t i = 0; i < 32; i++) dcode[i] = 1;
  ern_audio_fwd_ref(code, windows.data, block.data, &net);
  ern_audio_bwd_ref(dblock.data, dcode, windows.data, block.data, &net);
  for (size_t i = 0; i < 32; i++) assert_true(isfinite(code[i]));
  for (size_t i = 0; i < net.count; i++) assert_true(isfinite(dblock.data[net.first + i]));
  guarded_free(&windows), guarded_free(&block), guarded_free(&dblock);
}

static const size_t sizes[] = {1, 2, 7, 64, 301};
enum { SIZES = sizeof sizes / sizeof *sizes };

/* Values up to 3; a degree-3 polynomial of rounded factors: 8 roundings of at most 2^-24 of its largest term, 6. */
static void test_harmonics(void **state) {
  (void)state;
  for (size_t s = 0; s < SIZES; s++) {
    const size_t n = sizes[s], stride = n + 3, d_stride = n + 2;
    struct guarded d = guarded_make(3 * d_stride), y = guarded_make(16 * stride);
    for (size_t i = 0; i < n; i++) {
      float v[3], norm = 0;
      for (size_t k = 0; k < 3; k++) {
        v[k] = i < 6 ? (i % 3 == k ? (i < 3 ? 1.0f : -1.0f) : 0) : random_at(5, 3 * i + k, 1);
        norm += v[k] * v[k];
      }
      for (size_t k = 0; k < 3; k++) d.data[k * d_stride + i] = v[k] / sqrtf(norm);
    }
    double *wide_d = widened(d.data, 3 * d_stride), *wide_y = widened(y.data, 16 * stride);
    ern_sh_fwd_ref(y.data, stride, d.data, d_stride, n);
    ern_sh_fwd_ref64(wide_y, stride, wide_d, d_stride, n);
    for (size_t r = 0; r < 16; r++) {
      for (size_t i = 0; i < n; i++) assert_true(fabs(y.data[r * stride + i] - wide_y[r * stride + i]) <= 48 * 0x1p-24);
    }
    guarded_check(&y, 16, stride, n, "sh");
    guarded_free(&d), guarded_free(&y), free(wide_d), free(wide_y);
  }
}

/* sin(2^o x + pi/2): the argument, up to 2^7 + 2, is rounded to half a unit in its last place. */
static void test_frequency(void **state) {
  (void)state;
  enum { DIMS = 2, OCTAVES = 8, ROWS = DIMS * (1 + 2 * OCTAVES) };
  for (size_t s = 0; s < SIZES; s++) {
    const size_t n = sizes[s], stride = n + 3, x_stride = n + 2;
    struct guarded x = guarded_make(DIMS * x_stride), dx = guarded_make(DIMS * x_stride);
    struct guarded y = guarded_make(ROWS * stride), dy = guarded_make(ROWS * stride);
    random_rows(&x, DIMS, x_stride, n, 1, 1);
    random_rows(&dx, DIMS, x_stride, n, 1, 2);
    random_rows(&dy, ROWS, stride, n, 1, 3);
    double *wide_x = widened(x.data, x.count), *wide_dx = widened(dx.data, dx.count);
    double *wide_y = widened(y.data, y.count), *wide_dy = widened(dy.data, dy.count);
    ern_freq_fwd_ref(y.data, stride, x.data, x_stride, DIMS, OCTAVES, n);
    ern_freq_fwd_ref64(wide_y, stride, wide_x, x_stride, DIMS, OCTAVES, n);
    ern_freq_bwd_ref(dx.data, x_stride, dy.data, stride, x.data, x_stride, DIMS, OCTAVES, n);
    ern_freq_bwd_ref64(wide_dx, x_stride, wide_dy, stride, wide_x, x_stride, DIMS, OCTAVES, n);
    for (size_t i = 0; i < n; i++) {
      for (size_t r = 0; r < ROWS; r++) {
        const double argument = r < DIMS ? 0 : ldexp(1, (int)((r - DIMS) / (2 * DIMS))) + 2;
        assert_true(fabs(y.data[r * stride + i] - wide_y[r * stride + i]) <= (argument + 2) * 0x1p-24);
      }
      for (size_t d = 0; d < DIMS; d++) { /* sum of 17 terms, the largest 2^7 and its partial sums at most 2^9 */
        assert_true(fabs(dx.data[d * x_stride + i] - wide_dx[d * x_stride + i]) <= 17 * 0x1p9 * 0x1p-24);
      }
    }
    guarded_check(&y, ROWS, stride, n, "frequency");
    guarded_check(&dx, DIMS, x_stride, n, "frequency dx");
    guarded_free(&x), guarded_free(&dx), guarded_free(&y), guarded_free(&dy);
    free(wide_x), free(wide_dx), free(wide_y), free(wide_dy);
  }
}

struct bench {
  struct ern_audio_net net;
  float *code, *windows, *block, *dblock;
  bool backward;
};

static void bench_run(void *user) {
  struct bench *bench = user;
  if (bench->backward) {
    ern_audio_bwd_ref(bench->dblock, bench->code, bench->windows, bench->block, &bench->net);
  } else {
    ern_audio_fwd_ref(bench->code, bench->windows, bench->block, &bench->net);
  }
}

static int measure(void) {
  static const int form[][2] = {{29, 16}, {44, 16}, {1024, 2}};
  for (size_t k = 0; k < 3; k++) {
    struct bench bench = {.net = lay_out(form[k][0], form[k][1], 32)};
    const size_t values = bench.net.first + bench.net.count;
    struct guarded code = guarded_make(32), block = guarded_make(values), dblock = guarded_make(values);
    struct guarded windows = guarded_make((size_t)(WINDOWS * form[k][0] * form[k][1]));
    random_rows(&windows, 1, 0, windows.count, 1, 1);
    random_rows(&block, 1, 0, values, 0.1f, 1);
    memset(dblock.data, 0, values * sizeof(float));
    bench.code = code.data, bench.block = block.data, bench.dblock = dblock.data, bench.windows = windows.data;
    const double forward = seconds_of(bench_run, &bench);
    bench.backward = true;
    printf("audio of [%d, %d]: forward %.2f ms, backward %.2f ms\n", form[k][1], form[k][0], 1e3 * forward,
           1e3 * seconds_of(bench_run, &bench));
    guarded_free(&code), guarded_free(&block), guarded_free(&dblock), guarded_free(&windows);
  }
  return 0;
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) return measure();
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_audio),
      cmocka_unit_test(test_loud),
      cmocka_unit_test(test_harmonics),
      cmocka_unit_test(test_frequency),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
