/* SPDX-License-Identifier: MIT
 * The audio networks (docs/maths.md, Speech): AudioNet, one work-group per window, turns eight windows into codes;
 * AudioAttNet, one work-group, computes their weighted sum. All values are stored as [position][channel], channels
 * contiguous. Every device reads and sums them in blocks of eight channels, so that sums are in the same order
 * everywhere. Values that one item writes and others of its group read go through global memory and a barrier, because
 * the backward pass needs them in global memory. */
enum {
  GROUP = 64,
  WINDOWS = 8,
  BLOCK = 8, /* channels of a float8 */
  CONVS = 4,
  ATT_CONVS = 5,
  HIDDEN = 64,
  /* values of one window: the four convolutions, at most 8, 4, 2, 1 positions, and the hidden layer */
  HIDDEN_AT = 576,
  WINDOW_VALUES = 640,
  /* values of AudioAttNet: five convolutions of 8 positions, and the weights of the windows */
  WEIGHT_AT = 248,
  ATT_VALUES = 256
};
constant int conv_width[CONVS] = {32, 32, 64, 64}, conv_at[CONVS] = {0, 256, 384, 512};
constant int att_width[ATT_CONVS] = {16, 8, 4, 2, 1}, att_at[ATT_CONVS] = {0, 128, 192, 224, 240};

/* Offsets count from the start of the parameter block: struct ern_audio_net. */
struct audio_net {
  ulong conv_weight[CONVS], conv_bias[CONVS], fc_weight[2], fc_bias[2];
  ulong att_conv_weight[ATT_CONVS], att_conv_bias[ATT_CONVS], att_fc_weight, att_fc_bias;
  int width, window_length, code, padding;
};

#define LIMIT 1e6f /* ERN_AUDIO_LIMIT; NaN stays NaN */
static float held(float x) { return x > LIMIT ? LIMIT : x < -LIMIT ? -LIMIT : x; }
static float8 held_bwd(float8 gradient, float8 value) { return select(gradient, (float8)0, fabs(value) >= LIMIT); }

static float leaky_relu(float x) { return held(x > 0 ? x : 0.02f * x); }
/* The gradient with respect to the input of a LeakyReLU. `value` is its output, which has the sign of the input. */
static float8 leaky_relu_bwd(float8 gradient, float8 value) {
  return held_bwd(select(0.02f * gradient, gradient, value > 0), value);
}

static float sum_of(float8 v) {
  const float4 four = v.lo + v.hi;
  const float2 two = four.lo + four.hi;
  return two.x + two.y;
}

/* ---- blocks of eight channels; `left`: channels from here to the end; those beyond are read as zeros ---- */

static float8 block_load(global const float *x, int left) {
  float all[BLOCK];
  if (left >= BLOCK) return vload8(0, x);
  for (int i = 0; i < BLOCK; i++) all[i] = i < left ? x[i] : 0;
  return vload8(0, all);
}

static void block_store(global float *x, float8 value, int left) {
  float all[BLOCK];
  if (left >= BLOCK) {
    vstore8(value, 0, x);
    return;
  }
  vstore8(value, 0, all);
  for (int i = 0; i < left; i++) x[i] = all[i];
}

/* Weights of a convolution, [channel][3], by tap. */
struct taps {
  float8 before, middle, after;
};

static struct taps taps_load(global const float *w, int left) {
  float8 a, b, c;
  if (left >= BLOCK) {
    a = vload8(0, w);
    b = vload8(1, w);
    c = vload8(2, w);
  } else {
    float all[3 * BLOCK];
    for (int i = 0; i < 3 * BLOCK; i++) all[i] = i < 3 * left ? w[i] : 0;
    a = vload8(0, all);
    b = vload8(1, all);
    c = vload8(2, all);
  }
  struct taps taps;
  taps.before = (float8)(a.s0, a.s3, a.s6, b.s1, b.s4, b.s7, c.s2, c.s5);
  taps.middle = (float8)(a.s1, a.s4, a.s7, b.s2, b.s5, c.s0, c.s3, c.s6);
  taps.after = (float8)(a.s2, a.s5, b.s0, b.s3, b.s6, c.s1, c.s4, c.s7);
  return taps;
}

static void taps_store(global float *w, struct taps taps, int left) {
  const float8 x = taps.before, y = taps.middle, z = taps.after;
  const float8 a = (float8)(x.s0, y.s0, z.s0, x.s1, y.s1, z.s1, x.s2, y.s2);
  const float8 b = (float8)(z.s2, x.s3, y.s3, z.s3, x.s4, y.s4, z.s4, x.s5);
  const float8 c = (float8)(y.s5, z.s5, x.s6, y.s6, z.s6, x.s7, y.s7, z.s7);
  if (left >= BLOCK) {
    vstore8(a, 0, w);
    vstore8(b, 1, w);
    vstore8(c, 2, w);
    return;
  }
  float all[3 * BLOCK];
  vstore8(a, 0, all);
  vstore8(b, 1, all);
  vstore8(c, 2, all);
  for (int i = 0; i < 3 * left; i++) w[i] = all[i];
}

static int blocks_of(int channels) { return (channels + BLOCK - 1) / BLOCK; }

/* ---- layers ---- */

/* Kernel 3, padding 1: y[t][o] = b[o] + sum over c, k of W[o][c][k] x[t*stride + k - 1][c], zeros outside. */
struct conv {
  int out, in;
  int length; /* positions of x */
  int stride;
};

static int positions_of(struct conv conv) { return (conv.length - 1) / conv.stride + 1; }

/* Convolution l of AudioNet and of AudioAttNet. */
static struct conv window_conv(const struct audio_net *net, int l) {
  struct conv conv = {conv_width[0], net->width, net->window_length, 2};
  for (int k = 1; k <= l; k++) {
    conv.length = positions_of(conv);
    conv.in = conv.out;
    conv.out = conv_width[k];
  }
  return conv;
}
static struct conv att_conv(const struct audio_net *net, int l) {
  const struct conv conv = {att_width[l], l > 0 ? att_width[l - 1] : net->code, WINDOWS, 1};
  return conv;
}

static float conv_fwd(global const float *x, global const float *w, global const float *b, struct conv conv, int o,
                      int t) {
  const int at = t * conv.stride;
  const bool before = at > 0, after = at + 1 < conv.length;
  float8 sum = 0;
  for (int c = 0; c < conv.in; c += BLOCK) {
    const int left = conv.in - c;
    const struct taps tap = taps_load(w + ((ulong)o * conv.in + c) * 3, left);
    global const float *from = x + (ulong)at * conv.in + c;
    if (before) sum += tap.before * block_load(from - conv.in, left);
    sum += tap.middle * block_load(from, left);
    if (after) sum += tap.after * block_load(from + conv.in, left);
  }
  return b[o] + sum_of(sum);
}

/* dx[at][c .. c+7]: output position t reads input position `at` by tap at + 1 - t*stride. dy [t][o] */
static float8 conv_dx(float8 sum, global const float *dy, global const float *w, struct conv conv, int at, int c) {
  const int positions = positions_of(conv);
  for (int o = 0; o < conv.out; o++) {
    const struct taps tap = taps_load(w + ((ulong)o * conv.in + c) * 3, conv.in - c);
    for (int k = 2; k >= 0; k--) {
      const int t = (at + 1 - k) / conv.stride;
      if (at + 1 - k < 0 || t * conv.stride != at + 1 - k || t >= positions) continue;
      sum += (k == 2 ? tap.after : k == 1 ? tap.middle : tap.before) * dy[t * conv.out + o];
    }
  }
  return sum;
}

/* dW[o][c .. c+7][k] += sum of dy[t][o] x[t*stride + k - 1][c ..] over `copies` of dy and x. The first block also adds
 * db[o] += sum dy[t][o]. Terms are added one by one in the order of copies and positions, as in the reference. */
static void conv_dw(global float *dw, global float *db, global const float *dy, ulong dy_copy, global const float *x,
                    ulong x_copy, int copies, struct conv conv, int o, int c) {
  const int left = conv.in - c, positions = positions_of(conv);
  global float *row = dw + ((ulong)o * conv.in + c) * 3;
  struct taps sum = taps_load(row, left);
  float bias = c == 0 ? db[o] : 0;
  for (int copy = 0; copy < copies; copy++) {
    for (int t = 0; t < positions; t++) {
      const int at = t * conv.stride;
      const float gradient = dy[copy * dy_copy + t * conv.out + o];
      global const float *from = x + copy * x_copy + (ulong)at * conv.in + c;
      if (at > 0) sum.before += gradient * block_load(from - conv.in, left);
      sum.middle += gradient * block_load(from, left);
      if (at + 1 < conv.length) sum.after += gradient * block_load(from + conv.in, left);
      bias += gradient;
    }
  }
  taps_store(row, sum, left);
  if (c == 0) db[o] = bias;
}

/* Fully connected, W [outs][ins], ins a multiple of 8: y[o], dx[c .. c+7], and the weights' gradient as above. */
static float fc_fwd(global const float *x, global const float *w, global const float *b, int ins, int o) {
  float8 sum = 0;
  for (int c = 0; c < ins; c += BLOCK) sum += vload8(0, w + o * ins + c) * vload8(0, x + c);
  return b[o] + sum_of(sum);
}
static float8 fc_dx(global const float *dy, global const float *w, int outs, int ins, int c) {
  float8 sum = 0;
  for (int o = 0; o < outs; o++) sum += vload8(0, w + o * ins + c) * dy[o];
  return sum;
}
static void fc_dw(global float *dw, global float *db, global const float *dy, ulong dy_copy, global const float *x,
                  ulong x_copy, int copies, int ins, int o, int c) {
  float8 sum = vload8(0, dw + o * ins + c);
  float bias = c == 0 ? db[o] : 0;
  for (int copy = 0; copy < copies; copy++) {
    const float gradient = dy[copy * dy_copy + o];
    sum += gradient * vload8(0, x + copy * x_copy + c);
    bias += gradient;
  }
  vstore8(sum, 0, dw + o * ins + c);
  if (c == 0) db[o] = bias;
}

/* ---- AudioNet ---- */

/* codes [8][A], values [8][WINDOW_VALUES]. Group g processes the window whose number is hexadecimal digit g of `order`,
 * the lowest digit being 0. */
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void audio_windows(
    SPAN(float, codes), SPAN(float, values), SPAN(const float, windows), SPAN(const float, parameters),
    struct audio_net net, uint order) {
  OPEN(float, codes);
  OPEN(float, values);
  OPEN(const float, windows);
  OPEN(const float, parameters);
  const int item = get_local_id(0), window = order >> 4 * get_group_id(0) & 15;
  global float *own = values + window * WINDOW_VALUES;
  global const float *x = windows + (ulong)window * net.window_length * net.width;
  for (int l = 0; l < CONVS; l++) {
    const struct conv conv = window_conv(&net, l);
    global float *y = own + conv_at[l];
    for (int i = item; i < conv.out * positions_of(conv); i += GROUP) {
      y[i] = leaky_relu(conv_fwd(x, parameters + net.conv_weight[l], parameters + net.conv_bias[l], conv, i % conv.out,
                                 i / conv.out));
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    x = y;
  }
  for (int o = item; o < HIDDEN; o += GROUP) {
    own[HIDDEN_AT + o] =
        leaky_relu(fc_fwd(x, parameters + net.fc_weight[0], parameters + net.fc_bias[0], HIDDEN, o));
  }
  barrier(CLK_GLOBAL_MEM_FENCE);
  for (int a = item; a < net.code; a += GROUP) {
    codes[window * net.code + a] =
        held(fc_fwd(own + HIDDEN_AT, parameters + net.fc_weight[1], parameters + net.fc_bias[1], HIDDEN, a));
  }
}

/* gradients [8][WINDOW_VALUES]: the gradients with respect to the input of each LeakyReLU; `values` holds its output. */
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void audio_windows_bwd(
    SPAN(float, gradients), SPAN(const float, dcodes), SPAN(const float, values), SPAN(const float, parameters),
    struct audio_net net) {
  OPEN(float, gradients);
  OPEN(const float, dcodes);
  OPEN(const float, values);
  OPEN(const float, parameters);
  const int item = get_local_id(0), window = get_group_id(0), last = conv_at[CONVS - 1];
  global float *gradient = gradients + window * WINDOW_VALUES;
  global const float *value = values + window * WINDOW_VALUES;
  for (int c = item * BLOCK; c < HIDDEN; c += GROUP * BLOCK) {
    const float8 dx = fc_dx(dcodes + window * net.code, parameters + net.fc_weight[1], net.code, HIDDEN, c);
    vstore8(leaky_relu_bwd(dx, vload8(0, value + HIDDEN_AT + c)), 0, gradient + HIDDEN_AT + c);
  }
  barrier(CLK_GLOBAL_MEM_FENCE);
  for (int c = item * BLOCK; c < HIDDEN; c += GROUP * BLOCK) {
    const float8 dx = fc_dx(gradient + HIDDEN_AT, parameters + net.fc_weight[0], HIDDEN, HIDDEN, c);
    vstore8(leaky_relu_bwd(dx, vload8(0, value + last + c)), 0, gradient + last + c);
  }
  barrier(CLK_GLOBAL_MEM_FENCE);
  for (int l = CONVS - 1; l > 0; l--) {
    const struct conv conv = window_conv(&net, l);
    const int blocks = blocks_of(conv.in);
    for (int i = item; i < conv.length * blocks; i += GROUP) {
      const int c = i % blocks * BLOCK, to = conv_at[l - 1] + i / blocks * conv.in + c;
      const float8 dx = conv_dx(0, gradient + conv_at[l], parameters + net.conv_weight[l], conv, i / blocks, c);
      vstore8(leaky_relu_bwd(dx, vload8(0, value + to)), 0, gradient + to);
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
  }
}

/* The gradients of AudioNet's weights. An item computes one block of eight channels of one row; blocks are numbered
 * layer by layer. */
kernel void audio_windows_weights(SPAN(float, dparameters), SPAN(const float, gradients), SPAN(const float, dcodes),
                                  SPAN(const float, values), SPAN(const float, windows), struct audio_net net,
                                  ulong n) {
  OPEN(float, dparameters);
  OPEN(const float, gradients);
  OPEN(const float, dcodes);
  OPEN(const float, values);
  OPEN(const float, windows);
  if (get_global_id(0) >= n) return;
  int i = get_global_id(0);
  for (int l = 0; l < CONVS; l++) {
    const struct conv conv = window_conv(&net, l);
    const int blocks = blocks_of(conv.in);
    if (i < conv.out * blocks) {
      conv_dw(dparameters + net.conv_weight[l], dparameters + net.conv_bias[l], gradients + conv_at[l], WINDOW_VALUES,
              l > 0 ? values + conv_at[l - 1] : windows,
              l > 0 ? WINDOW_VALUES : (ulong)net.window_length * net.width, WINDOWS, conv, i / blocks,
              i % blocks * BLOCK);
      return;
    }
    i -= conv.out * blocks;
  }
  const int blocks = blocks_of(HIDDEN), c = i % blocks * BLOCK;
  const int o = i / blocks; /* the rows of the first layer, then those of the second */
  if (o < HIDDEN) {
    fc_dw(dparameters + net.fc_weight[0], dparameters + net.fc_bias[0], gradients + HIDDEN_AT, WINDOW_VALUES,
          values + conv_at[CONVS - 1], WINDOW_VALUES, WINDOWS, HIDDEN, o, c);
  } else {
    fc_dw(dparameters + net.fc_weight[1], dparameters + net.fc_bias[1], dcodes, net.code, values + HIDDEN_AT,
          WINDOW_VALUES, WINDOWS, HIDDEN, o - HIDDEN, c);
  }
}

/* ---- AudioAttNet ---- */

/* w_t = exp(x_t - max x) / sum exp(x - max x), in place */
static void softmax(global float *w) {
  float most = w[0], sum = 0;
  for (int t = 1; t < WINDOWS; t++) most = w[t] > most ? w[t] : most;
  for (int t = 0; t < WINDOWS; t++) {
    w[t] = exp(w[t] - most);
    sum += w[t];
  }
  for (int t = 0; t < WINDOWS; t++) w[t] /= sum;
}

/* code [A] = sum_t w_t codes[t], null: not wanted; values [ATT_VALUES]; one group */
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void audio_mix(
    SPAN(float, code), SPAN(float, values), SPAN(const float, codes), SPAN(const float, parameters),
    struct audio_net net) {
  OPEN(float, code);
  OPEN(float, values);
  OPEN(const float, codes);
  OPEN(const float, parameters);
  const int item = get_local_id(0);
  global const float *x = codes;
  global float *weight = values + WEIGHT_AT;
  for (int l = 0; l < ATT_CONVS; l++) {
    const struct conv conv = att_conv(&net, l);
    global float *y = values + att_at[l];
    for (int i = item; i < conv.out * WINDOWS; i += GROUP) {
      y[i] = leaky_relu(conv_fwd(x, parameters + net.att_conv_weight[l], parameters + net.att_conv_bias[l], conv,
                                 i % conv.out, i / conv.out));
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    x = y;
  }
  if (item < WINDOWS)
    weight[item] = fc_fwd(x, parameters + net.att_fc_weight, parameters + net.att_fc_bias, WINDOWS, item);
  barrier(CLK_GLOBAL_MEM_FENCE);
  if (item == 0) softmax(weight);
  barrier(CLK_GLOBAL_MEM_FENCE);
  for (int a = item; code && a < net.code; a += GROUP) {
    float sum = 0;
    for (int t = 0; t < WINDOWS; t++) sum += weight[t] * codes[t * net.code + a];
    code[a] = sum;
  }
}

/* dcodes [8][A]: overwritten; gradients [ATT_VALUES]: scratch; one group.
 * dweight_t = sum_a dcode_a codes[t][a];  dscore_t = w_t (dweight_t - sum_s w_s dweight_s) */
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void audio_mix_bwd(
    SPAN(float, dparameters), SPAN(float, dcodes), SPAN(float, gradients), SPAN(const float, dcode),
    SPAN(const float, codes), SPAN(const float, values), SPAN(const float, parameters), struct audio_net net) {
  OPEN(float, dparameters);
  OPEN(float, dcodes);
  OPEN(float, gradients);
  OPEN(const float, dcode);
  OPEN(const float, codes);
  OPEN(const float, values);
  OPEN(const float, parameters);
  const int item = get_local_id(0), last = att_at[ATT_CONVS - 1];
  global const float *weight = values + WEIGHT_AT;
  local float dweight[WINDOWS];
  global float *dscore = gradients + WEIGHT_AT;
  for (int i = item; i < WINDOWS * net.code; i += GROUP) dcodes[i] = weight[i / net.code] * dcode[i % net.code];
  if (item < WINDOWS) {
    float sum = 0;
    for (int a = 0; a < net.code; a++) sum += codes[item * net.code + a] * dcode[a];
    dweight[item] = sum;
  }
  barrier(CLK_LOCAL_MEM_FENCE);
  if (item < WINDOWS) {
    float mean = 0;
    for (int t = 0; t < WINDOWS; t++) mean += weight[t] * dweight[t];
    dscore[item] = weight[item] * (dweight[item] - mean);
  }
  barrier(CLK_GLOBAL_MEM_FENCE);
  if (item < WINDOWS)
    fc_dw(dparameters + net.att_fc_weight, dparameters + net.att_fc_bias, dscore, 0, values + last, 0, 1, WINDOWS, item,
          0);
  if (item == 0) {
    const float8 dx = fc_dx(dscore, parameters + net.att_fc_weight, WINDOWS, WINDOWS, 0);
    vstore8(leaky_relu_bwd(dx, vload8(0, values + last)), 0, gradients + last);
  }
  barrier(CLK_GLOBAL_MEM_FENCE);
  for (int l = ATT_CONVS - 1; l >= 0; l--) {
    const struct conv conv = att_conv(&net, l);
    const int blocks = blocks_of(conv.in), from = l > 0 ? att_at[l - 1] : 0;
    global const float *dy = gradients + att_at[l], *x = l > 0 ? values + from : codes;
    for (int i = item; i < conv.out * blocks; i += GROUP) {
      conv_dw(dparameters + net.att_conv_weight[l], dparameters + net.att_conv_bias[l], dy, 0, x, 0, 1, conv,
              i / blocks, i % blocks * BLOCK);
    }
    for (int i = item; i < WINDOWS * blocks; i += GROUP) {
      const int c = i % blocks * BLOCK, left = conv.in - c, to = i / blocks * conv.in + c;
      global float *dx = (l > 0 ? gradients + from : dcodes) + to;
      const float8 start = l > 0 ? (float8)0 : block_load(dx, left);
      const float8 sum = conv_dx(start, dy, parameters + net.att_conv_weight[l], conv, i / blocks, c);
      const float8 value = block_load(x + to, left);
      block_store(dx, l > 0 ? leaky_relu_bwd(sum, value) : held_bwd(sum, value), left);
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
  }
}
