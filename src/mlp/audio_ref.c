/* SPDX-License-Identifier: MIT
 * Reference of the audio networks (docs/maths.md, Speech): AudioNet turns each of eight windows into a code,
 * AudioAttNet computes the weighted mean of the eight codes. */
#include <stdbool.h>
#include <tgmath.h>

#include "mlp/audio_ops.h"
#include "mlp/conv1d_ref.h"

enum { WINDOWS = ERN_AUDIO_WINDOWS, CONVS = ERN_AUDIO_CONVS, ATT_CONVS = ERN_AUDIO_ATT_CONVS, HIDDEN = 64 };

/* Most values of a layer: 64 channels; 16 inputs leave 8 positions after the first convolution, which has 32. */
enum { CONV_VALUES = 256, ATT_VALUES = 16 * WINDOWS };

static const int conv_width[CONVS] = {32, 32, 64, 64};
static const int att_width[ATT_CONVS] = {16, 8, 4, 2, 1};

/* Values that the backward pass of a window needs. Activations are stored after the LeakyReLU, which keeps the sign. */
struct window_values {
  ern_real conv[CONVS][CONV_VALUES]; /* [channels][positions] */
  ern_real hidden[HIDDEN];
};

struct audio_values {
  ern_real code[WINDOWS][ERN_AUDIO_MAX_CODE];
  ern_real att[ATT_CONVS][ATT_VALUES]; /* [channels][8] */
  ern_real weight[WINDOWS];            /* softmax */
};

/* Clamps to ERN_AUDIO_LIMIT; NaN stays NaN. */
static ern_real held(ern_real x) {
  return x > ERN_AUDIO_LIMIT ? ERN_AUDIO_LIMIT : x < -ERN_AUDIO_LIMIT ? -ERN_AUDIO_LIMIT : x;
}
static bool is_held(ern_real x) { return fabs(x) >= ERN_AUDIO_LIMIT; }

static void leaky_relu(ern_real *values, int count) {
  for (int i = 0; i < count; i++) values[i] = held(values[i] > 0 ? values[i] : (ern_real)0.02 * values[i]);
}

static void leaky_relu_bwd(ern_real *gradient, const ern_real *value, int count) {
  for (int i = 0; i < count; i++)
    gradient[i] = is_held(value[i]) ? 0 : value[i] > 0 ? gradient[i] : (ern_real)0.02 * gradient[i];
}

/* y [outs] = W [outs][ins] x + b */
static void linear_fwd(ern_real *y, const ern_real *x, const ern_real *w, const ern_real *b, int outs, int ins) {
  for (int j = 0; j < outs; j++) {
    ern_real sum = b[j];
    for (int k = 0; k < ins; k++) sum += w[j * ins + k] * x[k];
    y[j] = sum;
  }
}

/* dW += dy x^T, db += dy, dx += W^T dy */
static void linear_bwd(ern_real *dx, ern_real *dw, ern_real *db, const ern_real *dy, const ern_real *x,
                       const ern_real *w, int outs, int ins) {
  for (int j = 0; j < outs; j++) {
    db[j] += dy[j];
    for (int k = 0; k < ins; k++) {
      dw[j * ins + k] += dy[j] * x[k];
      dx[k] += w[j * ins + k] * dy[j];
    }
  }
}

/* Convolution l of AudioNet; the first reads a window as the file has it, [time][channel]. */
static struct ern_conv1d window_conv(const struct ern_audio_net *net, int l) {
  int length = net->window_length;
  for (int k = 0; k < l; k++) length = ern_conv1d_length(length, 2);
  struct ern_conv1d conv = {.out = conv_width[l],
                            .in = l > 0 ? conv_width[l - 1] : net->width,
                            .length = length,
                            .stride = 2,
                            .channel = (size_t)length,
                            .time = 1};
  if (l == 0) {
    conv.channel = 1;
    conv.time = (size_t)net->width;
  }
  return conv;
}

/* Convolution l of AudioAttNet, over the windows; the first reads the codes [window][channel]. */
static struct ern_conv1d att_conv(const struct ern_audio_net *net, int l) {
  struct ern_conv1d conv = {.out = att_width[l],
                            .in = l > 0 ? att_width[l - 1] : net->code,
                            .length = WINDOWS,
                            .stride = 1,
                            .channel = WINDOWS,
                            .time = 1};
  if (l == 0) {
    conv.channel = 1;
    conv.time = ERN_AUDIO_MAX_CODE;
  }
  return conv;
}

static void window_fwd(ern_real *code, struct window_values *values, const ern_real *window, const ern_real *parameters,
                       const struct ern_audio_net *net) {
  for (int l = 0; l < CONVS; l++) {
    const struct ern_conv1d conv = window_conv(net, l);
    ERN_REF(ern_conv1d_fwd)
    (values->conv[l], l > 0 ? values->conv[l - 1] : window, parameters + net->conv_weight[l],
     parameters + net->conv_bias[l], &conv);
    leaky_relu(values->conv[l], conv.out * ern_conv1d_length(conv.length, conv.stride));
  }
  linear_fwd(values->hidden, values->conv[CONVS - 1], parameters + net->fc_weight[0], parameters + net->fc_bias[0],
             HIDDEN, HIDDEN);
  leaky_relu(values->hidden, HIDDEN);
  linear_fwd(code, values->hidden, parameters + net->fc_weight[1], parameters + net->fc_bias[1], net->code, HIDDEN);
  for (int a = 0; a < net->code; a++) code[a] = held(code[a]);
}

/* There is no gradient by the window itself: features are data. */
static void window_bwd(ern_real *dparameters, const ern_real *dcode, const struct window_values *values,
                       const ern_real *window, const ern_real *parameters, const struct ern_audio_net *net) {
  ern_real dconv[CONVS][CONV_VALUES] = {{0}}, dhidden[HIDDEN] = {0};
  linear_bwd(dhidden, dparameters + net->fc_weight[1], dparameters + net->fc_bias[1], dcode, values->hidden,
             parameters + net->fc_weight[1], net->code, HIDDEN);
  leaky_relu_bwd(dhidden, values->hidden, HIDDEN);
  linear_bwd(dconv[CONVS - 1], dparameters + net->fc_weight[0], dparameters + net->fc_bias[0], dhidden,
             values->conv[CONVS - 1], parameters + net->fc_weight[0], HIDDEN, HIDDEN);
  for (int l = CONVS - 1; l >= 0; l--) {
    const struct ern_conv1d conv = window_conv(net, l);
    leaky_relu_bwd(dconv[l], values->conv[l], conv.out * ern_conv1d_length(conv.length, conv.stride));
    ERN_REF(ern_conv1d_bwd)
    (l > 0 ? dconv[l - 1] : NULL, dparameters + net->conv_weight[l], dparameters + net->conv_bias[l], dconv[l],
     l > 0 ? values->conv[l - 1] : window, parameters + net->conv_weight[l], &conv);
  }
}

/* w_t = exp(x_t - max x) / sum exp(x - max x) */
static void softmax(ern_real *w, const ern_real *x) {
  ern_real most = x[0], sum = 0;
  for (int t = 1; t < WINDOWS; t++) most = x[t] > most ? x[t] : most;
  for (int t = 0; t < WINDOWS; t++) {
    w[t] = exp(x[t] - most);
    sum += w[t];
  }
  for (int t = 0; t < WINDOWS; t++) w[t] /= sum;
}

static void attention_fwd(struct audio_values *values, const ern_real *parameters, const struct ern_audio_net *net) {
  for (int l = 0; l < ATT_CONVS; l++) {
    const struct ern_conv1d conv = att_conv(net, l);
    ERN_REF(ern_conv1d_fwd)
    (values->att[l], l > 0 ? values->att[l - 1] : values->code[0], parameters + net->att_conv_weight[l],
     parameters + net->att_conv_bias[l], &conv);
    leaky_relu(values->att[l], conv.out * WINDOWS);
  }
  ern_real score[WINDOWS];
  linear_fwd(score, values->att[ATT_CONVS - 1], parameters + net->att_fc_weight, parameters + net->att_fc_bias, WINDOWS,
             WINDOWS);
  softmax(values->weight, score);
}

/* dcode[t][a] += the gradient through the attention weights; dweight_t = sum_a da_a code[t][a] */
static void attention_bwd(ern_real *dparameters, ern_real (*dcode)[ERN_AUDIO_MAX_CODE], const ern_real *dweight,
                          const struct audio_values *values, const ern_real *parameters,
                          const struct ern_audio_net *net) {
  ern_real mean = 0, dscore[WINDOWS], datt[ATT_CONVS][ATT_VALUES] = {{0}};
  for (int t = 0; t < WINDOWS; t++) mean += values->weight[t] * dweight[t];
  for (int t = 0; t < WINDOWS; t++) dscore[t] = values->weight[t] * (dweight[t] - mean);
  linear_bwd(datt[ATT_CONVS - 1], dparameters + net->att_fc_weight, dparameters + net->att_fc_bias, dscore,
             values->att[ATT_CONVS - 1], parameters + net->att_fc_weight, WINDOWS, WINDOWS);
  for (int l = ATT_CONVS - 1; l >= 0; l--) {
    const struct ern_conv1d conv = att_conv(net, l);
    leaky_relu_bwd(datt[l], values->att[l], conv.out * WINDOWS);
    ERN_REF(ern_conv1d_bwd)
    (l > 0 ? datt[l - 1] : dcode[0], dparameters + net->att_conv_weight[l], dparameters + net->att_conv_bias[l],
     datt[l], l > 0 ? values->att[l - 1] : values->code[0], parameters + net->att_conv_weight[l], &conv);
  }
}

/* a = sum_t w_t code_t */
static void mix_fwd(ern_real *code, struct audio_values *values, const ern_real *parameters,
                    const struct ern_audio_net *net) {
  attention_fwd(values, parameters, net);
  for (int a = 0; a < net->code; a++) {
    code[a] = 0;
    for (int t = 0; t < WINDOWS; t++) code[a] += values->weight[t] * values->code[t][a];
  }
}

void ERN_REF(ern_audio_fwd)(ern_real *code, const ern_real *windows, const ern_real *parameters,
                            const struct ern_audio_net *net) {
  struct audio_values values;
  struct window_values scrap;
  const size_t window_values = (size_t)net->window_length * (size_t)net->width;
  for (int t = 0; t < WINDOWS; t++) {
    window_fwd(values.code[t], &scrap, windows + (size_t)t * window_values, parameters, net);
  }
  mix_fwd(code, &values, parameters, net);
}

void ERN_REF(ern_audio_window)(ern_real *code, const ern_real *window, const ern_real *parameters,
                               const struct ern_audio_net *net) {
  struct window_values scrap;
  window_fwd(code, &scrap, window, parameters, net);
}

static void take_codes(struct audio_values *values, const ern_real *codes, const struct ern_audio_net *net) {
  for (int t = 0; t < WINDOWS; t++) {
    for (int a = 0; a < net->code; a++) values->code[t][a] = codes[t * net->code + a];
  }
}

void ERN_REF(ern_audio_mix)(ern_real *code, const ern_real *codes, const ern_real *parameters,
                            const struct ern_audio_net *net) {
  struct audio_values values;
  take_codes(&values, codes, net);
  mix_fwd(code, &values, parameters, net);
}

void ERN_REF(ern_audio_mix_bwd)(ern_real *dparameters, ern_real *dcodes, const ern_real *dcode, const ern_real *codes,
                                const ern_real *parameters, const struct ern_audio_net *net) {
  struct audio_values values;
  take_codes(&values, codes, net);
  attention_fwd(&values, parameters, net);
  ern_real gradient[WINDOWS][ERN_AUDIO_MAX_CODE] = {{0}}, dweight[WINDOWS] = {0};
  for (int t = 0; t < WINDOWS; t++) {
    for (int a = 0; a < net->code; a++) {
      gradient[t][a] = values.weight[t] * dcode[a];
      dweight[t] += values.code[t][a] * dcode[a];
    }
  }
  attention_bwd(dparameters, gradient, dweight, &values, parameters, net);
  for (int t = 0; t < WINDOWS; t++) {
    for (int a = 0; a < net->code; a++) dcodes[t * net->code + a] = is_held(values.code[t][a]) ? 0 : gradient[t][a];
  }
}

void ERN_REF(ern_audio_bwd)(ern_real *dparameters, const ern_real *dcode, const ern_real *windows,
                            const ern_real *parameters, const struct ern_audio_net *net) {
  ern_real codes[WINDOWS * ERN_AUDIO_MAX_CODE], dcodes[WINDOWS * ERN_AUDIO_MAX_CODE];
  struct window_values window[WINDOWS];
  const size_t window_values = (size_t)net->window_length * (size_t)net->width;
  for (int t = 0; t < WINDOWS; t++) {
    window_fwd(codes + t * net->code, &window[t], windows + (size_t)t * window_values, parameters, net);
  }
  ERN_REF(ern_audio_mix_bwd)(dparameters, dcodes, dcode, codes, parameters, net);
  for (int t = 0; t < WINDOWS; t++) {
    window_bwd(dparameters, dcodes + t * net->code, &window[t], windows + (size_t)t * window_values, parameters, net);
  }
}
