/* SPDX-License-Identifier: MIT
 * The kernels of the fused training step for any instruction set (simd/isa.h). A sample's values do not depend on its
 * position in a tile. */
#include <math.h>

#include "backend_cpu/fused/step_kernels.h"
#include "backend_cpu/simd/encode_tile.h"
#include "backend_cpu/simd/gemm_factors.h"
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes_math.h"
#include "core/profile.h"

enum { ATTENTION = ERN_NET_ATTENTION, EYE = ERN_NET_EYE, UNCERTAINTY = ERN_NET_UNCERTAINTY };
enum { DENSITY = ERN_NET_DENSITY, COLOUR = ERN_NET_COLOUR };
enum { COLOUR_ROW = 96, D_COLOUR_ROW = 80, CODE = ERN_AUDIO_CODE };

/* ---- pieces of a tile -------------------------------------------------------------------------------------------- */

static size_t least(size_t a, size_t b) { return a < b ? a : b; }

static size_t number_of(const struct ern_train_list *list, size_t s) {
  return list->index != NULL ? (size_t)list->index[s] : s;
}

/* width: aligned */
LANES_INLINE void copy_row(float *to, const float *from, size_t width) {
  for (size_t c = 0; c < width; c += LANES) vf_store(to + c, vf_load(from + c));
}
LANES_INLINE void clear_row(float *to, size_t width) {
  for (size_t c = 0; c < width; c += LANES) vf_store(to + c, (vf){0});
}

/* rows [TILE][row], columns 0 .. width-1 of it = f [width][stride] of the tile's samples; up to LANES - 1 columns after
 * them become 0 */
static void rows_of_channels(float *rows, size_t row, const float *f, size_t stride, size_t width) {
  for (size_t c = 0; c < width; c += LANES) {
    const size_t have = least(width - c, LANES);
    for (size_t s = 0; s < TILE; s += LANES) {
      vf block[LANES] = {{0}};
      for (size_t r = 0; r < have; r++) block[r] = vf_load(f + (c + r) * stride + s);
      rows_transpose(block);
      for (size_t l = 0; l < LANES; l++) vf_store(rows + (s + l) * row + c, block[l]);
    }
  }
}

/* f [width][stride] = rows, columns 0 .. width-1 */
static void channels_of_rows(float *f, size_t stride, const float *rows, size_t row, size_t width) {
  for (size_t c = 0; c < width; c += LANES) {
    const size_t have = least(width - c, LANES);
    for (size_t s = 0; s < TILE; s += LANES) {
      vf block[LANES];
      for (size_t l = 0; l < LANES; l++) block[l] = vf_load(rows + (s + l) * row + c);
      rows_transpose(block);
      for (size_t r = 0; r < have; r++) vf_store(f + (c + r) * stride + s, block[r]);
    }
  }
}

/* Row s of the tile = row index[first + s] of `from`; rows past the last are 0. width: aligned */
static void rows_of_list(float *rows, size_t row, const float *from, size_t width, const struct ern_train_list *list,
                         size_t first) {
  const size_t count = least(list->count - first, TILE);
  for (size_t s = 0; s < count; s++) copy_row(rows + s * row, from + number_of(list, first + s) * width, width);
  for (size_t s = count; s < TILE; s++) clear_row(rows + s * row, width);
}

/* out [TILE], lane by lane sum_c x(s, c) w[c] */
LANES_INLINE void dots(float *out, const float *x, size_t x_row, const float *w, const size_t width) {
  for (size_t s = 0; s < TILE; s += LANES) {
    vf part[LANES];
#pragma GCC unroll 16
    for (size_t l = 0; l < LANES; l++) {
      const float *at = x + (s + l) * x_row;
      part[l] = vf_load(at) * vf_load(w);
#pragma GCC unroll 16
      for (size_t c = LANES; c < width; c += LANES) part[l] += vf_load(at + c) * vf_load(w + c);
    }
    vf_store(out + s, rows_total(part));
  }
}

/* sum_c (times x(s, c))^2, lane by lane */
LANES_INLINE vf squares(const float *x, size_t x_row, const size_t width, const float times) {
  vf part[LANES];
#pragma GCC unroll 16
  for (size_t l = 0; l < LANES; l++) {
    const float *at = x + l * x_row;
    const vf first = vf_load(at) * times;
    part[l] = first * first;
#pragma GCC unroll 16
    for (size_t c = LANES; c < width; c += LANES) {
      const vf value = vf_load(at + c) * times;
      part[l] += value * value;
    }
  }
  return rows_total(part);
}

/* |x|_2 of each row */
LANES_INLINE void norms(float *out, const float *x, size_t x_row, const size_t width) {
  for (size_t s = 0; s < TILE; s += LANES) {
    const float *at = x + s * x_row;
    const vf sum = squares(at, x_row, width, 1);
    vf root = vf_sqrt(sum);
    if (__builtin_expect(vf_squares_leave_float(sum), 0))
      root = vf_root_of_any(sum, squares(at, x_row, width, VF_OF_HUGE), squares(at, x_row, width, VF_OF_TINY));
    vf_store(out + s, root);
  }
}

/* dw [width] += sum_s dy[s] x(s, .) */
LANES_INLINE void add_sums(float *dw, const float *dy, const float *x, size_t x_row, const size_t width) {
  vf sum[DENSITY / LANES];
#pragma GCC unroll 16
  for (size_t v = 0; v < width / LANES; v++) sum[v] = vf_load(dw + v * LANES);
  for (size_t s = 0; s < TILE; s++) {
    const vf factor = vf_all(dy[s]);
#pragma GCC unroll 16
    for (size_t v = 0; v < width / LANES; v++) sum[v] += factor * vf_load(x + s * x_row + v * LANES);
  }
#pragma GCC unroll 16
  for (size_t v = 0; v < width / LANES; v++) vf_store(dw + v * LANES, sum[v]);
}

/* out(s, c) = sum over the outputs o of dy(o, s) w(o, c), where the unit was active: x(s, c) > 0 */
LANES_INLINE void units_bwd(float *out, size_t out_row, const float *dy, const float *w, const float *x, size_t x_row,
                            const size_t outputs, const size_t width) {
  for (size_t s = 0; s < TILE; s++) {
#pragma GCC unroll 16
    for (size_t c = 0; c < width; c += LANES) {
      vf sum = vf_all(dy[s]) * vf_load(w + c);
#pragma GCC unroll 3
      for (size_t o = 1; o < outputs; o++) sum += vf_all(dy[o * TILE + s]) * vf_load(w + o * width + c);
      vf_store(out + s * out_row + c, vf_select(vf_load(x + s * x_row + c) <= 0, (vf){0}, sum));
    }
  }
}

/* out [TILE] = values[first ..] of count samples, then 0 */
static void take(float *out, const float *values, size_t first, size_t count) {
  for (size_t s = 0; s < TILE; s += LANES)
    vf_store(out + s, s < count ? vf_load_first(values + first + s, count - s) : (vf){0});
}
static void give(float *values, const float *tile, size_t first, size_t count) {
  for (size_t s = 0; s < count; s += LANES) vf_store_first(values + first + s, vf_load(tile + s), count - s);
}

#define EACH_VECTOR(s) for (size_t s = 0; s < TILE; s += LANES)

/* ---- encoding ---------------------------------------------------------------------------------------------------- */

/* Lane l becomes lane l ^ by, by < LANES. */
LANES_INLINE vf exchanged(vf value, uint32_t by) {
#define OTHER(l, d) ((l) ^ (d))
#define EXCHANGE(d) \
  if (by & (d)) value = __builtin_shufflevector(value, value, LANES_EACH(OTHER, d));
  ROWS_ROUNDS(EXCHANGE)
#undef EXCHANGE
#undef OTHER
  return value;
}

/* (c0, c1) is entry c0 ^ c1*prime modulo the size of the level (docs/maths.md, Tri-plane hash grids). The entries of a
 * register of c0 are one aligned group, permuted. */
static void unhash(float *value, const float *entries, const struct ern_grid_level *level) {
  const uint32_t side = level->resolution + 1, prime = 2654435761u, size = level->size;
  for (uint32_t c1 = 0; c1 < side; c1++, value += side) {
    const uint32_t key = c1 * prime, low = key % LANES;
    if ((size & (size - 1)) == 0) {
      for (uint32_t c0 = 0; c0 < side; c0 += LANES)
        vf_store(value + c0, exchanged(vf_load(entries + ((c0 ^ (key - low)) & (size - 1))), low));
    } else {
      for (uint32_t c0 = 0; c0 < side; c0++) value[c0] = entries[(c0 ^ key) % size];
    }
  }
}

/* Sets the features of planes on which the point is outside the cube to 0. */
static void clear_outside(float *f, const vi *inside, const struct ern_frame_net *grids) {
  for (size_t p = 0; p < ERN_PLANES; p++) {
    const vi *first = inside + (size_t)grids->axis[p][0] * (TILE / LANES);
    const vi *second = inside + (size_t)grids->axis[p][1] * (TILE / LANES);
    for (int l = 0; l < grids->levels; l++, f += TILE) {
      for (size_t k = 0; k < TILE / LANES; k++)
        vf_store(f + k * LANES, vf_select(first[k] & second[k], vf_load(f + k * LANES), (vf){0}));
    }
  }
}

/* Encodes the tiles from sample `first` on into t->f, up to ERN_TRAIN_TILES of them. */
static void encode(const struct ern_train_net *net, struct ern_train_tile *t, const float *x, size_t stride,
                   size_t first, size_t count) {
  const double began = ern_profile_now();
  const vf bound = vf_all(net->grids->bound);
  const size_t tiles = least((count - first + TILE - 1) / TILE, ERN_TRAIN_TILES);
  struct tile_places places[ERN_TRAIN_TILES];
  vi inside[ERN_TRAIN_TILES][3 * (TILE / LANES)];
  uint32_t outside[ERN_TRAIN_TILES] = {0};
  float *f[ERN_TRAIN_TILES];
  for (size_t i = 0; i < tiles; i++, first += TILE) {
    float tile[3 * TILE];
    f[i] = t->f[i];
    for (size_t axis = 0; axis < 3; axis++)
      take(tile + axis * TILE, x + axis * stride, first, least(count - first, TILE));
    for (size_t k = 0; k < 3 * (TILE / LANES); k++) {
      const vf value = vf_load(tile + k * LANES);
      inside[i][k] = (value >= -bound) & (value <= bound);
      outside[i] |= vi_bits(~inside[i][k]);
      vf_store(tile + k * LANES, vf_select(inside[i][k], value, (vf){0}));
    }
    tile_place(&places[i], tile, net->grids->bound);
  }
  encode_tiles(f, places, tiles, net->grids);
  for (size_t i = 0; i < tiles; i++) {
    if (outside[i] != 0) clear_outside(f[i], inside[i], net->grids);
  }
  t->encoding += ern_profile_now() - began;
}

/* ---- forward ----------------------------------------------------------------------------------------------------- */

/* out = x W, of the tile's rows. w: from net->factors */
static void layer(struct ern_train_tile *t, float *out, size_t out_row, const float *x, size_t x_row, const float *w,
                  size_t w_row, size_t outs, size_t ins, rows_finish finish) {
  const struct rows_factors a = factors_pair_columns(t->factors[0], x, x_row, ins);
  const struct rows_product p = {.out = out,
                                 .a = a.at,
                                 .b = w,
                                 .mask = out,
                                 .out_row = out_row,
                                 .a_row = a.row,
                                 .b_row = w_row,
                                 .rows = TILE,
                                 .columns = outs,
                                 .count = a.count,
                                 .finish = finish};
  rows_forward(&p);
}

/* Computes hidden units first .. last-1 from the features in t->ins. */
static void hidden_fwd(const struct ern_train_net *net, struct ern_train_tile *t, size_t first, size_t last) {
  layer(t, t->hidden + first, net->hidden, t->ins, net->in_row, net->factors + net->of_features + first, net->hidden,
        last - first, net->features, ROWS_RELU);
}

/* The hidden units of the attention, or their gradients, times the voice at each sample: v = W h has no bias, so that g
 * v = W (g h). */
static void fade(const struct ern_train_net *net, float *rows, const float *voice) {
  for (size_t s = 0; net->fades && s < TILE; s++) {
#pragma GCC unroll 16
    for (size_t c = 0; c < ATTENTION; c += LANES)
      vf_store(rows + s * net->hidden + c, vf_load(rows + s * net->hidden + c) * voice[s]);
  }
}

static void voice_of(const struct ern_train_net *net, struct ern_train_tile *t, const float *height, size_t first,
                     size_t count) {
  if (!net->fades) return;
  take(t->voice, height, first, count);
  EACH_VECTOR(s) vf_store(t->voice + s, vf_fade(vf_load(t->voice + s), net->fade));
}

/* Computes v and the eye attention; stores them after the features in t->ins. */
static void attention_fwd(const struct ern_train_net *net, struct ern_train_tile *t) {
  float *v = t->ins + net->features;
  fade(net, t->hidden, t->voice);
  layer(t, v, net->in_row, t->hidden, net->hidden, net->factors + net->attention, CODE, CODE, ATTENTION, ROWS_STORE);
  if (!net->eye) return;
  dots(t->eye_raw, t->hidden + net->eye_at, net->hidden, net->weights + net->eye_out, EYE);
  EACH_VECTOR(s) vf_store(t->eye + s, vf_sigmoid(vf_load(t->eye_raw + s)));
  for (size_t s = 0; s < TILE; s++) v[s * net->in_row + CODE] = t->eye[s];
}

static void uncertainty_fwd(const struct ern_train_net *net, struct ern_train_tile *t) {
  dots(t->unc_raw, t->hidden + net->unc_at, net->hidden, net->weights + net->unc_out, UNCERTAINTY);
}

/* hidden [TILE][row] */
static void density_fwd(const struct ern_train_net *net, struct ern_train_tile *t, float *hidden, size_t row) {
  layer(t, t->density0, DENSITY, t->ins, net->in_row, net->factors + net->density0, DENSITY, DENSITY, net->ins,
        ROWS_RELU);
  layer(t, hidden, row, t->density0, DENSITY, net->factors + net->density1, DENSITY, DENSITY, DENSITY, ROWS_RELU);
  dots(t->log_sigma, hidden, row, net->weights + net->sigma, DENSITY);
}

/* Writes the harmonics of sample s's ray, as many as the colour uses, and 1, after the hidden density; ray < 0: zeros
 */
static void put_harmonics(const struct ern_train_net *net, float *row, const float *harmonics, size_t stride,
                          int32_t ray) {
  for (size_t k = 0; k < net->harmonics; k++) row[DENSITY + k] = ray >= 0 ? harmonics[k * stride + (size_t)ray] : 0;
  row[DENSITY + net->harmonics] = 1;
}

static void colour_fwd(const struct ern_train_net *net, struct ern_train_tile *t) {
  layer(t, t->colour, COLOUR, t->colour_ins, COLOUR_ROW, net->factors + net->colour, COLOUR, COLOUR, net->colour_ins,
        ROWS_RELU);
  for (size_t c = 0; c < 3; c++)
    dots(t->rgb_raw + c * TILE, t->colour, COLOUR, net->weights + net->rgb + c * COLOUR, COLOUR);
}

/* The tile's features; the first tile of a group encodes the whole group. */
static void features_fwd(const struct ern_train_net *net, struct ern_train_tile *t, const float *x, size_t stride,
                         size_t first, size_t count) {
  const size_t tile = first / TILE % ERN_TRAIN_TILES;
  if (tile == 0) encode(net, t, x, stride, first, count);
  rows_of_channels(t->ins, net->in_row, t->f[tile], TILE, net->features);
}

static void density(const struct ern_train_net *net, struct ern_train_tile *t, const struct ern_train_density_args *a) {
  for (size_t first = 0; first < a->list.count; first += TILE) {
    const size_t count = least(a->list.count - first, TILE);
    features_fwd(net, t, a->x, a->x_stride, first, a->list.count);
    for (size_t s = 0; s < count && a->feature_rows != NULL; s++)
      copy_row(a->feature_rows + number_of(&a->list, first + s) * net->feature_row, t->ins + s * net->in_row,
               net->feature_row);
    voice_of(net, t, a->x, first, count);
    hidden_fwd(net, t, 0, net->scene_hidden);
    attention_fwd(net, t);
    if (a->norm != NULL) {
      norms(t->norm, t->ins + net->features, net->in_row, CODE);
      give(a->norm, t->norm, first, count);
    }
    if (a->eye != NULL) give(a->eye, t->eye, first, count);
    density_fwd(net, t, a->hidden != NULL ? a->hidden + first * DENSITY : t->d_density1, DENSITY);
    EACH_VECTOR(s) {
      const vf value = vf_load(t->log_sigma + s);
      vf_store(t->log_sigma + s, vf_exp(vf_select(value > 80, vf_all(80), value)));
    }
    give(a->sigma, t->log_sigma, first, count);
  }
}

static void colour(const struct ern_train_net *net, struct ern_train_tile *t, const struct ern_train_colour_args *a) {
  for (size_t first = 0; first < a->list.count; first += TILE) {
    const size_t count = least(a->list.count - first, TILE);
    for (size_t s = 0; s < TILE; s++) {
      const size_t at = first + (s < count ? s : 0);
      float *row = t->colour_ins + s * COLOUR_ROW;
      copy_row(row, a->hidden + (size_t)a->place[at] * DENSITY, DENSITY);
      put_harmonics(net, row, a->harmonics, a->sh_stride, a->ray[number_of(&a->list, at)]);
    }
    colour_fwd(net, t);
    for (size_t c = 0; c < 3; c++) {
      float *raw = t->rgb_raw + c * TILE;
      EACH_VECTOR(s) vf_store(raw + s, 1.002f * vf_sigmoid(vf_load(raw + s)) - 0.001f);
      give(a->rgb + c * a->stride, raw, first, count);
    }
  }
}

static void uncertainty(const struct ern_train_net *net, struct ern_train_tile *t,
                        const struct ern_train_uncertainty_args *a) {
  for (size_t first = 0; first < a->list.count; first += TILE) {
    rows_of_list(t->ins, net->in_row, a->feature_rows, net->feature_row, &a->list, first);
    hidden_fwd(net, t, net->unc_at, net->hidden);
    uncertainty_fwd(net, t);
    EACH_VECTOR(s) vf_store(t->unc_raw + s, vf_softplus(vf_load(t->unc_raw + s)));
    give(a->unc, t->unc_raw, first, least(a->list.count - first, TILE));
  }
}

/* ---- backward ---------------------------------------------------------------------------------------------------- */

/* gradient [ins][outs] += x^T dy */
static void add_weights(struct ern_train_tile *t, float *gradient, size_t gradient_row, const float *x, size_t x_row,
                        size_t ins, const float *dy, size_t dy_row, size_t outs) {
  const struct rows_factors a = factors_pair_rows(t->factors[0], x, x_row, TILE, ern_net_aligned(ins));
  const struct rows_factors b = factors_pair_rows(t->factors[1], dy, dy_row, TILE, outs);
  const struct rows_product p = {.out = gradient,
                                 .a = a.at,
                                 .b = b.at,
                                 .mask = gradient,
                                 .out_row = gradient_row,
                                 .a_row = a.row,
                                 .b_row = b.row,
                                 .rows = ins,
                                 .columns = outs,
                                 .count = a.count,
                                 .finish = ROWS_ADD};
  rows_sums(&p);
}

/* out = dy W, where the unit was active: x > 0 */
static void layer_bwd(struct ern_train_tile *t, float *out, size_t out_row, const float *dy, size_t dy_row, size_t outs,
                      const float *w, size_t ins, const float *x, size_t x_row) {
  const struct rows_factors a = factors_pair_columns(t->factors[0], dy, dy_row, outs);
  const struct rows_product p = {.out = out,
                                 .a = a.at,
                                 .b = w,
                                 .mask = x,
                                 .out_row = out_row,
                                 .a_row = a.row,
                                 .b_row = ins,
                                 .mask_row = x_row,
                                 .rows = TILE,
                                 .columns = ins,
                                 .count = a.count,
                                 .finish = ROWS_MASK};
  rows_forward(&p);
}

static float *gradient_rgb(struct ern_train_tile *t) { return t->gradient; }
static float *gradient_density(struct ern_train_tile *t) { return t->gradient + 3 * TILE; }
static float *gradient_eye(struct ern_train_tile *t) { return t->gradient + 4 * TILE; }
static float *gradient_unc(struct ern_train_tile *t) { return t->gradient + 5 * TILE; }

/* Backward pass from the gradients of rgb_raw and of the log density to those of features, eye attention and v. */
static void scene_bwd(const struct ern_train_net *net, struct ern_train_tile *t, float *gradient) {
  const float *w = net->weights;
  for (size_t c = 0; c < 3; c++)
    add_sums(gradient + net->rgb + c * COLOUR, t->gradient + c * TILE, t->colour, COLOUR, COLOUR);
  add_sums(gradient + net->sigma, gradient_density(t), t->colour_ins, COLOUR_ROW, DENSITY);
  units_bwd(t->d_colour, D_COLOUR_ROW, gradient_rgb(t), w + net->rgb, t->colour, COLOUR, 3, COLOUR);
  for (size_t s = 0; s < TILE; s++) t->d_colour[s * D_COLOUR_ROW + COLOUR] = gradient_density(t)[s];
  add_weights(t, gradient + net->colour, COLOUR, t->colour_ins, COLOUR_ROW, net->colour_ins, t->d_colour, D_COLOUR_ROW,
              COLOUR);
  layer_bwd(t, t->d_density1, DENSITY, t->d_colour, D_COLOUR_ROW, COLOUR + 1, net->factors + net->colour_back, DENSITY,
            t->colour_ins, COLOUR_ROW);
  add_weights(t, gradient + net->density1, DENSITY, t->density0, DENSITY, DENSITY, t->d_density1, DENSITY, DENSITY);
  layer_bwd(t, t->d_density0, DENSITY, t->d_density1, DENSITY, DENSITY, net->factors + net->density1_back, DENSITY,
            t->density0, DENSITY);
  add_weights(t, gradient + net->density0, DENSITY, t->ins, net->in_row, net->ins, t->d_density0, DENSITY, DENSITY);
  layer(t, t->d_features, net->gradient_row, t->d_density0, DENSITY, net->factors + net->features_back,
        net->gradient_row, net->gradient_row, DENSITY, ROWS_STORE);
  layer(t, t->d_v, CODE, t->d_density0, DENSITY, net->factors + net->v_back, CODE, CODE, DENSITY, ROWS_ADD);
}

/* d_v(s, .) = dnorm v/|v|, 0 at v = 0; where 1/|v| may be no float, both are scaled up before */
static void norm_bwd(const struct ern_train_net *net, struct ern_train_tile *t, const float *dnorm) {
  for (size_t s = 0; s < TILE; s++) {
    const float scale = t->norm[s] < 0x1p-60f ? 0x1p100f : 1, norm = t->norm[s] * scale;
    const vf factor = vf_all(t->norm[s] == 0 ? 0 : dnorm[s] / norm);
    const float *v = t->ins + s * net->in_row + net->features;
#pragma GCC unroll 8
    for (size_t c = 0; c < CODE; c += LANES) vf_store(t->d_v + s * CODE + c, factor * (vf_load(v + c) * scale));
  }
}

/* Backward pass from the gradients of v, eye_raw and unc_raw to the features; adds to d_features. */
static void attention_bwd(const struct ern_train_net *net, struct ern_train_tile *t, float *gradient,
                          rows_finish finish) {
  const float *w = net->weights;
  add_weights(t, gradient + net->attention, CODE, t->hidden, net->hidden, ATTENTION, t->d_v, CODE, CODE);
  layer_bwd(t, t->d_hidden, net->hidden, t->d_v, CODE, CODE, net->factors + net->attention_back, ATTENTION, t->hidden,
            net->hidden);
  fade(net, t->d_hidden, t->voice);
  if (net->eye) {
    const float *hidden = t->hidden + net->eye_at;
    add_sums(gradient + net->eye_out, gradient_eye(t), hidden, net->hidden, EYE);
    units_bwd(t->d_hidden + net->eye_at, net->hidden, gradient_eye(t), w + net->eye_out, hidden, net->hidden, 1, EYE);
  }
  const float *hidden = t->hidden + net->unc_at;
  add_sums(gradient + net->unc_out, gradient_unc(t), hidden, net->hidden, UNCERTAINTY);
  units_bwd(t->d_hidden + net->unc_at, net->hidden, gradient_unc(t), w + net->unc_out, hidden, net->hidden, 1,
            UNCERTAINTY);
  add_weights(t, gradient + net->of_features, net->hidden, t->ins, net->in_row, net->features, t->d_hidden, net->hidden,
              net->hidden);
  layer(t, t->d_features, net->gradient_row, t->d_hidden, net->hidden, net->factors + net->hidden_back,
        net->gradient_row, net->gradient_row, net->scene_hidden, finish);
}

/* Multiplies the outputs' gradients by the activations' derivatives. The density's are clamped as in the public code.
 */
static void outputs_bwd(const struct ern_train_net *net, struct ern_train_tile *t,
                        const struct ern_train_backward_args *a, size_t first, size_t count) {
  for (size_t c = 0; c < 3; c++) {
    float *gradient = gradient_rgb(t) + c * TILE;
    take(gradient, a->drgb + c * a->rgb_stride, first, count);
    EACH_VECTOR(s)
    vf_store(gradient + s,
             vf_load(gradient + s) * (1.002f * vf_sigmoid_derivative(vf_load(t->rgb_raw + c * TILE + s))));
  }
  take(gradient_density(t), a->dsigma, first, count);
  take(gradient_unc(t), a->dunc, first, count);
  EACH_VECTOR(s) {
    float *density_gradient = gradient_density(t) + s, *unc_gradient = gradient_unc(t) + s;
    vf_store(density_gradient, vf_load(density_gradient) * vf_exp(vf_clamp(vf_load(t->log_sigma + s), -15, 15)));
    vf_store(unc_gradient, vf_load(unc_gradient) * vf_sigmoid(vf_load(t->unc_raw + s)));
  }
  if (net->eye) take(gradient_eye(t), a->deye, first, count);
}

static void eye_bwd(const struct ern_train_net *net, struct ern_train_tile *t) {
  float *gradient = gradient_eye(t);
  for (size_t s = 0; s < TILE; s++) gradient[s] += t->d_features[s * net->gradient_row + net->features];
  EACH_VECTOR(s) vf_store(gradient + s, vf_load(gradient + s) * vf_sigmoid_derivative(vf_load(t->eye_raw + s)));
}

static void backward(const struct ern_train_net *net, struct ern_train_tile *t,
                     const struct ern_train_backward_args *a) {
  float dnorm[TILE];
  for (size_t first = 0; first < a->list.count; first += TILE) {
    const size_t count = least(a->list.count - first, TILE);
    rows_of_list(t->ins, net->in_row, a->feature_rows, net->feature_row, &a->list, first);
    voice_of(net, t, a->x, first, count);
    hidden_fwd(net, t, 0, net->hidden);
    attention_fwd(net, t);
    uncertainty_fwd(net, t);
    norms(t->norm, t->ins + net->features, net->in_row, CODE);
    density_fwd(net, t, t->colour_ins, COLOUR_ROW);
    for (size_t s = 0; s < TILE; s++)
      put_harmonics(net, t->colour_ins + s * COLOUR_ROW, a->harmonics, a->sh_stride,
                    s < count ? a->ray[first + s] : -1);
    colour_fwd(net, t);

    outputs_bwd(net, t, a, first, count);
    take(dnorm, a->dnorm, first, count);
    norm_bwd(net, t, dnorm);
    scene_bwd(net, t, a->gradient);
    for (size_t k = 0; a->dsh != NULL && k < net->harmonics; k++)
      dots(a->dsh + k * a->stride + first, t->d_colour, D_COLOUR_ROW,
           net->weights + net->colour + (DENSITY + k) * COLOUR, COLOUR);
    if (net->eye) eye_bwd(net, t);
    attention_bwd(net, t, a->gradient, ROWS_ADD);
    channels_of_rows(a->df + first, a->stride, t->d_features, net->gradient_row, net->features);
  }
}

/* ---- smoothness -------------------------------------------------------------------------------------------------- */

/* gradient = factor (moved - still), 0 past count; *sum += the squares */
static void difference(float *gradient, double *sum, const float *moved, const float *still, float factor, size_t first,
                       size_t count) {
  for (size_t s = 0; s < TILE; s++) {
    const float by = s < count ? moved[s] - still[first + s] : 0;
    gradient[s] = factor * by;
    *sum += (double)by * (double)by;
  }
}

static void smooth(const struct ern_train_net *net, struct ern_train_tile *t, struct ern_train_smooth_args *a) {
  float dnorm[TILE];
  for (size_t first = 0; first < a->count; first += TILE) {
    const size_t count = least(a->count - first, TILE);
    features_fwd(net, t, a->x, a->x_stride, first, a->count);
    for (size_t s = count; s < TILE; s++) clear_row(t->ins + s * net->in_row, net->feature_row);
    voice_of(net, t, a->x, first, count);
    hidden_fwd(net, t, 0, net->hidden);
    attention_fwd(net, t);
    norms(t->norm, t->ins + net->features, net->in_row, CODE);
    uncertainty_fwd(net, t);
    difference(dnorm, &a->sum[0], t->norm, a->norm, a->factor, first, count);
    if (net->eye) {
      difference(gradient_eye(t), &a->sum[1], t->eye, a->eye, a->factor, first, count);
      EACH_VECTOR(s)
      vf_store(gradient_eye(t) + s, vf_load(gradient_eye(t) + s) * vf_sigmoid_derivative(vf_load(t->eye_raw + s)));
    }
    float unc[TILE];
    EACH_VECTOR(s) vf_store(unc + s, vf_softplus(vf_load(t->unc_raw + s)));
    difference(gradient_unc(t), &a->sum[2], unc, a->unc, a->factor, first, count);
    EACH_VECTOR(s) vf_store(gradient_unc(t) + s, vf_load(gradient_unc(t) + s) * vf_sigmoid(vf_load(t->unc_raw + s)));
    norm_bwd(net, t, dnorm);
    attention_bwd(net, t, a->gradient, ROWS_STORE);
    channels_of_rows(a->df + first, a->stride, t->d_features, net->gradient_row, net->features);
  }
}

/* ---- weights ----------------------------------------------------------------------------------------------------- */

#if defined(ERN_TILE_PAIRS)
static void pair_weights(const struct ern_train_net *net, float *factors) {
  const struct {
    size_t at, ins, outs;
  } matrix[] = {{net->of_features, net->features, net->hidden},
                {net->attention, ATTENTION, CODE},
                {net->density0, net->ins, DENSITY},
                {net->density1, DENSITY, DENSITY},
                {net->colour, net->colour_ins, COLOUR},
                {net->colour_back, COLOUR + 1, DENSITY},
                {net->density1_back, DENSITY, DENSITY},
                {net->features_back, DENSITY, net->gradient_row},
                {net->v_back, DENSITY, CODE},
                {net->attention_back, CODE, ATTENTION},
                {net->hidden_back, net->scene_hidden, net->gradient_row}};
  for (size_t m = 0; m < sizeof matrix / sizeof *matrix; m++) {
    const size_t at = matrix[m].at;
    factors_pair_rows(factors + at, net->weights + at, matrix[m].outs, matrix[m].ins, matrix[m].outs);
  }
}
#define PAIR_WEIGHTS pair_weights
#else
#define PAIR_WEIGHTS NULL
#endif

const struct ern_train_kernels ERN_ISA(ern_train_kernels) = {unhash,   density, colour,      uncertainty,
                                                             backward, smooth,  PAIR_WEIGHTS};
