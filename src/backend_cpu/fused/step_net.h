/* SPDX-License-Identifier: MIT
 * The head's networks as a fused training step multiplies by them: a tile's samples are rows (gemm_rows.h), so the
 * weights lie input by input.
 *
 * Three things are folded, exactly but for rounding, and their gradients unfolded at the end of the step:
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
  ERN_NET_ALIGNED = 16 /* rows are a whole number of so many reals */
};

static inline size_t ern_net_aligned(size_t count) {
  return (count + ERN_NET_ALIGNED - 1) / ERN_NET_ALIGNED * ERN_NET_ALIGNED;
}

/* Where the weights begin in the block. The forward ones come first: a block of gradients has their layout. */
struct ern_train_net {
  size_t features;       /* D3 */
  size_t feature_row;    /* D3 aligned */
  size_t ins, in_row;    /* of the density: features, v, eye attention */
  size_t hidden;         /* hidden units that look at the features: attention, eye, uncertainty */
  size_t scene_hidden;   /* of them, those whose gradient reaches the features: attention, eye */
  size_t eye_at, unc_at; /* first hidden unit of these */
  size_t harmonics;      /* of the direction, that the colour reads: 16 or 0 */
  size_t colour_ins;     /* of the colour: hidden density, harmonics, 1 */
  size_t slope_row;      /* the features' gradient, that of the eye attention behind it, aligned */
  bool eye;

  size_t of_features; /* [features][hidden] */
  size_t attention;   /* [64][32] */
  size_t density0;    /* [ins][64] */
  size_t density1;    /* [64][64] */
  size_t colour;      /* [colour_ins][64] */
  size_t sigma;       /* [64] */
  size_t rgb;         /* [3][64] */
  size_t eye_out;     /* [16] */
  size_t unc_out;     /* [32] */
  size_t forward;     /* reals so far: of a block of gradients */

  size_t colour_back;    /* [64 + 1][64]: the colour's hidden units and the density to the hidden density */
  size_t density1_back;  /* [64][64] */
  size_t features_back;  /* [64][slope_row] */
  size_t v_back;         /* [64][32] */
  size_t attention_back; /* [32][64] */
  size_t hidden_back;    /* [scene_hidden][slope_row] */
  size_t count;
  const float *weights;              /* the block */
  const float *factors;              /* as products read it: itself, or in pairs of bf16 (simd/gemm_factors.h) */
  const struct ern_frame_net *grids; /* of it, the unhashed levels alone */
};

/* False where the layers are not those of the head: then the step goes through the stages. */
bool ern_train_net_plan(struct ern_train_net *net, const struct ern_field *field);

/* What the folding needs beside the weights. */
struct ern_train_fold {
  const struct ern_field *field;
  const float *parameters;
  const float *code; /* [32] */
  float eye;
  size_t individual;
};

/* block: [net->count] */
void ern_train_net_fill(struct ern_train_net *net, float *block, const struct ern_train_fold *fold);

/* dparameters and dcode [32] += the gradients of the weights, from those of the folded ones [net->forward]: all but
 * those of the colour's first layer, and those alone. */
void ern_train_net_unfold(float *dparameters, float *dcode, const float *gradient, const struct ern_train_net *net,
                          const struct ern_train_fold *fold);
void ern_train_net_unfold_colour(float *dparameters, const float *gradient, const struct ern_train_net *net,
                                 const struct ern_train_fold *fold);

#endif
