/* SPDX-License-Identifier: MIT
 * How the MLP kernels lay out their scratch: all of them work on a tile of samples, (c, i) at c*ERN_MLP_TILE + i. */
#ifndef ERN_MLP_TILE_H
#define ERN_MLP_TILE_H

#include "mlp/mlp_ops.h"

enum {
  ERN_MLP_TILE = 48, /* samples: three registers of 16 lanes, or a multiple of three of 8 or 4; rows of 3 cache lines */
  ERN_MLP_LANES = 16 /* most lanes of an instruction set: rows of inputs are padded to it */
};

static inline size_t ern_mlp_padded(int width) {
  return ((size_t)width + ERN_MLP_LANES - 1) / ERN_MLP_LANES * ERN_MLP_LANES;
}

/* Where the parts begin, in reals; each on a cache line. */
struct ern_mlp_layout {
  size_t value[ERN_MLP_MAX_LAYERS + 1]; /* tile of the input, of each hidden layer, of the output */
  size_t gradient[2];                   /* tiles of gradients, as wide as the widest layer */
  size_t transposed;                    /* [tile][padded widest]: a tile of values, transposed: sample by sample */
  size_t dweight[ERN_MLP_MAX_LAYERS];   /* [outputs][padded inputs] */
  size_t count;                         /* of all parts */
};

static inline struct ern_mlp_layout ern_mlp_layout_make(const struct ern_mlp *mlp) {
  struct ern_mlp_layout layout = {.count = 0};
  int widest = 0;
  for (int l = 0; l <= mlp->layers; l++) {
    if (mlp->width[l] > widest) widest = mlp->width[l];
    layout.value[l] = layout.count;
    layout.count += (size_t)mlp->width[l] * ERN_MLP_TILE;
  }
  for (int k = 0; k < 2; k++) {
    layout.gradient[k] = layout.count;
    layout.count += (size_t)widest * ERN_MLP_TILE;
  }
  layout.transposed = layout.count;
  layout.count += ern_mlp_padded(widest) * ERN_MLP_TILE;
  for (int l = 0; l < mlp->layers; l++) {
    layout.dweight[l] = layout.count;
    layout.count += (size_t)mlp->width[l + 1] * ern_mlp_padded(mlp->width[l]);
  }
  return layout;
}

/* Reals of scratch that a forward or backward kernel of any instruction set needs. */
static inline size_t ern_mlp_scratch(const struct ern_mlp *mlp) { return ern_mlp_layout_make(mlp).count; }

#endif
