/* SPDX-License-Identifier: MIT
 * Backward of the audio networks against central differences in double. The equations are written once more here, in
 * the plainest way, to tell where they have kinks and to hold the forward pass against. */
#define ERN_DOUBLE
#include "difference.h"
#include "mlp/audio_ops.h"

enum { WINDOWS = ERN_AUDIO_WINDOWS, MAX_WIDTH = 40, MAX_LENGTH = 16, CODE = 12, MAX_VALUES = 60000, FRONT = 5 };

struct audio {
  struct ern_audio_net net;
  double parameters[MAX_VALUES], dparameters[MAX_VALUES];
  double windows[WINDOWS * MAX_LENGTH * MAX_WIDTH];
  double code[CODE], dcode[CODE];
};

typedef double channels[64][MAX_LENGTH];

static double leaky(double x, uint64_t *hash) {
  *hash = difference_hash(*hash, x > 0);
  return x > 0 ? x : 0.02 * x;
}

/* y[o][t] = leaky(b[o] + sum W[o][c][k] x[c][t*stride + k - 1]); returns the new length */
static int convolve(channels y, double (*x)[MAX_LENGTH], const double *w, const double *b, int outs, int ins,
                    int length, int stride, uint64_t *hash) {
  int count = 0;
  for (int first = -1; first + 2 <= length; first += stride, count++) {
    for (int o = 0; o < outs; o++) {
      double sum = b[o];
      for (int c = 0; c < ins; c++) {
        for (int k = 0; k < 3; k++) {
          if (first + k >= 0 && first + k < length) sum += w[(o * ins + c) * 3 + k] * x[c][first + k];
        }
      }
      y[o][count] = leaky(sum, hash);
    }
  }
  return count;
}

static double affine(const double *w, const double *b, int j, const double *x, int ins) {
  double sum = b[j];
  for (int k = 0; k < ins; k++) sum += w[j * ins + k] * x[k];
  return sum;
}

/* The code, and a hash of the signs on the way. */
static uint64_t evaluate(const struct audio *audio, double *code) {
  static const int conv[] = {32, 32, 64, 64}, att[] = {16, 8, 4, 2, 1};
  const struct ern_audio_net *net = &audio->net;
  const double *block = audio->parameters;
  uint64_t hash = 0xcbf29ce484222325u;
  double codes[WINDOWS][CODE];
  for (int w = 0; w < WINDOWS; w++) {
    static channels a, b;
    for (int c = 0; c < net->width; c++) {
      for (int t = 0; t < net->window_length; t++) {
        a[c][t] = audio->windows[(w * net->window_length + t) * net->width + c];
      }
    }
    int length = net->window_length, ins = net->width;
    for (int l = 0; l < 4; l++) {
      length = convolve(b, a, block + net->conv_weight[l], block + net->conv_bias[l], conv[l], ins, length, 2, &hash);
      ins = conv[l];
      memcpy(a, b, sizeof a);
    }
    assert_int_equal(length, 1);
    double x[64], hidden[64];
    for (int k = 0; k < 64; k++) x[k] = a[k][0];
    for (int j = 0; j < 64; j++) {
      hidden[j] = leaky(affine(block + net->fc_weight[0], block + net->fc_bias[0], j, x, 64), &hash);
    }
    for (int j = 0; j < net->code; j++) {
      codes[w][j] = affine(block + net->fc_weight[1], block + net->fc_bias[1], j, hidden, 64);
    }
  }
  static channels a, b;
  for (int c = 0; c < net->code; c++) {
    for (int t = 0; t < WINDOWS; t++) a[c][t] = codes[t][c];
  }
  for (int l = 0, ins = net->code; l < 5; ins = att[l], l++) {
    convolve(b, a, block + net->att_conv_weight[l], block + net->att_conv_bias[l], att[l], ins, WINDOWS, 1, &hash);
    memcpy(a, b, sizeof a);
  }
  double weight[WINDOWS], sum = 0;
  for (int t = 0; t < WINDOWS; t++) {
    weight[t] = exp(affine(block + net->att_fc_weight, block + net->att_fc_bias, t, a[0], WINDOWS));
    sum += weight[t];
  }
  for (int j = 0; j < net->code; j++) {
    code[j] = 0;
    for (int t = 0; t < WINDOWS; t++) code[j] += weight[t] / sum * codes[t][j];
  }
  return hash;
}

static uint64_t audio_piece(void *user) {
  double code[CODE];
  return evaluate(user, code);
}

static double audio_loss(void *user) {
  struct audio *audio = user;
  ern_audio_fwd_ref64(audio->code, audio->windows, audio->parameters, &audio->net);
  double loss = 0;
  for (int a = 0; a < audio->net.code; a++) loss += audio->code[a] * audio->dcode[a];
  return loss;
}

/* One tensor after the other, uniform in middle +- scale. Weights in +-2/sqrt(inputs), so that values keep their size
 * from layer to layer; positive biases, so that neither are most units on the weak side of their kinks nor many near
 * them. */
static void place(struct audio *audio, size_t *at, size_t *end, size_t count, double scale, double middle) {
  static uint64_t seed = 0;
  *at = *end;
  *end += count;
  assert_true(*end <= MAX_VALUES);
  difference_fill(audio->parameters + *at, count, scale, ++seed);
  for (size_t i = *at; i < *end; i++) audio->parameters[i] += middle;
}

static void lay_out(struct audio *audio) {
  static const int conv[] = {32, 32, 64, 64}, att[] = {16, 8, 4, 2, 1};
  struct ern_audio_net *net = &audio->net;
  size_t end = FRONT;
  net->first = end;
  for (int l = 0, ins = net->width; l < 4; ins = conv[l], l++) {
    place(audio, &net->conv_weight[l], &end, (size_t)(conv[l] * ins * 3), 2 / sqrt(3 * ins), 0);
    place(audio, &net->conv_bias[l], &end, (size_t)conv[l], 0.5, 0.5);
  }
  for (int l = 0; l < 2; l++) {
    place(audio, &net->fc_weight[l], &end, (size_t)((l == 0 ? 64 : net->code) * 64), 2 / sqrt(64), 0);
    place(audio, &net->fc_bias[l], &end, (size_t)(l == 0 ? 64 : net->code), 0.5, 0.5);
  }
  for (int l = 0, ins = net->code; l < 5; ins = att[l], l++) {
    place(audio, &net->att_conv_weight[l], &end, (size_t)(att[l] * ins * 3), 2 / sqrt(3 * ins), 0);
    place(audio, &net->att_conv_bias[l], &end, (size_t)att[l], 0.5, 0.5);
  }
  place(audio, &net->att_fc_weight, &end, 64, 2 / sqrt(8), 0);
  place(audio, &net->att_fc_bias, &end, 8, 0.5, 0.5);
  net->count = end - FRONT;
}

static void check_audio(int width, int length) {
  static struct audio audio;
  memset(&audio, 0, sizeof audio);
  audio.net = (struct ern_audio_net){.width = width, .window_length = length, .code = CODE};
  lay_out(&audio);
  difference_fill(audio.windows, (size_t)(WINDOWS * length * width), 1, 500);
  difference_fill(audio.dcode, CODE, 1, 501);
  double code[CODE];
  evaluate(&audio, code);
  audio_loss(&audio);
  for (int a = 0; a < CODE; a++) assert_true(fabs(code[a] - audio.code[a]) <= 1e-12);

  for (size_t i = 0; i < MAX_VALUES; i++) audio.dparameters[i] = 1;
  ern_audio_bwd_ref64(audio.dparameters, audio.dcode, audio.windows, audio.parameters, &audio.net);
  for (size_t i = 0; i < MAX_VALUES; i++) audio.dparameters[i] -= 1;
  for (size_t i = 0; i < MAX_VALUES; i++) {
    if (i < FRONT || i >= FRONT + audio.net.count) assert_true(audio.dparameters[i] == 0);
  }
  const struct difference of = {audio_loss, audio_piece, &audio};
  const struct ern_audio_net *net = &audio.net;
  const size_t end = FRONT + net->count;
  const size_t bound[] = {net->conv_weight[0],
                          net->conv_bias[0],
                          net->conv_weight[1],
                          net->conv_bias[1],
                          net->conv_weight[2],
                          net->conv_bias[2],
                          net->conv_weight[3],
                          net->conv_bias[3],
                          net->fc_weight[0],
                          net->fc_bias[0],
                          net->fc_weight[1],
                          net->fc_bias[1],
                          net->att_conv_weight[0],
                          net->att_conv_bias[0],
                          net->att_conv_weight[1],
                          net->att_conv_bias[1],
                          net->att_conv_weight[2],
                          net->att_conv_bias[2],
                          net->att_conv_weight[3],
                          net->att_conv_bias[3],
                          net->att_conv_weight[4],
                          net->att_conv_bias[4],
                          net->att_fc_weight,
                          net->att_fc_bias,
                          end};
  for (size_t k = 0; k + 1 < sizeof bound / sizeof *bound; k++) {
    const size_t count = bound[k + 1] - bound[k];
    size_t step = (1 + count / 23) | 1; /* no multiple of 2 or 3: meets all channels and taps */
    if (step % 3 == 0) step += 2;
    char name[32];
    snprintf(name, sizeof name, "tensor %zu of %d x %d", k, length, width);
    difference_check(&of, name, audio.parameters + bound[k], audio.dparameters + bound[k], count,
                     count > 64 ? step : 1);
  }
}

static void test_deepspeech(void **state) {
  (void)state;
  check_audio(29, 16);
}

static void test_two_vectors(void **state) {
  (void)state;
  check_audio(40, 2);
}

static void test_odd_lengths_long(void **state) {
  (void)state;
  check_audio(3, 1);
  check_audio(5, 7);
  check_audio(4, 11);
}

/* Values beyond the limit stay at it, and nothing before them has a gradient: neither by differences nor by backward.
 */
static void check_held(bool code) {
  static struct audio audio;
  memset(&audio, 0, sizeof audio);
  audio.net = (struct ern_audio_net){.width = 4, .window_length = 16, .code = CODE};
  lay_out(&audio);
  difference_fill(audio.windows, WINDOWS * 16 * 4, 1, 500);
  difference_fill(audio.dcode, CODE, 1, 501);
  const struct ern_audio_net *net = &audio.net;
  const size_t held = code ? net->fc_weight[1] : net->fc_weight[0],
               end = code ? net->att_conv_weight[0] : net->fc_weight[1];
  for (size_t i = held; i < end; i++) audio.parameters[i] *= 1e12;
  for (size_t i = end; !code && i < net->fc_bias[1]; i++) audio.parameters[i] *= 1e-6; /* the code is not held too */
  ern_audio_bwd_ref64(audio.dparameters, audio.dcode, audio.windows, audio.parameters, net);
  const double loss = audio_loss(&audio);
  for (int a = 0; a < CODE; a++) assert_true(fabs(audio.code[a]) <= ERN_AUDIO_LIMIT);
  for (size_t i = net->first; i < end; i++) {
    assert_true(audio.dparameters[i] == 0);
    if (i % 97 != 0) continue;
    const double kept = audio.parameters[i];
    audio.parameters[i] += 1e-5 * fmax(1, fabs(kept));
    assert_true(audio_loss(&audio) == loss);
    audio.parameters[i] = kept;
  }
  double behind = 0;
  for (size_t i = end; i < net->first + net->count; i++) behind = fmax(behind, fabs(audio.dparameters[i]));
  assert_true(isfinite(behind) && (code || behind > 0)); /* codes of 1e6 are a choice of one window */
}

static void test_held(void **state) {
  (void)state;
  check_held(true);
  check_held(false);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_deepspeech),
      cmocka_unit_test(test_two_vectors),
      cmocka_unit_test(test_odd_lengths_long),
      cmocka_unit_test(test_held),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
