/* SPDX-License-Identifier: MIT */
#include "backend_cpu/fused/step_net.h"

#include <string.h>

/* ---- layout ------------------------------------------------------------------------------------------------------ */

static bool is(const struct ern_mlp *mlp, int layers, const int *width) {
  if (mlp->layers != layers) return false;
  for (int l = 0; l <= layers; l++)
    if (mlp->width[l] != width[l]) return false;
  return true;
}

static bool known(const struct ern_field *field) {
  const int f = field->feature_rows, eye = field->config.eye ? 1 : 0;
  const int code = field->config.codes > 0 ? ERN_CODE_WIDTH : 0;
  return ern_field_is_standard(field) && f <= ERN_NET_MAX_FEATURES &&
         is(&field->attention, 2, (int[]){f, ERN_NET_ATTENTION, ERN_AUDIO_CODE}) &&
         (!field->config.eye || is(&field->eye, 2, (int[]){f, ERN_NET_EYE, 1})) &&
         is(&field->uncertainty, 2, (int[]){f, ERN_NET_UNCERTAINTY, 1}) &&
         is(&field->density, 3,
            (int[]){f + ERN_AUDIO_CODE + eye, ERN_NET_DENSITY, ERN_NET_DENSITY, 1 + ERN_GEOMETRY}) &&
         is(&field->colour, 2, (int[]){ern_field_view_rows(field) + ERN_GEOMETRY + code, ERN_NET_COLOUR, 3});
}

static size_t part(size_t *count, size_t rows, size_t columns) {
  const size_t at = *count;
  *count += ern_net_aligned(rows * columns);
  return at;
}

bool ern_train_net_plan(struct ern_train_net *net, const struct ern_field *field) {
  *net = (struct ern_train_net){.features = (size_t)field->feature_rows, .eye = field->config.eye};
  if (!known(field)) return false;
  net->feature_row = ern_net_aligned(net->features);
  net->fades = ern_field_fades(field);
  net->fade = field->config.voice_fade;
  net->ins = net->features + ERN_AUDIO_CODE + (net->eye ? 1 : 0);
  net->in_row = ern_net_aligned(net->features + ERN_AUDIO_CODE + 1);
  net->eye_at = ERN_NET_ATTENTION;
  net->scene_hidden = net->unc_at = net->eye_at + (net->eye ? ERN_NET_EYE : 0);
  net->hidden = net->unc_at + ERN_NET_UNCERTAINTY;
  net->gradient_row = ern_net_aligned(net->features + (net->eye ? 1 : 0));

  net->harmonics = (size_t)ern_field_view_rows(field);
  net->colour_ins = ERN_NET_DENSITY + net->harmonics + 1;
  size_t *count = &net->count;
  net->of_features = part(count, net->features, net->hidden);
  net->attention = part(count, ERN_NET_ATTENTION, ERN_AUDIO_CODE);
  net->density0 = part(count, net->ins, ERN_NET_DENSITY);
  net->density1 = part(count, ERN_NET_DENSITY, ERN_NET_DENSITY);
  net->colour = part(count, net->colour_ins, ERN_NET_COLOUR);
  net->sigma = part(count, 1, ERN_NET_DENSITY);
  net->rgb = part(count, 3, ERN_NET_COLOUR);
  net->eye_out = part(count, 1, ERN_NET_EYE);
  net->unc_out = part(count, 1, ERN_NET_UNCERTAINTY);
  net->forward = net->count;
  net->colour_back = part(count, ERN_NET_COLOUR + 1, ERN_NET_DENSITY);
  net->density1_back = part(count, ERN_NET_DENSITY, ERN_NET_DENSITY);
  net->features_back = part(count, ERN_NET_DENSITY, net->gradient_row);
  net->v_back = part(count, ERN_NET_DENSITY, ERN_AUDIO_CODE);
  net->attention_back = part(count, ERN_AUDIO_CODE, ERN_NET_ATTENTION);
  net->hidden_back = part(count, net->scene_hidden, net->gradient_row);
  return true;
}

/* ---- weights ----------------------------------------------------------------------------------------------------- */

/* to (r, c) at r*to_row + c = factor * from (c, r) at c*from_row + r, r < rows, c < columns */
static void transposed(float *to, size_t to_row, const float *from, size_t from_row, size_t rows, size_t columns,
                       float factor) {
  for (size_t r = 0; r < rows; r++)
    for (size_t c = 0; c < columns; c++) to[r * to_row + c] = factor * from[c * from_row + r];
}

static void copied(float *to, size_t to_row, const float *from, size_t from_row, size_t rows, size_t columns) {
  for (size_t r = 0; r < rows; r++) memcpy(to + r * to_row, from + r * from_row, columns * sizeof *to);
}

static const float *weights_of(const struct ern_train_fold *fold, const struct ern_mlp *mlp, int layer) {
  return fold->parameters + mlp->weight[layer];
}

/* Row k of M^T = (Wc Wg)^T is sum_g Wg[g][k] Wc[.][g]; columns `harmonics`.. of the colour's weights are Wc, rows 1..
 * of the density's last layer Wg. */
static void fill_colour(const struct ern_train_net *net, float *block, const struct ern_train_fold *fold) {
  const struct ern_field *field = fold->field;
  const size_t width = (size_t)field->colour.width[0];
  const float *wc = weights_of(fold, &field->colour, 0), *w2 = weights_of(fold, &field->density, 2);
  float *colour = block + net->colour, *bias = colour + (net->colour_ins - 1) * ERN_NET_COLOUR;
  for (size_t j = 0; j < ERN_NET_COLOUR; j++) {
    float row[ERN_NET_DENSITY] = {0};
    for (size_t g = 0; g < ERN_GEOMETRY; g++) {
      const float weight = wc[j * width + net->harmonics + g], *wg = w2 + (1 + g) * ERN_NET_DENSITY;
      for (size_t k = 0; k < ERN_NET_DENSITY; k++) row[k] += weight * wg[k];
    }
    memcpy(block + net->colour_back + j * ERN_NET_DENSITY, row, sizeof row);
    for (size_t k = 0; k < ERN_NET_DENSITY; k++) colour[k * ERN_NET_COLOUR + j] = row[k];
    bias[j] = 0;
    for (size_t c = net->harmonics + ERN_GEOMETRY; c < width; c++)
      bias[j] += wc[j * width + c] *
                 fold->parameters[field->codes + fold->individual * ERN_CODE_WIDTH + c - net->harmonics - ERN_GEOMETRY];
  }
  memcpy(block + net->colour_back + ERN_NET_COLOUR * ERN_NET_DENSITY, w2, ERN_NET_DENSITY * sizeof *w2);
  transposed(colour + ERN_NET_DENSITY * ERN_NET_COLOUR, ERN_NET_COLOUR, wc, width, net->harmonics, ERN_NET_COLOUR, 1);
}

static void fill_density(const struct ern_train_net *net, float *block, const struct ern_train_fold *fold) {
  const size_t f = net->features, units = ERN_NET_DENSITY;
  const float *w0 = weights_of(fold, &fold->field->density, 0), *w1 = weights_of(fold, &fold->field->density, 1);
  float *density0 = block + net->density0;
  transposed(density0, units, w0, net->ins, f, units, 1);
  for (size_t c = 0; c < ERN_AUDIO_CODE; c++)
    transposed(density0 + (f + c) * units, units, w0 + f + c, net->ins, 1, units, fold->code[c]);
  if (net->eye)
    transposed(density0 + (f + ERN_AUDIO_CODE) * units, units, w0 + f + ERN_AUDIO_CODE, net->ins, 1, units, fold->eye);
  transposed(block + net->density1, units, w1, units, units, units, 1);
  copied(block + net->density1_back, units, w1, units, units, units);
  copied(block + net->features_back, net->gradient_row, w0, net->ins, units, f);
  for (size_t j = 0; j < units; j++) {
    for (size_t c = 0; c < ERN_AUDIO_CODE; c++)
      block[net->v_back + j * ERN_AUDIO_CODE + c] = density0[(f + c) * units + j];
    if (net->eye) block[net->features_back + j * net->gradient_row + f] = density0[(f + ERN_AUDIO_CODE) * units + j];
  }
}

void ern_train_net_fill(struct ern_train_net *net, float *block, const struct ern_train_fold *fold) {
  const struct ern_field *field = fold->field;
  const size_t f = net->features, hidden = net->hidden;
  const float *attention = weights_of(fold, &field->attention, 0), *out = weights_of(fold, &field->attention, 1);
  memset(block, 0, net->count * sizeof *block);
  net->weights = net->factors = block;
  transposed(block + net->of_features, hidden, attention, f, f, ERN_NET_ATTENTION, 1);
  copied(block + net->hidden_back, net->gradient_row, attention, f, ERN_NET_ATTENTION, f);
  if (net->eye) {
    const float *eye = weights_of(fold, &field->eye, 0);
    transposed(block + net->of_features + net->eye_at, hidden, eye, f, f, ERN_NET_EYE, 1);
    copied(block + net->hidden_back + net->eye_at * net->gradient_row, net->gradient_row, eye, f, ERN_NET_EYE, f);
    memcpy(block + net->eye_out, weights_of(fold, &field->eye, 1), ERN_NET_EYE * sizeof *block);
  }
  transposed(block + net->of_features + net->unc_at, hidden, weights_of(fold, &field->uncertainty, 0), f, f,
             ERN_NET_UNCERTAINTY, 1);
  memcpy(block + net->unc_out, weights_of(fold, &field->uncertainty, 1), ERN_NET_UNCERTAINTY * sizeof *block);
  transposed(block + net->attention, ERN_AUDIO_CODE, out, ERN_NET_ATTENTION, ERN_NET_ATTENTION, ERN_AUDIO_CODE, 1);
  copied(block + net->attention_back, ERN_NET_ATTENTION, out, ERN_NET_ATTENTION, ERN_AUDIO_CODE, ERN_NET_ATTENTION);
  fill_density(net, block, fold);
  memcpy(block + net->sigma, weights_of(fold, &field->density, 2), ERN_NET_DENSITY * sizeof *block);
  fill_colour(net, block, fold);
  memcpy(block + net->rgb, weights_of(fold, &field->colour, 1), 3 * ERN_NET_COLOUR * sizeof *block);
}

/* ---- gradients --------------------------------------------------------------------------------------------------- */

/* to (r, c) at r*to_row + c += factor * from (c, r) at c*from_row + r */
static void add_transposed(float *to, size_t to_row, const float *from, size_t from_row, size_t rows, size_t columns,
                           float factor) {
  for (size_t r = 0; r < rows; r++)
    for (size_t c = 0; c < columns; c++) to[r * to_row + c] += factor * from[c * from_row + r];
}

static void add(float *to, const float *from, size_t count) {
  for (size_t i = 0; i < count; i++) to[i] += from[i];
}

void ern_train_net_unfold_colour(float *dparameters, const float *gradient, const struct ern_train_net *net,
                                 const struct ern_train_fold *fold) {
  const struct ern_field *field = fold->field;
  const size_t width = (size_t)field->colour.width[0], units = ERN_NET_COLOUR;
  const float *wc = weights_of(fold, &field->colour, 0), *w2 = weights_of(fold, &field->density, 2);
  const float *dm = gradient + net->colour, *dbias = dm + (net->colour_ins - 1) * units; /* dm: [k][j] */
  float *dwc = dparameters + field->colour.weight[0], *dw2 = dparameters + field->density.weight[2];
  for (size_t g = 0; g < ERN_GEOMETRY; g++) {
    const float *wg = w2 + (1 + g) * ERN_NET_DENSITY;
    float column[ERN_NET_COLOUR] = {0}, from[ERN_NET_COLOUR]; /* of dWc; of Wc */
    for (size_t j = 0; j < units; j++) from[j] = wc[j * width + net->harmonics + g];
    for (size_t k = 0; k < ERN_NET_DENSITY; k++) {
      float sum = 0;
      for (size_t j = 0; j < units; j++) {
        column[j] += wg[k] * dm[k * units + j];
        sum += from[j] * dm[k * units + j];
      }
      dw2[(1 + g) * ERN_NET_DENSITY + k] += sum;
    }
    for (size_t j = 0; j < units; j++) dwc[j * width + net->harmonics + g] += column[j];
  }
  add_transposed(dwc, width, dm + ERN_NET_DENSITY * units, units, units, net->harmonics, 1);
  for (size_t c = net->harmonics + ERN_GEOMETRY; c < width; c++) {
    const size_t at = field->codes + fold->individual * ERN_CODE_WIDTH + c - net->harmonics - ERN_GEOMETRY;
    for (size_t j = 0; j < units; j++) {
      dwc[j * width + c] += fold->parameters[at] * dbias[j];
      dparameters[at] += wc[j * width + c] * dbias[j];
    }
  }
}

static void unfold_density(float *dparameters, float *dcode, const float *gradient, const struct ern_train_net *net,
                           const struct ern_train_fold *fold) {
  const struct ern_field *field = fold->field;
  const size_t f = net->features, units = ERN_NET_DENSITY, ins = net->ins;
  const float *w0 = weights_of(fold, &field->density, 0), *g = gradient + net->density0;
  float *dw0 = dparameters + field->density.weight[0];
  add_transposed(dw0, ins, g, units, units, f, 1);
  for (size_t c = 0; c < ERN_AUDIO_CODE; c++) {
    add_transposed(dw0 + f + c, ins, g + (f + c) * units, units, units, 1, fold->code[c]);
    for (size_t j = 0; j < units; j++) dcode[c] += w0[j * ins + f + c] * g[(f + c) * units + j];
  }
  if (net->eye)
    add_transposed(dw0 + f + ERN_AUDIO_CODE, ins, g + (f + ERN_AUDIO_CODE) * units, units, units, 1, fold->eye);
  add_transposed(dparameters + field->density.weight[1], units, gradient + net->density1, units, units, units, 1);
  add(dparameters + field->density.weight[2], gradient + net->sigma, units);
}

void ern_train_net_unfold(float *dparameters, float *dcode, const float *gradient, const struct ern_train_net *net,
                          const struct ern_train_fold *fold) {
  const struct ern_field *field = fold->field;
  const size_t f = net->features, hidden = net->hidden;
  const float *of_features = gradient + net->of_features;
  add_transposed(dparameters + field->attention.weight[0], f, of_features, hidden, ERN_NET_ATTENTION, f, 1);
  add_transposed(dparameters + field->attention.weight[1], ERN_NET_ATTENTION, gradient + net->attention, ERN_AUDIO_CODE,
                 ERN_AUDIO_CODE, ERN_NET_ATTENTION, 1);
  if (net->eye) {
    add_transposed(dparameters + field->eye.weight[0], f, of_features + net->eye_at, hidden, ERN_NET_EYE, f, 1);
    add(dparameters + field->eye.weight[1], gradient + net->eye_out, ERN_NET_EYE);
  }
  add_transposed(dparameters + field->uncertainty.weight[0], f, of_features + net->unc_at, hidden, ERN_NET_UNCERTAINTY,
                 f, 1);
  add(dparameters + field->uncertainty.weight[1], gradient + net->unc_out, ERN_NET_UNCERTAINTY);
  unfold_density(dparameters, dcode, gradient, net, fold);
  add(dparameters + field->colour.weight[1], gradient + net->rgb, 3 * ERN_NET_COLOUR);
}
