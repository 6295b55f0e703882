/* SPDX-License-Identifier: MIT
 * A causal convolutional network over rows of log mel bands, less their mean over the speech so far, which takes out
 * the microphone and the room: a convolution of three rows, residual blocks of a dilated convolution of three rows and
 * one of a single row, and a last layer. Its weights are src/media/speech/articulatory.safetensors; batch normalisation
 * is part of them. */
#include "media/speech/articulatory.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/memory.h"
#include "io/safetensors.h"

enum { BANDS = ERN_CEPSTRA_BANDS, CHANNELS = 40, BLOCKS = 6, TAPS = 3, OUTPUTS = ERN_ARTICULATORY_OUTPUTS };
enum { LONGEST = 4, KEPT = 2 * LONGEST + 1 /* rows of a block's input */, FIELD = 31 /* rows that a row depends on */ };

static const int dilations[BLOCKS] = {1, 2, 4, 1, 2, 4};
/* The mean begins as that of the training (the tensor "mean"), as if it were one of `prior` audible rows; a row's
 * weight in it decays with a time constant of `memory` rows. */
static const double prior = 50, memory = 500;

/* The file's bytes (cmake/embed.cmake). */
extern const unsigned char ern_weights_text_articulatory[];
extern const size_t ern_weights_bytes_articulatory;

/* Weights are [tap][input][output], so that the innermost loop is over outputs. Tap 2 is the row itself. */
struct block {
  float wide[TAPS][CHANNELS][CHANNELS], wide_bias[CHANNELS], narrow[CHANNELS][CHANNELS], narrow_bias[CHANNELS];
  float kept[KEPT][CHANNELS]; /* row r in kept[r % KEPT] */
};

struct ern_articulatory {
  float input[TAPS][BANDS][CHANNELS], input_bias[CHANNELS], output[CHANNELS][OUTPUTS], output_bias[OUTPUTS];
  struct block block[BLOCKS];
  float band[TAPS][BANDS];   /* the row and the two before, less the mean */
  double sum[BANDS], weight; /* of the mean: decaying sums over audible rows */
  size_t row;
};

static ern_status take(ern_context *context, const struct ern_tensor_file *file, const char *name, size_t count,
                       float *values) {
  const struct ern_tensor *tensor = ern_tensor_file_find(file, name);
  if (tensor == NULL || tensor->count != count)
    return ern_fail(context, ERN_E_FORMAT, "articulatory.safetensors: %s is missing or has not %zu values", name,
                    count);
  return ern_tensor_to_float(context, tensor, values);
}

static ern_status take_block(ern_context *context, const struct ern_tensor_file *file, int index, struct block *block) {
  ern_status status = ERN_OK;
  char name[32];
  snprintf(name, sizeof name, "block.%d.wide", index);
  ERN_TRY(take(context, file, name, TAPS * CHANNELS * CHANNELS, &block->wide[0][0][0]));
  snprintf(name, sizeof name, "block.%d.wide_bias", index);
  ERN_TRY(take(context, file, name, CHANNELS, block->wide_bias));
  snprintf(name, sizeof name, "block.%d.narrow", index);
  ERN_TRY(take(context, file, name, CHANNELS * CHANNELS, &block->narrow[0][0]));
  snprintf(name, sizeof name, "block.%d.narrow_bias", index);
  ERN_TRY(take(context, file, name, CHANNELS, block->narrow_bias));
fail:
  return status;
}

void ern_articulatory_free(ern_context *context, struct ern_articulatory *articulatory) {
  ern_release(context, articulatory);
}

/* out += weight^T in */
static void add_product(const float (*weight)[CHANNELS], const float *in, int inputs, float out[CHANNELS]) {
  for (int i = 0; i < inputs; i++)
    for (int o = 0; o < CHANNELS; o++) out[o] += weight[i][o] * in[i];
}

static void rectify(float value[CHANNELS]) {
  for (int o = 0; o < CHANNELS; o++) value[o] = fmaxf(value[o], 0);
}

/* hidden += narrow(relu(wide(hidden of this row, and of one and two dilations before))) */
static void add_block(struct block *block, int dilation, size_t row, float hidden[CHANNELS]) {
  float inner[CHANNELS];
  memcpy(block->kept[row % KEPT], hidden, sizeof inner);
  memcpy(inner, block->wide_bias, sizeof inner);
  for (int t = 0; t < TAPS; t++) {
    const size_t before = (size_t)((TAPS - 1 - t) * dilation);
    add_product(block->wide[t], block->kept[(row + KEPT - before) % KEPT], CHANNELS, inner);
  }
  rectify(inner);
  for (int o = 0; o < CHANNELS; o++) hidden[o] += block->narrow_bias[o];
  add_product(block->narrow, inner, CHANNELS, hidden);
}

static void subtract_mean(struct ern_articulatory *a, float band[BANDS], bool audible) {
  const double keep = audible ? exp(-1 / memory) : 1;
  a->weight = keep * a->weight + audible;
  for (int b = 0; b < BANDS; b++) {
    a->sum[b] = keep * a->sum[b] + (audible ? (double)band[b] : 0);
    band[b] -= (float)(a->sum[b] / a->weight);
  }
}

void ern_articulatory_row(struct ern_articulatory *a, float band[BANDS], bool audible, float output[OUTPUTS]) {
  float hidden[CHANNELS];
  subtract_mean(a, band, audible);
  memmove(a->band[0], a->band[1], (TAPS - 1) * sizeof a->band[0]);
  memcpy(a->band[TAPS - 1], band, sizeof a->band[0]);
  memcpy(hidden, a->input_bias, sizeof hidden);
  for (int t = 0; t < TAPS; t++) add_product(a->input[t], a->band[t], BANDS, hidden);
  rectify(hidden);
  for (int i = 0; i < BLOCKS; i++) add_block(&a->block[i], dilations[i], a->row, hidden);
  memcpy(output, a->output_bias, sizeof a->output_bias);
  for (int i = 0; i < CHANNELS; i++)
    for (int o = 0; o < OUTPUTS; o++) output[o] += a->output[i][o] * hidden[i];
  for (int o = 0; o < OUTPUTS; o++) output[o] = 1.5f * tanhf(output[o]);
  a->row++;
}

/* The rows before the first. */
static void begin_in_silence(struct ern_articulatory *a) {
  float band[BANDS], output[OUTPUTS];
  for (int r = 0; r < FIELD; r++) {
    for (int b = 0; b < BANDS; b++) band[b] = ern_cepstra_silence();
    ern_articulatory_row(a, band, false, output);
  }
}

ern_status ern_articulatory_make(ern_context *context, struct ern_articulatory **articulatory) {
  ern_status status = ERN_OK;
  struct ern_articulatory *a = NULL;
  struct ern_tensor_file file = {0};
  uint8_t *bytes = NULL;
  float mean[BANDS];
  *articulatory = NULL;
  ERN_TRY(ERN_NEW(context, 1, &a));
  ERN_TRY(ERN_NEW(context, ern_weights_bytes_articulatory, &bytes));
  memcpy(bytes, ern_weights_text_articulatory, ern_weights_bytes_articulatory);
  ERN_TRY(ern_safetensors_open(context, "articulatory.safetensors", bytes, ern_weights_bytes_articulatory, &file));
  ERN_TRY(take(context, &file, "input", TAPS * BANDS * CHANNELS, &a->input[0][0][0]));
  ERN_TRY(take(context, &file, "input_bias", CHANNELS, a->input_bias));
  for (int i = 0; i < BLOCKS; i++) ERN_TRY(take_block(context, &file, i, &a->block[i]));
  ERN_TRY(take(context, &file, "output", CHANNELS * OUTPUTS, &a->output[0][0]));
  ERN_TRY(take(context, &file, "output_bias", OUTPUTS, a->output_bias));
  ERN_TRY(take(context, &file, "mean", BANDS, mean));
  for (int b = 0; b < BANDS; b++) a->sum[b] = prior * (double)mean[b];
  a->weight = prior;
  begin_in_silence(a);
  *articulatory = a;
  a = NULL;
fail:
  ern_tensor_file_free(context, &file);
  ern_release(context, a);
  return status;
}
