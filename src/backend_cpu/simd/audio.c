/* SPDX-License-Identifier: MIT
 * AudioNet on the eight windows for any instruction set (simd/isa.h); AudioAttNet is small and uses the reference.
 *
 * It runs layer by layer for all windows. Lanes are channels: outputs in the forward pass, inputs in the backward pass.
 * Every product is rounded separately and each sum keeps the reference's order, so the results are bit-identical to the
 * reference's. Activations are stored as [window][position][channel]. */
#include <math.h>
#include <stdbool.h>

#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes.h"
#include "mlp/audio_ops.h"

enum {
  WINDOWS = ERN_AUDIO_WINDOWS,
  LAYERS = ERN_AUDIO_CONVS + 2,
  HIDDEN = 64,
  CHUNK = 64, /* input channels whose weights are transposed at a time */
  MOST = ERN_AUDIO_MAX_CODE
};

/* A zero-padded convolution, or with `kernel` 1 and length 1 a linear layer. Weights [out][in][kernel]. */
struct layer {
  int in, out, kernel, stride, length, positions;
  size_t weight, bias; /* offsets in the block of parameters */
};

/* Input and output, or their gradients, of a layer: steps from window to window and from position to position. */
struct rows {
  float *data;
  size_t window, position;
};

/* Activations of all windows; the channels of a position are padded to a register. */
struct values {
  float conv0[WINDOWS * 8 * 32], conv1[WINDOWS * 4 * 32], conv2[WINDOWS * 2 * HIDDEN], conv3[WINDOWS * HIDDEN];
  float hidden[WINDOWS * HIDDEN], code[WINDOWS * MOST];
};

static size_t padded(int count) { return ((size_t)count + LANES - 1) / LANES * LANES; }

static void layers_of(struct layer layer[LAYERS], const struct ern_audio_net *net) {
  static const int width[ERN_AUDIO_CONVS] = {32, 32, HIDDEN, HIDDEN};
  int in = net->width, length = net->window_length;
  for (int l = 0; l < ERN_AUDIO_CONVS; l++) {
    const int positions = (length - 1) / 2 + 1;
    layer[l] = (struct layer){in, width[l], 3, 2, length, positions, net->conv_weight[l], net->conv_bias[l]};
    in = width[l];
    length = positions;
  }
  layer[LAYERS - 2] = (struct layer){HIDDEN, HIDDEN, 1, 1, 1, 1, net->fc_weight[0], net->fc_bias[0]};
  layer[LAYERS - 1] = (struct layer){HIDDEN, net->code, 1, 1, 1, 1, net->fc_weight[1], net->fc_bias[1]};
}

/* Output of layer l. */
static struct rows output_of(struct values *v, const struct layer *layer, int l) {
  float *const data[LAYERS] = {v->conv0, v->conv1, v->conv2, v->conv3, v->hidden, v->code};
  const size_t position = l == LAYERS - 1 ? MOST : (size_t)layer[l].out;
  return (struct rows){data[l], (size_t)layer[l].positions * position, position};
}
static struct rows input_of(struct values *v, const struct layer *layer, int l, const float *windows) {
  union {
    const float *read;
    float *data; /* is only read */
  } input = {.read = windows};
  const size_t width = (size_t)layer[0].in;
  return l > 0 ? output_of(v, layer, l - 1) : (struct rows){input.data, (size_t)layer[0].length * width, width};
}

/* ---- forward ----------------------------------------------------------------------------------------------------- */

/* y [blocks registers] += transposed [count][out] times x [count] */
LANES_INLINE void add_products(float *y, const float *transposed, size_t out, const float *x, size_t count,
                               size_t blocks) {
  vf sum[4];
  for (size_t b = 0; b < blocks; b++) sum[b] = vf_load(y + b * LANES);
  for (size_t c = 0; c < count; c++) {
    const vf value = vf_all(x[c]);
    for (size_t b = 0; b < blocks; b++) sum[b] += vf_multiply_rounded(vf_load(transposed + c * out + b * LANES), value);
  }
  for (size_t b = 0; b < blocks; b++) vf_store(y + b * LANES, sum[b]);
}

static void add_all_products(float *y, const float *transposed, size_t out, const float *x, size_t count) {
  size_t o = 0;
  for (; o + 4 * LANES <= out; o += 4 * LANES) add_products(y + o, transposed + o, out, x, count, 4);
  for (; o + 2 * LANES <= out; o += 2 * LANES) add_products(y + o, transposed + o, out, x, count, 2);
  for (; o < out; o += LANES) add_products(y + o, transposed + o, out, x, count, 1);
}

/* The input position that tap k of output position t reads, or -1 for padding. */
static int reads(const struct layer *l, int t, int k) {
  const int at = t * l->stride + k - l->kernel / 2;
  return at < l->length ? at : -1;
}

/* y = b + W x */
static void layer_fwd(struct rows y, struct rows x, const float *parameters, const struct layer *l) {
  const float *weight = parameters + l->weight, *bias = parameters + l->bias;
  const size_t out = padded(l->out), in = (size_t)l->in, kernel = (size_t)l->kernel;
  float transposed[CHUNK * MOST];
  for (size_t n = 0; n < WINDOWS; n++) {
    for (size_t t = 0; t < (size_t)l->positions; t++) {
      float *to = y.data + n * y.window + t * y.position;
      for (size_t o = 0; o < out; o++) to[o] = o < (size_t)l->out ? bias[o] : 0;
    }
  }
  for (size_t k = 0; k < kernel; k++) {
    for (size_t begin = 0; begin < in; begin += CHUNK) {
      const size_t count = in - begin < CHUNK ? in - begin : CHUNK;
      for (size_t o = 0; o < out; o++)
        for (size_t c = 0; c < count; c++)
          transposed[c * out + o] = o < (size_t)l->out ? weight[(o * in + begin + c) * kernel + k] : 0;
      for (size_t n = 0; n < WINDOWS; n++) {
        for (int t = 0; t < l->positions; t++) {
          const int at = reads(l, t, (int)k);
          if (at < 0) continue;
          add_all_products(y.data + n * y.window + (size_t)t * y.position, transposed, out,
                           x.data + n * x.window + (size_t)at * x.position + begin, count);
        }
      }
    }
  }
}

static float held(float x) {
  return x > ERN_AUDIO_LIMIT ? ERN_AUDIO_LIMIT : x < -ERN_AUDIO_LIMIT ? -ERN_AUDIO_LIMIT : x;
}

static void windows_fwd(struct values *v, const float *windows, const float *parameters, const struct layer *layer) {
  for (int l = 0; l < LAYERS; l++) {
    const struct rows y = output_of(v, layer, l);
    layer_fwd(y, input_of(v, layer, l, windows), parameters, &layer[l]);
    for (size_t i = 0; i < WINDOWS * y.window; i++) {
      if (l == LAYERS - 1 && i % y.window >= padded(layer[l].out)) continue; /* never written */
      const float value = y.data[i];
      y.data[i] = held(value > 0 || l == LAYERS - 1 ? value : 0.02f * value);
    }
  }
}

/* [8][A] */
static void pack_codes(float *codes, const struct values *v, size_t count) {
  for (size_t n = 0; n < WINDOWS; n++) memcpy(codes + n * count, v->code + n * MOST, count * sizeof *codes);
}

void ERN_ISA(ern_audio_fwd)(float *code, const float *windows, const float *parameters,
                            const struct ern_audio_net *net) {
  struct layer layer[LAYERS];
  struct values values;
  float codes[WINDOWS * MOST];
  layers_of(layer, net);
  windows_fwd(&values, windows, parameters, layer);
  pack_codes(codes, &values, (size_t)net->code);
  ern_audio_mix_ref(code, codes, parameters, net);
}

/* ---- backward ---------------------------------------------------------------------------------------------------- */

/* Transposes the weights of one output: [kernel][CHUNK], 0 from `count` to the end of a register. */
static void turn(float *transposed, const float *weight, size_t count, size_t kernel) {
  for (size_t k = 0; k < kernel; k++)
    for (size_t c = 0; c < padded((int)count); c++) transposed[k * CHUNK + c] = c < count ? weight[c * kernel + k] : 0;
}
static void turn_back(float *weight, const float *transposed, size_t count, size_t kernel) {
  for (size_t k = 0; k < kernel; k++)
    for (size_t c = 0; c < count; c++) weight[c * kernel + k] = transposed[k * CHUNK + c];
}

/* dW += gradient x; dx += gradient W, where it is wanted */
LANES_INLINE void add_gradient(float *dweight, float *dx, float gradient, const float *x, const float *weight,
                               size_t count) {
  const vf all = vf_all(gradient);
  for (size_t c = 0; c < count; c += LANES) {
    const size_t some = count - c < LANES ? count - c : LANES;
    vf_store(dweight + c, vf_load(dweight + c) + vf_multiply_rounded(all, vf_load_partial(x + c, some)));
    if (dx != NULL)
      vf_store_partial(dx + c, vf_load_partial(dx + c, some) + vf_multiply_rounded(vf_load(weight + c), all), some);
  }
}

/* dx.data NULL: not wanted */
static void layer_bwd(struct rows dx, float *dparameters, struct rows dy, struct rows x, const float *parameters,
                      const struct layer *l) {
  const size_t in = (size_t)l->in, kernel = (size_t)l->kernel;
  float weight[3 * CHUNK], dweight[3 * CHUNK];
  for (size_t o = 0; o < (size_t)l->out; o++) {
    for (size_t n = 0; n < WINDOWS; n++)
      for (size_t t = 0; t < (size_t)l->positions; t++)
        dparameters[l->bias + o] += dy.data[n * dy.window + t * dy.position + o];
    for (size_t begin = 0; begin < in; begin += CHUNK) {
      const size_t count = in - begin < CHUNK ? in - begin : CHUNK, first = l->weight + (o * in + begin) * kernel;
      turn(weight, parameters + first, count, kernel);
      turn(dweight, dparameters + first, count, kernel);
      for (size_t n = 0; n < WINDOWS; n++) {
        for (int t = 0; t < l->positions; t++) {
          const float gradient = dy.data[n * dy.window + (size_t)t * dy.position + o];
          for (int k = 0; k < l->kernel; k++) {
            const int at = reads(l, t, k);
            if (at < 0) continue;
            const size_t from = (size_t)at * x.position + begin;
            add_gradient(dweight + (size_t)k * CHUNK, dx.data != NULL ? dx.data + n * dx.window + from : NULL, gradient,
                         x.data + n * x.window + from, weight + (size_t)k * CHUNK, count);
          }
        }
      }
      turn_back(dparameters + first, dweight, count, kernel);
    }
  }
}

static void leaky_relu_bwd(float *gradient, const float *value, size_t count) {
  for (size_t i = 0; i < count; i++)
    gradient[i] = fabsf(value[i]) >= ERN_AUDIO_LIMIT ? 0 : value[i] > 0 ? gradient[i] : 0.02f * gradient[i];
}

void ERN_ISA(ern_audio_bwd)(float *dparameters, const float *dcode, const float *windows, const float *parameters,
                            const struct ern_audio_net *net) {
  struct layer layer[LAYERS];
  struct values values, gradients;
  float codes[WINDOWS * MOST], dcodes[WINDOWS * MOST];
  const size_t count = (size_t)net->code;
  memset(&gradients, 0, sizeof gradients);
  layers_of(layer, net);
  windows_fwd(&values, windows, parameters, layer);
  pack_codes(codes, &values, count);
  ern_audio_mix_bwd_ref(dparameters, dcodes, dcode, codes, parameters, net);
  for (size_t n = 0; n < WINDOWS; n++) memcpy(gradients.code + n * MOST, dcodes + n * count, count * sizeof *dcodes);
  for (int l = LAYERS - 1; l >= 0; l--) {
    const struct rows dy = output_of(&gradients, layer, l);
    if (l < LAYERS - 1) leaky_relu_bwd(dy.data, output_of(&values, layer, l).data, WINDOWS * dy.window);
    layer_bwd(l > 0 ? output_of(&gradients, layer, l - 1) : (struct rows){0}, dparameters, dy,
              input_of(&values, layer, l, windows), parameters, &layer[l]);
  }
}
