/* SPDX-License-Identifier: MIT
 * The kernels of the fused training step: the head's networks over lists of samples, forward, and backward, which
 * recomputes the hidden values. Float only; one set of kernels for each instruction set. */
#ifndef ERN_STEP_KERNELS_H
#define ERN_STEP_KERNELS_H

#include "backend_cpu/fused/step_net.h"
#include "mlp/mlp_tile.h"

/* A thread's work memory: a tile's values and gradients, a row a sample. */
enum { ERN_TRAIN_TILES = 4 /* encoded together */ };
enum { ERN_TRAIN_HIDDEN = ERN_NET_ATTENTION + ERN_NET_EYE + ERN_NET_UNCERTAINTY };
struct ern_train_tile {
  _Alignas(64) float f[ERN_TRAIN_TILES][ERN_NET_MAX_FEATURES * ERN_MLP_TILE]; /* by channel */
  float ins[ERN_MLP_TILE * 112];                                              /* features, v, eye attention */
  float hidden[ERN_MLP_TILE * ERN_TRAIN_HIDDEN];                              /* of attention, eye, uncertainty */
  float density0[ERN_MLP_TILE * ERN_NET_DENSITY];                             /* hidden */
  float colour_ins[ERN_MLP_TILE * 96];                                        /* hidden density, harmonics, 1 */
  float colour[ERN_MLP_TILE * ERN_NET_COLOUR];                                /* hidden */
  float d_colour[ERN_MLP_TILE * 80];                /* gradients: of colour, followed by that of the log density */
  float d_density1[ERN_MLP_TILE * ERN_NET_DENSITY]; /* of the density's second hidden layer */
  float d_density0[ERN_MLP_TILE * ERN_NET_DENSITY]; /* of its first */
  float d_features[ERN_MLP_TILE * 80];              /* of features, followed by that of the eye attention */
  float d_v[ERN_MLP_TILE * ERN_AUDIO_CODE];
  float d_hidden[ERN_MLP_TILE * ERN_TRAIN_HIDDEN];
  /* by channel: (c, s) at c*ERN_MLP_TILE + s */
  float voice[ERN_MLP_TILE]; /* g of attention_fade, where the net has it */
  float norm[ERN_MLP_TILE], log_sigma[ERN_MLP_TILE], eye_raw[ERN_MLP_TILE], eye[ERN_MLP_TILE], unc_raw[ERN_MLP_TILE];
  float rgb_raw[3 * ERN_MLP_TILE];
  float gradient[6 * ERN_MLP_TILE];         /* of rgb_raw, log_sigma, eye_raw, unc_raw */
  float factors[2][ERN_MLP_TILE * 128 / 2]; /* factors of a product, in pairs of bf16 */
  double encoding;                          /* seconds spent encoding, accumulated */
};

/* Samples s = 0 .. count-1 of a list. "By list": indexed by s. "By number": indexed by the sample's number index[s]
 * (NULL: s itself). */
struct ern_train_list {
  const int32_t *index;
  size_t count;
};

/* x: [3] by list at x_stride; outside the cube features are 0. feature_rows: output, [number][feature_row]; NULL: not
 * stored. By list: sigma, norm, eye, hidden [64] a sample (with room for whole tiles); NULL: not wanted. */
struct ern_train_density_args {
  struct ern_train_list list;
  const float *x;
  size_t x_stride;
  float *feature_rows, *sigma, *norm, *eye, *hidden;
};
typedef void ern_train_density_kernel(const struct ern_train_net *net, struct ern_train_tile *tile,
                                      const struct ern_train_density_args *args);

/* hidden: rows of the density kernel, place[s] is the row of sample s. harmonics: [16] per ray at sh_stride, `ray` by
 * number. rgb: [3] by list, at `stride`. */
struct ern_train_colour_args {
  struct ern_train_list list;
  const int32_t *place, *ray;
  const float *hidden, *harmonics;
  size_t sh_stride;
  float *rgb;
  size_t stride;
};
typedef void ern_train_colour_kernel(const struct ern_train_net *net, struct ern_train_tile *tile,
                                     const struct ern_train_colour_args *args);

/* unc, by list. */
struct ern_train_uncertainty_args {
  struct ern_train_list list;
  const float *feature_rows;
  float *unc;
};
typedef void ern_train_uncertainty_kernel(const struct ern_train_net *net, struct ern_train_tile *tile,
                                          const struct ern_train_uncertainty_args *args);

/* gradient [net->forward] += the gradient of all weights; df [features][stride] by list, with room for whole tiles, and
 * dsh [16][stride], the gradient of the harmonics (NULL: not wanted). The outputs' gradients are by list. feature_rows
 * and harmonics as above; ray by list. deye NULL: no eye branch. */
struct ern_train_backward_args {
  struct ern_train_list list;
  const int32_t *ray;
  const float *x; /* [3] by list, at `stride` */
  const float *feature_rows, *harmonics;
  const float *dsigma, *drgb, *dnorm, *deye, *dunc;
  float *gradient, *df, *dsh;
  size_t sh_stride, rgb_stride, stride;
};
typedef void ern_train_backward_kernel(const struct ern_train_net *net, struct ern_train_tile *tile,
                                       const struct ern_train_backward_args *args);

/* Smoothness loss: factor (moved - still) is the gradient of each of |v|, eye attention and uncertainty at the moved
 * points x [3]. df [features][stride], with room for whole tiles. The sums of the squared differences are added to sum.
 * eye NULL: no eye branch. */
struct ern_train_smooth_args {
  size_t count;
  const float *x;
  size_t x_stride;
  const float *norm, *eye, *unc; /* at the unmoved points */
  float factor;
  float *gradient, *df;
  size_t stride;
  double sum[3]; /* in and out */
};
typedef void ern_train_smooth_kernel(const struct ern_train_net *net, struct ern_train_tile *tile,
                                     struct ern_train_smooth_args *args);

/* value [side][side] = a level, unhashed: (c0, c1) at c0 + c1*side, side = resolution + 1. May write up to one register
 * past its end. */
typedef void ern_train_unhash_kernel(float *value, const float *entries, const struct ern_grid_level *level);

/* factors [net->count] = net->weights in pairs of bf16, for net->factors; each matrix begins at the same offset as in
 * `weights`. */
typedef void ern_train_pair_weights_kernel(const struct ern_train_net *net, float *factors);

struct ern_train_kernels {
  ern_train_unhash_kernel *unhash;
  ern_train_density_kernel *density;
  ern_train_colour_kernel *colour;
  ern_train_uncertainty_kernel *uncertainty;
  ern_train_backward_kernel *backward;
  ern_train_smooth_kernel *smooth;
  ern_train_pair_weights_kernel *pair_weights; /* NULL: products are of floats */
};

extern const struct ern_train_kernels ern_train_kernels_avx2, ern_train_kernels_avx512, ern_train_kernels_neon;
extern const struct ern_train_kernels ern_train_kernels_avx512bf16; /* products of pairs of bf16, sums in float */

#endif
