/* SPDX-License-Identifier: MIT
 * The head's networks in the layout of the fused training step: a tile's samples are rows (gemm_rows.h), so the weights
 * are stored input-major, [ins][outs].
 *
 * Three parts are folded into other weights (exact but for rounding); their gradients are unfolded at the end of the
 * step:
 *  - the audio code a and the eye value e, one of each a step, into the density's first layer: its inputs are v and the
 *    eye attention themselves; dW = a G and da = sum_j W G, where G is the gradient of the folded weights;
 *  - the last density layer without its first row, Wg, and the colour's weights of the geometry, Wc, between which
 *    there is no activation: M = Wc Wg; dWg = Wc^T dM and dWc = dM Wg^T;
 *  - the individual code, one a step, into a bias of the colour's hidden layer. */
#ifndef ERN_STEP_NET_H
#define ERN_STEP_NET_H

#include "backend_cpu/fused/frame_net.h"

enum {
  ERN_NET_ATTENTION = 64, /* hidden units */
  ERN_NET_EYE = 16,
  ERN_NET_UNCERTAINTY = 32,
  ERN_NET_DENSITY = 64,
  ERN_NET_COLOUR = 64,
  ERN_NET_MAX_FEATURES = ERN_PLANES * ERN_GRID_MAX_LEVELS,
  ERN_NET_ALIGNED = 16 /* rows are a multiple of this many reals */
};

static inline size_t ern_net_aligned(size_t count) {
  return (count + ERN_NET_ALIGNED - 1) / ERN_NET_ALIGNED * ERN_NET_ALIGNED;
}

/* Offsets of the weight matrices in one block. The forward weights come first; a block of gradients has the layout of
 * these. */
struct ern_train_net {
  size_t features;       /* D3 */
  size_t feature_row;    /* D3 aligned */
  size_t ins, in_row;    /* inputs of the density MLP: features, v, eye attention */
  size_t hidden;         /* hidden units whose inputs are the features: attention, eye, uncertainty */
  size_t scene_hidden;   /* those of them whose gradient is passed on to the features: attention, eye */
  size_t eye_at, unc_at; /* first hidden unit of eye, of uncertainty */
  size_t harmonics;      /* spherical harmonics of the direction, inputs of the colour MLP: 16 or 0 */
  size_t colour_ins;     /* inputs of the colour MLP: hidden density, harmonics, 1 */
  size_t gradient_row;   /* width of the features' gradient followed by that of the eye attention, aligned */
  bool eye, fades;
  const float *fade; /* of attention_fade, where `fades` is set */

  size_t of_features; /* [features][hidden] */
  size_t attention;   /* [64][32] */
  size_t density0;    /* [ins][64] */
  size_t density1;    /* [64][64] */
  size_t colour;      /* [colour_ins][64] */
  size_t sigma;       /* [64] */
  size_t rgb;         /* [3][64] */
  size_t eye_out;     /* [16] */
  size_t unc_out;     /* [32] */
  size_t forward;     /* reals of the forward weights: the size of a block of gradients */

  size_t colour_back;    /* [64 + 1][64]: from the colour's hidden units and the density back to the hidden density */
  size_t density1_back;  /* [64][64] */
  size_t features_back;  /* [64][gradient_row] */
  size_t v_back;         /* [64][32] */
  size_t attention_back; /* [32][64] */
  size_t hidden_back;    /* [scene_hidden][gradient_row] */
  size_t count;
  const float *weights; /* the block */
  const float *factors; /* the block as products read it: `weights`, or its pairs of bf16 (simd/gemm_factors.h) */
  const struct ern_frame_net *grids; /* only its unhashed levels are used */
};

/* False where the layers are not those of the head: then the step runs the separate stages. */
bool ern_train_net_plan(struct ern_train_net *net, const struct ern_field *field);

/* Inputs of the folding beside the weights. */
struct ern_train_fold {
  const struct ern_field *field;
  const float *parameters;
  const float *code; /* [32] */
  float eye;
  size_t individual;
};

/* block: [net->count] */
void ern_train_net_fill(struct ern_train_net *net, float *block, const struct ern_train_fold *fold);

/* dparameters and dcode [32] += the gradients of the weights, from those of the folded ones [net->forward].
 * ern_train_net_unfold leaves out the colour's first layer; ern_train_net_unfold_colour does that layer alone. */
void ern_train_net_unfold(float *dparameters, float *dcode, const float *gradient, const struct ern_train_net *net,
                          const struct ern_train_fold *fold);
void ern_train_net_unfold_colour(float *dparameters, const float *gradient, const struct ern_train_net *net,
                                 const struct ern_train_fold *fold);

#endif
